"""Arrival stamps in, instants of measurement out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.estimator.epoch_clock import EpochClock, UtcClock

START_NS = 1_777_881_600_000_000_000
CLUMP = (65267, 65256, 65535)


def _run(
    clock: EpochClock, period_s: float, jitter_s: float, epochs: int, skew: float = 0.0, seed: int = 1
) -> list[tuple[float, float]]:
    """[(true epoch, what the clock says)] in s, for clumps of three messages 4 ms apart."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(epochs):
        epoch = k * period_s * (1 + skew)
        late = jitter_s * rng.random()
        for place, pgn in enumerate(CLUMP):
            said = clock.arrive(START_NS + round((epoch + late + 0.004 * place) * 1e9), pgn, None)
            out.append((epoch, (said - START_NS) * 1e-9))
    return out


@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    period_ms=st.sampled_from([100, 145, 200, 250, 296, 1000, 1046]),
    jitter_s=st.floats(0.0, 0.03),
    skew=st.floats(-100e-6, 100e-6),
)
def test_jitter_is_taken_out_at_any_period_and_skew(period_ms: int, jitter_s: float, skew: float) -> None:
    clock = EpochClock()
    out = _run(clock, period_ms * 1e-3, jitter_s, 300, skew)
    assert clock.period_ns == period_ms * 1_000_000
    late = [said - epoch for epoch, said in out[len(out) // 2 :]]
    assert min(late) > -1e-3
    assert max(late) <= jitter_s + 1e-6
    # 300 ppm of leak over the few epochs between early arrivals
    assert sum(late) / len(late) <= 0.1 * jitter_s + 300e-6 * 10 * period_ms * 1e-3 + 1e-4
    assert clock.resets == 0


def test_messages_of_one_clump_share_an_instant() -> None:
    out = _run(EpochClock(), 0.2, 0.02, 100)
    for k in range(0, len(out), len(CLUMP)):
        assert len({said for _, said in out[k : k + len(CLUMP)]}) == 1


def test_a_sid_ties_messages_that_queued_apart_and_a_constant_sid_does_not() -> None:
    clock = EpochClock()
    first = clock.arrive(START_NS, 129026, 7)
    assert clock.arrive(START_NS + 90_000_000, 127250, 7) == first
    assert clock.arrive(START_NS + 100_000_000, 129026, 7) != first


def test_a_dropout_keeps_the_grid_and_a_step_starts_it_anew() -> None:
    clock = EpochClock()
    _run(clock, 0.2, 0.02, 50)
    after_gap = clock.arrive(START_NS + round((50 * 0.2 + 2.0 + 0.019) * 1e9), 65267, None)
    assert abs(after_gap - START_NS - 12.0e9) < 4e6  # 19 ms late, 2 s away: still on the old grid
    clock.arrive(START_NS - 3_600_000_000_000, 65267, None)
    assert clock.resets == 1
    assert clock.epoch_ns == START_NS - 3_600_000_000_000


@pytest.mark.parametrize("jump_s", [-5.0, 5.0, 1e9])
def test_utc_follows_the_earliest_arrivals_and_a_jump(jump_s: float) -> None:
    clock = UtcClock()
    assert clock.utc_ns(START_NS) is None
    for k in range(30):
        clock.measured(
            START_NS + k * 1_000_000_000 + (k * 7 % 5) * 3_000_000, START_NS - 10**9 + k * 10**9, 1e-4
        )
    said = clock.utc_ns(START_NS + 30 * 10**9)
    assert said is not None
    assert abs(said - (START_NS + 29 * 10**9)) < 2e6
    clock.measured(START_NS + 31 * 10**9, START_NS + 30 * 10**9 + round(jump_s * 1e9), 1e-4)
    said = clock.utc_ns(START_NS + 31 * 10**9)
    assert said == START_NS + 30 * 10**9 + round(jump_s * 1e9)


def test_a_coarse_time_never_replaces_a_fine_one() -> None:
    clock = UtcClock()
    clock.measured(START_NS, START_NS, 0.25)
    clock.measured(START_NS + 10**9, START_NS + 10**9 - 5_000_000, 1e-4)
    clock.measured(START_NS + 2 * 10**9, START_NS + 2 * 10**9 + 200_000_000, 0.25)
    assert clock.utc_ns(START_NS + 2 * 10**9) == START_NS + 2 * 10**9 - 5_000_000


@pytest.mark.parametrize(("before_s", "after_s"), [(0.2, 0.1), (0.1, 0.25), (1.0, 0.2)])
def test_a_device_that_changes_its_rate_is_followed(before_s: float, after_s: float) -> None:
    clock = EpochClock()
    _run(clock, before_s, 0.01, 40)
    start = START_NS + round(40 * before_s * 1e9)
    late = [
        rx - clock.arrive(rx, 129025, None) for rx in (start + round(k * after_s * 1e9) for k in range(80))
    ]
    assert clock.period_ns == round(after_s * 1e9)
    assert abs(late[-1]) < 2e6
