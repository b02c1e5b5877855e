"""How soil differs from place to place, and what windows of driving tell of it at another place.

The logarithms of the six at a place x are m_j + z(x) + e_j(x): m of the rig and the field, whose prior is the
machine file's; z, a soil factor that all axles share, and e, smaller, of each axle, for the three
stiffnesses. z and e are Gaussian processes whose correlation falls with distance. How much soil differs, and
over which length, is learned: each pair of values is a hypothesis, weighed by the marginal likelihood of what
the windows told, and by how often fields are so. With few windows many are likely, and the answer is wide.

A window tells of the mean over its path, of each axle's stiffness along the way of that axle. Errors of the
model are common to all windows of a method: a random effect, so they do not average out. Each fit has some of
its own besides, as no two turns are alike; how large they are, on this rig, are hypotheses too. Worked ground
is an effect of its own, and the level of the stiffnesses drifts with time (Ornstein and Uhlenbeck's process).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import chdtrc

from tilth.estimator.filters.unknowns import NOISE, SIX
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

AXLES: Final = len(PARAMETERS) // 2
ROWS: Final = "rows"  # the method whose windows are pieces of one fit


@dataclass(frozen=True, slots=True)
class SoilFieldTuning:
    """What is thought possible of a field."""

    sds: tuple[float, ...] = tuned(
        (0.05, 0.15, 0.25, 0.4, 0.6), "1", "of a stiffness' logarithm over the field"
    )
    beforehand: tuple[float, ...] = tuned(
        (0.5, 0.2, 0.15, 0.1, 0.05), "1", "how probable each of these sds is before any window"
    )
    lengths_m: tuple[float, ...] = tuned((10.0, 30.0, 100.0), "m", "over which soil is alike")
    common: float = tuned(0.8, "1", "share of the variance that all axles have in common")
    direction: float = tuned(
        0.05, "1", "sd of a stiffness' logarithm that turns with the heading: slope, pull"
    )
    """3° fore and aft shift 5 % of the front axle's load. What passes to and fro differ by is not soil."""
    worked: float = tuned(0.2, "1", "sd of a stiffness' logarithm between worked ground and other ground")
    changed: float = tuned(0.4, "1", "sd of a stiffness' logarithm between before and after a change in time")
    own_errors: tuple[float, ...] = tuned(
        (0.0, 0.4), "1", "sd of errors of the model in one fit alone, over those in common; each as probable"
    )
    """Sixteen turns on one soil scattered by 0.14, where noise is 0.03 and errors of the model are 0.19. Were
    all in common, another soil every 10 m would explain it. In 24 days of that rig 0.5 is likeliest, in days
    of 18 rigs 0.3, by 92 and 14 nats. Rigs differ: of four in patchy fields three have rather 0.4, by 1 to 3
    nats, and one 0, by 10."""
    ages_s: float = tuned(
        400_000.0, "s", "in which the level becomes another, as by such a change: 5 % in an hour, 17 % in ten"
    )
    telling: float = tuned(0.02, "1", "information over the prior's, of a direction that is used")
    likely: float = tuned(1e-3, "1", "likelihood over the largest: of a hypothesis that is not left out")
    along: float = tuned(
        math.log(10.0), "nat", "that the ways of windows tell of patches at most, or against them"
    )
    """Patches go on everywhere, a wet end does not: all windows may lie in zones of one soil each. While it
    was counted in full, and for which patches, 82 86 92 % of intervals held in rows of two fields with wet
    ends, where without it 89 92 95 did."""
    points: int = tuned(6, "positions", "of a path")


SOIL_FIELD: Final = SoilFieldTuning()


@dataclass(frozen=True, slots=True)
class Told:
    """What one window told of the six logarithms, less what was known before."""

    information: Annotated[Array, Shape((6, 6))]
    vector: Annotated[Array, Shape((6,))]  # information @ (what it says alone, less the prior's mean)
    model_sd: Annotated[Array, Shape((6,))]  # of errors of the model, in common with others of its method
    patches: float = 0.0  # nats by which patches explain what differs along its way better than one soil


