"""How long to wait before the next try: twice as long after each failure, up to a limit."""


class BackOff:
    def __init__(self, first_ns: int, longest_ns: int) -> None:
        self._first_ns = first_ns
        self._longest_ns = longest_ns
        self._wait_ns = first_ns
        self.retry_at_ns = 0

    def failed(self, t_ns: int) -> None:
        """A try failed at t_ns."""
        self.retry_at_ns = t_ns + self._wait_ns
        self._wait_ns = min(2 * self._wait_ns, self._longest_ns)

    def worked(self) -> None:
        """The next failure is a new one: the wait begins short again."""
        self._wait_ns = self._first_ns

    def is_due(self, t_ns: int) -> bool:
        """Whether it is time to try again."""
        return t_ns >= self.retry_at_ns
