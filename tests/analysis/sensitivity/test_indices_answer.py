"""Which inputs a design gives to the indices."""

import pytest

from tilth.analysis.sensitivity.designs import DISSERTATION, LogNormal, Uniform
from tilth.analysis.sensitivity.indices_answer import inputs_of


def test_of_a_box_and_of_a_covariance() -> None:
    box = inputs_of(Uniform(DISSERTATION, 100))
    assert not box.median and len(box.names) == len(set(box.names))
    normal = inputs_of(LogNormal(("C_af", "sigma_f"), (2e5, 1.0), ((0.04, 0.01), (0.01, 0.09)), 100))
    assert normal.names == ("C_af", "sigma_f") and normal.median


def test_a_covariance_that_is_none() -> None:
    with pytest.raises(ValueError):
        inputs_of(LogNormal(("C_af", "sigma_f"), (2e5, 1.0), ((0.04, 0.1), (0.1, 0.04)), 100))
