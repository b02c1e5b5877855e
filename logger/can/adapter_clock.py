"""Puts the stamps of an adapter's own clock on the clock of a run."""

RISE = 10_000  # the adapter may be slower than the computer by 1 in so many: worse than any crystal
RESET_NS = 1_000_000_000  # a jump by more than this: it has begun to count anew


class AdapterClock:
    """A frame reaches the computer late and never early: the smallest (arrival - stamp) is the offset.

    It is let rise slowly, so that it follows an adapter whose clock is slow; one that is fast pulls it down.
    """

    def __init__(self) -> None:
        self._offset_ns: int | None = None
        self._arrival_ns = 0

    def rx_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """When the adapter received a frame, ns on the clock of arrival_ns: when it reached the computer."""
        now_ns = arrival_ns - stamp_ns
        if self._offset_ns is None:
            self._offset_ns = now_ns
        else:
            risen_ns = self._offset_ns + (arrival_ns - self._arrival_ns) // RISE
            self._offset_ns = now_ns if abs(now_ns - risen_ns) > RESET_NS else min(now_ns, risen_ns)
        self._arrival_ns = arrival_ns
        return stamp_ns + self._offset_ns