def told(
    before: Array,
    covariance: Array,
    after: Array,
    information: Array,
    prior: tuple[Array, Array],
    wider: Array,
    model_sd: Array,
    *,
    of_file: bool = False,
) -> Told:
    """What a window adds, whose likelihood has this information, (n, n), and with what was known before it,
    (n,) and (n, n), its largest value at `after`, (n,).

    What was known of all but the six stays known; how it was correlated with the six, of other places, does
    not count. Noise levels are the window's own. All else is of the rig, and the same in all windows: the six
    are told as if it were known, and its uncertainty joins the errors of the model.
    prior: mean and sds of the machine file, (n,). wider: factors on the sds of the six by noise, (6,).
    model_sd: (6,). of_file: the rig is as its machine file has it, whatever was known of it. What is wrong
    with the model is alike in all windows and has moved what looks like it further with each; then softer
    soil looks like the same soil.
    """
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    known, start = covariance[np.ix_(active, active)], (before - prior[0])[active]
    precision = information[np.ix_(active, active)]
    vector = precision @ (after - prior[0])[active] + np.linalg.solve(known, (after - before)[active])
    six, of_rig = active < 6, (active >= 6) & ~np.isin(active, np.arange(NOISE.start, NOISE.stop))
    others = np.zeros_like(known)
    rest = np.ix_(~six, ~six)
    others[rest] = np.linalg.inv(known[rest])
    if of_file:
        others[of_rig, :] = others[:, of_rig] = start[of_rig] = 0.0
        others[of_rig, of_rig] = prior[1][active[of_rig]] ** -2.0
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
    passing: int  # number of the pass; -1: of an earlier run
    path: Annotated[Array, Shape((-1, AXLES, 2))]  # north and east of each axle, m, at places along it
    told: Told
    epoch: int = 0  # number of the changes in time before it
    worked: Annotated[Array, Shape((AXLES,))] = field(default_factory=lambda: np.zeros(AXLES))
    """Share of each axle's way that had been worked before this pass."""


def merged(one: SoilWindow, other: SoilWindow) -> SoilWindow:
    """Both of a method as one, where the soil is taken to be the same: the path of the later one."""
    told = Told(
        one.told.information + other.told.information,
        one.told.vector + other.told.vector,
        np.maximum(one.told.model_sd, other.told.model_sd),
        one.told.patches + other.told.patches,
    )
    latest = max(one, other, key=lambda window: window.begin_ns)
    return replace(latest, told=told, worked=(one.worked + other.worked) / 2.0)


@dataclass(frozen=True, slots=True)
class WorkedPoint:
    """Where the middle of an implement has worked: a corner of its way."""

    passing: int
    place: Annotated[Array, Shape((2,))]  # north and east, m


@dataclass(frozen=True, slots=True)
class KeptSoil:
    """What is kept of a field, for the next run."""

    origin_deg: tuple[float, float]  # latitude and longitude, of the plane that paths are in
    windows: list[SoilWindow]  # each begins so long before the last of them informed
    way: list[WorkedPoint]

    @property
    def finite(self) -> bool:
        def numbers(w: SoilWindow) -> tuple[Array | float, ...]:
            told = w.told
            return w.path, told.information, told.vector, told.model_sd, told.patches, w.worked

        return all(np.all(np.isfinite(part)) for w in self.windows for part in numbers(w)) and all(
            np.all(np.isfinite(point.place)) for point in self.way
        )


class At(NamedTuple):
    """What is known at a place."""

    mean: Array  # (6,), of the logarithms less the prior's mean
    covariance: Array  # (6, 6)
    length_m: float  # over which soil is alike


class AskedGround(NamedTuple):
    """What is asked of a place, besides where it is."""

    t_ns: int | None = None  # when; None: when what was told last began
    worked: Array | None = None  # share of each axle's ground that had been worked before, (3,); None: none


LAST: Final = AskedGround()
_OF_AXLES: Final = np.full((AXLES, AXLES), SOIL_FIELD.common) + (1.0 - SOIL_FIELD.common) * np.eye(AXLES)
"""Correlation of what axles have in common."""


def exponential(apart: Array, length_m: float) -> Array:
    """Correlation of the stiffnesses' means over paths, (3 n, 3 m). apart: as of `_apart`."""
    return _over_axles(apart, np.exp(np.sqrt(apart[0] * apart[0] + apart[1] * apart[1]) / -length_m))


