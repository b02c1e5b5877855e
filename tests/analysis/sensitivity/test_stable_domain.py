"""Where rigs are unstable, of two parameters at once."""

import numpy as np
import pytest

from tilth.analysis.sensitivity.designs import Design, Grid, LogNormal, ParameterBox, Uniform
from tilth.analysis.sensitivity.global_answer import in_words
from tilth.analysis.sensitivity.run_batches import pairs
from tilth.analysis.sensitivity.stable_domain import clearest, edges, pair_answer
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import eigenvalues, system
from tilth.estimator.models.parameters import TABLE_7_2

BOX = ParameterBox(("C_af", "C_ar", "m_i"), (100e3, 50e3, 1000.0), (300e3, 450e3, 5000.0))
COVARIANCE = ((0.04, 0.0, 0.0), (0.0, 0.09, 0.0), (0.0, 0.0, 0.01))
DESIGNS: tuple[Design, ...] = (
    Grid(BOX),
    Uniform(BOX, 4000),
    LogNormal(BOX.names, (200e3, 200e3, 2000.0), COVARIANCE, 4000),
)


@pytest.mark.parametrize("design", DESIGNS, ids=lambda design: type(design).__name__)
def test_a_corner_that_is_unstable_is_found_and_named(design: Design) -> None:
    """Unstable wherever C_af is in its upper two levels and C_ar in its lowest."""
    levels = design.levels_of(0, design.size)
    bad = (levels[:, 0] >= 3) & (levels[:, 1] == 0)
    there, unstable = pairs(levels, design.levels), pairs(levels[bad], design.levels)
    found = clearest(design, there, unstable)
    assert found is not None
    assert (found.names, found.high, found.unstable, found.holds) == (
        ("C_af", "C_ar"),
        (True, False),
        1.0,
        1.0,
    )
    points = design.points(0, design.size)
    slack = 1e-6 * points.max(axis=0)
    inside = (points[:, 0] >= found.ends[0] - slack[0]) & (points[:, 1] <= found.ends[1] + slack[1])
    np.testing.assert_array_equal(inside, bad)
    text = in_words(found)
    assert text.startswith("100 % of the unstable rigs have C_af from ") and "N/rad up and C_ar up to" in text
    for k in range(3):
        assert np.all(np.diff(edges(design, k)) > 0)


def test_the_line_is_where_the_rig_itself_becomes_unstable() -> None:
    design = Grid(BOX)
    levels = design.levels_of(0, design.size)
    bad = (levels[:, 0] >= 3) & (levels[:, 1] == 0)
    there, unstable = pairs(levels, 5), pairs(levels[bad], 5)
    first = pair_answer(model_named("relaxation"), TABLE_7_2, 7.5, design, there, unstable)[0]
    assert (
        first["names"] == ["C_af", "C_ar"] and first["shares"][4][0] == 1.0 and first["shares"][0][0] == 0.0
    )
    x, y = first["line"]["at"]
    rig = TABLE_7_2._replace(C_af=x[20], C_ar=y[3])
    poles = eigenvalues(system(model_named("relaxation"), rig, 7.5).a)
    growth = poles[np.abs(poles) > 1e-6].real.max()
    assert first["line"]["growth"][20][3] == pytest.approx(growth)
    assert min(map(min, first["line"]["growth"])) < 0.0 < max(map(max, first["line"]["growth"]))


def test_where_none_is_unstable_nothing_is_named() -> None:
    there = pairs(np.array([[0, 1, 2]]), 5)
    assert clearest(Grid(BOX), there, 0 * there) is None
    assert pair_answer(model_named("relaxation"), TABLE_7_2, 7.5, Grid(BOX), there, 0 * there) == []
