"""The measurements of a drive through the product's own poses and record: what the likelihood takes."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from tilth.estimator.calibration.changes import Changes, heard_after
from tilth.estimator.pose import aligner, receiver_checks
from tilth.estimator.pose.pose import poses
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Record, Segment, concatenate
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Flag, Measurement, Position
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.reasons import Code


@dataclass(frozen=True, slots=True)
class CalibrationRecordTuning:
    """Records of a calibration drive."""

    longest: int = tuned(150, "segments", "of 0.2 s in one record")
    shortest: int = tuned(40, "segments", "a shorter record is not fitted")
    loose_m: float = tuned(0.2, "m", "of the survey: a rough file refuses nothing")
    latency_sd: float = tuned(0.001, "s", "the poses' own search for receivers with other latencies is held")
    """It takes a hitch that stands elsewhere for latency, and the likelihood would then agree: on 150 s of
    driving tractor.c came out 6 cm off."""


CALIBRATION_RECORDS: Final = CalibrationRecordTuning()


@dataclass(frozen=True, slots=True)
class FollowedRecords:
    """Records, in the order of driving, and why there are not more."""

    records: tuple[Record, ...]
    refused: dict[Code, int]  # reason -> segments
    flags: Counter[Flag]  # of how many poses
    poses: int


def loosened(machine: Machine) -> Machine:
    """The same rig, of which less is taken for known: so poses of a rough file are not refused."""
    receivers = [
        r.model_copy(
            update={
                "survey_sd": max(r.survey_sd, CALIBRATION_RECORDS.loose_m),
                "latency": Quantity(value=r.latency.value, sd=CALIBRATION_RECORDS.latency_sd),
            }
        )
        for r in machine.receiver
    ]
    return machine.model_copy(update={"receiver": receivers})


def follow(machine: Machine, measurements: Iterable[Measurement], changes: Changes) -> FollowedRecords:
    """Poses and records by a machine file that has the changes in it."""
    loose = loosened(machine)
    state, checks = aligner.initial(loose), receiver_checks.ReceiverChecks()
    record = record_builder.initial(loose)
    segments: list[Segment | None] = []
    flags: Counter[Flag] = Counter()
    for one in measurements:
        measurement = heard_after(one, changes)
        if not aligner.is_number(measurement):
            continue
        aligner.take(state, measurement)
        if not isinstance(measurement, Position) or measurement.origin.mount is None or not state.due_ns:
            continue
        for pose in poses(state, measurement.rx_ns):
            receiver_checks.observe(checks, state, pose)
            aligner.leave_out_turn_rates(state, receiver_checks.lagging(checks))
            flags.update((*pose.flags, *receiver_checks.flags(checks)))
            segments.append(record_builder.observe(record, state, pose))
    return FollowedRecords(tuple(_records(segments)), dict(record.refused), flags, len(segments))


def _records(segments: Iterable[Segment | None]) -> list[Record]:
    """Stretches without a gap, cut to `longest`."""
    found: list[Record] = []
    stretch: list[Segment] = []
    for segment in (*segments, None):
        sound = segment if segment is not None and not segment.reason else None
        if stretch and (sound is None or not sound.follows or len(stretch) == CALIBRATION_RECORDS.longest):
            if len(stretch) >= CALIBRATION_RECORDS.shortest:
                found.append(concatenate(stretch))
            stretch = []
        if sound is not None:
            stretch.append(sound)
    return found
