"""Local sensitivities of the dissertation: the change of a response when one parameter changes by 1 %.

Source: Karkee (2009), section 6.2.2.1, eqs. 6.16 and 6.17. A step of the wheels at one speed, each parameter
raised by 1 % in turn, and the change of each response in per cent: of velocities its root mean square over
that of the unchanged response; of the position the distance of the end points over the radius of the turn; of
headings the difference at the end over the whole change.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import simulate
from tilth.estimator.models.parameters import Rig
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

RESPONSES: Final = ("v", "r_t", "r_i", "position", "psi_t", "psi_i")
VARIED: Final = (*PARAMETERS, "m_i", "I_i")
STEP_S: Final = 0.01
SHARE: Final = 0.01  # of a parameter's value


def local_sensitivities(
    rig: Rig,
    speed: float,
    seconds: float,
    wheel_angle: float = np.radians(10.0),
    names: Sequence[str] = VARIED,
) -> Array:
    """Per cent of each response per per cent of each parameter, shape (len(names), 6), columns as RESPONSES.

    Their mean over a row is the parameter's overall sensitivity (6.17). names: fields of Rig.
    """
    velocities, places, headings = _response(rig, speed, seconds, wheel_angle)
    radius = speed / abs(velocities[-1, 1])
    rows = []
    for name in names:
        changed = rig._replace(**{name: getattr(rig, name) * (1 + SHARE)})
        v, p, h = _response(changed, speed, seconds, wheel_angle)
        rows.append(
            [
                *(_root_mean_square(v - velocities) / _root_mean_square(velocities)),
                np.hypot(*(p - places)) / radius,
                *np.abs((h - headings) / headings),
            ]
        )
    return np.array(rows) / SHARE


def _root_mean_square(series: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(series**2, axis=0)))


def _response(rig: Rig, speed: float, seconds: float, wheel_angle: float) -> tuple[Array, Array, Array]:
    """(v, r_t, r_i at each sample (n, 3), place at the end (2,), headings at the end (2,)) after the step."""
    inputs = np.tile([wheel_angle, 0.0, 0.0], (round(seconds / STEP_S) - 1, 1))
    states = simulate(model_named("relaxation"), rig, speed, inputs, np.zeros(9), STEP_S)
    v, psi = states[:, 0], states[:, 7]
    north = speed * np.cos(psi) - v * np.sin(psi)  # 6.10
    east = speed * np.sin(psi) + v * np.cos(psi)  # 6.11
    return states[:, :3], np.array([north.sum(), east.sum()]) * STEP_S, states[-1, 7:9]
