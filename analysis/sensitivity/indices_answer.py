"""Sobol' indices, Morris's effects and bounds by derivatives of a rig's outputs, as plain data."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.side_by_side import Map, side_by_side
from tilth.analysis.sensitivity.designs import Design, LogNormal
from tilth.analysis.sensitivity.indices import (
    POINTS,
    SCRAMBLES,
    Inputs,
    dgsm,
    morris,
    of_box,
    of_covariance,
    sobol,
)
from tilth.analysis.sensitivity.outputs import NAMES, case_of
from tilth.analysis.sensitivity.propagation import Asked, outputs_of
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

_TOGETHER: Final = 125  # points in one piece of work


def inputs_of(design: Design) -> Inputs:
    """Marginals and correlation of a design's parameters. Raises ValueError for a covariance that is none."""
    if isinstance(design, LogNormal):
        return of_covariance(design.names, design.median, np.array(design.log_covariance))
    return of_box(design.box)


def indices_answer(
    model: str, rig: Rig, speed: float, seconds: float, design: Design, outputs: Sequence[str]
) -> dict[str, Any]:
    """{"points", "lost", "outputs": {output: {parameter: {"sobol_first": {"value", "low", "high"},
    "sobol_total": …, "morris": {"size", "spread"}, "dgsm_bound"}}}}.

    Of the change of each output against the rig's own. lost: share of points that have no answer, or are
    compared with one that has none. The last two only for a box: None else. Raises ValueError, Unstable.
    """
    inputs = inputs_of(design)
    asked = Asked(case_of(model_named(model), rig, speed, seconds), rig, inputs.names)
    columns = [NAMES.index(name) for name in outputs]
    with side_by_side(2) as each:
        ask = partial(_ask, asked, columns, each)
        found = sobol(ask, inputs)
        screened = None if inputs.median else (morris(ask, inputs), dgsm(ask, inputs)[0])
    answer: dict[str, Any] = {}
    for m, output in enumerate(outputs):
        answer[output] = {}
        for k, name in enumerate(inputs.names):
            row: dict[str, Any] = {
                "sobol_first": _interval(found.first[k, m], found.first_half[k, m]),
                "sobol_total": _interval(found.total[k, m], found.total_half[k, m]),
                "morris": None,
                "dgsm_bound": None,
            }
            if screened is not None:
                effects, bound = screened
                row["morris"] = {
                    "size": _plain(effects.size[k, m]), "spread": _plain(effects.spread[k, m])
                }  # fmt: skip
                row["dgsm_bound"] = _plain(bound[k, m])
            answer[output][name] = row
    return {"points": POINTS * SCRAMBLES, "lost": found.lost, "outputs": answer}


def _ask(asked: Asked, columns: list[int], each: Map, points: Array) -> Array:
    pieces = [points[first : first + _TOGETHER] for first in range(0, len(points), _TOGETHER)]
    return np.concatenate(list(each(outputs_of, [asked] * len(pieces), pieces)))[:, columns]


def _interval(value: float, half: float) -> dict[str, float | None]:
    return {"value": _plain(value), "low": _plain(value - half), "high": _plain(value + half)}


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
