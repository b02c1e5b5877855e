"""What the open tracker doubts."""

import math

import numpy as np
from circle import demo_machine

from tilth.estimator.diagnosis import open_numbers
from tilth.estimator.diagnosis.consistency import CONSISTENCY
from tilth.estimator.filters import unknowns
from tilth.estimator.methods import open_tracker


def test_a_mass_that_only_small_forces_tell_is_no_doubt() -> None:
    """As it came out in fields with headland turns, with right files. Ten times the mass would be one."""
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    m_i = unknowns.AT["m_i"]
    state.covariance[m_i, m_i] = 0.22**2
    for off, doubted in ((-1.6, False), (math.log(0.1), True)):
        state.mean[m_i] = state.prior_mean[m_i] + off
        now = open_tracker.misfit(state, machine)
        assert (now.by_name.max() > CONSISTENCY.ends * CONSISTENCY.begins) == doubted
    assert not state.by_steering


def test_open_tracker_starts_at_the_file_with_wide_priors() -> None:
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    now = open_tracker.misfit(state, machine)
    assert now.total == 0.0 and not now.by_name.any()
    assert not now.moves[:, :-1].any()  # the last, of the tractor's mass, needs no driving
    narrow = open_numbers.allowed(machine) < 0.5 * np.array([row.open_sd for row in open_numbers.OPEN])
    assert [name for name, so in zip(open_numbers.NAMES, narrow, strict=True) if not so] == ["m_i", "I_i"]
