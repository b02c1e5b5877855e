"""Sobol' indices, Morris's effects and bounds by derivatives of a rig's outputs, as plain data."""

import os
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.side_by_side import Map, side_by_side
from tilth.analysis.sensitivity.answers import Indices, IndicesAnswer, Interval, finite
from tilth.analysis.sensitivity.designs import Design, LogNormal
from tilth.analysis.sensitivity.inputs import Inputs, of_box, of_covariance
from tilth.analysis.sensitivity.outputs import NAMES, case_of
from tilth.analysis.sensitivity.propagation import Asked, outputs_of
from tilth.analysis.sensitivity.run_batches import GlobalPlan
from tilth.analysis.sensitivity.screening import dgsm, morris
from tilth.analysis.sensitivity.sobol import POINTS, SCRAMBLES, SobolIndices, sobol
from tilth.estimator.models.family import model_named

Array = NDArray[np.float64]

_TOGETHER: Final = 125  # points in one piece of work


def inputs_of(design: Design) -> Inputs:
    """Marginals and correlation of a design's parameters. Raises ValueError for a covariance that is none."""
    if isinstance(design, LogNormal):
        return of_covariance(design.names, design.median, np.array(design.log_covariance))
    return of_box(design.box)


def indices_answer(plan: GlobalPlan, outputs: Sequence[str], workers: int | None = None) -> IndicesAnswer:
    """Of the change of each output against the rig's own. workers: processes. Raises ValueError, Unstable."""
    inputs = inputs_of(plan.design)
    case = case_of(model_named(plan.model), plan.rig, plan.speed, plan.seconds, steering=plan.steering)
    asked = Asked(case, plan.rig, inputs.names)
    told = tuple(dict.fromkeys((*outputs, *plan.outputs)))
    columns = [NAMES.index(name) for name in told]
    with side_by_side(workers or os.cpu_count() or 1, workers) as each:
        ask = partial(_ask, asked, columns, each)
        found = sobol(ask, inputs, points=POINTS, scrambles=SCRAMBLES)
        screened = None if inputs.median else (morris(ask, inputs), dgsm(ask, inputs)[0])
    together = found.of_mean([told.index(name) for name in plan.outputs])
    overall = {name: _pair(together, k, 0) for k, name in enumerate(inputs.names)}
    answer: dict[str, dict[str, Indices]] = {output: {} for output in told}
    for (m, output), (k, name) in product(enumerate(told), enumerate(inputs.names)):
        row: Indices = {**_pair(found, k, m), "morris": None, "dgsm_bound": None}
        if screened is not None:
            effects, bound = screened
            row["morris"] = {"size": finite(effects.size[k, m]), "spread": finite(effects.spread[k, m])}
            row["dgsm_bound"] = finite(bound[k, m])
        answer[output][name] = row
    return {"points": POINTS * SCRAMBLES, "lost": found.lost, "overall": overall, "outputs": answer}


def _pair(found: SobolIndices, k: int, m: int) -> Indices:
    """Of parameter k and output m."""
    return {
        "sobol_first": _interval(found.first[k, m], found.first_half[k, m]),
        "sobol_total": _interval(found.total[k, m], found.total_half[k, m]),
    }


def _ask(asked: Asked, columns: list[int], each: Map, points: Array) -> Array:
    pieces = [points[first : first + _TOGETHER] for first in range(0, len(points), _TOGETHER)]
    return np.concatenate(list(each(outputs_of, [asked] * len(pieces), pieces)))[:, columns]


def _interval(value: float, half: float) -> Interval:
    return {"value": finite(value), "low": finite(value - half), "high": finite(value + half)}
