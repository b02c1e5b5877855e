"""What a machine file has structurally wrong, found without being told: kinds, and sentences for people."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.changes import BODIES, BODY, Changes
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.initial_guess import Pairs
from tilth.estimator.calibration.least_squares import Solved
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Flag, FlagKind

Array = NDArray[np.float64]

REVERSED, SWAPPED = "reversed_pair", "swapped"
WHEEL_SIGN, WHEEL_SCALE, WHEEL_UNREAD = "wheel_sign", "wheel_scale", "wheel_unread"
YAW_SIGN, ROLL_SIGN, ROLL_CORRECTED = "yaw_rate_sign", "roll_sign", "roll_corrected"
SMOOTHED: Final = "smoothed_yaw_rate"


@dataclass(frozen=True, slots=True)
class FaultTuning:
    """What no error of a linkage is, but of the description."""

    gross_gain: float = tuned(1.35, "1", "scales beyond this, or below its inverse, are of the description")
    turning: float = tuned(0.03, "rad/s", "sd of a body's turn rate: enough to compare signs")
    explained: float = tuned(0.9, "1", "of the wheel angle's variance: less is no wheel angle")
    share: float = tuned(0.5, "1", "of the turn rate: less than minus this says that the sign is wrong")


FAULTS: Final = FaultTuning()


@dataclass(frozen=True, slots=True)
class RigFault:
    """One that was found, and that the changed file does not have any more unless it says so."""

    kind: str
    of: str  # a mount, a body, a key
    text: str  # what was found, and what to do or what was changed


def assignment_faults(assignment: tuple[int, ...]) -> list[RigFault]:
    """Of receivers that stand elsewhere than the file says. assignment: as Changes.assignment."""
    found = []
    for body, (front, rear) in enumerate(((0, 1), (2, 3))):
        if (assignment[front], assignment[rear]) == (rear, front):
            found.append(
                RigFault(
                    REVERSED, BODIES[body],
                    f"the {BODIES[body]}'s receivers are exchanged: the one that the file calls front "
                    "drives behind; mount and position are exchanged in the file",
                )
            )  # fmt: skip
    if {BODY[k] for k in assignment[:2]} != {0}:
        moved = [f"{MOUNTS[assignment[k]]} stands at {MOUNTS[k]}" for k in range(4) if assignment[k] != k]
        found.append(
            RigFault(
                SWAPPED, "receiver",
                f"receivers are not on the body that the file says: {', '.join(moved)}; mount and position "
                "are exchanged in the file",
            )
        )  # fmt: skip
    return found


def yaw_rate_signs(view: Pairs) -> tuple[tuple[int, ...], list[RigFault]]:
    """Signs of the receivers' turn rates against those of the bodies' headings."""
    signs, found = [1, 1, 1, 1], []
    for k, body in enumerate(BODY):
        rows = np.isfinite(view.gyro[:, k]) & np.isfinite(view.rate[:, body]) & view.known
        rate = view.rate[rows, body]
        if np.count_nonzero(rows) < 100 or np.std(rate) < FAULTS.turning:
            continue
        slope = float(rate @ view.gyro[rows, k] / (rate @ rate))
        if slope < -FAULTS.share:
            signs[k] = -1
            text = f"the turn rate of {MOUNTS[k]} has the wrong sign; yaw_rate_sign is turned in the file"
            found.append(RigFault(YAW_SIGN, MOUNTS[k].value, text))
    return tuple(signs), found


def roll_sign_faults(signs: tuple[int, ...]) -> list[RigFault]:
    """Of roll.Rolls.sign."""
    return [
        RigFault(
            ROLL_SIGN, MOUNTS[k].value,
            f"the roll of {MOUNTS[k]} has the wrong sign: on the same ground it leans the other way than the "
            "others; roll_sign is turned in the file",
        )
        for k in range(4) if signs[k] < 0
    ]  # fmt: skip


def wheel_faults(found: Solved, explained: float) -> list[RigFault]:
    """Of initial_guess.wheel and initial_guess.explained."""
    gain = float(found.value[1])
    if explained < FAULTS.explained:
        text = (
            "the wheel angle does not go with the way that is driven: another message, byte order, start "
            "byte or signedness is right ([wheel_angle])"
        )
        return [RigFault(WHEEL_UNREAD, "wheel_angle", text)]
    faults = []
    if gain < 0.0:
        text = "the wheel angle has the wrong sign; wheel_angle.sign is turned in the file"
        faults.append(RigFault(WHEEL_SIGN, "wheel_angle.sign", text))
    if not 1 / FAULTS.gross_gain < abs(gain) < FAULTS.gross_gain:
        text = f"the wheel angle reads {abs(gain):.3g} times the true one; scale is changed in the file"
        faults.append(RigFault(WHEEL_SCALE, "wheel_angle.scale", text))
    return faults


_CORRECTED: Final = {FlagKind.ROLL_CORRECTED_TWICE: True, FlagKind.NOT_ROLL_CORRECTED: False}


def receiver_faults(flags: dict[Flag, int], poses: int) -> list[RigFault]:
    """Of the flags of a drive's poses; a flag of a few poses at the beginning counts not."""
    found = []
    for flag, count in sorted(flags.items()):
        if count < 0.2 * poses:
            continue
        if flag.kind in _CORRECTED:
            right = str(_CORRECTED[flag.kind]).lower()
            text = f"roll_corrected of {flag.of} should be {right}; it is changed in the file"
            found.append(RigFault(ROLL_CORRECTED, flag.of, text))
        elif flag.kind is FlagKind.ROLL_CORRECTION:
            text = (
                "roll_corrected is wrong on one of the bodies; the drive does not tell on which, look it up"
            )
            found.append(RigFault(ROLL_CORRECTED, "receiver", text))
        elif flag.kind is FlagKind.SMOOTHED_YAW_RATE:
            text = f"the turn rate of {flag.of} is smoothed and is not used; turn its smoothing off"
            found.append(RigFault(SMOOTHED, flag.of, text))
    return found


def corrected(changes: Changes, faults: list[RigFault], flags: dict[Flag, int]) -> tuple[bool | None, ...]:
    """Changes.roll_corrected after these faults."""
    found = list(changes.roll_corrected)
    named = {fault.of for fault in faults if fault.kind == ROLL_CORRECTED}
    for flag in flags:
        if flag.kind in _CORRECTED and flag.of in named:
            found[[mount.value for mount in MOUNTS].index(flag.of)] = _CORRECTED[flag.kind]
    return tuple(found)