def smooth(apart: Array, length_m: float) -> Array:
    """The same of soil that does not change over a few metres."""
    return _over_axles(apart, np.exp((apart[0] * apart[0] + apart[1] * apart[1]) / -(length_m**2)))


def _over_axles(apart: Array, alike: Array) -> Array:
    """By the correlation of places, with what axles have in common."""
    return np.asarray(over_paths(alike) * np.tile(_OF_AXLES, (apart.shape[1], apart.shape[4])))


def over_paths(each: Array) -> Array:
    """The mean over all pairs of places of two paths, (n, 3, p, m, 3, q): (3 n, 3 m)."""
    n, axles, p, m, _, q = each.shape
    return np.asarray(each.reshape(n * axles, p, m * axles, q).mean(axis=(1, 3)))


def _apart(these: Array, those: Array) -> Array:
    """How far places of paths, (n, 3, p, 2) and (m, 3, q, 2), are to north and east of each other, m:
    (2, n, 3, p, m, 3, q)."""
    one, other = these.reshape(-1, 2), those.reshape(-1, 2)
    shape = (*these.shape[:3], *those.shape[:3])
    return np.stack([(one[:, None, k] - other[None, :, k]).reshape(shape) for k in (0, 1)])


def _headings(places: Array) -> Array:
    """Mean direction of the rig, (…, 2): of length 1 where it heads the same way all along, of next to 0
    where it turns round. places: of the axles, (…, 3, points, 2)."""
    ahead = places[..., 0, :, :] - places[..., -1, :, :]
    return np.asarray((ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)).mean(axis=-2))


class Variogram(NamedTuple):
    """How soil may differ."""

    sd: float
    length_m: float
    correlation: Callable[[Array, float], Array] = exponential
    beforehand: float = 1.0  # how probable it is before any window, over that of another

    @property
    def alike(self) -> bool:
        """Whether it is one soil."""
        return self.sd == min(SOIL_FIELD.sds)

    @property
    def kind(self) -> tuple[float, Callable[[Array, float], Array]]:
        """What those have in common that differ in the sd alone."""
        return self.length_m, self.correlation


VARIOGRAMS: Final = tuple(
    Variogram(sd, length, beforehand=probable)
    for length in SOIL_FIELD.lengths_m
    for sd, probable in zip(SOIL_FIELD.sds, SOIL_FIELD.beforehand, strict=True)
)


class _Hypothesis(NamedTuple):
    soil: Variogram
    weight: float
    score: float  # logarithm of the likelihood of what was told, with how probable it was before
    root: Array  # (r, r), lower, of the covariance of what was told
    alpha: Array  # (r,), its inverse times what was told
    distance: float  # squared, of what was told from what was thought before

    def solve(self, told: Array) -> Array:
        return np.asarray(cho_solve((self.root, True), told, check_finite=False))


_Kinds = dict[tuple[float, Callable[[Array, float], Array]], tuple[Array, Array]]


class _Near(NamedTuple):
    """What a place has to do with what was told."""

    kinds: _Kinds
    """Of each kind of soil: correlation of what was told with each axle's, (r, 3), and of these, (3, 3)."""
    level: tuple[Array, Array]
    """Whatever the soil: covariance of what was told with the six there, (r, 6), and of these, (6, 6), ..."""
    toward: tuple[Array, Array]  # ... what the direction adds to it for the stiffnesses, (r, 3) and (3, 3),
    work: tuple[Array, Array]  # and what work does


