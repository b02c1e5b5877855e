"""What the open tracker doubts."""

import math

import numpy as np
import pytest
from circle import demo_machine
from estimation_study import RANDOM
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.estimator import fold
from tilth.estimator.diagnosis import open_numbers
from tilth.estimator.diagnosis.consistency import CONSISTENCY
from tilth.estimator.filters import unknowns
from tilth.estimator.methods import open_tracker, pem, tracker
from tilth.estimator.record.record import Segment
from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import changed
from tilth.simulator.traffic import simulate


def test_a_mass_that_only_small_forces_tell_is_no_doubt() -> None:
    """As it came out in fields with headland turns, with right files. Ten times the mass would be one."""
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    m_i = unknowns.AT["m_i"]
    state.covariance[m_i, m_i] = 0.22**2
    for off, doubted in ((-1.6, False), (math.log(0.1), True)):
        state.mean[m_i] = state.prior_mean[m_i] + off
        now = open_tracker.misfit(state, tracker.initial(machine), machine)
        assert (now.by_name.max() > CONSISTENCY.ends * CONSISTENCY.begins) == doubted
    assert not state.by_steering


def test_open_tracker_starts_at_the_file_with_wide_priors() -> None:
    machine = demo_machine()
    state = open_tracker.initial(machine).tracker
    now = open_tracker.misfit(state, tracker.initial(machine), machine)
    assert now.total == 0.0 and not now.by_name.any()
    assert not now.moves[:, :-1].any()  # the last, of the tractor's mass, needs no driving
    narrow = open_numbers.allowed(machine) < 0.5 * np.array([row.open_sd for row in open_numbers.OPEN])
    assert [name for name, so in zip(open_numbers.NAMES, narrow, strict=True) if not so] == ["m_i", "I_i"]


def test_what_an_error_of_the_file_does_is_what_a_tracker_that_believes_it_learns() -> None:
    """By how much implement.e moves C_ai: two trackers over the same driving, of which one is told 5 cm less.
    The open tracker's own slope was half of that, and less."""
    machine, off = demo_machine(), 0.05
    shorter = changed(machine, {"e": Amount(-off)})
    state, segments = fold.initial(machine), list[Segment]()
    for frame in simulate(machine, 2, 20.0, RANDOM):
        fold.step(state, frame)
        segments += [one for one in state.segments if one is not None]
        state.segments.clear()
    learned = []
    for file in (machine, shorter):
        believing = tracker.initial(file)
        for segment in segments:
            tracker.take_segment(believing, file, segment)
        learned.append(believing)
    moved = learned[0].mean[:6] - learned[1].mean[:6]
    now = open_tracker.misfit(state.open.tracker, learned[1], shorter)
    slopes = now.moves[:, open_numbers.NAMES.index("e")] * off
    np.testing.assert_allclose(slopes[:3], moved[:3], atol=0.25 * np.abs(moved[2]))
    assert moved[2] < -0.05


@pytest.mark.parametrize("whose", ["open", "believing", "none"])
def test_ground_is_rough_where_either_tracker_says_so(whose: str) -> None:
    """One that has taken rough ground for another rig has explained it away: it said 6 mrad where the other
    said 8 to 10, and accused the right files of rigs 626 and 716 of the fleet."""
    machine = demo_machine()
    open_, believing = open_tracker.initial(machine), tracker.initial(machine)
    for name, state in (("open", open_.tracker), ("believing", believing)):
        share = 1.2 if name == whose else 0.8
        state.disturbance[3] = (share * open_tracker.OPEN_TRACKER.rough) ** 2
    assert open_tracker.observe(open_, machine, None, believing).rough == (whose != "none")


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 30.0))
@settings(max_examples=30, deadline=None)
def test_of_a_linear_model_a_fit_tells_what_one_with_open_numbers_would_find(seed: int, told: float) -> None:
    """Information of any rank, in prior sds of the file; masses stay as the file says."""
    machine, rng = demo_machine(), np.random.default_rng(seed)
    mean, sd = unknowns.prior(machine)
    free = np.flatnonzero((sd > 0.0) & ~np.isin(np.arange(len(sd)), unknowns.MASSES))
    free = free[(free < unknowns.NOISE.start) | (free >= unknowns.NOISE.stop)]
    rows = told * rng.standard_normal((int(rng.integers(1, 80)), len(free))) / sd[free]
    measured = rng.standard_normal(len(rows))

    def fitted(prior_sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at, covariance = mean.copy(), pem.with_known_masses(np.diag(prior_sd**2))
        covariance[np.ix_(free, free)] = np.linalg.inv(rows.T @ rows + np.diag(prior_sd[free] ** -2.0))
        at[free] += covariance[np.ix_(free, free)] @ rows.T @ measured
        return at, covariance + pem.of_masses(np.diag(sd**2))

    now = open_tracker.of_fit(machine, *fitted(sd), (mean, sd))
    opened, covariance = fitted(open_tracker.opened(sd))
    learned = [k for k in open_tracker.PLACES if k in free]
    at, wide = np.isin(open_tracker.PLACES, learned), open_tracker.opened(sd)[learned]
    np.testing.assert_allclose(now.off[at] / wide, (opened - mean)[learned] / wide, atol=1e-4)
    np.testing.assert_allclose(now.sd[at] / wide, np.sqrt(np.diag(covariance)[learned]) / wide, atol=1e-4)
