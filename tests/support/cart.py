"""A cart that carries up to six tonnes, and two loads of it."""

from logs import MACHINE_TEXT
from numpy import array, float64
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.schemas.flow import Carried, LoadSource
from tilth.schemas.machine_toml import parse_machine

LOAD_TEXT = "\n[implement.load]\nmass = 6000\nahead_of_axle = 0.1\nheight = 1.2\nlength = 5.3\nwidth = 2.8\n"
CART = parse_machine(MACHINE_TEXT + LOAD_TEXT)
FULL = Carried(1, 6000.0, 300.0, LoadSource.OPERATOR)
EMPTY = Carried(1, 0.0, 60.0, LoadSource.OPERATOR)


def known(state: fold.State, name: str) -> NDArray[float64]:
    """Puts in that a method knows C_ai well; its mean."""
    method = state.estimators[name]
    method.mean[2] += 0.3
    method.covariance[2, :] = method.covariance[:, 2] = 0.0
    method.covariance[2, 2] = 0.08**2
    return array(method.mean)
