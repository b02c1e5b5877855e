"""What `tilth fit --json` might give."""

from typing import Any

import numpy as np

from tilth.schemas.flow import PARAMETERS


def answer(values: dict[str, float] | None = None, sd: float = 0.1) -> Any:
    """What `tilth fit --json` might give. sd: of each logarithm."""
    given = {"C_af": 2e5, "C_ar": 5e5, "C_ai": 1.7e5, "sigma_f": 1.0, "sigma_r": 1.5, "sigma_i": 1.0}
    given |= values or {}
    parameters = {name: {"value": given[name], "sd": sd * given[name], "status": "estimated", "reason": ""}
                  for name in PARAMETERS}  # fmt: skip
    covariance = (sd**2 * np.eye(6)).tolist()
    nuisances = {"wheel_zero": {"value": 0.01, "sd": 0.002}}
    return {
        "runs": [],
        "joint": {"parameters": parameters, "log_covariance": covariance, "nuisances": nuisances},
    }