class SoilMemory:
    """What some windows tell of a field. Derived from them alone."""

    def __init__(
        self,
        windows: Sequence[SoilWindow],
        prior_sd: Array,
        variograms: Sequence[Variogram] = VARIOGRAMS,
        own_errors: Sequence[float] = SOIL_FIELD.own_errors,
    ) -> None:
        """prior_sd: (n,), of the machine file. variograms, own_errors: hypotheses, each with each."""
        self.windows, self.prior_sd = windows, prior_sd[SIX]
        self.variograms, self.own_errors = variograms, own_errors
        paths = np.array([window.path for window in windows]).reshape(-1, SOIL_FIELD.points, AXLES, 2)
        self._places = paths.transpose(0, 2, 1, 3)  # (windows, 3, points, 2)
        self._last_place: tuple[Array, tuple[_Kinds, Array]] | None = None  # and its `_of_place`

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
    def _toward(self) -> Array:
        """What each direction that was told of has of each axle's stiffness to north and to east, (r, 6)."""
        of, units, _, _ = self._directions
        toward = units[:, :AXLES, None] * _headings(self._places)[of][:, None]
        return np.asarray(toward.reshape(len(of), 2 * AXLES))

    @cached_property
    def _scored(self) -> list[_Hypothesis]:
        """All hypotheses, with the weight of each."""
        of, units, values, variances = self._directions
        sds = np.array([window.told.model_sd for window in self.windows]).reshape(-1, 6)[of]
        methods = np.array([window.method for window in self.windows])[of]
        fixed = (units * self.prior_sd**2) @ units.T + np.diag(variances)
        for alike, changing in zip(self._alike(*self._ages), self._of_time, strict=True):
            fixed -= (units * changing) @ units.T * (1.0 - alike[of][:, of])
        fixed += SOIL_FIELD.worked**2 * (self._worked @ _OF_AXLES @ self._worked.T)
        fixed += SOIL_FIELD.direction**2 * (self._toward @ self._toward.T)
        # What the surer of two windows has of errors, both have: a difference of them is not free of it.
        in_common = np.minimum(sds[:, None], sds[None, :]) ** 2 * units[:, None] * units[None, :]
        fixed += in_common.sum(axis=2) * (methods[:, None] == methods[None, :])
        # Pieces of rows are of one fit, or of blocks that each begin where the one before ended: one error.
        of_fit = np.where(methods == ROWS, -1, of)
        own = in_common.sum(axis=2) * (of_fit[:, None] == of_fit)
        apart = _apart(self._places, self._places)
        within = {
            key: self._placed @ one.correlation(apart, one.length_m) @ self._placed.T
            for key, one in self._kinds.items()
        }
        # Only whether there are patches: which ones, windows tell that are apart. Nor may it grow for ever.
        along = sum(window.told.patches for window in self.windows)
        along = min(max(along, -SOIL_FIELD.along), SOIL_FIELD.along)
        found, logs = [], []
        for one, share in product(self.variograms, self.own_errors):
            # In LAPACK's order: each solution would copy it otherwise.
            covariance = fixed + one.sd**2 * within[one.kind] + share**2 * own
            root = np.asfortranarray(np.linalg.cholesky(covariance))
            alpha = np.asarray(cho_solve((root, True), values, check_finite=False))
            distance = float(values @ alpha)
            likely = -0.5 * distance - float(np.sum(np.log(np.diag(root))))
            likely += 0.0 if one.alike else along
            logs.append(math.log(one.beforehand / len(self.own_errors)) + likely)
            found.append(_Hypothesis(one, 0.0, logs[-1], root, alpha, distance))
        weights = np.exp(np.array(logs) - max(logs))
        weights[weights <= SOIL_FIELD.likely] = 0.0
        return [h._replace(weight=w) for h, w in zip(found, (weights / weights.sum()).tolist(), strict=True)]

    @cached_property
    def _kinds(self) -> dict[tuple[float, Callable[[Array, float], Array]], Variogram]:
        """One of those that have a correlation in common."""
        return {one.kind: one for one in self.variograms}

    @cached_property
    def _worked(self) -> Array:
        """What each direction that was told of has of the effect of work on each axle, (r, 3)."""
        of, units, _, _ = self._directions
        shares = np.array([window.worked for window in self.windows]).reshape(-1, AXLES)
        return np.asarray(units[:, :AXLES] * shares[of])

    @cached_property
    def _ages(self) -> tuple[Array, Array]:
        """Of each window: when it began, s, and the number of the changes in time before it."""
        begin_s = np.array([window.begin_ns * 1e-9 for window in self.windows], np.float64)
        return begin_s, np.array([window.epoch for window in self.windows], np.float64)

    def _alike(self, at_s: Array, epochs: Array) -> tuple[Array, Array]:
        """Correlation with the level in each window by age, and by both age and changes, (windows, …)."""
        own_s, own = self._ages
        near: Array = np.exp(-np.abs(own_s[:, None] - at_s) / SOIL_FIELD.ages_s)
        both: Array = near * (own[:, None] == epochs)
        return near, both

    @property
    def _of_time(self) -> tuple[Array, Array]:
        """Variances of the six between times far apart: of what only ages, and of what may change, (6,)."""
        variance: Array = np.minimum(SOIL_FIELD.changed, self.prior_sd) ** 2
        stiffness = np.arange(6) < AXLES
        return np.where(stiffness, 0.0, variance), np.where(stiffness, variance, 0.0)

    @property
    def for_patches(self) -> tuple[float, float]:
        """Logarithms of the likelihoods of what was told by patches, and by one soil."""
        patches, alike = (
            float(np.logaddexp.reduce([one.score for one in self._scored if one.soil.alike is same]))
            - math.log(sum(one.beforehand for one in self.variograms if one.alike is same))
            for same in (False, True)
        )
        return patches, alike

    @property
    def _hypotheses(self) -> list[_Hypothesis]:
        """Those that are not left out."""
        return [one for one in self._scored if one.weight]

    def surprise(self, more: "SoilMemory") -> float:
        """How likely it was that a window more, the last of `more`, is as far as it is from what these tell.
        1 where these tell nothing."""
        dimensions = len(more._directions[0]) - len(self._directions[0])
        if not self.windows or not dimensions:
            return 1.0
        distances = zip(self._scored, more._scored, strict=True)
        apart = np.array([after.distance - before.distance for before, after in distances])
        likely = chdtrc(dimensions, np.maximum(apart, 0.0))
        return float(np.sum(likely * [one.weight for one in self._scored]))

    @property
    def patchy(self) -> float:
        """Probability that soil differs by more than the least of the sds."""
        return 1.0 - sum(one.weight for one in self._hypotheses if one.soil.alike)

    def at(self, place: Array, asked: AskedGround = LAST) -> At:
        """At a place of the rig, or on average over a path: north and east of each axle, (..., 3, 2), m."""
        mean, second, length = np.zeros(6), np.zeros((6, 6)), 0.0
        near = self._near(place, asked)
        for one in self._hypotheses:
            cross, own = self._with(near, one.soil)
            there = cross.T @ one.alpha
            mean += one.weight * there
            second += one.weight * (own - cross.T @ one.solve(cross) + np.outer(there, there))
            length += one.weight * one.soil.length_m
        covariance = second - np.outer(mean, mean)
        return At(mean, (covariance + covariance.T) / 2.0, length)

    def around(self, places: Array) -> tuple[Array, Array]:
        """Of the stiffnesses' logarithms less the prior's mean, of an axle at each of these places, whatever
        its heading: mean (m, 3) and covariance (m, 3, 3). places: north and east, (m, 2), m."""
        there = np.broadcast_to(places[:, None, None], (len(places), AXLES, 1, 2))
        apart, at_one = _apart(self._places, there), self._near(np.zeros((AXLES, 2)))
        mean, second = np.zeros((len(places), AXLES)), np.zeros((len(places), AXLES, AXLES))
        placed = {k: self._placed @ one.correlation(apart, one.length_m) for k, one in self._kinds.items()}
        for one in self._hypotheses:
            told, itself = at_one.kinds[one.soil.kind]
            alike = {one.soil.kind: (np.zeros_like(told), itself)}
            of_rig, own = self._with(at_one._replace(kinds=alike), one.soil)
            cross = np.tile(of_rig[:, :AXLES], len(places)) + one.soil.sd**2 * placed[one.soil.kind]
            here = (cross.T @ one.alpha).reshape(-1, AXLES)
            half = solve_triangular(one.root, cross, lower=True, check_finite=False)
            by_place = half.reshape(len(cross), len(places), AXLES).transpose(1, 2, 0)
            left = own[:AXLES, :AXLES] - by_place @ by_place.transpose(0, 2, 1)
            mean += one.weight * here
            second += one.weight * (left + here[:, :, None] * here[:, None, :])
        return mean, second - mean[:, :, None] * mean[:, None, :]

    def elsewhere(self, place: Array, asked: AskedGround = LAST) -> Array:
        """How much more uncertain the six are there than by what these windows tell of one soil, (6, 6): what
        is learned without place has this error besides. Of the stiffnesses."""
        there, near = self.at(place, asked), self._near(place)
        same = (one for one in self._scored if one.soil.alike)
        one = max(same, key=lambda hypothesis: hypothesis.score)
        cross, own = self._with(near, one.soil)
        off = there.mean - cross.T @ one.alpha
        added = there.covariance + np.outer(off, off) - (own - cross.T @ one.solve(cross))
        sizes, axes = np.linalg.eigh(added[:AXLES, :AXLES])
        left = np.zeros((6, 6))
        left[:AXLES, :AXLES] = axes * np.maximum(sizes, 0.0) @ axes.T
        return left

    def _near(self, place: Array, asked: AskedGround = LAST) -> "_Near":
        kinds, toward = self._of_place(place)
        (begin_s, epochs), worked = self._ages, np.zeros(AXLES) if asked.worked is None else asked.worked
        now_s = begin_s.max(initial=0.0) if asked.t_ns is None else asked.t_ns * 1e-9
        of, units, _, _ = self._directions
        cross, own = units * self.prior_sd**2, np.diag(self.prior_sd**2)
        ages = self._alike(np.array([now_s]), epochs.max(initial=0.0))
        for alike, changing in zip(ages, self._of_time, strict=True):
            cross -= units * changing * (1.0 - alike[of])
        across = SOIL_FIELD.direction**2 * toward
        by_work = SOIL_FIELD.worked**2 * _OF_AXLES * worked
        return _Near(
            kinds, (cross, own), (self._toward @ across.T, toward @ across.T),
            (self._worked @ by_work, worked[:, None] * by_work),
        )  # fmt: skip

    def _of_place(self, place: Array) -> tuple[_Kinds, Array]:
        """`kinds` and `toward` of `_near`. Where the rig is, they are asked for four times a second."""
        last = self._last_place
        if last is not None and np.array_equal(last[0], place):
            return last[1]
        there = place.reshape(1, -1, AXLES, 2).transpose(0, 2, 1, 3)
        apart, own = _apart(self._places, there), _apart(there, there)
        kinds = {
            key: (self._placed @ one.correlation(apart, one.length_m), one.correlation(own, one.length_m))
            for key, one in self._kinds.items()
        }
        found = kinds, np.asarray(np.kron(np.eye(AXLES), _headings(there)), np.float64)
        self._last_place = place.copy(), found
        return found

    def _with(self, near: "_Near", soil: Variogram) -> tuple[Array, Array]:
        """Covariance of what was told with the six at a place now, (r, 6), and of these, (6, 6)."""
        cross, own = (level.copy() for level in near.level)
        of_axles = cross[:, :AXLES], own[:AXLES, :AXLES]
        for part, kind, toward, work in zip(
            of_axles, near.kinds[soil.kind], near.toward, near.work, strict=True
        ):
            part += soil.sd**2 * kind + toward
            part += work
        return cross, own

    def shares(
        self, place: Array, chosen: Sequence[bool], asked: AskedGround = LAST
    ) -> tuple[float, float, float]:
        """By how much the chosen windows, then the others, narrow the stiffnesses at a place, over their
        prior's sd, and what is left of it; mean of the three. They add up to 1."""
        one = max(self._hypotheses, key=lambda hypothesis: hypothesis.weight)
        cross, own = self._with(self._near(place, asked), one.soil)
        rows = np.flatnonzero(np.array(chosen)[self._directions[0]])
        told = one.root[rows] @ one.root[rows].T
        by_chosen = cross[rows].T @ np.linalg.solve(told, cross[rows])
        left = [np.diag(own - known)[:AXLES] for known in (by_chosen, cross.T @ one.solve(cross))]
        first, last = (np.mean(np.sqrt(np.maximum(v, 0.0) / np.diag(own)[:AXLES])) for v in left)
        return float(1.0 - first), float(first - last), float(last)
