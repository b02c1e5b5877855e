"""What can be known of the parameters: published figures, and the bound met by a simulated fit."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.models.family import model_named
from tilth.estimator.models.identifiability import (
    DISTURBANCES,
    NUISANCES,
    SENSOR_SETS,
    Bound,
    Sensor,
    bound,
    cramer_rao,
    sensitivities,
    whitened,
)
from tilth.estimator.models.linear_analysis import discretise, outputs_of, simulate, system
from tilth.estimator.models.manoeuvres import MANOEUVRES, Manoeuvre, manoeuvre_named
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig
from tilth.estimator.models.steady_turn import steady_turn
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

RELAXATION = model_named("relaxation")
DT = 0.02
STEP = 1e-4
TIME: Array = np.arange(1501, dtype=np.float64) * DT


def steady_sensitivities(rig: Rig, speed: float) -> Array:
    """d log(gain) / d log(C) of steady turning, shape (3, 3).

    Rows: yaw rate, articulation, lateral velocity per wheel angle. Columns: C_af, C_ar, C_ai.
    """

    def logs(log_c: Array) -> Array:
        row = np.array([[*np.exp(log_c), rig.m_t, rig.m_i, speed, 1.0, 0.0, 0.0]])
        v, r, lam = steady_turn(row, *rig.geometry[:5].tolist())[0]
        return np.log(np.abs([r, lam, v]))

    at = np.log(rig.theta[:3])
    nudges = np.eye(3) * STEP
    return np.column_stack([(logs(at + n) - logs(at - n)) / (2 * STEP) for n in nudges])


def steady_bound(rig: Rig, speeds: Sequence[float], outputs: Sequence[int] = (0, 1, 2)) -> Bound:
    """Rank and condition of the three stiffnesses from steady turns at several speeds.

    outputs: rows of `steady_sensitivities`, each known to the same share. With (0, 1), yaw rate and
    articulation, the rank is 2 at any set of speeds.
    """
    rows = np.concatenate([steady_sensitivities(rig, speed)[list(outputs)] for speed in speeds])
    return bound(rows, PARAMETERS[:3])


def _steering(name: str, degrees: float = 8.0, seed: int = 1) -> Array:
    return manoeuvre_named(name).wheel_angle(TIME, np.radians(degrees), np.random.default_rng(seed))


def test_steady_sensitivities_at_4_5_m_per_s() -> None:
    """d log(gain) / d log(C): identification.md, 3.1."""
    printed = [[0.118, -0.077, 0.0], [0.118, -0.127, 0.055], [0.118, 0.163, 0.0]]
    found = steady_sensitivities(TABLE_5_1, 4.5)
    np.testing.assert_allclose(found, printed, atol=6e-4)
    np.testing.assert_allclose(np.linalg.svd(found, compute_uv=False), [0.23, 0.20, 0.034], atol=2e-3)


@pytest.mark.parametrize("speeds", [[4.5], [1.0, 2.5, 4.5, 7.5]])
def test_steady_turns_without_sideslip_have_rank_two(speeds: list[float]) -> None:
    poor = steady_bound(TABLE_5_1, speeds, (0, 1))
    assert (poor.rank, poor.condition) == (2, np.inf)
    assert np.isinf(poor.sd).all()  # the open direction holds a part of each
    full = steady_bound(TABLE_5_1, speeds)
    assert full.rank == 3 and np.isfinite(full.sd).all()


# Per cent, identification.md 3.1: random steering of 8 degrees at 4.5 m/s for 30 s. Another draw of
# the steering moves each figure by some 15 %.
BOUNDS = [
    ("gyros", [1.5, 2.5, 5.0, 2.6, 4.1, 8.1], 0.15),
    ("gyros_headings", [1.5, 2.5, 4.6, 2.6, 4.1, 7.9], 0.15),
    ("positions_5hz", [3.5, 6.2, 13.0, 13.2, 9.5, 24.2], 0.15),
]  # fmt: skip


@pytest.mark.parametrize(("sensors", "printed", "within"), BOUNDS)
def test_bounds_in_print(sensors: str, printed: list[float], within: float) -> None:
    found = cramer_rao(
        RELAXATION, TABLE_7_2, 4.5, _steering("random"), DT, SENSOR_SETS[sensors], disturbances=DISTURBANCES
    )
    np.testing.assert_allclose(100 * found.sd, printed, rtol=within)
    assert found.rank == 6
    assert 7.0 < found.condition < 13.0


def test_the_bound_scales_with_amplitude_and_time() -> None:
    sensors = SENSOR_SETS["gyros"]
    strong, weak = (
        cramer_rao(RELAXATION, TABLE_7_2, 4.5, _steering("chirp", a), DT, sensors).sd for a in (8.0, 2.0)
    )
    np.testing.assert_allclose(weak, 4 * strong, rtol=1e-6)
    disturbed = cramer_rao(
        RELAXATION, TABLE_7_2, 4.5, _steering("chirp"), DT, sensors, disturbances=DISTURBANCES
    )
    assert (disturbed.sd > strong).all()
    more = cramer_rao(RELAXATION, TABLE_7_2, 4.5, _steering("chirp"), DT, (*sensors, Sensor("psi_i", 0.001)))
    assert (more.sd < strong).all()


def test_cost_of_nuisances() -> None:
    """A wheel angle's zero is nearly free, its gain doubles the sd of C_af (identification.md, 3.1)."""
    args = (RELAXATION, TABLE_7_2, 4.5, _steering("random"), DT, SENSOR_SETS["gyros_headings"])
    alone = cramer_rao(*args, disturbances=DISTURBANCES)
    zero = cramer_rao(*args, names=(*PARAMETERS, "wheel_zero"), disturbances=DISTURBANCES)
    gain = cramer_rao(*args, names=(*PARAMETERS, "wheel_gain"), disturbances=DISTURBANCES)
    assert zero.sd[0] / alone.sd[0] < 1.1
    assert 1.6 < gain.sd[0] / alone.sd[0] < 3.0
    everything = cramer_rao(*args, names=(*PARAMETERS, *NUISANCES), disturbances=DISTURBANCES)
    assert everything.rank == 10
    assert np.degrees(everything.sd[6]) < 0.03


