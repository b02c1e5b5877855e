"""One bus as it is at the moment: its connection, its traffic, its outages."""

import threading
from dataclasses import dataclass, field
from enum import StrEnum

from tilth.logger.back_off import BackOff
from tilth.logger.can.port import Port, StampedBy, Tally
from tilth.schemas.machine import Bus

RENEW_NS = 10_000_000_000  # a silent bus is opened afresh after this: some die without an error
RENEW_MOST_NS = 60_000_000_000
BACK_OFF_NS = 500_000_000
BACK_OFF_MOST_NS = 5_000_000_000
HANGING = 4  # openings of one bus that may hang at a time
NOT_YET = "not open yet"


class BusState(StrEnum):
    """The words are those of tilth.BusStatus."""

    OPEN = "open"
    SILENT = "silent"
    FAILED = "failed"


@dataclass(slots=True)
class Connection:
    """The open port, or the attempts to get one."""

    port: Port | None = None
    descriptor: int | None = None  # that the selector waits for
    opened: int = 0  # how often
    opened_ns: int = 0
    opening: bool = False
    opening_began_ns: int = 0  # when the opening began
    attempt: int = 0
    threads: list[threading.Thread] = field(default_factory=list)  # that open or close
    back_off: BackOff = field(default_factory=lambda: BackOff(BACK_OFF_NS, BACK_OFF_MOST_NS))
    renew_ns: int = RENEW_NS

    def begin_attempt(self, t_ns: int) -> int:
        """Begin an attempt to open the bus. Returns its number: results of earlier attempts are discarded."""
        self.opening = True
        self.opening_began_ns = t_ns
        self.attempt += 1
        return self.attempt

    def give_up(self) -> None:
        """Wait no longer for the attempt under way."""
        self.opening = False
        self.attempt += 1

    def adopt(self, port: Port, t_ns: int) -> None:
        """An attempt has succeeded."""
        self.port = port
        self.opened += 1
        self.opened_ns = t_ns

    def may_retry(self, t_ns: int) -> bool:
        """Whether the next attempt is due at t_ns."""
        return self.back_off.is_due(t_ns) and len(self.threads) < HANGING

    def works(self) -> None:
        """A frame has come: what fails from now on is a new failure."""
        self.back_off.worked()
        self.renew_ns = RENEW_NS

    def wants_renewing(self, silent_ns: int) -> bool:
        """Whether a bus that has been silent for so long should be opened afresh now."""
        if self.port is None or not self.port.renewable or silent_ns < self.renew_ns:
            return False
        self.renew_ns = min(silent_ns + 2 * self.renew_ns, silent_ns + RENEW_MOST_NS)
        return True


@dataclass(slots=True)
class Traffic:
    """What has come, and when."""

    frames: int = 0
    frames_per_s: float = 0.0
    stamp: StampedBy | None = None  # of the frames that came last; None before the first
    lost: int = 0  # dropped by the kernel, as far as it says
    last_ns: int = 0  # last frame of any kind, or opening
    usable_ns: int = 0  # last frame that is taken, or opening
    empty_reads: int = 0  # one after the other
    _lost_before: int = 0  # by sockets closed since
    _frames_before: int = 0  # when the rate was last counted
    _data_frames_before: int = 0  # at the last look

    def count_rate(self, seconds: float) -> None:
        """Set the rate of the frames since the last call, `seconds` ago."""
        self.frames_per_s = (self.frames - self._frames_before) / seconds
        self._frames_before = self.frames

    def count_lost(self, port: Port) -> int:
        """How many were lost since the last call."""
        lost = self._lost_before + port.lost()
        new = max(lost - self.lost, 0)
        self.lost += new
        return new

    def port_released(self) -> None:
        """The next port counts from zero again."""
        self._lost_before = self.lost

    def data_has_come(self, error_frames: int) -> bool:
        """Whether frames other than error frames have come since the last call. error_frames: until now."""
        data_frames = self.frames - error_frames
        came = data_frames != self._data_frames_before
        self._data_frames_before = data_frames
        return came


@dataclass(slots=True)
class Outages:
    """Failures and silences: how many, since when, and what was reported of them."""

    failures: int = 0
    failing: bool = False  # one is counted and reported; until frames come, or it has been open for a while
    silences: int = 0
    down_ns: int = 0  # when frames ended because it failed; 0 while they come
    _reported: str = ""  # last problem
    _noted: set[str] = field(default_factory=set)

    def begin_failure(self, t_ns: int) -> None:
        """Count a failure, unless one is under way since an earlier t_ns."""
        if not self.failing:
            self.failing = True
            self.failures += 1
        self.down_ns = self.down_ns or t_ns

    def end_failure(self) -> None:
        """The next failure counts as a new one."""
        self.failing = False
        self._reported = ""

    def is_news(self, problem: str) -> bool:
        """Whether this problem differs from the one reported last. It counts as reported from now on."""
        news = problem != self._reported
        self._reported = problem
        return news

    def forget_reported(self) -> None:
        self._reported = ""

    def is_first(self, note: str) -> bool:
        """Whether this note, worth an event once in a run, was never reported."""
        first = note not in self._noted
        self._noted.add(note)
        return first


@dataclass(slots=True, eq=False)
class LiveBus:
    config: Bus
    tally: Tally = field(default_factory=Tally)
    state: BusState = BusState.FAILED
    reason: str = NOT_YET  # of the state, for a person
    connection: Connection = field(default_factory=Connection)
    traffic: Traffic = field(default_factory=Traffic)
    outages: Outages = field(default_factory=Outages)

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def untried(self) -> bool:
        """Whether the first opening is still under way."""
        return self.connection.opened == 0 and self.outages.failures == 0

    @property
    def unusable(self) -> str:
        """Which kinds of frame arrived that cannot be used, and what to do; "" where there are none."""
        tally = self.tally
        kinds = [name for name, n in (("CAN FD", tally.fd_frames), ("remote", tally.remote_frames)) if n]
        return f"only {' and '.join(kinds)} frames, which are not read; check the channel" if kinds else ""

    @property
    def problem(self) -> str:
        """The worst problem, in words, with what to do; "" where there is none."""
        port = self.connection.port
        if port is None:
            return self.reason
        return self.tally.health.problem or port.problem or self.reason

    def is_now(self, state: BusState, reason: str = "") -> None:
        """Set the state, and its reason in words."""
        self.state, self.reason = state, reason
