"""How soil differs from place to place, and what windows of driving tell of it at another place.

The logarithms of the six at a place x are m_j + z(x) + e_j(x): m of the rig and the field, whose prior is the
machine file's; z, a soil factor that all axles share, and e, smaller, of each axle, for the three
stiffnesses. z and e are Gaussian processes whose correlation falls with distance. How much soil differs, and
over which length, is learned: each pair of values is a hypothesis, weighed by the marginal likelihood of what
the windows told. With few windows many are likely, and the answer is wide.

A window tells of the mean over its path, of each axle's stiffness along the way of that axle. Errors of the
model are common to all windows of a method: a random effect, so they do not average out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

AXLES: Final = len(PARAMETERS) // 2


@dataclass(frozen=True, slots=True)
class SoilFieldTuning:
    """What is thought possible of a field."""

    sds: tuple[float, ...] = tuned((0.05, 0.15, 0.25, 0.4), "1", "of a stiffness' logarithm over the field")
    lengths_m: tuple[float, ...] = tuned((10.0, 30.0, 100.0), "m", "over which soil is alike")
    common: float = tuned(0.8, "1", "share of the variance that all axles have in common")
    telling: float = tuned(0.02, "1", "information over the prior's, of a direction that is used")
    likely: float = tuned(1e-3, "1", "likelihood over the largest: of a hypothesis that is not left out")
    points: int = tuned(6, "positions", "of a path")


SOIL_FIELD: Final = SoilFieldTuning()


@dataclass(frozen=True, slots=True)
class Told:
    """What one window told of the six logarithms, less what was known before."""

    information: Annotated[Array, Shape((6, 6))]
    vector: Annotated[Array, Shape((6,))]  # information @ (what it says alone, less the prior's mean)
    model_sd: Annotated[Array, Shape((6,))]  # of errors of the model, in common with others of its method


def told(
    before: Array,
    covariance: Array,
    after: Array,
    information: Array,
    prior: tuple[Array, Array],
    wider: Array,
    model_sd: Array,
) -> Told:
    """What a window adds, whose likelihood has this information, (n, n), and with what was known before it,
    (n,) and (n, n), its largest value at `after`, (n,).

    What was known of all but the six stays known; how it was correlated with the six, of other places, does
    not count. Noise levels are the window's own. All else is of the rig, and the same in all windows: the six
    are told as if it were known, and its uncertainty joins the errors of the model.
    prior: mean and sds of the machine file, (n,). wider: factors on the sds of the six by noise, (6,).
    model_sd: (6,).
    """
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    known, start = covariance[np.ix_(active, active)], (before - prior[0])[active]
    precision = information[np.ix_(active, active)]
    vector = precision @ (after - prior[0])[active] + np.linalg.solve(known, (after - before)[active])
    six, of_rig = active < 6, (active >= 6) & ~np.isin(active, np.arange(NOISE.start, NOISE.stop))
    others = np.zeros_like(known)
    rest = np.ix_(~six, ~six)
    others[rest] = np.linalg.inv(known[rest])
    precision, vector = _without(precision + others, vector + others @ start, ~six & ~of_rig)
    six = six[six | of_rig]
    weak = np.diag(np.where(six, prior[1][active[: len(six)]] ** -2.0, 0.0))
    found = np.linalg.inv(precision + weak)
    by_rig = np.linalg.solve((precision + weak)[np.ix_(six, six)], precision[np.ix_(six, ~six)])
    rig_sd = np.sqrt(np.diag(by_rig @ found[np.ix_(~six, ~six)] @ by_rig.T))
    alone = precision[np.ix_(six, six)]
    value = np.linalg.pinv(alone, hermitian=True) @ (
        vector[six] - precision[np.ix_(six, ~six)] @ (found @ vector)[~six]
    )
    at, left, of_six, sds = active[active < 6], np.zeros((6, 6)), np.zeros(6), model_sd.copy()
    left[np.ix_(at, at)] = alone / np.outer(wider[at], wider[at])
    of_six[at], sds[at] = value, np.hypot(model_sd[at], rig_sd)
    return Told((left + left.T) / 2.0, left @ of_six, sds)


def _without(precision: Array, vector: Array, gone: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The information on what is not gone, and its vector, where what is gone may be anything."""
    passed_on = np.linalg.solve(precision[np.ix_(gone, gone)], precision[np.ix_(gone, ~gone)]).T
    return (
        precision[np.ix_(~gone, ~gone)] - passed_on @ precision[np.ix_(gone, ~gone)],
        vector[~gone] - passed_on @ vector[gone],
    )


