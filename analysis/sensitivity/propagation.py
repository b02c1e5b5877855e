"""What is not known of parameters, carried through a model to its outputs; and turned round.

Source: Karkee (2009), section 6.2.3, for any covariance, output and rig. Draws are log-normal, so that
none is negative, and are carried through the whole model; beside them stands the first order, exact for small
uncertainties: sd^2 of an output is the sum over parameters j, k of their covariance times the product of the
output's changes (outputs.products). Draws of rigs that are unstable have no outputs; they are counted.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tilth.analysis.fit.side_by_side import Map, side_by_side
from tilth.analysis.sensitivity.answers import (
    AloneAnswer,
    Assumed,
    OutputAnswer,
    RefusedSpeed,
    UncertaintyAnswer,
    UncertaintyEntry,
    Values,
    WantedAnswer,
    finite,
)
from tilth.analysis.sensitivity.designs import log_normal
from tilth.analysis.sensitivity.knowledge import Knowledge
from tilth.analysis.sensitivity.local import response_slope
from tilth.analysis.sensitivity.outputs import (
    NAMES,
    OUTPUTS,
    STEP,
    STILL,
    Case,
    Unstable,
    case_of,
    deviations,
    products,
    respond,
    sizes,
)
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import eigenvalues, system
from tilth.estimator.models.parameters import Rig
from tilth.schemas.spread import WITHIN

Array = NDArray[np.float64]

DRAWS: Final = 2000
ALONE: Final = 41  # values of a parameter alone, at the middles of as many equal shares of its distribution
FACTORS: Final = (0.25, 0.5, 1.0, 1.5, 2.0)  # times the sds: figure 6.12
SEED: Final = 1
ROUNDING: Final = 1e-9  # of an output's interval: a smaller change is none
IDLE: Final = 1e-12  # share of the variance, of a parameter that does nothing
MIDDLE: Final = (0.005, 0.995)  # of a distribution: what is drawn of it
_TOGETHER: Final = 125  # draws in one piece of work
_FEWEST: Final = 20  # outputs, of which an interval is made
_BINS: Final = 40


class UncertaintyQuestion(NamedTuple):
    """seconds: one for each speed, None for the default. wanted: output -> half of its 95 % interval, in the
    output's unit, or as a share where it has none."""

    models: tuple[Model, ...]
    speeds: tuple[float, ...]  # m/s
    seconds: tuple[float | None, ...]
    outputs: tuple[str, ...] = NAMES
    wanted: Mapping[str, float] = {}
    draws: int = DRAWS
    steering: str = STEP


class Asked(NamedTuple):
    """What draws are made into: a case, the rig at the medians, names of what is drawn."""

    case: Case
    rig: Rig
    names: tuple[str, ...]


def outputs_of(asked: Asked, points: Array) -> Array:
    """Changes of each output against the rig at the medians, (n, len(NAMES)): in the unit of
    outputs.OUTPUTS, or as shares where there is none. NaN of rigs that are unstable.

    points: values of asked.names, (n, k).
    """
    case = asked.case
    reference = respond(case, asked.rig)
    per = per_unit(case, asked.rig)
    found = np.full((len(points), len(NAMES)), np.nan)
    for row, point in zip(found, points, strict=True):
        rig = asked.rig._replace(**dict(zip(asked.names, point.tolist(), strict=True)))
        if float(eigenvalues(system(case.model, rig, case.speed).a).real.max()) <= STILL:
            row[:] = deviations(case, reference, respond(case, rig).minus(reference)) * per
    return found


def per_unit(case: Case, rig: Rig) -> Array:
    """What an SI change of an output is multiplied by: 1 of outputs with a unit, else 1 over the size."""
    own = np.array([bool(output.unit) for output in OUTPUTS])
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(own, 1.0, 1.0 / sizes(case, respond(case, rig))))


def uncertainty_answer(known: Knowledge, question: UncertaintyQuestion) -> UncertaintyAnswer:
    """Raises ValueError where nothing can be answered, and for a covariance that is not positive definite."""
    speeds: list[UncertaintyEntry] = []
    refused: list[RefusedSpeed] = []
    with side_by_side(2) as each:
        for model in question.models:
            for speed, seconds in zip(question.speeds, question.seconds, strict=True):
                try:
                    case = case_of(model, known.rig, speed, seconds, steering=question.steering)
                except Unstable as error:
                    refused.append({"speed": speed, "model": model.name, "reason": str(error)})
                    continue
                speeds.append(_at_speed(case, known, question, each))
    if not speeds:
        raise ValueError(refused[0]["reason"])
    parameters: dict[str, Assumed] = {
        name: {"median": float(median), "log_sd": float(sd)}
        for name, median, sd in zip(known.names, known.median, known.log_sd, strict=True)
    }
    return {
        "source": known.source,
        "input": question.steering,
        "parameters": parameters,
        "speeds": speeds,
        "refused": refused,
    }


