"""The machine file by what a drive tells: first in closed form, then by the likelihood until it stands.

A pure function of the machine file and the measurements: live and at the desk it is the same.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration import drive as drives
from tilth.estimator.calibration import faults as finding
from tilth.estimator.calibration import initial_guess, joint, linkage, sought_numbers
from tilth.estimator.calibration.assignment import assign
from tilth.estimator.calibration.changes import (
    Changes,
    applied,
    further_wheel,
    linkage_of,
    named,
    not_early,
    wheel_after,
)
from tilth.estimator.calibration.drive import MOUNTS, DriveGrid
from tilth.estimator.calibration.faults import RigFault
from tilth.estimator.calibration.initial_guess import DrivingCoverage, Pairs
from tilth.estimator.calibration.joint import JointFit
from tilth.estimator.calibration.least_squares import Solved
from tilth.estimator.calibration.records import FollowedRecords, follow
from tilth.estimator.calibration.refusals import CannotCalibrate as CannotCalibrate
from tilth.estimator.calibration.refusals import (
    check_lengths,
    check_receivers,
    check_records,
    check_turned,
    check_wheel,
)
from tilth.estimator.calibration.roll import Rolls, rolls
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT, MASSES, NAMES, SHAPE
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Measurement
from tilth.schemas.limits import LIMITS
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]  # what is done, share of all

AS_STATED: Final = (None,) * 4  # roll_corrected of each receiver is what the file says


@dataclass(frozen=True, slots=True)
class CalibrationTuning:
    """How a drive is fitted."""

    looks: int = tuned(3, "rounds", "of the initial guess")
    most_fits: int = tuned(3, "fits", "each about the file that the one before gives")
    stands: float = tuned(0.5, "sd", "a fit that moves no number further ends it")
    roll_floor: float = tuned(math.radians(0.05), "rad", "sd of zeros of roll: bench/calibration.py")
    lateral_offset_floor: float = tuned(0.004, "m", "sd of lateral offsets that such zeros leave")


CALIBRATION: Final = CalibrationTuning()

STEPS: Final = ((6, 0), (3, joint.JOINT.most_steps), (0, joint.JOINT.most_steps))
"""At most, of each fit: with noise levels, and with these held."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a drive tells of a rig."""

    changes: Changes
    machine: Machine  # after the changes, sds as before
    faults: tuple[RigFault, ...]
    rolls: Rolls
    roll_sd: Array  # rad, (4,)
    lateral_offset_sd: float  # m, of what stands aside on the tractor
    hitch_sd: tuple[float, float]  # m, of hitch and drawbar by where the bodies see the hitch
    delay_sd: Array  # s, (3,): of how much later one receiver of a pair is, tractor first; one body
    speed: float  # m/s, rms: what is late moves things along the way by it
    fit: JointFit
    moved: dict[str, float]  # name of a number -> SI, by how much the file was moved
    coverage: DrivingCoverage
    records_s: float
    refused: dict[Code, int]
    hitch_gap: float  # m, sd of the distance between the hitch as seen from either body
    curve_sd: float  # 1/rad, of wheel_angle.curve


