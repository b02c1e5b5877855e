"""What cannot be calibrated, and the sentence for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration import drive as drives
from tilth.estimator.calibration import faults as finding
from tilth.estimator.calibration.changes import BODIES
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.faults import RigFault
from tilth.estimator.calibration.initial_guess import DrivingCoverage
from tilth.estimator.calibration.records import FollowedRecords
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import FixType
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Reason
from tilth.schemas.sentences import sentence


@dataclass(frozen=True, slots=True)
class RefusalTuning:
    """Which drives tell too little."""

    least_records_s: float = tuned(40.0, "s", "of driving that can be fitted")
    least_turned_s: float = tuned(10.0, "s", "of it with turned wheels")
    other_rig_m: float = tuned(1.0, "m", "beyond what two positions by a tape are wrong")


REFUSALS: Final = RefusalTuning()


class CannotCalibrate(Exception):
    """The drive tells nothing; one sentence that says why, and what to do. faults: found meanwhile."""

    def __init__(self, text: str, faults: Sequence[RigFault] = ()) -> None:
        super().__init__(text)
        self.faults = tuple(faults)


def check_receivers(machine: Machine, heard: drives.MeasuredLists) -> None:
    """Raises CannotCalibrate."""
    missing = [mount.value for k, mount in enumerate(MOUNTS) if len(heard.positions[k]) < 2]
    names = {r.mount for r in machine.receiver}
    if len(names) < 4:
        raise CannotCalibrate(
            f"the machine file has {len(names)} receivers; calibrating takes two on the tractor and two on "
            "the implement"
        )
    if len(missing) == len(MOUNTS):
        raise CannotCalibrate(
            "none of the receivers of the machine file is in the drive: the file may be of another rig, or "
            "name other devices than those that send; `tilth discover LOG` lists who is there"
        )
    if missing:
        raise CannotCalibrate(
            f"no position of {', '.join(missing)} is in the drive: the log is of another rig, or the machine "
            "file names other devices; `tilth discover LOG` lists who is there"
        )
    without = [
        mount.value for k, mount in enumerate(MOUNTS) if heard.fixes[k] and _fixed_share(heard.fixes[k]) < 0.5
    ]
    if without:
        raise CannotCalibrate(
            f"{', '.join(without)} had no RTK fix for most of the drive; lengths of centimetres need one: "
            "check the correction service and drive again"
        )


def check_wheel(heard: drives.MeasuredLists) -> None:
    """Raises CannotCalibrate."""
    if len(heard.wheel) < 2:
        text = (
            "no wheel angle is in the drive: [wheel_angle] of the machine file fits no message; "
            "`tilth discover LOG` lists candidates"
        )
        raise CannotCalibrate(text, [RigFault(finding.WHEEL_UNREAD, "wheel_angle", text)])


def _fixed_share(fixes: dict[FixType, int]) -> float:
    good = fixes.get(FixType.RTK_FIXED, 0)
    return good / max(sum(fixes.values()), 1)


def check_records(followed: FollowedRecords, faults: Sequence[RigFault]) -> None:
    """Raises CannotCalibrate."""
    seconds = sum(len(record.ticks) for record in followed.records) * 0.02
    if seconds >= REFUSALS.least_records_s:
        return
    said = [fault.text for fault in faults]
    refused = followed.refused
    most = sentence(Reason(max(refused, key=refused.__getitem__))) if refused else "nothing was driven"
    raise CannotCalibrate(
        f"only {seconds:.0f} s of the drive can be learned from; most of it is refused: {most}"
        + (f". Found meanwhile: {'; '.join(said)}" if said else ""),
        faults,
    )


def check_lengths(longer: NDArray[np.float64]) -> None:
    """longer: m, by which receivers of either body are further apart than the file says, (2,)."""
    for body, by in zip(BODIES, longer.tolist(), strict=True):
        if abs(by) > REFUSALS.other_rig_m:
            how = "further apart" if by > 0.0 else "closer"
            raise CannotCalibrate(
                f"the {body}'s receivers are {abs(by):.1f} m {how} than in the machine file: it is "
                "of another rig, or their positions are wrong by more than a tape is"
            )


def check_turned(coverage: DrivingCoverage) -> None:
    if coverage.left + coverage.right < REFUSALS.least_turned_s:
        raise CannotCalibrate(
            "the drive has rows only: without turns nothing is told of wheel, levers, hitch and drawbar; "
            "drive slow circles to both sides"
        )