def _at_speed(case: Case, known: Knowledge, question: UncertaintyQuestion, each: Map) -> UncertaintyEntry:
    asked = Asked(case, known.rig, known.names)
    groups = [
        log_normal(
            known.median.tolist(), known.log_covariance * factor**2, SEED, 0,
            question.draws if factor == 1.0 else max(question.draws // 4, _FEWEST),
        )
        for factor in FACTORS
    ]  # fmt: skip
    groups += [_alone(known, k) for k in range(len(known.names))]
    found = _through(asked, groups, each)
    drawn = found[: len(FACTORS)]
    alone = found[len(FACTORS) :]
    per = per_unit(case, known.rig)
    changes = [response_slope(case, known.rig, name) for name in known.names]
    terms = products(case, changes) * per[:, None, None] ** 2 * known.log_covariance
    outputs: dict[str, OutputAnswer] = {}
    for name in question.outputs:
        k = NAMES.index(name)
        spread = [values[:, k] for values in drawn]
        single = dict(zip(known.names, [values[:, k] for values in alone], strict=True))
        outputs[name] = _output(OUTPUTS[k].unit, spread, single, terms[k])
        if name in question.wanted:
            outputs[name]["wanted"] = wanted(question.wanted[name], known, terms[k])
    whole = drawn[FACTORS.index(1.0)]
    return {
        "speed": case.speed,
        "model": case.model.name,
        "seconds": case.seconds,
        "draws": question.draws,
        "unstable_share": float(np.mean(np.isnan(whole[:, 0]))),
        "outputs": outputs,
    }


def _alone(known: Knowledge, k: int) -> Array:
    points = np.tile(known.median, (ALONE, 1))
    points[:, k] *= np.exp(known.log_sd[k] * ndtri((np.arange(ALONE) + 0.5) / ALONE))
    return points


def _through(asked: Asked, groups: Sequence[Array], each: Map) -> list[Array]:
    """Outputs of each group of points, computed side by side."""
    points = np.concatenate(groups)
    pieces = [points[first : first + _TOGETHER] for first in range(0, len(points), _TOGETHER)]
    found = np.concatenate(list(each(outputs_of, [asked] * len(pieces), pieces)))
    return np.split(found, np.cumsum([len(group) for group in groups])[:-1])


def _output(unit: str, drawn: Sequence[Array], alone: Mapping[str, Array], terms: Array) -> OutputAnswer:
    """terms: of the variance in the first order, (parameters, parameters)."""
    total = float(terms.sum())
    sd = float(np.sqrt(max(total, 0.0))) if np.isfinite(total) else np.nan
    good = drawn[FACTORS.index(1.0)]
    low, high = within(good)
    shares = terms.sum(axis=1) / total if total > 0 else np.zeros(len(terms))
    halves = [(above - below) / 2 for below, above in map(within, drawn)]
    good = good[np.isfinite(good)]
    shown = tuple(np.quantile(good, MIDDLE).tolist()) if good.size else (0.0, 1.0)
    counts, edges = np.histogram(good, _BINS, range=(shown[0], shown[1]))
    parameters: dict[str, AloneAnswer] = {}
    for (name, values), part in zip(alone.items(), shares, strict=True):
        below, above = (side if abs(side) > ROUNDING * (high - low) else 0.0 for side in within(values))
        parameters[name] = {"low": finite(below), "high": finite(above), "share": finite(part)}
    return {
        "unit": unit,
        "low": finite(low),
        "high": finite(high),
        "half": finite((high - low) / 2),
        "first_order": finite(WITHIN * sd),
        "parameters": parameters,
        "growth": {
            "factors": list(FACTORS),
            "half": [finite(half) for half in halves],
            "first_order": [finite(WITHIN * sd * factor) for factor in FACTORS],
        },
        "histogram": {"edges": edges.tolist(), "counts": counts.tolist()},
    }


def within(values: Array) -> tuple[float, float]:
    """The middle 95 % of finite values; NaN where there are too few."""
    good = values[np.isfinite(values)]
    if len(good) < _FEWEST:
        return np.nan, np.nan
    low, high = np.quantile(good, [0.025, 0.975])
    return float(low), float(high)


def wanted(half: float, known: Knowledge, terms: Array) -> WantedAnswer:
    """In the first order. terms: as of `_output`."""
    variance = (half / WITHIN) ** 2
    total = float(terms.sum())
    factor = np.sqrt(variance / total) if total > 0 else np.inf
    alone, only = Values(), Values()
    for k, (name, sd) in enumerate(zip(known.names, known.log_sd.tolist(), strict=True)):
        own = float(terms[k, k])
        crossed = float(terms[k].sum()) - own
        rest = total - own - 2 * crossed
        alone[name] = finite(_largest_factor(own, crossed, rest - variance) * sd)
        acts = own > IDLE * total
        only[name] = finite(np.sqrt(variance / own) * sd) if acts else None
    return {"half": half, "factor": finite(factor), "alone": alone, "only": only}


def _largest_factor(own: float, crossed: float, rest: float) -> float:
    """Of f² own + 2 f crossed + rest = 0, from 0 up; NaN where there is none or any will do."""
    if own <= 0:
        return np.nan
    root = crossed**2 - own * rest
    largest = (-crossed + np.sqrt(root)) / own if root >= 0 else np.nan
    return float(largest) if largest >= 0 else np.nan