def calibrate(machine: Machine, measurements: Sequence[Measurement], progress: Progress) -> Calibration:
    """measurements: of the whole drive, in their order, as this machine file makes them. Raises
    CannotCalibrate."""
    looked = _looked(machine, measurements, progress)
    drive, changes, faults = looked.drive, looked.changes, looked.faults
    view, found_rolls, followed = looked.view, looked.rolls, looked.followed
    check_records(followed, faults)
    fit: JointFit | None = None
    for k in range(CALIBRATION.most_fits):
        now = applied(machine, changes)
        mean, sd = sought_numbers.wide(now, np.maximum(found_rolls.sd, CALIBRATION.roll_floor))
        moved = _moved(machine, changes)
        mean, sd = _centred(now, mean, sd, moved)
        start = mean.copy() if fit is None else _from(fit, mean)
        fit = joint.fit(
            followed.records, rig_setup(now), mean, sd, start, SOUGHT, _of_fit(progress, k), *STEPS[k]
        )
        changes = _taken(machine, changes, fit)
        changes = _by_the_hitch(machine, drive, changes, found_rolls)
        size = _largest(fit)
        if k == CALIBRATION.most_fits - 1 or (k > 0 and size < CALIBRATION.stands):
            break
        followed = follow(applied(machine, changes), measurements, changes)
    assert fit is not None
    share = float(np.clip(1.0 - fit.mean[AT["parallel"]], *LIMITS["tractor.ackermann"].range))
    changes = replace(changes, ackermann=share - machine.tractor.ackermann.value)
    placed = _placed(drive, changes)
    after = _view(applied(machine, changes), placed, changes, found_rolls)
    gap = initial_guess.hitch(after)
    return Calibration(
        changes, applied(machine, changes), tuple(faults), found_rolls,
        np.maximum(found_rolls.sd, CALIBRATION.roll_floor), _lateral_offset_sd(gap.sds[1], fit, machine),
        (float(gap.sds[0]), float(gap.sds[2])), _late_sd(placed, after, gap), _speed(after), fit,
        _moved(machine, changes), initial_guess.coverage(view), fit.seconds, followed.refused, gap.sd,
        looked.curve_sd,
    )  # fmt: skip


def _of_fit(progress: Progress, k: int) -> joint.Progress:
    return lambda steps, size: progress(f"fit {k + 1}, step {steps}", 0.2 + 0.25 * k + 0.015 * steps)


def look(machine: Machine, measurements: Sequence[Measurement]) -> list[RigFault]:
    """What is structurally wrong, without the numbers. Raises CannotCalibrate, too."""
    return _looked(machine, measurements, lambda what, share: None).faults


@dataclass(frozen=True, slots=True)
class TractorMotion:
    """How the tractor moves, by its receivers alone: n instants, drive.STEP_S apart."""

    t_ns: NDArray[np.int64]  # on the clock of Frame.rx_ns, as far as the file's latencies are right
    speed: Array  # m/s, of the middle of its receivers, not a number where it is not known
    yaw_rate: Array  # rad/s
    wheelbase: float  # m


def tractor_motion(machine: Machine, measurements: Sequence[Measurement]) -> TractorMotion:
    """For who looks for the wheel angle. Raises CannotCalibrate."""
    heard = drives.MeasuredLists()
    for measurement in measurements:
        drives.take(heard, measurement)
    check_receivers(machine, heard)
    drive = drives.drive_of(heard, machine)
    changes = Changes(assignment=assign(drive, machine).assignment)
    view = _view(applied(machine, changes), _placed(drive, changes), changes, None)
    t_ns = (heard.first_ns or 0) + np.round(drive.t * 1e9).astype(np.int64)
    base = machine.tractor.wheelbase
    return TractorMotion(t_ns, view.along[:, 0], view.rate[:, 0], base)


def _by_geometry(
    machine: Machine, drive: DriveGrid, corrected: tuple[bool | None, ...] = AS_STATED
) -> tuple[Changes, list[RigFault], Pairs, Rolls, float]:
    """What needs no likelihood, and the sd of the linkage's curvature. corrected: Changes.roll_corrected."""
    changes, faults, view, found = _initial_guess(machine, drive, corrected)
    changes, curve_sd = _with_linkage(machine, drive, changes, view, found)
    faults += linkage.kingpin_faults(changes.linkage_before, changes.linkage)
    return changes, faults, view, found, curve_sd


@dataclass(frozen=True, slots=True)
class _Looked:
    """What the first look gives."""

    drive: DriveGrid
    changes: Changes
    faults: list[RigFault]
    view: Pairs
    rolls: Rolls
    followed: FollowedRecords
    curve_sd: float


