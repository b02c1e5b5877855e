"""Soil-tyre parameters that roughly fit a measured response, so that leakage cancels where no given set does.

Residuals of a model that is far from the rig hold much of the input and leak between frequencies as outputs
do. Those of a model that is near do not. These parameters serve for that only: they have no uncertainty and
are no estimate. Six numbers take little of the noise with them; whatever they miss is left in the residuals.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from tilth.analysis.response.segments import Array, Complex
from tilth.estimator.models.parameters import Rig
from tilth.schemas.flow import PARAMETERS

ROUNDS: Final = 6
STEP: Final = 0.02  # of a logarithm, for differences
LONGEST: Final = 0.5  # step of a logarithm in one round
USUAL: Final = 2.0  # sd of the logarithms about the set that it begins with


def near(rig: Rig, missed_by: Callable[[Rig], Complex | None], variance: Array) -> Rig:
    """The rig with parameters changed until it misses little, by damped Gauss-Newton steps.

    missed_by: a rig's transfer from input to residuals, (f, p), None where it cannot be simulated. It holds
    the leakage that a fit to a measured response would be drawn by. variance: (f, p), expected square of its
    error. The same rig where no step leads nearer.
    """
    weight = 1.0 / np.sqrt(variance)

    def misfit(change: Array) -> Array | None:
        missed = missed_by(_changed(rig, change))
        if missed is None:
            return None
        apart = (weight * missed).ravel()
        return np.concatenate([apart.real, apart.imag, change / USUAL])

    at = np.zeros(len(PARAMETERS))
    missed = misfit(at)
    for _ in range(ROUNDS):
        ahead = [misfit(at + STEP * unit) for unit in np.eye(len(at))]
        if missed is None or any(one is None for one in ahead):
            break
        slopes = np.column_stack([one - missed for one in ahead if one is not None]) / STEP
        step = np.clip(np.linalg.lstsq(slopes, -missed, rcond=None)[0], -LONGEST, LONGEST)
        for share in (1.0, 0.5, 0.25):
            tried = misfit(at + share * step)
            if tried is not None and tried @ tried < missed @ missed:
                at, missed = at + share * step, tried
                break
        else:
            break
        if np.abs(step).max() < STEP:
            break
    return _changed(rig, at)


def _changed(rig: Rig, change: Array) -> Rig:
    return rig._replace(**dict(zip(PARAMETERS, (rig.theta * np.exp(change)).tolist(), strict=True)))
