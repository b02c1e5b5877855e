"""What a load does to a rig, how a word of it ages, and what a scale may say."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cart import CART, FULL
from logs import MACHINE

from tilth.estimator.filters.unknowns import AT, prior
from tilth.estimator.models.load import aged, laden, of_nobody, of_scale
from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.schemas.ballast import as_driven, carrying
from tilth.schemas.quantity import Quantity


def test_the_laden_rig_is_heavier_and_its_tyres_follow() -> None:
    full = laden(CART, FULL)
    own = CART.implement.mass.value
    assert full.implement.mass.value == pytest.approx(own + 6000.0)
    assert full.implement.yaw_inertia.value > CART.implement.yaw_inertia.value
    heavier = np.divide(static_loads(rig_of(full)), static_loads(rig_of(CART)))
    for axle, factor in zip(("front", "rear", "implement"), heavier, strict=True):
        before, after = (getattr(m.tyres, axle).cornering_stiffness for m in (CART, full))
        assert after == pytest.approx(before * factor**0.8)
    assert laden(MACHINE, FULL) is MACHINE  # its file knows of no load


@pytest.mark.parametrize("as_ballast", [False, True])
@pytest.mark.parametrize("length", [2.0, 5.3, 9.0])
def test_inertia_and_mass_come_together(length: float, as_ballast: bool) -> None:
    """A load, or a tank, that is known badly: the inertia is as uncertain as it is over the mass, which the
    estimators take as known. By draws."""
    load, inertia = CART.implement.load, CART.implement.yaw_inertia
    assert load is not None
    mass, at = Quantity(value=3000.0, sd=300.0), {"length": length, "ahead_of_axle": Quantity(value=0.1)}
    exact = {"load": load.model_copy(update=at), "yaw_inertia": Quantity(value=inertia.value)}
    cart = CART.model_copy(update={"implement": CART.implement.model_copy(update=exact)})
    told = laden(cart, replace(FULL, mass=mass.value, sd=mass.sd))
    if as_ballast:
        tank = load.model_copy(update={**at, "mass": mass})
        bare = cart.implement.model_copy(update={"load": None, "ballast": [tank]})
        told = as_driven(cart.model_copy(update={"implement": bare}))
    over_mass = [
        one.yaw_inertia.value / one.mass.value
        for kg in np.random.default_rng(1).normal(mass.value, mass.sd, 300)
        for one in [carrying(cart, Quantity(value=kg)).implement]
    ]
    share = prior(told)[1][AT["I_i"]]
    assert share == pytest.approx(np.std(over_mass) / np.mean(over_mass), rel=0.15, abs=1e-3)
    assert told.implement.mass.sd > 300.0


def test_a_word_ages_until_all_is_possible() -> None:
    own = CART.implement.mass.value
    sds = [aged(CART, FULL, seconds).sd / (own + 6000.0) for seconds in (0.0, 60.0, 600.0, 6e5)]
    assert sds == sorted(sds) and sds[0] == pytest.approx(300.0 / (own + 6000.0))
    widest = math.log1p(6000.0 / own)
    assert sds[-1] == pytest.approx(widest / math.sqrt(3.0))  # of anything up to it, about the full one
    nobody = of_nobody(CART, 1)
    assert nobody is not None
    assert aged(CART, nobody, 6e5).sd == pytest.approx(nobody.sd)  # was as wide as can be


@pytest.mark.parametrize(
    ("whole", "content", "mass"),
    [(None, 3000.0, 3000.0), (5127.0, None, 3000.0), (9000.0, 2500.0, 2500.0), (2100.0, None, 0.0),
     (1000.0, None, None), (None, 9000.0, None), (None, None, None)],
)  # fmt: skip
def test_a_scale(whole: float | None, content: float | None, mass: float | None) -> None:
    assert of_scale(CART, whole, content) == (mass if mass is None else pytest.approx(mass))
