"""The open tracker: it estimates lengths, wheel angle and antennas of the machine file from driving.

It is the filter of tracker.py over the same segments, with priors as wide as the errors that people make in a
file. If its result differs from the file by more than the sds of file and filter allow, the file is wrong, or
describes another rig. The antennas' positions along a body are fixed: shifting them together with the CG
changes no measurement, so the lengths a to e stand for them.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.open_numbers import NAMES, OPEN, Misfit, OpenEvidence, misfit_of
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import drift
from tilth.estimator.filters.tracker_kernel import BAD, GATED, USED
from tilth.estimator.filters.unknowns import AT, NEED_STEERING, NOISE, SIX
from tilth.estimator.methods import tracker
from tilth.estimator.methods.pem import PemState, of_masses
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.record.record import Segment
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]

PLACES: Final = [AT[name] for name in NAMES]
_PLACES: Final = np.array(PLACES)
_SIX_AND_OPEN: Final = np.ix_(*[[*range(6), *PLACES]] * 2)


@dataclass(frozen=True, slots=True)
class OpenTrackerTuning:
    """What is learned of the machine file's numbers while all of them are open."""

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

    outlier_segments: int = tuned(100, "segments", "the last ones, among whose rows outliers are counted")


OPEN_TRACKER: Final = OpenTrackerTuning()

_STEERED: Final = [*NEED_STEERING, *(AT[row.name] for row in OPEN if not row.in_rows)]


@dataclass(slots=True)
class OpenTracker:
    """Plain data."""

    tracker: TrackerState
    learned: int = 0  # segments from which it has learned
    rows: list[tuple[float, float]] = field(default_factory=list)  # (outliers, all) after the last segments


def initial(machine: Machine) -> OpenTracker:
    """The state before any data, at the values of the machine file, as wide as people are wrong."""
    state = tracker.initial(machine)
    sd = state.prior_sd[:] = opened(state.prior_sd)
    sd[[AT["cg_t"], AT["cg_i"], AT["lever_t"], AT["lever_i"], AT["m_t"]]] = 0.0
    state.covariance = np.diag(sd**2)
    state.covariance[NOISE, NOISE] = 0.0
    state.needs_steering, state.considered = list(_STEERED), []
    # In a circle only unevenness moves the rig later on, and the implement follows the tractor over the same
    # one, which the model does not describe: when it learned there, right files were doubted in half of all
    # drives of three long steps on the planar plant (implement.e off by 0.6 m). So where its slopes are not
    # by steering, a tracker stops while the wheels are held.
    state.by_steering = False
    return OpenTracker(state)


def opened(sd: Array) -> Array:
    """Prior sds, (n,) of unknowns.NAMES, with all OPEN numbers and the six as wide as people are wrong."""
    sd = sd.copy()
    for row in OPEN:
        sd[AT[row.name]] = max(sd[AT[row.name]], row.open_sd)
    sd[SIX] = np.maximum(sd[SIX], OPEN_TRACKER.tyre_log_sd)
    return sd


def observe(
    state: OpenTracker, machine: Machine, segment: Segment | None, believing: TrackerState
) -> OpenEvidence:
    """Take the segment that is complete with a pose. What it finds now. believing: the tracker that has the
    file's sds for priors, which tells what its errors do to numbers that are learned with it."""
    if segment is not None:
        learned = _take(state.tracker, machine, segment)
        state.learned += learned
        if learned or state.tracker.reason is Code.HELD:
            state.rows = [*state.rows, _rejected_rows(state.tracker)][-OPEN_TRACKER.outlier_segments :]
    uneven = max(map(_unevenness, (state.tracker, believing)))  # one that has diverged explains it away
    return OpenEvidence(
        misfit(state.tracker, believing, machine), _at_first(machine), state.learned, _rejected(state.rows),
        uneven > 1.0, min(uneven, 1.0),
    )  # fmt: skip