def _looked(machine: Machine, measurements: Sequence[Measurement], progress: Progress) -> _Looked:
    progress("looking at the drive", 0.0)
    heard = drives.MeasuredLists()
    for measurement in measurements:
        drives.take(heard, measurement)
    check_receivers(machine, heard)
    check_wheel(heard)
    drive = drives.drive_of(heard, machine)
    changes, faults, view, found_rolls, curve_sd = _by_geometry(machine, drive)
    progress("poses by the first values", 0.15)
    followed = follow(applied(machine, changes), measurements, changes)
    more = finding.receiver_faults(followed.flags, followed.poses)
    if any(fault.kind == finding.ROLL_CORRECTED for fault in more):
        # Places that were right with the other setting are wrong with this one, by the height times the roll.
        corrected = finding.corrected(changes, more, followed.flags)
        changes, faults, view, found_rolls, curve_sd = _by_geometry(machine, drive, corrected)
        followed = follow(applied(machine, changes), measurements, changes)
    return _Looked(drive, changes, [*faults, *more], view, found_rolls, followed, curve_sd)


SOUGHT: Final = (*range(6), *(AT[name] for name in sought_numbers.BY_LIKELIHOOD))


def _placed(drive: DriveGrid, changes: Changes) -> DriveGrid:
    """The same with the receivers in the order of where they stand, signs of turn rates and rolls turned."""
    assignment = list(changes.assignment)
    signs, turned = np.array(changes.roll_sign), np.array(changes.yaw_rate_sign)
    wheel = np.array([wheel_after(angle, changes) for angle in drive.wheel.tolist()])
    return replace(
        drive, at=drive.at[:, assignment], velocity=drive.velocity[:, assignment],
        roll=drive.roll[:, assignment] * signs,
        yaw_rate=drive.yaw_rate[:, assignment] * turned, wheel=wheel, pitch=drive.pitch[:, assignment],
    )  # fmt: skip


def _view(now: Machine, placed: DriveGrid, changes: Changes, found: Rolls | None) -> Pairs:
    """By a file after the changes. Its latencies are those of the changed file; the grid has the old ones."""
    roll = np.zeros((len(placed.t), 2))
    if found is not None:
        for body in range(2):
            both = placed.roll[:, 2 * body : 2 * body + 2] - found.zero[2 * body : 2 * body + 2]
            roll[:, body] = initial_guess.mean_of_known(both)
    return initial_guess.seen(placed, now, roll, changes.delay)


def _initial_guess(
    machine: Machine, drive: DriveGrid, corrected: tuple[bool | None, ...] = AS_STATED
) -> tuple[Changes, list[RigFault], Pairs, Rolls]:
    stands = assign(drive, machine)
    own = linkage_of(machine)
    changes = Changes(assignment=stands.assignment, linkage_before=own, linkage=own, roll_corrected=corrected)
    faults = finding.assignment_faults(stands.assignment) if stands.sure else []
    placed = _placed(drive, changes)
    view = _view(applied(machine, changes), placed, changes, None)
    if (
        np.count_nonzero(view.known & (np.abs(view.along[:, 0]) > initial_guess.INITIAL_GUESS.moving))
        * drives.DRIVE.step_s
        < initial_guess.INITIAL_GUESS.least_driven_s
    ):
        raise CannotCalibrate(
            "the four receivers were heard together for less than a minute of driving; drive what "
            "docs/calibrate.md lists, with RTK"
        )
    changes = replace(changes, delay=initial_guess.latency_differences(placed, view)[0])
    for _ in range(CALIBRATION.looks - 1):
        view = _view(applied(machine, changes), placed, changes, None)
        changes = _between_bodies(changes, initial_guess.hitch(view))
    view = _view(applied(machine, changes), placed, changes, None)
    signs, wrong = finding.yaw_rate_signs(view)
    found_rolls = rolls(placed, view)
    changes = replace(
        changes, yaw_rate_sign=signs, roll_sign=found_rolls.sign,
        roll_zero=np.where(found_rolls.heard, found_rolls.zero, 0.0),
    )  # fmt: skip
    faults += [*wrong, *finding.roll_sign_faults(found_rolls.sign)]
    placed = _placed(drive, changes)
    changes = _geometry(machine, placed, changes, found_rolls)
    check_lengths(changes.longer)
    view = _view(applied(machine, changes), placed, changes, found_rolls)
    base = machine.tractor.wheelbase
    told, share = initial_guess.wheel_by_the_way(view, base, view.rate[:, 0])
    wheel_faults = finding.wheel_faults(told, share)
    faults += wheel_faults
    if any(fault.kind == finding.WHEEL_UNREAD for fault in wheel_faults):
        check_turned(initial_guess.coverage(view))
        raise CannotCalibrate(wheel_faults[0].text, faults)
    gain = float(told.value[1])
    changes = replace(
        changes, wheel_sign=1 if gain > 0 else -1, wheel_zero=float(told.value[0]), wheel_gain=abs(gain),
        delay=not_early(
            machine, changes.assignment, changes.delay + initial_guess.common_latency(view, base, told)
        ),
    )  # fmt: skip
    return changes, faults, view, found_rolls


