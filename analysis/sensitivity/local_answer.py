"""What `tilth sensitivity` answers: local sensitivities of a rig as plain data, and its figures' curves.

Source: Karkee (2009), section 6.3.1, figures 6.3 to 6.9. Figure 6.9 is drawn at ANOTHER_POINT.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.report.curves import numbers
from tilth.analysis.sensitivity.answers import (
    ChangedCurves,
    FrequencyAnswer,
    FrequencyEntry,
    LocalAnswer,
    LocalEntry,
    Numbers,
    RefusedSpeed,
    Values,
    finite,
)
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


def local_answer(rig: Rig, question: LocalQuestion) -> LocalAnswer:
    """Raises ValueError where nothing can be answered."""
    speeds: list[LocalEntry] = []
    refused: list[RefusedSpeed] = []
    for model in question.models:
        for speed, seconds in zip(question.speeds, question.seconds, strict=True):
            try:
                found = local_sensitivities(
                    model, rig, speed, seconds=seconds, steering=question.steering,
                    parameters=question.parameters,
                )  # fmt: skip
            except Unstable as error:
                refused.append({"speed": speed, "model": model.name, "reason": str(error)})
                continue
            values = found.derivative if question.exact else found.step
            speeds.append({
                "speed": speed, "model": model.name, "seconds": found.case.seconds,
                "outputs": list(question.outputs), "local": table_of(found, values, question.outputs),
            })  # fmt: skip
    if not speeds:
        raise ValueError(refused[0]["reason"])
    return {
        "step": "exact" if question.exact else "1 %",
        "input": question.steering,
        "speeds": speeds,
        "refused": refused,
    }


def table_of(found: LocalSensitivities, values: Array, outputs: Sequence[str]) -> dict[str, Values]:
    """By parameter. values: (parameters, outputs.NAMES)."""
    means = overall(values)
    columns = [NAMES.index(name) for name in outputs]
    return {
        parameter: {
            **{name: finite(values[k, at]) for name, at in zip(outputs, columns, strict=True)},
            OVERALL: finite(means[k]),
        }
        for k, parameter in enumerate(found.parameters)
    }


def another_point(rig: Rig, question: LocalQuestion) -> LocalAnswer | None:
    """Of figure 6.9: `local_answer` of the rig at ANOTHER_POINT; None where it is unstable at every speed."""
    try:
        return local_answer(scaled(rig, dict(ANOTHER_POINT)), question)
    except ValueError:
        return None


def changed_curves(
    rig: Rig, model: Model, speeds: Sequence[LocalEntry], steering: str = STEP
) -> dict[str, list[ChangedCurves]]:
    """Of figures 6.6 and 6.7, by parameter.

    speeds: entries of `local_answer` of that model; both rigs get the same input for as long.
    """
    found: dict[str, list[ChangedCurves]] = {name: [] for name in CHANGED}
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
) -> FrequencyAnswer:
    """Raises ValueError for an unknown name."""
    rows: list[FrequencyEntry] = []
    omega: Numbers = []
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