@dataclass(frozen=True, slots=True)
class SoilWindow:
    """A window of driving: where it was, and what it told."""

    method: str
    begin_ns: int
    passing: int  # number of the pass
    path: Annotated[Array, Shape((-1, AXLES, 2))]  # north and east of each axle, m, at places along it
    told: Told


def merged(one: SoilWindow, other: SoilWindow) -> SoilWindow:
    """Both of a method as one, where the soil is taken to be the same: the path of the later one."""
    told = Told(
        one.told.information + other.told.information,
        one.told.vector + other.told.vector,
        np.maximum(one.told.model_sd, other.told.model_sd),
    )
    return replace(max(one, other, key=lambda window: window.begin_ns), told=told)


@dataclass(frozen=True, slots=True)
class KeptSoil:
    """What is kept of a field, for the next run."""

    origin_deg: tuple[float, float]  # latitude and longitude, of the plane that paths are in
    windows: list[SoilWindow]

    @property
    def finite(self) -> bool:
        return all(
            np.all(np.isfinite(part))
            for w in self.windows
            for part in (w.path, w.told.information, w.told.vector, w.told.model_sd)
        )

    def faded(self, share: float) -> "KeptSoil":
        """With so much of its information left."""
        windows = [
            replace(
                w, told=replace(w.told, information=share * w.told.information, vector=share * w.told.vector)
            )
            for w in self.windows
        ]
        return replace(self, windows=windows)


class At(NamedTuple):
    """What is known at a place."""

    mean: Array  # (6,), of the logarithms less the prior's mean
    covariance: Array  # (6, 6)
    length_m: float  # over which soil is alike


class _Hypothesis(NamedTuple):
    sd: float
    length_m: float
    weight: float
    covariance: Array  # (r, r), of what was told
    inverse: Array
    alpha: Array  # (r,), that times what was told