def _with_linkage(
    machine: Machine, drive: DriveGrid, changes: Changes, view: Pairs, found: Rolls
) -> tuple[Changes, float]:
    """With the kingpin and the curvature of the wheel sensor's linkage, and the sd of that."""
    now = applied(machine, changes)
    seen = initial_guess.hitch(_view(now, _placed(drive, changes), changes, found))
    told = linkage.find(machine, changes, view, (float(_middles(now)[0, 1]), float(seen.sds[1])))
    if told.wheel is not None:
        zero, gain = told.wheel
        changes = replace(changes, wheel_zero=zero, wheel_gain=gain)
    return replace(changes, linkage=told.linkage), told.curve_sd


def _between_bodies(changes: Changes, seen: Solved) -> Changes:
    """seen: as initial_guess.hitch gives it."""
    delay = float(seen.value[4]) if seen.sds[4] < initial_guess.INITIAL_GUESS.identified_delay_sd else 0.0
    return replace(changes, delay=changes.delay + delay * np.array([-0.5, -0.5, 0.5, 0.5]))


def _middles(machine: Machine) -> Array:
    """(forward, right) of the middle of each pair, (2, 2)."""
    by_mount = {r.mount: r.position[:2] for r in machine.receiver}
    return np.array([np.mean([by_mount[MOUNTS[k]], by_mount[MOUNTS[k + 1]]], axis=0) for k in (0, 2)])


def _geometry(machine: Machine, placed: DriveGrid, changes: Changes, found: Rolls) -> Changes:
    """Yaw and length of the pairs, levers, hitch and drawbar."""
    for _ in range(2):
        now = applied(machine, changes)
        view = _view(now, placed, changes, found)
        crabs = [initial_guess.crab(view, body) for body in range(2)]
        longer = np.nan_to_num(np.nanmedian(view.longer[view.known], axis=0))
        axle = np.array([now.tractor.b.value, now.implement.e.value])
        ahead = np.array([crab.value[1] for crab in crabs]) - axle - _middles(now)[:, 0]
        ahead = np.where([crab.sds[1] < 0.15 for crab in crabs], ahead, 0.0)
        yaw = np.array([crab.value[0] for crab in crabs])
        changes = replace(
            changes, pair=changes.pair + yaw, longer=changes.longer + longer, forward=changes.forward + ahead
        )
    now = applied(machine, changes)
    told = initial_guess.hitch(_view(now, placed, changes, found))
    middles = _middles(now)
    c, d = -told.value[0] - middles[0, 0], told.value[2] + middles[1, 0]
    known = told.sds[[0, 2]] < 0.1
    by = np.where(known, [c - now.tractor.c.value, d - now.implement.d.value], 0.0)
    return _by_the_hitch(machine, placed, replace(changes, hitch=changes.hitch + by), found, placed=True)


def _by_the_hitch(
    machine: Machine, drive: DriveGrid, changes: Changes, found: Rolls, *, placed: bool = False
) -> Changes:
    """What is late between the bodies, and the tractor's receivers aside, by where the hitch is seen from
    either body: it is on the middle line. The likelihood has no unknown for either.

    The implement's go along aside: the likelihood knows them relative to the tractor's.
    """
    now = applied(machine, changes)
    told = initial_guess.hitch(_view(now, drive if placed else _placed(drive, changes), changes, found))
    changes = _between_bodies(changes, told)
    if told.sds[1] > 0.05:
        return changes
    right = -told.value[[1, 3]] - _middles(now)[:, 1]
    if placed:
        return replace(changes, lateral_offset=changes.lateral_offset + right)
    return replace(changes, lateral_offset=changes.lateral_offset + right[0])