def test_slopes_over_nuisances_are_what_they_mean() -> None:
    """The model is linear: a gain scales its response, a delay shifts it, a zero adds a step's."""
    delta, outputs = _steering("chirp"), ("r_t", "psi_i")
    slopes = sensitivities(RELAXATION, TABLE_5_1, 4.5, delta, DT, outputs, NUISANCES)
    inputs = np.column_stack([delta, np.zeros((len(delta), 2))])
    sys = system(RELAXATION, TABLE_5_1, 4.5, outputs=outputs)
    response = outputs_of(
        sys, simulate(RELAXATION, TABLE_5_1, 4.5, inputs, np.zeros(9), DT, linear=True), inputs
    )
    np.testing.assert_allclose(slopes[:, :, 1], response, atol=1e-7)
    late = (response[:-2] - response[2:]) / (2 * DT)
    np.testing.assert_allclose(slopes[1:-1, :, 2], late, atol=1e-7)
    step = np.column_stack([np.ones(len(delta)), np.zeros((len(delta), 2))])
    settled = outputs_of(sys, simulate(RELAXATION, TABLE_5_1, 4.5, step, np.zeros(9), DT, linear=True), step)
    np.testing.assert_allclose(slopes[:, :, 0], settled, atol=1e-6)


def test_masses_of_the_implement_hide_its_stiffness() -> None:
    """Only the ratio of forces to masses shows: all of them together leave one direction open."""
    names = ("C_af", "C_ar", "C_ai", "m_t", "m_i", "I_t", "I_i")
    found = cramer_rao(
        RELAXATION, TABLE_7_2, 4.5, _steering("random"), DT, SENSOR_SETS["gyros_headings"], names=names
    )
    assert found.rank == 6
    assert np.isinf(found.sd).all()
    straight = bound(np.array([[1.0, 0.0], [0.0, 0.0]]), ("a", "b"))
    assert straight.rank == 1
    assert straight.sd.tolist() == [1.0, np.inf]


