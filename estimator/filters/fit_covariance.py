"""Covariance that a fit publishes: the information of the record and the prior, widened for what its noise
model leaves out, and for errors of the motion model."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.likelihood import Search, inverse
from tilth.estimator.filters.priors import PRIOR
from tilth.estimator.filters.states import DT
from tilth.estimator.filters.unknowns import AT, NAMES
from tilth.estimator.record.record import KIND, PLACE, TICK, WHEEL_ANGLE, R, Record, U
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FitCovarianceTuning:
    """What widens the covariance of a fit: errors of the model of noise and of motion."""

    colour_factor: float = tuned(1.0, "1", "growth of the six sds by the innovations' autocorrelation")
    """For ground that is no Gauss-Markov process, and slow errors of receivers. From Monte Carlo; no effect
    on white innovations."""
    model_sd: float = tuned(0.03, "1", "sd of the six from errors of the model, which no data reduce")
    """Tyre curves and load transfer of the real rig differ from those of the file, and relaxation lengths
    fall with slip. By Monte Carlo on the spatial plant with drawn rigs, tyres and ground."""
    length_sd: Array = tuned(np.array([0.05, 0.05, 0.06]), "m", "what is added to each relaxation length")
    """A lag that the model leaves out is a distance, whatever the tyre's own length is: 10 ms at 4.5 m/s. By
    a stranger's plant (134 rigs, lengths from 0.3 m): the error was 0.06 to 0.11 m in front and behind, 0.3 m
    or 1.2 m long, and of lengths below 0.5 m one in seven was beyond its 95 % interval (4.8 sds once), as
    long as errors were taken to be in proportion."""
    hard: float = tuned(0.72, "m/s^2", "rms, lateral, in hard driving: 6° rms of the wheels at 4.5 m/s")
    hardest: float = tuned(1.5, "1", "of its square, at most: nobody knows how errors go on")
    hard_sd: Array = tuned(
        np.array([0.06, 0.05, 0.03, 0.05, 0.03, 0.18]), "1", "what is added there to the six"
    )
    """It goes with the square, as what tyres give less than in proportion to slip does. There real tyre
    curves, and how lengths fall with slip, differ most from the model's. By two plants of a stranger, one
    spatial and one planar, of 24 and 16 rigs: C_af came out 7 % soft on the one, C_ar 5 % stiff and sigma_i
    25 % short on the other."""
    held_s: float = tuned(4.0, "s", "for which all of the steering is held in steady circles")
    held_sd: Array = tuned(np.array([0.06, 0.06, 0.0, 0.0, 0.0, 0.0]), "1", "what is added to the six there")
    """Steady circles tell stiffnesses by a tenth of a degree of slip, and what is wrong with the model is the
    same all the way, so it does not average out. By three steps of 30 s on a plant of a stranger (59 rigs):
    C_af and C_ar came out 5 % stiff, and held in 86 % of all runs."""
    tight: float = tuned(math.radians(15.0), "rad", "wheels beyond it are in a sharp turn")
    tight_share: float = tuned(0.1, "1", "of what was learned from, for errors to be those of sharp turns")
    """Above it, errors of the model are those of sharp turns."""
    tight_sd: Array = tuned(
        np.array([0.15, 0.11, 0.17, 0.14, 0.22, 0.18]), "1", "what is added to the six there"
    )
    """In headland turns a hundredth of the wheel angle, or of the speed, does what a fifth of the front
    tyres' stiffness does. What the covariance of `pem` leaves of its root mean square error after 18 fields
    of the spatial and 18 of the planar plant, weighted alike, and a tenth more; of C_ai since lengths are not
    exact, after 11 fields of the planar plant (0.31) and 16 of a stranger's (0.09); of C_ai and sigma_r with
    48 rigs of the fleet (0.11 and 0.16), where 0.24 and 0.28 made their intervals three and two times as wide
    as errors were."""
    tracked_tight_sd: Array = tuned(np.array([0.22, 0.25, 0.23, 0.21, 0.23, 0.28]), "1", "same of tracker")
    """Of C_ai more, since other fields of the planar plant ask for it. Its sigma_i would ask for 0.4 there:
    with that there is no number. C_af, C_ar and sigma_f are those of 22 fields of a stranger's plant, where
    C_ar came out 23 % stiff; our own ask for 0.14, 0.13 and 0.12."""
    rough_sd: float = tuned(0.1, "1", "what is added to the three stiffnesses on `PRIOR.rough` ground")
    """Where the loads of the wheels come and go, less side force is left on average: on the spatial plant 5
    to 16 % less on ground of 3 cm rms, where the loads' sd is a third of them, and 1 to 4 % on 1 cm. It goes
    with the square of the unevenness."""
    bin_s: float = tuned(0.1, "s", "over which scores are summed")
    lags: int = tuned(12, "bins", "with correlated scores, by waves of the ground and slow errors")


FIT_COVARIANCE: Final = FitCovarianceTuning()


def model_sd(
    tight: bool,
    lateral: float,
    uneven: float,
    logs: Array,
    tight_sd: Array = FIT_COVARIANCE.tight_sd,
    held: float = 0.0,
) -> Array:
    """Sds of the six logarithms, (6,), from errors of the model. tight: in sharp turns, so they are at least
    tight_sd. lateral: rms of lateral acceleration, m/s^2. uneven: sd of how far the ground turns the wheels
    about a body's long axis, rad. logs: (6,), of the parameters. held: as `held_share`."""
    hard = min((lateral / FIT_COVARIANCE.hard) ** 2, FIT_COVARIANCE.hardest)
    sds = np.full(6, FIT_COVARIANCE.model_sd)
    sds[3:] = np.hypot(FIT_COVARIANCE.model_sd, FIT_COVARIANCE.length_sd * np.exp(-logs[3:]))
    if tight:
        sds = np.maximum(sds, tight_sd)
    else:
        sds = np.sqrt(sds**2 + (FIT_COVARIANCE.hard_sd * hard) ** 2 + (FIT_COVARIANCE.held_sd * held) ** 2)
    sds[:3] = np.hypot(sds[:3], FIT_COVARIANCE.rough_sd * (uneven / PRIOR.rough) ** 2)
    return sds


