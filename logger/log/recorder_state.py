"""The states of the recorder, and the one place where one follows another."""

from collections.abc import Mapping
from enum import Enum, auto

from tilth.schemas.flow import EventKind
from tilth.schemas.notices import NoticeCode, Report, notice
from tilth.schemas.sentences import notice_sentence


class RecorderState(Enum):
    RECORDING = auto()  # what is written reaches the disk
    SLOW = auto()  # the disk does not answer at the moment; the log waits in memory
    TRYING = auto()  # a file was begun after a failure; nothing of it is on the disk yet
    STOPPED = auto()  # no file can be written; another one is tried later
    RESTING = auto()  # ignition is off; the next frame begins a run
    RESTING_UNSURE = auto()  # the same, and the last file may not have reached the disk
    ENDED = auto()  # the last file is finished


class Happening(Enum):
    FILE_BEGUN = auto()
    ON_DISK = auto()  # something of the file has reached the disk
    DISK_SLOW = auto()
    FILE_FAILED = auto()  # nothing more can be written into this file
    EARLIER_FAILED = auto()  # a finished file turns out never to have been made
    IGNITION_OFF = auto()
    END = auto()  # the file was finished because the recorder is closed


_S, _H = RecorderState, Happening
NEXT: Mapping[tuple[RecorderState, Happening], RecorderState] = {
    (_S.RECORDING, _H.DISK_SLOW): _S.SLOW,
    (_S.RECORDING, _H.FILE_FAILED): _S.STOPPED,
    (_S.RECORDING, _H.EARLIER_FAILED): _S.TRYING,
    (_S.RECORDING, _H.IGNITION_OFF): _S.RESTING,
    (_S.RECORDING, _H.END): _S.ENDED,
    (_S.SLOW, _H.ON_DISK): _S.RECORDING,
    (_S.SLOW, _H.FILE_FAILED): _S.STOPPED,
    (_S.SLOW, _H.EARLIER_FAILED): _S.TRYING,
    (_S.SLOW, _H.IGNITION_OFF): _S.RESTING,
    (_S.SLOW, _H.END): _S.ENDED,
    (_S.TRYING, _H.ON_DISK): _S.RECORDING,
    (_S.TRYING, _H.FILE_FAILED): _S.STOPPED,
    (_S.TRYING, _H.IGNITION_OFF): _S.RESTING_UNSURE,
    (_S.TRYING, _H.END): _S.STOPPED,
    (_S.STOPPED, _H.FILE_BEGUN): _S.TRYING,
    (_S.RESTING, _H.FILE_BEGUN): _S.RECORDING,
    (_S.RESTING, _H.EARLIER_FAILED): _S.RESTING_UNSURE,
    (_S.RESTING_UNSURE, _H.FILE_BEGUN): _S.TRYING,
    (_S.ENDED, _H.EARLIER_FAILED): _S.STOPPED,
}
"""What is not listed changes nothing: a file that is rotated while the disk is slow leaves it slow."""

FAILING = (_S.TRYING, _S.STOPPED, _S.RESTING_UNSURE)
"""States in which frames are lost, or may be; entering one is reported."""


class RecorderStates:
    """The recorder's state, and what a person should know of it."""

    def __init__(self, report: Report) -> None:
        self.state = RecorderState.RECORDING
        self.problem = ""  # in words; "" where all is well
        self._report = report

    @property
    def resting(self) -> bool:
        """Ignition is off: the next frame begins a run."""
        return self.state in (RecorderState.RESTING, RecorderState.RESTING_UNSURE)

    @property
    def recording(self) -> bool:
        """What comes is written, and what was written before is on the disk or only waits for it."""
        return self.state in (RecorderState.RECORDING, RecorderState.SLOW)

    def after(self, happening: Happening) -> None:
        """Go to the state that follows."""
        self.state = NEXT.get((self.state, happening), self.state)
        if self.state not in FAILING and self.state is not RecorderState.SLOW:
            self.problem = ""

    def slow(self, problem: str) -> None:
        """The disk does not answer. A failure that has not ended is the worse problem of the two."""
        self.after(Happening.DISK_SLOW)
        if self.state is RecorderState.SLOW:
            self.problem = problem

    def failed(self, happening: Happening, why: str) -> None:
        """FILE_FAILED or EARLIER_FAILED. An event says so, one for all tries until one of them succeeds."""
        known = self.state in FAILING
        self.after(happening)
        stopped = notice(NoticeCode.NOT_RECORDING, why=why)
        self.problem = notice_sentence(stopped)
        if not known:
            self._report(EventKind.LOG, stopped)
