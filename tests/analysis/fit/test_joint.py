"""Segments joined: the prior counts once, drift forgets, and what does not agree is said."""

import numpy as np
import pytest
from logs import MACHINE
from numpy.typing import NDArray

from tilth.analysis.fit.joint import Agreement, agree, join
from tilth.analysis.fit.segment_fit import SegmentFit
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import DRIFT_LENGTH_M
from tilth.estimator.filters.unknowns import NAMES, NOISE, SIX

Floats = NDArray[np.float64]
MEAN, SD = unknowns.prior(MACHINE)
NO_MODEL = np.full(6, 1e-6)
LEARNED = np.flatnonzero((SD > 0.0) & ~np.isin(np.arange(len(NAMES)), np.arange(NOISE.start, NOISE.stop)))


def told(truth: Floats, root: Floats, rng: np.random.Generator, model_sd: Floats = NO_MODEL) -> SegmentFit:
    """What a segment gives that measures root (rows, learned) @ unknowns with white noise of sd 1."""
    prior = np.diag(SD[LEARNED] ** -2.0)
    observed = root @ truth + rng.normal(size=len(root))
    covariance = np.linalg.inv(prior + root.T @ root)
    mean, whole = MEAN.copy(), np.zeros((len(NAMES), len(NAMES)))
    mean[LEARNED] = covariance @ (prior @ MEAN[LEARNED] + root.T @ observed)
    whole[np.ix_(LEARNED, LEARNED)] = covariance
    whole[SIX, SIX] += np.diag(model_sd**2)
    return SegmentFit({}, mean, whole, model_sd, 30.0, 130.0, {}, 0.0)


def root_of(rng: np.random.Generator, rows: int = 40, scale: float = 3.0) -> Floats:
    root: Floats = rng.normal(size=(rows, len(LEARNED))) * scale / np.sqrt(rows) / SD[LEARNED]
    return root


def drawn(rng: np.random.Generator) -> Floats:
    return MEAN[LEARNED] + SD[LEARNED] * rng.normal(size=len(LEARNED))


def test_the_joint_posterior_is_that_of_all_data_at_once() -> None:
    rng = np.random.default_rng(1)
    truth = drawn(rng)
    roots = [root_of(rng, rows) for rows in (4, 30, 60)]
    observed: list[Floats] = []
    fits = []
    for k, root in enumerate(roots):
        noise = np.random.default_rng(10 + k)
        fits.append(told(truth, root, np.random.default_rng(10 + k)))
        observed.append(root @ truth + noise.normal(size=len(root)))
    joint = join(MACHINE, fits, [0.0, 0.0])
    whole, prior = np.vstack(roots), np.diag(SD[LEARNED] ** -2.0)
    covariance = np.linalg.inv(prior + whole.T @ whole)
    mean = covariance @ (prior @ MEAN[LEARNED] + whole.T @ np.concatenate(observed))
    assert joint.mean[LEARNED] == pytest.approx(mean, abs=1e-5)
    assert joint.covariance[np.ix_(LEARNED, LEARNED)] == pytest.approx(covariance, abs=1e-6)
    assert joint.seconds == 90.0


def test_one_segment_alone_stays_as_it_is() -> None:
    rng = np.random.default_rng(2)
    model_sd = np.array([0.03, 0.03, 0.03, 0.05, 0.05, 0.08])
    fit = told(drawn(rng), root_of(rng), rng, model_sd)
    joint = join(MACHINE, [fit], [])
    assert joint.mean[SIX] == pytest.approx(fit.mean[SIX], abs=1e-3)
    assert np.diag(joint.covariance)[:6] == pytest.approx(np.diag(fit.covariance)[:6], rel=0.02)
    assert joint.agreement.p == 1.0 and "nothing can be said" in joint.agreement.sentence


def test_errors_of_the_model_do_not_average_out() -> None:
    rng = np.random.default_rng(3)
    truth, model_sd = drawn(rng), np.full(6, 0.05)
    fits = [told(truth, root_of(rng, 80, 30.0), rng, model_sd) for _ in range(9)]
    sds = np.sqrt(np.diag(join(MACHINE, fits, [0.0] * 8).covariance)[:6])
    assert np.all(sds >= 0.05) and np.all(sds < 0.08)


def test_soil_that_is_far_away_tells_less() -> None:
    rng = np.random.default_rng(4)
    truth = drawn(rng)
    fits = [told(truth, root_of(rng, 60, 10.0), rng) for _ in range(2)]
    near, far = (join(MACHINE, fits, [metres]) for metres in (10.0, 20 * DRIFT_LENGTH_M))
    assert np.all(np.diag(far.covariance)[:6] > 1.5 * np.diag(near.covariance)[:6])
    machine = np.diag(far.covariance)[LEARNED[6:]]
    assert machine == pytest.approx(np.diag(near.covariance)[LEARNED[6:]], rel=0.3)  # that does not drift


@pytest.mark.parametrize("count", [2, 3, 9])
def test_segments_of_one_soil_agree(count: int) -> None:
    rng = np.random.default_rng(count)
    ps = []
    for _ in range(200):
        truth = drawn(rng)
        fits = [told(truth, root_of(rng, 12), rng) for _ in range(count)]
        ps.append(agree(MACHINE, fits, [0.0] * (count - 1)).p)
    assert np.mean(np.array(ps) < 0.05) < 0.09  # what the segments have in common makes it no smaller
    assert np.mean(np.array(ps) < 0.01) < 0.04


def test_segments_of_two_soils_do_not_agree() -> None:
    rng = np.random.default_rng(7)
    truth = drawn(rng)
    other = truth.copy()
    other[:3] -= 0.5
    fits = [told(soil, root_of(rng, 200, 20.0), rng) for soil in (truth, truth, other)]
    joint = join(MACHINE, fits, [0.0, 0.0])
    assert not joint.agreement.agrees and "do not agree" in joint.agreement.sentence
    assert joint.agreement.widening > 2.0
    same = join(MACHINE, fits[:2], [0.0])
    assert same.agreement.agrees and same.agreement.widening == 1.0


def test_nothing_to_join() -> None:
    with pytest.raises(ValueError, match="no segment to join"):
        join(MACHINE, [], [])
    assert Agreement(3.0, 2, 0.2, "").agrees
