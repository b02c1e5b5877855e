"""What a driver is shown of a calibration."""

from collections.abc import Iterable
from typing import Any

from kinematic_drive import MACHINE, Plan, measurements

from tilth.client.calibration.shown import (
    DRIVING,
    ComputedSoFar,
    shown,
)
from tilth.estimator.calibration import stages
from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.estimator.calibration.verdict import IDENTIFIED
from tilth.schemas.flow import Measurement

STANDS: Plan = ((10, 0.0, 0),)


def take_all(state: stages.StageFold, given: Iterable[Measurement]) -> stages.StageFold:
    """The same state, after these."""
    for measurement in given:
        stages.take(state, measurement)
    return state


def fold_of(plan: Plan) -> stages.StageFold:
    return take_all(stages.initial(MACHINE), measurements(plan))


def shown_of(fold: stages.StageFold, answer: dict[str, Any], phase: str = DRIVING, trouble: str = "") -> Any:
    return shown("rig", fold, ComputedSoFar(answer), (), trouble, phase)


def computed(**changes: Any) -> dict[str, Any]:
    rows = [
        {
            "name": number.name, "status": IDENTIFIED, "sd": number.prior_sd / 20,
            "prior_sd": number.prior_sd,
            "wanted_sd": number.wanted_sd, "moved": number.prior_sd / 3, "tell": "",
        }
        for number in SOUGHT
    ]  # fmt: skip
    return {"numbers": rows, "faults": [{"kind": "swapped", "text": "two are exchanged"}], **changes}
