"""Arrival stamps in, instants of measurement out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.estimator.pose.epoch_clock import EpochClock, UtcClock

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
            rx_ns = START_NS + round((epoch + late + 0.004 * place) * 1e9)
            instant = clock.position(rx_ns) if place == 0 else clock.other(rx_ns, pgn, None)
            out.append((epoch, (instant - START_NS) * 1e-9))
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
    late = [instant - epoch for epoch, instant in out[len(out) // 2 :]]
    assert min(late) > -1e-3
    assert max(late) <= jitter_s + 1e-6
    # 300 ppm of leak over the few epochs between early arrivals
    assert sum(late) / len(late) <= 0.1 * jitter_s + 300e-6 * 10 * period_ms * 1e-3 + 1e-4
    assert clock.resets == 0


def test_messages_of_one_clump_share_an_instant() -> None:
    out = _run(EpochClock(), 0.2, 0.02, 100)
    for k in range(10 * len(CLUMP), len(out), len(CLUMP)):  # once the period is known
        assert len({instant for _, instant in out[k : k + len(CLUMP)]}) == 1


def test_a_sid_ties_messages_that_queued_apart_and_a_constant_sid_does_not() -> None:
    changing, constant = EpochClock(), EpochClock()
    for k in range(4):
        at = START_NS + k * 1_000_000_000
        first = changing.other(at, 129026, k)
        assert (changing.other(at + 90_000_000, 127250, k) == first) == (k > 0)  # once it was seen to change
        constant.other(at, 129026, 0)
        assert constant.other(at + 90_000_000, 127250, 0) == at + 90_000_000


@pytest.mark.parametrize("phase_s", [0.002, 0.055, 0.07, 0.08, 0.1, 0.165, 0.195])
@pytest.mark.parametrize("period_s", [0.1, 0.145, 0.25, 1.0])
def test_other_messages_never_move_the_grid_of_positions(phase_s: float, period_s: float) -> None:
    alone, together = EpochClock(), EpochClock()
    rng = np.random.default_rng(4)
    events = [(k * 0.1 + 0.02 * rng.random(), True) for k in range(200)]
    events += [(k * period_s + phase_s, False) for k in range(round(20 / period_s))]
    for at, is_position in sorted(events):
        rx_ns = START_NS + round(at * 1e9)
        if is_position:
            assert alone.position(rx_ns) == together.position(rx_ns)
        else:
            together.other(rx_ns, 127250, None)


def test_frames_that_overtake_one_another_do_no_harm() -> None:
    clock = EpochClock()
    for k in range(60):
        at = START_NS + k * 100_000_000
        clock.position(at)
        clock.position(at - 2_000_000)  # a fast packet that began earlier is complete later
    assert clock.period_ns == 100_000_000
    assert abs(clock.epoch_ns - (START_NS + 59 * 100_000_000 - 2_000_000)) < 1e6


@pytest.mark.parametrize("period_ms", [104, 208, 260, 1030])
def test_a_period_near_a_common_one_is_not_taken_for_it(period_ms: int) -> None:
    clock = EpochClock()
    out = _run(clock, period_ms * 1e-3, 0.01, 400)
    assert clock.period_ns == period_ms * 1_000_000
    assert clock.resets == 0
    assert max(abs(instant - epoch) for epoch, instant in out[-300:]) < 0.012


def test_a_dropout_keeps_the_grid_and_a_step_starts_it_anew() -> None:
    clock = EpochClock()
    _run(clock, 0.2, 0.02, 150)
    after_gap = clock.position(START_NS + round((150 * 0.2 + 2.0 + 0.019) * 1e9))
    assert abs(after_gap - START_NS - 32.0e9) < 4e6  # 19 ms late, 2 s away: still on the old grid
    clock.position(START_NS - 3_600_000_000_000)
    assert clock.resets == 1
    assert clock.epoch_ns == START_NS - 3_600_000_000_000


@pytest.mark.parametrize("jump_s", [-5.0, 5.0, 1e9])
def test_utc_follows_the_earliest_arrivals_and_a_jump(jump_s: float) -> None:
    clock = UtcClock()
    assert clock.utc_ns(START_NS) is None
    for k in range(30):
        clock.update(
            START_NS + k * 1_000_000_000 + (k * 7 % 5) * 3_000_000, START_NS - 10**9 + k * 10**9, 1e-4
        )
    instant = clock.utc_ns(START_NS + 30 * 10**9)
    assert instant is not None
    assert abs(instant - (START_NS + 29 * 10**9)) < 2e6
    clock.update(START_NS + 31 * 10**9, START_NS + 30 * 10**9 + round(jump_s * 1e9), 1e-4)
    instant = clock.utc_ns(START_NS + 31 * 10**9)
    assert instant == START_NS + 30 * 10**9 + round(jump_s * 1e9)


def test_a_coarse_time_never_replaces_a_fine_one() -> None:
    clock = UtcClock()
    clock.update(START_NS, START_NS, 0.25)
    clock.update(START_NS + 10**9, START_NS + 10**9 - 5_000_000, 1e-4)
    clock.update(START_NS + 2 * 10**9, START_NS + 2 * 10**9 + 200_000_000, 0.25)
    assert clock.utc_ns(START_NS + 2 * 10**9) == START_NS + 2 * 10**9 - 5_000_000


@pytest.mark.parametrize(("before_s", "after_s"), [(0.2, 0.1), (0.1, 0.25), (1.0, 0.2)])
def test_a_device_that_changes_its_rate_is_followed(before_s: float, after_s: float) -> None:
    clock = EpochClock()
    _run(clock, before_s, 0.01, 40)
    start = START_NS + round(40 * before_s * 1e9)
    late = [rx - clock.position(rx) for rx in (start + round(k * after_s * 1e9) for k in range(80))]
    assert clock.period_ns == round(after_s * 1e9)
    assert abs(late[-1]) < 2e6
