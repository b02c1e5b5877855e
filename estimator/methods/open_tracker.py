"""The open tracker: it estimates lengths, wheel angle and antennas of the machine file from driving.

It is the filter of tracker.py over the same segments, with priors as wide as the errors that people make in a
file. If its result differs from the file by more than the sds of file and filter allow, the file is wrong, or
describes another rig. The antennas' positions along a body are fixed: shifting them together with the CG
changes no measurement, so the lengths a to e stand for them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import drift
from tilth.estimator.filters.tracker_kernel import BAD, GATED, USED
from tilth.estimator.filters.unknowns import AT, NEED_STEERING, NOISE, SIX
from tilth.estimator.methods import tracker
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.record.record import Segment
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OpenTrackerTuning:
    """What is learned of the machine file's numbers while all of them are open."""

    open_sd: Mapping[str, float] = tuned(
        {
            "wheel_zero": math.radians(5.0),
            "wheel_gain": 0.4,
            "latency": 0.1,
            "pair_t": math.radians(5.0),
            "pair_i": math.radians(5.0),
            "aside_i": 0.5,
            "a": 0.4,
            "b": 0.4,
            "c": 0.4,
            "d": 0.4,
            "e": 0.5,
            "m_i": 0.4,
            "I_t": 0.4,
            "I_i": 0.4,
        },
        "by unknown",
        "prior sd of each unknown that is left open, in its own unit (filters/unknowns.py)",
    )
    allowed_sd: Mapping[str, float] = tuned(
        {
            "wheel_zero": math.radians(0.3),
            "wheel_gain": 0.05,
            "latency": 0.02,
            "pair_t": math.radians(0.1),
            "pair_i": math.radians(0.1),
            "aside_i": 0.03,
            "a": 0.03,
            "b": 0.03,
            "c": 0.03,
            "d": 0.02,
            "e": 0.03,
            "m_i": 0.35,
            "I_t": 0.08,
            "I_i": 0.1,
        },
        "by unknown",
        "by which a right file may differ from the result, besides its own sds: error of the model",
    )
    """From drives with right files. What tells of the implement's mass itself are small forces between the
    bodies: in fields with headland turns it came out at half and less, in 4 of 10 on the planar plant and 1
    of 4 in space, and the right file was doubted to the end. Not to learn masses in sharp turns at all ends
    more such doubts: two of sixteen on a stranger's fields, where numbers of the tracker then were 3 and 4
    sds off. There the doubt was right."""
    confirming_sd: Mapping[str, float] = tuned(
        {
            "wheel_zero": math.radians(0.6),
            "wheel_gain": 0.16,
            "latency": 0.06,
            "pair_t": math.radians(0.6),
            "pair_i": math.radians(0.6),
            "aside_i": 0.1,
            "a": 0.28,
            "b": 0.15,
            "c": 0.08,
            "d": 0.08,
            "e": 0.2,
            "I_t": 0.25,
        },
        "by unknown",
        "largest sds with which a gross error would show; only then can the file be confirmed",
    )
    gross: Mapping[str, float] = tuned(
        {"a": 1.0, "I_t": math.log(2.0)}, "by unknown", "gross errors that are told apart"
    )
    """A metre on the wheelbase and twice the inertia have the same effect, and either changes the stiffnesses
    in proportion."""
    certain: float = tuned(2.33, "sd", "by which data must be off each of these: 1 % of gross errors pass")
    tyre_log_sd: float = tuned(0.7, "1", "smallest prior sd of each of the six logarithms")
    memory: float = tuned(2400.0, "segments", "learned from (8 min), over which the result is forgotten")
    soil_memory: float = tuned(500.0, "segments", "same of the six (100 s): soil differs from place to place")
    wide_look_s: float = tuned(60.0, "s", "of steering, after which slopes are by steering, as in tracker")
    """Gross errors show sooner with all that a drive tells. But slopes at the estimated state are correlated
    with what they are compared with: tyres come out softer the longer one drives, and lengths and the wheels'
    scale make up for it. After four minutes in space two of eight right files were doubted (tractor.a + 0.8
    m). In sharp turns they stay at the estimated state: steering alone would have a rig whose numbers are off
    elsewhere, and 8 of 20 right files were doubted in fields."""
    rough: float = tuned(0.007, "rad", "unevenness above which what is found may be a divergence")
    """On ground of 3 cm rms it found inertias twice as large, or the front axle at the CG, in 4 of 40 drives
    with right files, at 0.008 to 0.016. On 1 cm it is at most 0.006, with wrong files too."""


OPEN_TRACKER: Final = OpenTrackerTuning()

NAMES: Final = tuple(OPEN_TRACKER.open_sd)
PLACES: Final = [AT[name] for name in NAMES]
STRAIGHT: Final = ("wheel_zero", "pair_t", "pair_i", "aside_i")  # observable in straight driving too
OF_PAIRS: Final = STRAIGHT[1:]
_STEERED: Final = [*NEED_STEERING, *(AT[name] for name in NAMES if name not in STRAIGHT)]


