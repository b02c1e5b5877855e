"""What driving tells of the lengths of an implement that nobody has described (`described = false`).

The tractor's receivers see the hitch, so those of the implement see how far they are behind it. What goes
sideways with the turn rate is the place of the axle; what does so with the lateral acceleration is its slip:

    v / u + (r / u) x = −ψ + κ u r + κ' φ

of the pair's middle: v sideways, u forwards, r turn rate, φ roll; x the axle, ahead, ψ the pair's yaw. At one
speed x and κ are one sum: then x is as uncertain as the slip is before anything is known of the tyres.
"""

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.information import (
    AT,
    CONSTANTS,
    CRAB,
    INFORMATION,
    PAIR,
    ROLL,
    TURN,
    N,
    lengths,
    rows,
)
from tilth.estimator.diagnosis.sample import Sample, sample
from tilth.estimator.driving import DRIVING
from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import changed
from tilth.estimator.rig.residuals import sideways
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import WITHOUT_RTK, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.spread import plus_minus

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StrangeTuning:
    """When lengths that driving has found are used."""

    drawbar_sd: float = tuned(
        0.15, "m", "of hitch to axle, from which on they are used: slip leaves 0.11 at 3 m/s alone"
    )
    hitch_sd: float = tuned(0.04, "m", "of hitch to receivers, the same")
    pair_sd: float = tuned(math.radians(0.5), "rad", "of the yaw of the implement's pair, the same")
    better: float = tuned(0.5, "1", "of the sd of what is used, from which on it is used in its place")
    floor_m: float = tuned(0.01, "m", "of lengths: what swings and lags is not in this model")
    lateral: float = tuned(2.5, "m/s^2", "up to which slip is taken for proportional to it")
    speed_sd: float = tuned(0.04, "m/s", "of the velocity sideways")
    correlated: float = tuned(
        25.0, "poses", "5 s of a turn whose errors of that, tyres' and body's lag, are one"
    )
    slip_log_sd: float = tuned(0.5, "1", "of slip over lateral acceleration, about that of the file's tyres")


STRANGE: Final = StrangeTuning()
AXLE: Final = N  # the axle's place, behind where the file has it, m; after the constants of information.py
SIZE: Final = N + 1
FOUND: Final = [AT["longer_i"], AT["pair_i"], AT["aside_i"], AT["d"], AXLE]


class FoundLengths(NamedTuple):
    """Of the implement: by how much the constants are more than its file says, and sds."""

    longer: float  # distance of its receivers, m
    yaw: float  # of its pair, rad
    lateral_offset: float  # its receivers, to the right of the line from hitch to axle, m
    hitch: float  # from them to the hitch, m
    axle: float  # from them to the axle, m
    yaw_sd: float
    lateral_offset_sd: float
    hitch_sd: float
    axle_sd: float
    drawbar_sd: float  # of hitch to axle


@dataclass(slots=True)
class StrangeImplement:
    """Plain data. Information in the units of the constants, without what is known before."""

    information: Array = field(default_factory=lambda: np.zeros((SIZE, SIZE)))
    vector: Array = field(default_factory=lambda: np.zeros(SIZE))
    used: FoundLengths | None = None  # in the machine that the estimators have


def observe(state: StrangeImplement, file: Machine, aligner: Aligner, pose: Pose) -> FoundLengths | None:
    """Take one pose. Returns what is to be used from now on, if that is new. file: as its owner wrote it."""
    if any(flag.kind in WITHOUT_RTK for flag in pose.flags):
        return None
    now = sample(aligner, pose.t_ns - ALIGNMENT.pose_ns)
    if now is None:
        return None
    _add(state, aligner.machine, now)
    found, used = found_lengths(state, file), state.used
    known = found.hitch_sd < STRANGE.hitch_sd and found.yaw_sd < STRANGE.pair_sd
    wanted = STRANGE.drawbar_sd if used is None else STRANGE.better * used.drawbar_sd
    if not known or found.drawbar_sd > wanted:
        return None
    state.used = found
    return found