def test_whitening_is_that_of_the_joint_covariance() -> None:
    """The filter's innovations carry the information of the whole record with its covariance written out."""
    sensors, n = (Sensor("r_t", 0.01), Sensor("psi_i", 0.02, 3)), 30
    slopes = sensitivities(
        RELAXATION, TABLE_5_1, 4.5, _steering("chirp")[100 : 100 + n], DT, ["r_t", "psi_i"]
    )
    white = whitened(RELAXATION, TABLE_5_1, 4.5, DT, sensors, slopes, DISTURBANCES)
    sys = system(RELAXATION, TABLE_5_1, 4.5, outputs=["r_t", "psi_i"])
    f, _, _ = discretise(sys.a, sys.b, DT)
    disturbance = np.diag([DISTURBANCES.get(name, 0.0) * DT for name in sys.states])
    sampled = [(k, i) for k in range(n) for i, s in enumerate(sensors) if k % s.every == 0]
    power = [np.linalg.matrix_power(f, k) for k in range(n)]
    rows = []
    for k, i in sampled:
        rows.append(
            np.concatenate(
                [sys.c[i] @ power[k - 1 - j] @ disturbance if j < k else np.zeros(9) for j in range(n)]
            )
        )
    reach = np.array(rows)
    joint = reach @ reach.T + np.diag([sensors[i].sd ** 2 for _, i in sampled])
    stacked = np.array([slopes[k, i] for k, i in sampled])
    np.testing.assert_allclose(white.T @ white, stacked.T @ np.linalg.solve(joint, stacked), rtol=1e-8)


def test_a_fit_meets_the_bound() -> None:
    """Least squares over 60 noisy records: its covariance is the bound's, without disturbances."""
    delta, sensors = _steering("random"), SENSOR_SETS["gyros"]
    inputs = np.column_stack([delta, np.zeros((len(delta), 2))])
    sd = np.array([s.sd for s in sensors])
    limit = cramer_rao(RELAXATION, TABLE_7_2, 4.5, delta, DT, sensors)
    rng = np.random.default_rng(11)

    def rates(log_theta: Array) -> Array:
        rig = TABLE_7_2._replace(**dict(zip(PARAMETERS, np.exp(log_theta).tolist(), strict=True)))
        return simulate(RELAXATION, rig, 4.5, inputs, np.zeros(9), DT, linear=True)[:, 1:3]

    truth = np.log(TABLE_7_2.theta)
    exact = rates(truth)
    slopes = sensitivities(RELAXATION, TABLE_7_2, 4.5, delta, DT, [s.output for s in sensors]) / sd[:, None]
    solver = np.linalg.pinv(slopes.reshape(-1, 6))
    errors = []
    for _ in range(60):
        measured = exact + rng.normal(0, 1, exact.shape) * sd
        guess = truth
        for _ in range(2):  # Gauss-Newton with the slope at the truth
            guess = guess + solver @ ((measured - rates(guess)) / sd).ravel()
        errors.append(guess - truth)
    shares = np.std(errors, axis=0) / limit.sd
    np.testing.assert_allclose(shares, 1.0, atol=0.25)


@pytest.mark.parametrize("row", MANOEUVRES, ids=lambda m: m.name)
def test_a_manoeuvre_stays_within_its_amplitude(row: Manoeuvre) -> None:
    angle = row.wheel_angle(TIME, 0.1, np.random.default_rng(3))
    assert angle.shape == TIME.shape
    assert np.abs(angle).max() <= 0.1 + 1e-12
    assert np.abs(angle).max() > 0.02
    assert not angle[TIME < 0.99].any()


def test_an_unknown_manoeuvre_is_named() -> None:
    with pytest.raises(ValueError, match="step, steps, chirp, turn, random, multisine, row"):
        manoeuvre_named("slalom")
