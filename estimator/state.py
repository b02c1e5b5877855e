"""The whole state of the fold."""

from dataclasses import dataclass, field
from typing import Any

from tilth.estimator.diagnosis.diagnosis import RigDiagnosis
from tilth.estimator.diagnosis.strange_implement import StrangeImplement
from tilth.estimator.methods.open_tracker import OpenTracker
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.recognition import Recognition
from tilth.estimator.record.record import Segment
from tilth.estimator.record.record_builder import RecordState
from tilth.estimator.state_json import NOT_STORED
from tilth.estimator.warm_start import SavedPosterior
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Accepted, Carried, Estimate, Flag, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.rejections import Rejection


@dataclass(frozen=True, slots=True)
class ScaleWord:
    """What a scale says, averaged over seconds."""

    t_ns: int
    mass: float  # kg, of what the implement carries


@dataclass(frozen=True, slots=True)
class WaitingPose:
    """What the estimators take of one pose."""

    pose: Pose
    segment: Segment | None  # of the record, that it completed
    judged: bool  # whether what is found then is found of the machine file


@dataclass(slots=True)
class State:
    """The whole state of the fold. `step` changes it in place; nothing else does."""

    machine: Machine = field(metadata=NOT_STORED)  # with what its implement carries
    empty: Machine = field(metadata=NOT_STORED)  # without
    file: Machine = field(metadata=NOT_STORED)  # as that, without the lengths that driving has found
    decoder: Decoder = field(metadata=NOT_STORED)  # but in a form of its own
    aligner: Aligner
    record: RecordState
    open: OpenTracker  # whose evidence the diagnosis weighs
    estimators: dict[str, Any]  # method -> state of that row of ESTIMATORS
    diagnosis: RigDiagnosis = field(default_factory=RigDiagnosis)  # is the machine file right
    strange: StrangeImplement = field(default_factory=StrangeImplement)  # one that nobody has described
    accepted: list[Accepted] = field(default_factory=list)  # values in `machine` that its file does not have
    carried: Carried | None = None  # by the implement; None where its file has no [implement.load]
    scale: ScaleWord | None = None
    walked_ns: int = 0  # until when it is counted in that a load may have changed that nobody weighs
    drove_ns: int = 0  # when the rig was last seen to drive; 0: not in this run
    stood_ns: int = 0  # when it drove off after the last stop in which its load may have changed; 0: no such
    previous_run: dict[str, SavedPosterior] = field(default_factory=dict)
    """Method -> what the run before had learned, from which this run has started."""
    previous_run_ns: int = 0  # when that run had saved them
    frames: int = 0
    measurements: int = 0
    poses: int = 0
    ready: bool = True  # whether the estimators run; poses and record do not wait for kernels to be compiled
    waiting: list[WaitingPose] = field(
        default_factory=list
    )  # what the estimators have not taken yet, in order
    clock_steps: int = 0
    not_numbers: int = 0  # measurements refused because a value is not finite
    time: LogTime = field(default_factory=LogTime)  # of the log
    recognition: Recognition = field(default_factory=Recognition)  # of receivers that claim no address
    flags: tuple[Flag, ...] = ()  # of the last pose
    flag_times: dict[str, int] = field(default_factory=dict)  # flag -> how often it has begun, of OFTEN
    place: tuple[float, float, float, float] | None = None
    """At the last pose: latitude and longitude of the origin, deg, and x and y of the tractor, m."""
    disagree: bool = False  # whether the methods disagree
    segments: list[Segment | None] = field(default_factory=list, metadata=NOT_STORED)
    """What each pose of the last frame completed; for who analyses a drive afterwards."""
    estimates: dict[str, Estimate] = field(default_factory=dict, metadata=NOT_STORED)
    """Method -> latest estimate, as published."""

    @property
    def latest_ns(self) -> int:
        """Greatest t_ns since the last step back of the log's clock."""
        return self.time.latest_ns

    @property
    def rejected(self) -> dict[str, int]:
        """Reason -> count, of frames and measurements that were not used."""
        counts = self.decoder.rejected | self.aligner.screens.rejected
        if self.aligner.lateness.late:
            counts[Rejection.LATE] = self.aligner.lateness.late
        if self.clock_steps:
            counts[Rejection.CLOCK_STEP] = self.clock_steps
        if self.time.stray:
            counts[Rejection.OTHER_TIME] = self.time.stray
        if self.not_numbers:
            counts[Rejection.NOT_A_NUMBER] = self.not_numbers
        return counts
