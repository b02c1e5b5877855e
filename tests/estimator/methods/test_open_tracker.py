"""What the open tracker doubts, and when a gross error would have shown."""

import math

import numpy as np
import pytest
from circle import demo_machine

from tilth.estimator.diagnosis import open_numbers
from tilth.estimator.diagnosis.consistency import CONSISTENCY
from tilth.estimator.filters import unknowns
from tilth.estimator.methods import open_tracker


@pytest.mark.parametrize("name", [row.name for row in open_numbers.OPEN if row.gross])
@pytest.mark.parametrize(("sds_off", "sds_to_gross", "known"), [(0.0, 2.5, True), (0.0, 2.2, False),
    (1.0, 3.4, True), (1.0, 3.2, False), (3.0, 5.0, False)])  # fmt: skip
def test_a_file_is_confirmed_when_its_gross_errors_can_be_ruled_out(
    name: str, sds_off: float, sds_to_gross: float, known: bool
) -> None:
    machine, n = demo_machine(), len(open_numbers.NAMES)
    size = math.log1p(1.0 / machine.tractor.a.value) if name == "a" else math.log(2.0)
    k, alone, by_name = open_numbers.NAMES.index(name), np.full(n, 0.01), np.zeros(n)
    alone[k], by_name[k] = size / sds_to_gross, sds_off**2
    now = open_numbers.Misfit(0.0, by_name, np.zeros(n), np.full(n, 0.01), alone)
    assert open_numbers.unconfirmed(now, machine) == ([] if known else [name])


def test_a_mass_that_only_small_forces_tell_is_no_doubt() -> None:
    """As it came out in fields with headland turns, with right files. Five times the mass would be one."""
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    m_i = unknowns.AT["m_i"]
    state.covariance[m_i, m_i] = 0.22**2
    for off, doubted in ((-0.9, False), (math.log(0.2), True)):
        state.mean[m_i] = state.prior_mean[m_i] + off
        now = open_tracker.misfit(state, machine)
        assert (now.by_name.max() > CONSISTENCY.ends * CONSISTENCY.begins) == doubted
    assert not state.by_steering


def test_open_tracker_starts_at_the_file_with_wide_priors() -> None:
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    now = open_tracker.misfit(state, machine)
    assert now.total == 0.0 and not now.by_name.any()
    assert set(open_numbers.unconfirmed(now, machine)) == {
        row.name for row in open_numbers.OPEN if row.confirming_sd
    }
    narrow = open_numbers.allowed(machine) < 0.5 * np.array([row.open_sd for row in open_numbers.OPEN])
    assert [name for name, so in zip(open_numbers.NAMES, narrow, strict=True) if not so] == ["m_i"]
