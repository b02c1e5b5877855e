"""A season of stretches put together: beside one least-squares problem of all, and beside the daemon."""

from dataclasses import replace

import numpy as np
import pytest
from logs import MACHINE
from numpy.typing import NDArray

from tilth.analysis.season.identified import Stretch, share_learned
from tilth.analysis.season.merging import _faded, merged
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.drift import retained_share
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem
from tilth.estimator.warm_start import share_left

Array = NDArray[np.float64]
DAY_S = 86_400.0
MEAN, SD = (part[SIX] for part in unknowns.prior(MACHINE))
MASSES = pem.of_masses(np.diag(unknowns.prior(MACHINE)[1] ** 2))[SIX, SIX]


def stretch(seed: int, metres: float = 200.0, model_sd: float = 0.0) -> Stretch:
    """Of random information about a random truth."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((6, 6)) * 4.0
    information = root @ root.T
    return Stretch(
        "pem", seed * 10**10, seed * 10**10 + 10**9, 20.0, metres, 3.0, 0.1, np.zeros((0, 2)), information,
        information @ (0.2 * rng.standard_normal(6)), np.full(6, model_sd),
    )  # fmt: skip


def whole(stretches: list[Stretch]) -> tuple[Array, Array]:
    """Mean (n, 6) and covariance (n, 6, 6) of all stretches at once, of drift alone."""
    n = len(stretches)
    way = np.cumsum([one.metres for one in stretches])
    share = np.array([[retained_share(abs(a - b)) for a in way] for b in way])
    prior = np.kron(share, np.diag(SD**2))
    information, vector = np.zeros((6 * n, 6 * n)), np.concatenate([one.vector for one in stretches])
    for k, one in enumerate(stretches):
        information[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = one.information
    covariance = np.linalg.inv(np.linalg.inv(prior) + information)
    mean = covariance @ vector
    blocks = [covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k in range(n)]
    return np.asarray(mean.reshape(n, 6), np.float64), np.array(blocks, np.float64)


def test_smoothed_is_the_whole_season_as_one_problem() -> None:
    """Stiffnesses far apart: the drift of half the correlation length between them."""
    stretches = [stretch(k, metres=400.0 * 3**k) for k in range(1, 5)]
    found = merged(MACHINE, stretches, [0.0] * 4)
    mean, covariance = whole(stretches)
    for k, one in enumerate(found):
        np.testing.assert_allclose(one.smoothed.mean - MEAN, mean[k], atol=1e-8)
        np.testing.assert_allclose(one.smoothed.covariance - MASSES, covariance[k], atol=1e-8)
        before, here = whole(stretches[: k + 1])
        np.testing.assert_allclose(one.forward.mean - MEAN, before[k], atol=1e-8)
        np.testing.assert_allclose(one.forward.covariance - MASSES, here[k], atol=1e-8)


def test_between_runs_it_fades_as_the_warm_start_does() -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((6, 6))
    covariance, mean, prior = root @ root.T + np.eye(6), rng.standard_normal(6), np.diag(SD**2)
    share = share_left(0.7 * DAY_S)
    step = _faded(covariance, prior, share)
    after = np.linalg.inv(share * np.linalg.inv(covariance) + (1.0 - share) * np.linalg.inv(prior))
    np.testing.assert_allclose(
        step.transition @ covariance @ step.transition.T + step.noise, after, atol=1e-12
    )
    np.testing.assert_allclose(step.transition @ mean, after @ (share * np.linalg.inv(covariance) @ mean))
    assert np.linalg.eigvalsh(step.noise)[0] > 0.0


def test_after_a_year_a_run_begins_as_the_first_did() -> None:
    one, other = stretch(1), stretch(2)
    found = merged(MACHINE, [one, other], [0.0, 400 * DAY_S])
    np.testing.assert_allclose(found[1].forward.mean, found[1].alone.mean, atol=1e-9)
    near = merged(MACHINE, [one, other], [0.0, 60.0])
    assert np.all(np.diag(near[1].forward.covariance) < np.diag(found[1].forward.covariance))


def test_other_soil_gives_up_what_was_known_both_ways() -> None:
    first, second = stretch(1), replace(stretch(2), changed=True)
    found = merged(MACHINE, [first, second], [0.0, 0.0])
    np.testing.assert_allclose(found[0].smoothed.mean, found[0].alone.mean, atol=1e-9)
    np.testing.assert_allclose(found[1].smoothed.covariance, found[1].alone.covariance, atol=1e-9)


def test_errors_of_the_model_do_not_average_out() -> None:
    found = merged(MACHINE, [stretch(k, metres=1.0, model_sd=0.1) for k in range(40)], [0.0] * 40)
    for one in (found[-1].forward, found[20].smoothed):
        assert np.all(np.sqrt(np.diag(one.covariance)) > 0.095)


def test_errors_of_the_machine_file_are_added_to_what_is_known_by_all_stretches() -> None:
    """The file is one, so its errors are the same in all, and no number of stretches makes them less."""
    root = np.random.default_rng(7).standard_normal((6, 6))
    by_file = 0.01 * root @ root.T
    stretches = [stretch(k) for k in range(1, 5)]
    right = merged(MACHINE, stretches, [0.0] * 4)
    doubted = merged(MACHINE, [replace(one, by_file=by_file) for one in stretches], [0.0] * 4)
    for one, other in zip(right, doubted, strict=True):
        for way in ("alone", "forward", "smoothed"):
            np.testing.assert_array_equal(getattr(one, way).mean, getattr(other, way).mean)
            np.testing.assert_allclose(
                getattr(other, way).covariance, getattr(one, way).covariance + by_file, atol=1e-12
            )


def test_a_stretch_that_tells_nothing_takes_nothing_off_the_prior() -> None:
    none = replace(stretch(1), information=np.zeros((6, 6)), vector=np.zeros(6))
    assert all(share == pytest.approx(0.0) for share in share_learned(none.information, SD).values())
    (alone,) = merged(MACHINE, [none], [0.0])
    np.testing.assert_allclose(np.diag(alone.smoothed.covariance - MASSES), SD**2)
    assert merged(MACHINE, [], []) == []
