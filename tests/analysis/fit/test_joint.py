"""Segments joined: the prior counts once, drift forgets, and what does not agree is said."""

from dataclasses import replace

import numpy as np
import pytest
from told_segments import LEARNED, MACHINE, MEAN, SD, around, drawn, masses, root_of, told

from tilth.analysis.fit.agreement import Agreement, agree
from tilth.analysis.fit.joint import join, linearise
from tilth.estimator.filters.drift import DRIFT
from tilth.estimator.filters.unknowns import SIX


def test_the_joint_posterior_is_that_of_all_data_at_once() -> None:
    rng = np.random.default_rng(1)
    truth = drawn(rng)
    roots = [root_of(rng, rows) for rows in (4, 30, 60)]
    segments = [told(truth, root, rng) for root in roots]
    joint = join(MACHINE, around(segments))
    whole, prior = np.vstack(roots), np.diag(SD[LEARNED] ** -2.0)
    covariance = np.linalg.inv(prior + whole.T @ whole)
    mean = -covariance @ np.sum([one.gradient for (one,) in segments], axis=0)
    assert joint.mean[LEARNED] - MEAN[LEARNED] == pytest.approx(mean, abs=1e-9)
    found = joint.covariance[np.ix_(LEARNED, LEARNED)] - masses()
    assert found == pytest.approx(covariance, rel=1e-6, abs=1e-9)
    assert joint.seconds == 90.0


def test_a_subset_is_what_its_segments_give_alone() -> None:
    rng = np.random.default_rng(2)
    segments = [told(drawn(rng), root_of(rng), rng) for _ in range(4)]
    some = join(MACHINE, around(segments), [1, 3])
    alone = join(MACHINE, around([segments[1], segments[3]]))
    assert np.array_equal(some.mean, alone.mean) and np.array_equal(some.covariance, alone.covariance)
    assert some.seconds == 60.0


def test_errors_of_the_model_do_not_average_out() -> None:
    rng = np.random.default_rng(3)
    truth, model_sd = drawn(rng), np.full(6, 0.05)
    segments = [told(truth, root_of(rng, 80, 30.0), rng, model_sd) for _ in range(9)]
    sds = np.sqrt(np.diag(join(MACHINE, around(segments)).covariance)[:6] - np.diag(masses())[:6])
    assert np.all(sds >= 0.05) and np.all(sds < 0.08)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_sharp_turn_takes_nothing_from_what_gentle_steering_has_told(order: tuple[int, int]) -> None:
    """Hardly anything, whichever was driven first: its errors count as far as it was learned from."""
    rng = np.random.default_rng(4)
    truth = drawn(rng)
    gentle = told(truth, root_of(rng, 80, 40.0), rng, np.full(6, 0.03))
    sharp = told(truth, root_of(rng, 80, 10.0), rng, np.full(6, 0.2))
    masses_sd = np.diag(masses())[:6]
    alone, both, last = (
        np.sqrt(np.diag(join(MACHINE, around(segments)).covariance)[:6] - masses_sd)
        for segments in ([gentle], [(gentle, sharp)[k] for k in order], [sharp])
    )
    assert np.all(both < 1.9 * alone) and np.all(both < 0.4 * last)


def test_soil_that_is_far_away_tells_less() -> None:
    rng = np.random.default_rng(4)
    truth = drawn(rng)
    segments = [told(truth, root_of(rng, 60, 10.0), rng) for _ in range(2)]
    near, far = (join(MACHINE, around(segments, metres)) for metres in (10.0, 20 * DRIFT.length_m))
    soil_near, soil_far = (np.diag(joint.covariance)[:6] - np.diag(masses())[:6] for joint in (near, far))
    assert np.all(soil_far > 1.2 * soil_near)
    machine = np.diag(far.covariance)[LEARNED[6:]]
    assert machine == pytest.approx(np.diag(near.covariance)[LEARNED[6:]], rel=0.6)  # that does not drift


def test_scores_that_vary_more_than_white_noise_widen() -> None:
    rng = np.random.default_rng(5)
    (one,) = told(drawn(rng), root_of(rng, 60, 10.0), rng)
    spread = 4.0 * one.information
    coloured = replace(one, scores=spread, whiteness=0.2)
    white, wide = (np.diag(join(MACHINE, around([(row,)])).covariance)[:6] for row in (one, coloured))
    assert np.all(wide - np.diag(masses())[:6] > 2.0 * (white - np.diag(masses())[:6]))


@pytest.mark.parametrize("count", [2, 3, 9])
def test_segments_of_one_soil_agree(count: int) -> None:
    rng = np.random.default_rng(count)
    ps = []
    for _ in range(200):
        truth = drawn(rng)
        segments = [told(truth, root_of(rng, 12), rng) for _ in range(count)]
        ps.append(agree(MACHINE, segments, [0.0] * (count - 1)).p)
    assert np.mean(np.array(ps) < 0.05) < 0.09
    assert np.mean(np.array(ps) < 0.01) < 0.04
    assert np.mean(np.array(ps) < 0.5) > 0.3  # the test is not blind either


def test_segments_of_two_soils_do_not_agree() -> None:
    rng = np.random.default_rng(7)
    truth = drawn(rng)
    other = truth.copy()
    other[:3] -= 0.5
    segments = [told(soil, root_of(rng, 200, 20.0), rng) for soil in (truth, truth, other)]
    joint = join(MACHINE, around(segments))
    assert not joint.agreement.agrees and "do not agree" in joint.agreement.sentence
    assert np.all(joint.refused[:3]) and np.all(joint.between_sd[:3] > 0.2)
    same = join(MACHINE, around(segments), [0, 1])
    assert same.agreement.agrees and not same.between_sd.any() and not same.refused.any()


def test_one_segment_has_nothing_to_agree_with() -> None:
    rng = np.random.default_rng(8)
    joint = join(MACHINE, around([told(drawn(rng), root_of(rng), rng)]))
    assert joint.agreement.p == 1.0 and "nothing can be said" in joint.agreement.sentence
    assert np.all(np.diag(joint.covariance)[SIX] > 0.0)


def test_nothing_to_join() -> None:
    with pytest.raises(ValueError, match="no segment to join"):
        linearise(MACHINE, [], [])
    assert Agreement(3.0, 2, 0.2, "").agrees
