"""The same linear model as a statsmodels state space, fitted by maximum likelihood."""

# What statsmodels says of its types is not what its manual shows.
# pyright: reportIncompatibleMethodOverride=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportAssignmentType=false

import numpy as np
import statsmodels.api as sm
from numpy.typing import NDArray
from plain_least_squares import DT, OUTPUT_STATES, discrete, middles

Array = NDArray[np.float64]


class Rig(sm.tsa.statespace.MLEModel):  # type: ignore[misc]
    """Parameters (12,): six logarithms, the wheel's zero, logarithms of three disturbances and two noises."""

    def __init__(self, y: Array, wheel: Array, geometry: Array, speed: float, mean: Array, sd: Array) -> None:
        super().__init__(y, k_states=8, k_posdef=3, initialization="known", **_start())
        self._wheel, self._geometry, self._speed = wheel, geometry, speed
        self._mean, self._sd = mean, sd
        design = np.zeros((4, 8))
        design[range(4), OUTPUT_STATES] = 1.0
        selection = np.zeros((8, 3))
        selection[:3] = np.eye(3)
        self["design"], self["selection"] = design, selection

    @property
    def start_params(self) -> Array:
        return self._mean

    def update(self, params: Array, **kwargs: object) -> None:
        params = super().update(params, **kwargs)
        f, g = discrete(np.exp(np.real(params[:6])), self._geometry, self._speed)
        self["transition"] = f
        self["state_intercept"] = np.outer(g, middles(self._wheel - np.real(params[6])))
        self["state_cov"] = np.diag((np.exp(np.real(params[7:10])) * DT) ** 2)
        noise = np.exp(2 * np.real(params[10:12]))
        self["obs_cov"] = np.diag([noise[0], noise[0], noise[1], noise[1]])

    def loglike(self, params: Array, *args: object, **kwargs: object) -> float:
        """With the prior, as a mean over the samples times their number."""
        off = (np.asarray(params) - self._mean) / self._sd
        return float(super().loglike(params, *args, **kwargs) - 0.5 * off @ off)


def _start() -> dict[str, Array]:
    return {
        "initial_state": np.zeros(8),
        "initial_state_cov": np.diag(np.square([0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05])),
    }


def fit(y: Array, wheel: Array, geometry: Array, speed: float, mean: Array, sd: Array) -> tuple[Array, Array]:
    """(logarithms (6,), their sds (6,)). mean, sd: (12,) prior of the parameters."""
    model = Rig(y, wheel, geometry, speed, mean, sd)
    found = model.fit(method="lbfgs", disp=False, maxiter=200, cov_type="none")
    hessian = _curvature(model, np.asarray(found.params))
    return np.asarray(found.params[:6]), np.sqrt(np.diag(np.linalg.inv(hessian))[:6])


def _curvature(model: Rig, at: Array, step: float = 1e-3) -> Array:
    """Minus the Hessian of the log-likelihood by differences, (q, q)."""
    q = len(at)
    nudges = step * np.eye(q)
    hessian = np.zeros((q, q))
    for i in range(q):
        for j in range(i + 1):
            corners = [
                a * b * model.loglike(at + a * nudges[i] + b * nudges[j]) for a in (1, -1) for b in (1, -1)
            ]
            hessian[i, j] = hessian[j, i] = -sum(corners) / (4 * step**2)
    return hessian
