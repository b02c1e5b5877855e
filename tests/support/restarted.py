"""Parts of a drive behind a restart, and what a fold makes of them."""

from collections.abc import Sequence
from functools import cache

from logs import MACHINE

from tilth.estimator import fold
from tilth.schemas.flow import Event, Frame, Mount, Pose
from tilth.schemas.identity import KnownAddress
from tilth.schemas.sentences import event_sentence
from tilth.simulator.traffic import simulate

SECOND = 1_000_000_000
NAMES = {receiver.mount: receiver.name for receiver in MACHINE.receiver}


@cache
def drive() -> tuple[Frame, ...]:
    """Forty seconds, address claims at the beginning."""
    return tuple(simulate(MACHINE, 5, 40.0))


@cache
def right() -> dict[Mount, int]:
    """Where the receivers stand in it."""
    state = fold.initial(MACHINE)
    for frame in drive()[:2000]:
        state.decoder.measurements(frame)
    return {known.mount: known.source for known in state.decoder.addresses.known() if known.mount is not None}


def from_s(seconds: float, until_s: float = 99.0) -> list[Frame]:
    """That part of the drive."""
    t_ns = drive()[0].t_ns
    return [f for f in drive() if seconds <= (f.t_ns - t_ns) * 1e-9 < until_s]


def exchanged(sources: Sequence[int], last_ns: int = 0) -> list[KnownAddress]:
    """That the receivers, in the order of Mount, have these addresses."""
    return [
        KnownAddress("can0", source, NAMES[mount], mount, last_ns)
        for mount, source in zip(Mount, sources, strict=True)
    ]


class Followed:
    """What a fold makes of frames."""

    def __init__(
        self, frames: Sequence[Frame], known: Sequence[KnownAddress] = (), ready: bool = False
    ) -> None:
        self.state = fold.initial(MACHINE)
        self.state.ready = ready
        fold.recall(self.state, known)
        self.events: list[str] = []
        self.whole = 0  # poses of both bodies
        self.wrong = 0  # of them with a receiver in another's place
        self.first_s: float | None = None
        self.frames = frames
        for frame in frames:
            self.take(frame)

    def take(self, frame: Frame) -> None:
        for publication in fold.step(self.state, frame):
            value = publication.value
            if isinstance(value, Event):
                self.events.append(f"{value.kind}: {event_sentence(value)}")
            if isinstance(value, Pose) and None not in (value.tractor.heading, value.implement.heading):
                known = self.state.decoder.addresses.known()
                here = {one.mount: one.source for one in known if one.mount is not None}
                self.whole += 1
                self.wrong += here != right()
                if self.first_s is None:
                    self.first_s = (frame.t_ns - self.frames[0].t_ns) * 1e-9

    def said(self, text: str) -> bool:
        return any(event.startswith("addresses: ") and text in event for event in self.events)
