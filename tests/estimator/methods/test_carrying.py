"""What methods have learned, once the implement carries another load."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cart import CART, EMPTY, FULL, known

from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.methods.carrying import open_up
from tilth.estimator.models.load import laden
from tilth.estimator.models.parameters import rig_of, static_loads

S = 1_000_000_000


@pytest.mark.parametrize("name", ["tracker", "pem", "rows"])
def test_what_was_learned_moves_with_the_load(name: str) -> None:
    state = fold.initial(CART, (), FULL)
    before, method = known(state, name), state.estimators[name]
    fold.carry_load(state, replace(EMPTY, t_ns=S))
    moved = method.mean - before
    loads = np.log(static_loads(rig_of(state.machine))) - np.log(static_loads(rig_of(laden(CART, FULL))))
    np.testing.assert_allclose(moved[:3], 0.8 * loads, atol=1e-9)
    of_mass = (
        0.0
        if name == "tracker"
        else (state.machine.implement.mass.sd / state.machine.implement.mass.value) ** 2
    )
    sd = math.sqrt(method.covariance[2, 2] - of_mass)
    assert sd == pytest.approx(math.hypot(0.08, 0.15 * loads[2]), rel=0.02)
    np.testing.assert_array_equal(method.prior_mean, unknowns.prior(state.machine)[0])
    assert np.linalg.eigvalsh(method.covariance)[0] > -1e-12
    assert method.covariance[AT["roll_k_i"], AT["roll_k_i"]] == pytest.approx(
        method.prior_sd[AT["roll_k_i"]] ** 2
    )


def test_a_load_that_nobody_says_opens_up() -> None:
    state = fold.initial(CART, (), FULL)
    for name in ("tracker", "pem", "rows"):
        known(state, name)
        before = state.estimators[name].covariance.copy()
        open_up(state.estimators[name], state.machine, 0.5)
        grown = state.estimators[name].covariance - before
        assert grown[2, 2] > 0.02 and abs(grown[:2, :2]).max() < 1e-9
        assert np.diag(state.estimators[name].covariance)[:6].max() < 0.8
