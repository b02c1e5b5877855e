"""The table of parameters, the rig of a machine file, its load."""

import math

import numpy as np
import pytest
from linear_tyres import linear_tyres
from loaded_rig import loaded
from paths import MACHINE_FILE

from tilth.estimator.models.parameters import (
    GEOMETRY,
    RIG_PARAMETERS,
    TABLE_5_1,
    TABLE_7_2,
    Parameter,
    Rig,
    checked,
    rig_of,
    static_loads,
)
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine_toml import parse_machine


@pytest.mark.parametrize("row", RIG_PARAMETERS, ids=lambda row: row.name)
def test_each_row_is_complete_and_its_default_allowed(row: Parameter) -> None:
    assert row.low <= row.default <= row.high
    assert row.unit and row.meaning and row.source and row.symbol
    outside = [value for value in (row.low - 0.01, row.high * 1.01) if math.isfinite(value)]
    for value in outside:
        with pytest.raises(ValueError, match=rf"^{row.name} = "):
            checked(TABLE_5_1._replace(**{row.name: value}))


def test_the_packaged_machine_is_table_7_2() -> None:
    rig = rig_of(parse_machine(MACHINE_FILE.read_text()))
    assert rig == TABLE_7_2
    assert rig.geometry.tolist() == [getattr(TABLE_7_2, name) for name in GEOMETRY]
    assert rig.theta.tolist() == [getattr(TABLE_7_2, name) for name in PARAMETERS]


def test_integers_become_floats() -> None:
    assert all(type(value) is float for value in checked(TABLE_5_1._replace(m_i=2000)))


def test_static_loads_balance_about_every_axle() -> None:
    rig = TABLE_5_1._replace(e=0.5)
    front, rear, implement = static_loads(rig)
    assert front + rear + implement == pytest.approx((rig.m_t + rig.m_i) * rig.g)
    tongue = rig.m_i * rig.g - implement  # on the hitch
    assert tongue * (rig.d + rig.e) == pytest.approx(rig.m_i * rig.g * rig.e)  # about the implement's axle
    about_rear = front * (rig.a + rig.b) - rig.m_t * rig.g * rig.b + tongue * (rig.c - rig.b)
    assert about_rear == pytest.approx(0.0, abs=1e-6)


def test_a_load_keeps_the_axle_where_it_is() -> None:
    rig = TABLE_5_1
    full = loaded(rig, 12_000.0, ahead=0.3)
    assert full.m_i == rig.m_i + 12_000.0
    assert full.towed_length == pytest.approx(rig.towed_length)
    assert full.d == pytest.approx(rig.d - 12_000.0 * 0.3 / full.m_i)
    box = 12_000.0 * (4.0**2 + 2.6**2) / 12
    apart = rig.m_i * 12_000.0 / full.m_i * 0.3**2  # two masses about their common centre
    assert full.I_i == pytest.approx(rig.I_i + box + apart)
    assert full.h_i == pytest.approx((rig.m_i * 1.2 + 12_000.0 * 1.8) / full.m_i)
    ratios = np.array(static_loads(full)) / np.array(static_loads(rig))
    np.testing.assert_allclose(full.theta[:3] / rig.theta[:3], ratios**rig.load_exponent)
    assert loaded(rig, 0.0) == rig


def test_a_rig_that_would_tip_is_refused() -> None:
    with pytest.raises(ValueError, match=r"implement\.|tractor's front axle would stand off"):
        checked(TABLE_5_1._replace(b=0.3, c=6.0, e=4.0, m_i=9000.0))
    with pytest.raises(ValueError, match="must be from"):
        loaded(TABLE_5_1, 1e6)


def test_linear_tyres_have_no_limit() -> None:
    rig = linear_tyres(TABLE_5_1)
    assert isinstance(rig, Rig)
    assert (rig.grip_f, rig.grip_r, rig.grip_i, rig.load_exponent) == (math.inf, math.inf, math.inf, 0.0)
