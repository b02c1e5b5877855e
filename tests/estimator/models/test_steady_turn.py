"""The closed form of steady turning against a long run of the nonlinear model, drag and all."""

import math

import numpy as np
import pytest
from circle import demo_machine
from linear_tyres import linear_tyres

from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.models.steady_turn import steady_turn

RIG = linear_tyres(rig_of(demo_machine()))
AT = {name: k for k, name in enumerate(nonlinear.STATES)}


@pytest.mark.parametrize("rolling", [0.0, 0.03, 0.06, 0.1])
@pytest.mark.parametrize("speed", [2.0, 4.5, 7.0])
@pytest.mark.parametrize("delta", [math.radians(1.0), math.radians(-1.5)])
def test_a_long_run_ends_where_the_closed_form_says(rolling: float, speed: float, delta: float) -> None:
    rig = RIG._replace(roll_f=rolling, roll_r=rolling, roll_i=rolling)
    run = nonlinear.inputs_of(1500, delta=delta, speed=speed)
    end = nonlinear.simulate(rig, run, nonlinear.running(speed), 0.02)[-1]
    row = np.array([[*rig.theta[:3], rig.m_t, rig.m_i, end[AT["u"]], delta, 0.0, 0.0]])
    lengths = (rig.a, rig.b, rig.c, rig.d, rig.e)
    v, r, articulation = steady_turn(row, *lengths, rolling=rolling, heights=(rig.h_t, rig.h_i))[0]
    assert end[AT["r_t"]] == pytest.approx(r, rel=1e-3)
    assert end[AT["v"]] == pytest.approx(v, rel=2e-3, abs=1e-4)
    assert end[AT["psi_t"]] - end[AT["psi_i"]] == pytest.approx(articulation, rel=1e-3)
    if rolling:
        without = steady_turn(row, *lengths)[0]
        assert abs(without[1] / end[AT["r_t"]] - 1) > 3e-3  # what it costs to leave the drag out