def mixed(kept: Array, added: Array, before: Array, after: Array) -> Array:
    """Sds of the six, (6,), from errors of the model after more driving.

    They are not independent from window to window, so they must neither add up nor average out: each
    parameter has those of before (kept) and of this driving (added) in the shares in which it has learned
    from either. before, after: its variances without them; one that is fixed has 0 and no errors.
    """
    learned = np.clip(1.0 - after / np.where(before > 0.0, before, 1.0), 0.0, 1.0)
    return np.where(before > 0.0, (1.0 - learned) * kept + learned * added, 0.0)


def model_sd_of(record: Record, point: Array) -> Array:
    """The same, of a record and what was found of it, (n,)."""
    tight = (
        float(np.mean(np.abs(record.ticks[:, WHEEL_ANGLE]) > FIT_COVARIANCE.tight))
        > FIT_COVARIANCE.tight_share
    )
    lateral, uneven = math.sqrt(lateral_square(record)), math.exp(point[AT["uneven"]])
    return model_sd(tight, lateral, uneven, point[unknowns.SIX], held=held_share(record))


def held_share(record: Record) -> float:
    """How much of the steering, 0 to 1, stays as it is for `held_s`: the square of the mean wheel angle of
    such stretches over the mean square of all."""
    length = min(round(FIT_COVARIANCE.held_s / DT), len(record.ticks))
    whole = record.ticks[: len(record.ticks) // length * length, WHEEL_ANGLE]
    square = float(np.mean(whole**2))
    return float(np.mean(whole.reshape(-1, length).mean(axis=1) ** 2)) / square if square > 0.0 else 0.0


def lateral_square(record: Record) -> float:
    """Mean square of the tractor's lateral acceleration, m^2/s^4."""
    return float(np.mean((record.ticks[:, U] * record.ticks[:, R]) ** 2))


def published(
    search: Search, point: Array, scores: Array, covariance: Array, autocorrelation: float
) -> tuple[Array, Array]:
    """(mean (n,), covariance (n, n)) of all unknowns, by where a search has ended, (n,), and the covariance
    there of the active ones, (a, a): as far as coloured noise lets them be known, widened for errors of the
    model. Not finite if these are not."""
    active = search.active
    mean, whole = point.copy(), np.zeros((len(NAMES), len(NAMES)))
    if not (np.all(np.isfinite(covariance)) and np.all(np.isfinite(scores))):
        return mean, np.full_like(whole, np.nan)
    colour = (1.0 + FIT_COVARIANCE.colour_factor * max(autocorrelation, 0.0)) ** 2
    change, whole[np.ix_(active, active)] = tempered(
        (point - search.prior_mean)[active], covariance, inverse(search.prior_information),
        scores_covariance(search, scores), colour,
    )  # fmt: skip
    mean[active] = search.prior_mean[active] + change
    if search.setup.scale == 1.0:
        open_ = active[active < 6]
        whole[open_, open_] += model_sd_of(search.record, point)[open_] ** 2
    return mean, (whole + whole.T) / 2


def tempered(
    change: Array, covariance: Array, prior: Array, scores: Array, colour: float
) -> tuple[Array, Array]:
    """(change (a,), covariance (a, a)) of a posterior from the prior, where a record has told as much less as
    its scores vary more than its information says.

    It is the sandwich estimator of quasi maximum likelihood, direction by direction: along those that prior
    and posterior have in common, the likelihood is raised to a power (tempered). So a shift counts as little
    as the information that it comes with, and nothing is known worse than before. A power is at most 1: a
    short record may look better than white by chance. prior: (a, a). scores: covariance of the record's
    summed scores, (a, a). colour: what the power is divided by besides.
    """
    root = np.linalg.cholesky(prior)
    inside = np.linalg.inv(root)
    left, directions = np.linalg.eigh(inside @ covariance @ inside.T)
    onto, back = directions.T @ inside, root @ directions
    left = np.clip(left, 1e-12, 1.0 - 1e-12)  # of the prior's variance
    of_scores = onto @ covariance
    varies = np.einsum("ij,jk,ik->i", of_scores, scores, of_scores)
    power = 1.0 / (np.maximum(varies / (left * (1.0 - left)), 1.0) * colour)
    share = 1.0 / (left + (1.0 - left) * power)
    made = (back * (share * left)) @ back.T
    return back @ (share * power * (onto @ change)), made


def scores_covariance(search: Search, scores: Array) -> Array:
    """Covariance of a record's summed scores, (a, a), with their correlation over time. scores: (a, m)."""
    bins = (search.record.rows[:, TICK] * DT / FIT_COVARIANCE.bin_s).astype(np.int64)
    sums = np.zeros((len(scores), int(bins[-1]) + 1))
    for row, into in zip(scores, sums, strict=True):
        into += np.bincount(bins, row, minlength=len(into))
    sums = np.asarray(sums - sums.mean(axis=1, keepdims=True), np.float64)
    found: Array = sums @ sums.T
    for lag in range(1, FIT_COVARIANCE.lags + 1):
        later = sums[:, lag:] @ sums[:, :-lag].T
        found = found + (1.0 - lag / (FIT_COVARIANCE.lags + 1)) * (later + later.T)
    return found


def widened(covariance: Array, scores: Array) -> Array:
    """A covariance, (a, a), no narrower in any unknown than the covariance of the scores lets it be. Of a
    single fit of all data, not of one that others begin with: it may be wider than its prior (`tempered`)."""
    robust = covariance @ scores @ covariance
    factors = np.sqrt(np.maximum(np.diag(robust) / np.diag(covariance), 1.0))
    return np.asarray(covariance * np.outer(factors, factors), np.float64)


def whiteness(rows: Array, used: Array, e: Array, S: Array) -> float:
    """Autocorrelation at lag one of the normalised innovations of each kind and place, weighted mean."""
    found, weights = [], []
    for kind, place in {(float(k), float(p)) for k, p in rows[:, [KIND, PLACE]]}:
        chosen = (rows[:, KIND] == kind) & (rows[:, PLACE] == place) & (used > 0.0)
        z = (e / np.sqrt(S))[chosen]
        if len(z) > 20 and z @ z > 0.0:
            found.append(float(z[1:] @ z[:-1] / (z @ z)))
            weights.append(len(z))
    return float(np.average(found, weights=weights)) if found else 0.0