def _add(state: StrangeImplement, machine: Machine, now: Sample) -> None:
    """machine: with what is used."""
    rig, body = lengths(machine), now.implement
    kinds, design, measured = rows(rig, now)
    kept = kinds != CRAB[1]  # which is of gentle driving
    design = np.hstack([design, np.zeros((kinds.size, 1))])[kept]
    variance = (rig.sds**2 * rig.correlated)[kinds[kept]]
    measured = measured[kept]
    u, r = body.forward_velocity, body.yaw_rate
    if u > DRIVING.under_way and abs(u * r) < STRANGE.lateral:
        row = np.zeros(SIZE)
        row[[PAIR[1], TURN[1], ROLL[1], AXLE]] = -1.0, u * r, body.roll, r / u
        design = np.vstack([design, row])
        measured = np.append(measured, sideways(body.lateral_velocity, r, rig.axles[1]) / u)
        sd = math.hypot(INFORMATION.crab_sd, STRANGE.speed_sd / u)
        variance = np.append(variance, sd**2 * STRANGE.correlated)
    if state.used is not None:
        measured = measured + design @ _constants(state.used)
    weighted = design.T / variance
    state.information += weighted @ design
    state.vector += weighted @ measured


def _constants(found: FoundLengths) -> Array:
    out = np.zeros(SIZE)
    out[FOUND] = found[: len(FOUND)]
    return out


def _prior(file: Machine) -> tuple[Array, Array]:
    """Mean and sd of the constants, (SIZE,), by what the file tells."""
    tractor, implement = file.tractor, file.implement
    survey = {
        body: max(r.survey_sd for r in file.receiver if r.mount.body == body)
        for body in ("tractor", "implement")
    }
    mean, sd = np.zeros(SIZE), np.array([*(sd for sd, _ in CONSTANTS.values()), 0.0])
    told = {
        "longer_t": survey["tractor"] * math.sqrt(2.0), "longer_i": survey["implement"] * math.sqrt(2.0),
        "pair_i": math.radians(implement.pair_yaw_sd), "aside_t": survey["tractor"],
        "aside_i": survey["implement"], "c": math.hypot(tractor.c.sd, survey["tractor"]),
        "d": math.hypot(implement.d.sd, survey["implement"]),
    }  # fmt: skip
    sd[[AT[name] for name in told]] = list(told.values())
    lever_sd = survey["implement"] if implement.lever_sd is None else implement.lever_sd
    sd[AXLE] = math.hypot(implement.e.sd, lever_sd)
    rig = rig_of(file)
    slip = static_loads(rig)[2] / rig.g / file.tyres.implement.cornering_stiffness  # rad per m/s^2
    mean[TURN[1]], sd[TURN[1]] = -slip, STRANGE.slip_log_sd * slip
    return mean, sd


def found_lengths(state: StrangeImplement, file: Machine) -> FoundLengths:
    """What is known by now."""
    mean, sd = _prior(file)
    known = np.diag(sd**-2)
    covariance = np.linalg.inv(state.information + known)
    best = covariance @ (state.vector + known @ mean)
    floor = STRANGE.floor_m**2
    at = covariance[np.ix_(FOUND, FOUND)]
    drawbar = at[-2:, -2:].sum()  # hitch and axle
    floors = np.array([0.0, floor, floor, floor, floor])
    sds = np.sqrt(np.array([*np.diag(at)[1:], drawbar]) + floors)
    return FoundLengths(*best[FOUND].tolist(), *sds.tolist())


def with_found(file: Machine, found: FoundLengths | None) -> Machine:
    """The machine with these lengths, file: without. Its CG stays as far from the axle as the file has it:
    where that is driving does not tell."""
    if found is None:
        return file
    hitch_ahead = file.implement.d.value + found.hitch - _middle_ahead(file)
    return changed(file, {
        "longer_i": Amount(found.longer),
        "pair_i": Amount(found.yaw, found.yaw_sd),
        "aside_i": Amount(found.lateral_offset - found.yaw * hitch_ahead, found.lateral_offset_sd),
        "lever_i": Amount(found.axle, STRANGE.floor_m),
        "d": Amount(found.hitch + found.axle, found.hitch_sd),
        "e": Amount(0.0, found.axle_sd),
    })  # fmt: skip


def told(file: Machine, found: FoundLengths) -> Notice:
    """For the event. file: without these lengths."""
    drawbar = file.implement.d.value + file.implement.e.value + found.hitch + found.axle
    receivers = file.implement.d.value + found.hitch - _middle_ahead(file)
    return notice(
        NoticeCode.IMPLEMENT_LENGTHS,
        implement=file.implement.name or "the implement",
        drawbar=plus_minus(drawbar, found.drawbar_sd, "m"),
        receivers=plus_minus(receivers, found.hitch_sd, "m"),
    )  # fmt: skip


def _middle_ahead(machine: Machine) -> float:
    """Of the implement's receivers, ahead of its CG, m."""
    places = [r.position[0] for r in machine.receiver if r.mount.body == "implement"]
    return sum(places) / len(places)
