"""What `tilth sensitivity` answers: local sensitivities of a rig as plain data, and its figures' curves.

Source: Karkee (2009), section 6.3.1, figures 6.3 to 6.9. Figure 6.9 is drawn at ANOTHER_POINT.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.report.curves import numbers
from tilth.analysis.sensitivity.frequency import TRANSFERS, frequency_sensitivities
from tilth.analysis.sensitivity.local import LocalSensitivities, local_sensitivities, overall
from tilth.analysis.sensitivity.outputs import NAMES, STEP, STEP_S, Unstable, case_of, respond
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS, scaled
from tilth.estimator.models.family import Model
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

OVERALL: Final = "overall"  # (6.17), beside the outputs
ANOTHER_POINT: Final[Mapping[str, float]] = {
    "sigma_f": 0.1, "sigma_r": 0.1, "sigma_i": 0.1, "m_i": 2.0, "I_i": 2.0,
}  # fmt: skip
"""Of figure 6.9: shares of the nominal values."""
CHANGED: Final = ("sigma_r", "C_ar")  # figures 6.6 and 6.7
BY: Final = 1.1  # times: the change of both
POINTS: Final = 150  # of a curve


class LocalQuestion(NamedTuple):
    """exact: the derivatives instead of the 1 % step. seconds: one for each speed, None for the default."""

    models: tuple[Model, ...]
    speeds: tuple[float, ...]  # m/s
    seconds: tuple[float | None, ...]
    outputs: tuple[str, ...] = NAMES
    parameters: tuple[str, ...] = MACHINE_PARAMETERS
    exact: bool = False
    steering: str = STEP


def local_answer(rig: Rig, question: LocalQuestion) -> dict[str, Any]:
    """Keys "step", "input", "speeds", "refused".

    speeds: [{"speed", "model", "seconds", "outputs", "local": {parameter: {output: value, …, "overall"}}}], a
    value in per cent of the output for each per cent of the parameter, None where it has none. refused:
    [{"speed", "model", "reason"}]. Raises ValueError where nothing can be answered.
    """
    speeds: list[dict[str, Any]] = []
    refused: list[dict[str, Any]] = []
    for model in question.models:
        for speed, seconds in zip(question.speeds, question.seconds, strict=True):
            at = {"speed": speed, "model": model.name}
            try:
                found = local_sensitivities(
                    model,
                    rig,
                    speed,
                    seconds=seconds,
                    steering=question.steering,
                    parameters=question.parameters,
                )
            except Unstable as error:
                refused.append(at | {"reason": str(error)})
                continue
            values = found.derivative if question.exact else found.step
            speeds.append(
                at
                | {"seconds": found.case.seconds, "outputs": list(question.outputs)}
                | {"local": table_of(found, values, question.outputs)}
            )
    if not speeds:
        raise ValueError(refused[0]["reason"])
    return {
        "step": "exact" if question.exact else "1 %",
        "input": question.steering,
        "speeds": speeds,
        "refused": refused,
    }


def table_of(found: LocalSensitivities, values: Array, outputs: Sequence[str]) -> dict[str, Any]:
    """{parameter: {output: value, …, "overall": value}}. values: (parameters, outputs.NAMES)."""
    means = overall(values)
    columns = [NAMES.index(name) for name in outputs]
    return {
        parameter: {
            **{name: _plain(values[k, at]) for name, at in zip(outputs, columns, strict=True)},
            OVERALL: _plain(means[k]),
        }
        for k, parameter in enumerate(found.parameters)
    }


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def another_point(rig: Rig, question: LocalQuestion) -> dict[str, Any] | None:
    """Of figure 6.9: `local_answer` of the rig at ANOTHER_POINT; None where it is unstable at every speed."""
    try:
        return local_answer(scaled(rig, dict(ANOTHER_POINT)), question)
    except ValueError:
        return None


def changed_curves(
    rig: Rig, model: Model, speeds: Sequence[Mapping[str, Any]], steering: str = STEP
) -> dict[str, Any]:
    """Of figures 6.6 and 6.7: {parameter: [{"speed", "t_s", "reference", "changed"}]}, yaw rates in rad/s.

    speeds: entries of `local_answer` of that model; both rigs get the same input for as long.
    """
    found: dict[str, Any] = {name: [] for name in CHANGED}
    for entry in speeds:
        case = case_of(model, rig, entry["speed"], entry["seconds"], steering=steering)
        spaced = np.geomspace if steering == STEP else np.linspace  # a step answers most at once
        rows = np.unique(spaced(1, case.samples, POINTS).round().astype(int)) - 1
        reference = respond(case, rig).velocities[rows, 1]
        for name in CHANGED:
            changed = respond(case, scaled(rig, {name: BY})).velocities[rows, 1]
            found[name].append({
                "speed": entry["speed"], "t_s": numbers(rows * STEP_S),
                "reference": numbers(reference), "changed": numbers(changed),
            })  # fmt: skip
    return found


def frequency_answer(
    rig: Rig, model: Model, speeds: Sequence[float], parameters: Sequence[str]
) -> dict[str, Any]:
    """{"omega", "speeds": [{"speed", "transfers": {output: {"gain": {parameter: […]}, "phase": …}}}]}.

    rad/s; gain in per cent for each per cent of the parameter, phase in rad for each unit of its logarithm.
    Raises ValueError for an unknown name.
    """
    rows = []
    omega: list[float | None] = []
    for speed in speeds:
        found = frequency_sensitivities(model, rig, speed, parameters=parameters)
        omega = numbers(found.omega)
        rows.append({
            "speed": speed,
            "transfers": {
                output: {
                    "gain": {name: numbers(found.gain[:, j, k]) for k, name in enumerate(parameters)},
                    "phase": {name: numbers(found.phase[:, j, k]) for k, name in enumerate(parameters)},
                }
                for j, output in enumerate(TRANSFERS)
            },
        })  # fmt: skip
    return {"omega": omega, "speeds": rows}