class SoilMemory:
    """What some windows tell of a field. Derived from them alone."""

    def __init__(self, windows: Sequence[SoilWindow], prior_sd: Array) -> None:
        """prior_sd: (n,), of the machine file."""
        self.windows, self.prior_sd = windows, prior_sd[SIX]
        paths = np.array([window.path for window in windows]).reshape(-1, SOIL_FIELD.points, AXLES, 2)
        self._places = paths.transpose(0, 2, 1, 3)  # (windows, 3, points, 2)

    @cached_property
    def _directions(self) -> tuple[NDArray[np.int64], Array, Array, Array]:
        """Of each direction that was told of: (its window, (r,); unit vector, (r, 6); value; variance)."""
        of, units, values, variances = [], [np.zeros((0, 6))], [], []
        for k, window in enumerate(self.windows):
            scale = np.where(self.prior_sd > 0.0, self.prior_sd, 1.0)
            size, axes = np.linalg.eigh(window.told.information * np.outer(scale, scale))
            used = np.flatnonzero(size > SOIL_FIELD.telling)
            units.append((axes[:, used] / scale[:, None]).T)
            values += ((axes[:, used].T @ (scale * window.told.vector)) / size[used]).tolist()
            variances += (1.0 / size[used]).tolist()
            of += [k] * len(used)
        return np.array(of, np.int64), np.concatenate(units), np.array(values), np.array(variances)

    @cached_property
    def _placed(self) -> Array:
        """What each direction has of the stiffness of each axle in each window, (r, 3 windows)."""
        of, units, _, _ = self._directions
        placed = np.zeros((len(of), AXLES * len(self.windows)))
        for axle in range(AXLES):
            placed[np.arange(len(of)), AXLES * of + axle] = units[:, axle]
        return placed

    @cached_property
    def _hypotheses(self) -> list[_Hypothesis]:
        of, units, values, variances = self._directions
        sds = np.array([window.told.model_sd for window in self.windows]).reshape(-1, 6)[of]
        methods = np.array([window.method for window in self.windows])[of]
        fixed = (units * self.prior_sd**2) @ units.T + np.diag(variances)
        # What the surer of two windows has of errors, both have: a difference of them is not free of it.
        in_common = np.minimum(sds[:, None], sds[None, :]) ** 2 * units[:, None] * units[None, :]
        fixed += in_common.sum(axis=2) * (methods[:, None] == methods[None, :])
        alike = _alike(len(self.windows), len(self.windows))
        found, logs = [], []
        for length in SOIL_FIELD.lengths_m:
            within = (
                self._placed @ (alike * _correlation(self._places, self._places, length)) @ self._placed.T
            )
            for sd in SOIL_FIELD.sds:
                covariance = fixed + sd**2 * within
                inverse = np.asarray(np.linalg.inv(covariance), np.float64)
                alpha = inverse @ values
                logs.append(-0.5 * float(values @ alpha) - 0.5 * float(np.linalg.slogdet(covariance)[1]))
                found.append(_Hypothesis(sd, length, 0.0, covariance, inverse, alpha))
        weights = np.exp(np.array(logs) - max(logs))
        used = weights > SOIL_FIELD.likely
        weights /= np.sum(weights[used])
        return [h._replace(weight=float(w)) for h, w, u in zip(found, weights, used, strict=True) if u]

    @property
    def patchy(self) -> float:
        """Probability that soil differs by more than the least of the sds."""
        return 1.0 - sum(one.weight for one in self._hypotheses if one.sd == min(SOIL_FIELD.sds))

    def at(self, place: Array) -> At:
        """At a place of the rig: north and east of each axle, (3, 2), m."""
        mean, second, length = np.zeros(6), np.zeros((6, 6)), 0.0
        near = {length_m: self._near(place, length_m) for length_m in SOIL_FIELD.lengths_m}
        for one in self._hypotheses:
            cross, own = self._with(near[one.length_m], one.sd)
            there = cross.T @ one.alpha
            mean += one.weight * there
            second += one.weight * (own - cross.T @ one.inverse @ cross + np.outer(there, there))
            length += one.weight * one.length_m
        covariance = second - np.outer(mean, mean)
        return At(mean, (covariance + covariance.T) / 2.0, length)

    def _near(self, place: Array, length_m: float) -> tuple[Array, Array]:
        """Correlation of what was told with the soil of each axle at a place, (r, 3), of these, (3, 3)."""
        there = place[None, :, None, :]
        near = _alike(len(self.windows), 1) * _correlation(self._places, there, length_m)
        return self._placed @ near, _alike(1, 1) * _correlation(there, there, length_m)

    def _with(self, near: tuple[Array, Array], sd: float) -> tuple[Array, Array]:
        """Covariance of what was told with the six at a place, (r, 6), and of these, (6, 6)."""
        cross, own = self._directions[1] * self.prior_sd**2, np.diag(self.prior_sd**2)
        cross[:, :AXLES] += sd**2 * near[0]
        own[:AXLES, :AXLES] += sd**2 * near[1]
        return cross, own

    def shares(self, place: Array, chosen: Sequence[bool]) -> tuple[float, float, float]:
        """By how much the chosen windows, then the others, narrow the stiffnesses at a place, over their
        prior's sd, and what is left of it; mean of the three. They add up to 1."""
        one = max(self._hypotheses, key=lambda hypothesis: hypothesis.weight)
        cross, own = self._with(self._near(place, one.length_m), one.sd)
        rows = np.flatnonzero(np.array(chosen)[self._directions[0]])
        by_chosen = cross[rows].T @ np.linalg.solve(one.covariance[np.ix_(rows, rows)], cross[rows])
        left = [np.diag(own - told)[:AXLES] for told in (by_chosen, cross.T @ one.inverse @ cross)]
        first, last = (np.mean(np.sqrt(np.maximum(v, 0.0) / np.diag(own)[:AXLES])) for v in left)
        return float(1.0 - first), float(first - last), float(last)


def _alike(n: int, m: int) -> Array:
    """Correlation of axles with each other at one place, tiled, (3 n, 3 m)."""
    one = np.full((AXLES, AXLES), SOIL_FIELD.common) + (1.0 - SOIL_FIELD.common) * np.eye(AXLES)
    return np.tile(one, (n, m))


def _correlation(these: Array, those: Array, length: float) -> Array:
    """Of the means over paths, (n, 3, p, 2) and (m, 3, q, 2): (3 n, 3 m)."""
    one, other = these.reshape(-1, 2), those.reshape(-1, 2)
    north, east = (one[:, None, k] - other[None, :, k] for k in (0, 1))
    near = np.exp(-np.sqrt(north**2 + east**2) / length)
    p, q = these.shape[2], those.shape[2]
    return np.asarray(near.reshape(-1, p, len(other) // q, q).mean(axis=(1, 3)))