def clock_stepped(state: OpenTracker) -> None:
    """The log's clock stepped back: the motion state is discarded; what was learned stays."""
    state.tracker.pending, state.tracker.running = None, False
    state.tracker.ticks_before = np.zeros((0, 8))


@once_for_a_machine
def _at_first(machine: Machine) -> Misfit:
    return misfit(initial(machine).tracker, tracker.initial(machine), machine)


def _take(state: TrackerState, machine: Machine, segment: Segment) -> bool:
    """Returns whether all open numbers were learned from it."""
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
    for places, memory in ((_PLACES, OPEN_TRACKER.memory), (SIX, OPEN_TRACKER.soil_memory)):
        share = math.exp(-1.0 / memory)
        drift(state.covariance, places, share, state.prior_sd)
        state.P_xtheta[:, places] *= share


def misfit(state: TrackerState, believing: TrackerState, machine: Machine) -> Misfit:
    """The present difference from the machine file. believing: as of `observe`."""
    return from_file(state.mean - state.prior_mean, state.covariance, believing.covariance, machine)


def from_file(
    off: Array, covariance: Array, believing: Array, machine: Machine, of_fit: bool = False
) -> Misfit:
    """What is found, (n,) off the machine file with its covariance, (n, n), of unknowns.NAMES. believing: the
    covariance of what believes the file as far as its sds say. of_fit: as of `misfit_of`."""
    at = _SIX_AND_OPEN
    return misfit_of(off[_PLACES], covariance[at], believing[at], machine, of_fit)


def of_fit(machine: Machine, mean: Array, covariance: Array, prior: tuple[Array, Array]) -> Misfit:
    """What a fit would find were the numbers of the file as open as here: its search ends there but for a
    step, since it is by information that the posterior is wider then. mean, covariance: of the fit, (n,) and
    (n, n) of unknowns.NAMES. prior: (mean, sd) that it began with."""
    sd, off = prior[1], mean - prior[0]
    known = np.isin(np.arange(len(sd)), [*unknowns.MASSES, *np.arange(len(sd))[NOISE]])
    active = np.flatnonzero((sd > 0.0) & ~known)
    at, wide = np.ix_(active, active), opened(sd)
    narrow, open_ = (np.diag(one[active] ** -2.0) for one in (sd, wide))
    information = added(np.diag(sd[active] ** 2), (covariance - of_masses(covariance))[at])
    found = np.diag(wide**2)
    found[at] = np.linalg.inv(information + open_)
    off[active] += found[at] @ (narrow - open_) @ off[active]
    return from_file(off, found, covariance, machine, of_fit=True)


def of_windows(machine: Machine, fits: PemState) -> Misfit:
    """The same of all windows of pem so far."""
    return of_fit(machine, fits.mean, fits.covariance, (fits.prior_mean, fits.prior_sd))


def added(before: Array, after: Array) -> Array:
    """Information, (a, a), between two covariances. Where filters differ, it may be less than before."""
    sizes, axes = np.linalg.eigh(np.linalg.inv(after) - np.linalg.inv(before))
    return np.asarray((axes * np.maximum(sizes, 0.0)) @ axes.T)


def _unevenness(state: TrackerState) -> float:
    """Above 1 the ground is so uneven that the result may be a divergence."""
    return math.sqrt(state.disturbance[3]) / OPEN_TRACKER.rough


def _rejected(rows: list[tuple[float, float]]) -> float:
    """Share of outliers among the recent measurements, 0 before there are enough."""
    if len(rows) < OPEN_TRACKER.outlier_segments // 2:
        return 0.0
    refused, every = (rows[-1][k] - rows[0][k] for k in (0, 1))
    return refused / every if every > 0 else 0.0


def _rejected_rows(state: TrackerState) -> tuple[float, float]:
    """(rows rejected as outliers or as not finite, all rows) so far."""
    return float(state.counts[GATED] + state.counts[BAD]), float(state.counts[[USED, GATED, BAD]].sum())