class Misfit(NamedTuple):
    """Difference between the open tracker's result and the file."""

    total: float  # chi-square of all open numbers, len(NAMES) degrees of freedom
    by_name: Array  # [n]; decrease of `total` if this number alone is freed
    off: Array  # [n]; result minus the file's value, in the unit of each
    sd: Array  # [n]; of the result
    alone: Array  # [n]; sd of the difference if all other numbers are right, with the error that is allowed


def initial(machine: Machine) -> TrackerState:
    """The state before any data, at the values of the machine file, with the prior sds of `open_sd`."""
    state = tracker.initial(machine)
    sd = state.prior_sd
    for name, ratio in OPEN_TRACKER.open_sd.items():
        sd[AT[name]] = max(sd[AT[name]], ratio)
    sd[SIX] = np.maximum(sd[SIX], OPEN_TRACKER.tyre_log_sd)
    sd[[AT["cg_t"], AT["cg_i"], AT["lever_t"], AT["lever_i"], AT["m_t"]]] = 0.0
    state.covariance = np.diag(sd**2)
    state.covariance[NOISE, NOISE] = 0.0
    state.needs_steering, state.considered = list(_STEERED), []
    # In a circle only unevenness moves the rig later on, and the implement follows the tractor over the same
    # one, which the model does not describe: when it learned there, right files were doubted in half of all
    # drives of three long steps on the planar plant (implement.e off by 0.6 m). So where its slopes are not
    # by steering, a tracker stops while the wheels are held.
    state.by_steering = False
    return state


def take(state: TrackerState, machine: Machine, segment: Segment) -> bool:
    """Take one segment. Returns whether all open numbers were learned from it."""
    gentle = state.pending is not None and not tracker.is_tight(state, state.pending)  # what is learned now
    state.by_steering = gentle and state.window_s >= OPEN_TRACKER.wide_look_s
    tracker.take_segment(state, machine, segment)
    state.events.clear()
    state.checkpoints.clear()  # only the tracker itself detects changes of soil
    learned = not state.reason and state.pending is not None
    if learned:
        _fade(state)
    return learned


def _fade(state: TrackerState) -> None:
    """Drift the posterior towards the prior: a receiver may be moved in the middle of a day."""
    for places, memory in ((PLACES, OPEN_TRACKER.memory), (list(range(6)), OPEN_TRACKER.soil_memory)):
        share = math.exp(-1.0 / memory)
        drift(state.covariance, np.array(places), share, state.prior_sd)
        state.P_xtheta[:, places] *= share


def misfit(state: TrackerState, machine: Machine) -> Misfit:
    """The present difference from the machine file."""
    off = (state.mean - state.prior_mean)[PLACES]
    covariance = state.covariance[np.ix_(PLACES, PLACES)]
    inverse = np.linalg.inv(covariance + np.diag(allowed(machine) ** 2))
    solved = inverse @ off
    precision = np.diag(inverse)
    return Misfit(
        float(off @ solved),
        solved**2 / precision,
        off,
        np.sqrt(np.diag(covariance)),
        1.0 / np.sqrt(precision),
    )


@once_for_a_machine
def allowed(machine: Machine) -> Array:
    """Sd by which a right file may differ from the result, [n] in the order of NAMES."""
    _, stated = unknowns.prior(machine)
    shape = unknowns.base_geometry(machine)
    out = np.array([math.hypot(stated[AT[name]], OPEN_TRACKER.allowed_sd[name]) for name in NAMES])
    centres = {"a": 0, "b": 0, "c": 0, "d": 1, "e": 1}
    for name, body in centres.items():
        length = 1.0 if name == "e" else float(shape["abcde".index(name)])
        cg_sd = (machine.tractor, machine.implement)[body].cg_sd / length
        out[NAMES.index(name)] = math.hypot(out[NAMES.index(name)], cg_sd)
    return out


def unconfirmed(now: Misfit, machine: Machine) -> list[str]:
    """The names of which a gross error would not show yet, the largest sd relative to its limit first."""
    ratio = {
        name: float(now.sd[NAMES.index(name)]) / limit for name, limit in OPEN_TRACKER.confirming_sd.items()
    }
    for name, gross in OPEN_TRACKER.gross.items():
        k = NAMES.index(name)
        size = math.log1p(gross / machine.tractor.a.value) if name == "a" else gross
        off = size / float(now.alone[k]) - math.sqrt(float(now.by_name[k]))
        ratio[name] = max(ratio[name], OPEN_TRACKER.certain / max(off, 1e-3))
    return sorted((name for name, excess in ratio.items() if excess > 1.0), key=lambda name: -ratio[name])


def is_rough(state: TrackerState) -> bool:
    """Whether the ground is so uneven that the result may be a divergence."""
    return math.sqrt(state.disturbance[3]) > OPEN_TRACKER.rough


def rejected_rows(state: TrackerState) -> tuple[float, float]:
    """(rows rejected as outliers or as not finite, all rows) so far."""
    return float(state.counts[GATED] + state.counts[BAD]), float(state.counts[[USED, GATED, BAD]].sum())