def _centred(now: Machine, mean: Array, sd: Array, moved: dict[str, float]) -> tuple[Array, Array]:
    """The prior about what the file said at first, unless that was no error of measuring. Masses are held."""
    mean, sd = mean.copy(), sd.copy()
    sd[list(MASSES)] = 0.0
    for name in sought_numbers.BY_LIKELIHOOD:
        by = moved[name]
        if abs(by) > 3.0 * NUMBER[name].prior_sd:
            continue
        value = NUMBER[name].value
        mean[AT[name]] = -by if value is None else math.log1p(-by / value(now))
    return mean, sd


def _from(fit: JointFit, mean: Array) -> Array:
    """Where a fit about the changed file begins: what the changes do not hold stays."""
    start = fit.mean.copy()
    for name in sought_numbers.BY_LIKELIHOOD:
        start[AT[name]] = 0.0
    for k in range(AT["roll_zero_tractor_front"], AT["roll_zero_implement_rear"] + 1):
        start[k] = mean[k]
    return start


def _taken(machine: Machine, changes: Changes, fit: JointFit) -> Changes:
    """The changes with what a fit about the file after them has found of the numbers."""
    now = applied(machine, changes)
    by = dict(zip(sought_numbers.BY_LIKELIHOOD, sought_numbers.metres(now, fit.mean).tolist(), strict=True))
    changes = further_wheel(changes, by["wheel_zero"], by["wheel_gain"])
    return replace(
        changes,
        delay=not_early(machine, changes.assignment, changes.delay + by["latency"]),
        pair=changes.pair + np.array([by["pair_t"], by["pair_i"]]),
        forward=changes.forward + np.array([by["lever_t"], by["lever_i"]]),
        lateral_offset=changes.lateral_offset + np.array([0.0, by["aside_i"]]),
        hitch=changes.hitch + np.array([by["c"], by["d"]]),
    )


def _moved(machine: Machine, changes: Changes) -> dict[str, float]:
    """Name of a number -> by how much the changes move the file, SI."""
    found = named(changes)
    found["aside_i"] -= found["aside_t"]
    found["wheel_zero"] = changes.wheel_sign * changes.wheel_zero / changes.wheel_gain
    found["wheel_curve"] = changes.linkage.curve - changes.linkage_before.curve
    found["latency"] = float(np.mean(changes.delay))
    return found


def _largest(fit: JointFit) -> float:
    """Sds by which a fit has moved any number from where its file stood."""
    rows = [AT[name] for name in sought_numbers.BY_LIKELIHOOD]
    return float(np.max(np.abs(fit.mean[rows]) / np.sqrt(np.diag(fit.covariance)[rows])))


def _late_sd(placed: DriveGrid, view: Pairs, gap: Solved) -> Array:
    between = float(gap.sds[4])
    pairs = initial_guess.latency_differences(placed, view)[1]
    return np.array(
        [
            *pairs,
            between
            if between < initial_guess.INITIAL_GUESS.identified_delay_sd
            else initial_guess.INITIAL_GUESS.delay_sd,
        ]
    )


def _speed(view: Pairs) -> float:
    return math.sqrt(float(np.mean(view.along[view.known, 0] ** 2)))


def _lateral_offset_sd(seen_sd: float, fit: JointFit, machine: Machine) -> float:
    turned = math.sqrt(float(fit.covariance[AT["pair_t"], AT["pair_t"]]))
    reach = machine.tractor.c.value + abs(_middles(machine)[0, 0])
    return math.hypot(seen_sd, turned * reach, CALIBRATION.lateral_offset_floor)


assert NAMES[SHAPE] == NAMES[AT["a"] : AT["I_i"] + 1]
