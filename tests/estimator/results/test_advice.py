"""Advice: what it reports as determined, against the information put in; predicted sds, against drives."""

import math
import re
from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
from circle import demo_machine
from linear_drive import LINEAR, SPEED, simulated
from numpy.typing import NDArray

from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.fit_covariance import model_sd
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import AT, NAMES, SIX
from tilth.estimator.models.family import model_named
from tilth.estimator.models.identifiability import Sensor, cramer_rao
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.results import advice
from tilth.estimator.results.advice import Advisor, Candidate
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Advice, AdviceKind
from tilth.schemas.sentences import advice_sentence, combination_words

Array = NDArray[np.float64]

MACHINE = demo_machine()
CHIRP = Candidate("chirp", 5.0)
MEAN, SD = unknowns.prior(MACHINE)
PRIOR_6 = np.full(6, 0.7)


def embedded(
    machine: Machine,
    mean: Array,
    covariance: Array,
    nuisances: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Array, Array]:
    """(mean [n], covariance [n, n]) over unknowns.NAMES of an estimate that has only the six logarithms,
    shapes (6,), (6, 6), and perhaps some nuisances by name, (value, sd); else the machine file's."""
    whole, sd = unknowns.prior(machine)
    for name, (value, known) in (nuisances or {}).items():
        if name in AT and sd[AT[name]] > 0:
            whole[AT[name]], sd[AT[name]] = value, min(known, sd[AT[name]])
    whole_covariance: Array = np.diag(sd**2)
    whole[SIX], whole_covariance[SIX, SIX] = mean, covariance
    return whole, whole_covariance


def information_on(*rows: tuple[dict[str, float], float]) -> Array:
    """Information of six logarithms from combinations that are known with an sd."""
    whole = np.zeros((6, 6))
    for weights, sd in rows:
        w = np.array([weights.get(name, 0.0) for name in PARAMETERS])
        whole += np.outer(w, w) / sd**2
    return whole


def test_single_parameters_are_named_with_their_range() -> None:
    advice_text = tuple(
        map(
            combination_words,
            advice.determined(information_on(({"C_af": 1.0}, 0.04), ({"sigma_i": 1.0}, 0.2)), PRIOR_6),
        )
    )
    assert advice_text == ("C_af ±7.8 % (95 %)", "sigma_i -31 … +46 % (95 %)")


@pytest.mark.parametrize(
    ("weights", "expected_text"),
    [
        ({"C_af": 1.0, "C_ar": -1.0}, "C_af/C_ar ±7.8 % (95 %)"),
        ({"C_ar": -1.0, "C_ai": -1.0}, "C_ar·C_ai ±7.8 % (95 %)"),
        ({"C_af": 1.0, "C_ar": 0.8, "C_ai": 0.7}, "C_af·C_ar^0.8·C_ai^0.7 ±7.8 % (95 %)"),
    ],
)
def test_a_combination_is_named_where_no_parameter_of_it_is_determined(
    weights: dict[str, float], expected_text: str
) -> None:
    advice_text = tuple(map(combination_words, advice.determined(information_on((weights, 0.04)), PRIOR_6)))
    assert advice_text == (expected_text,)


def test_a_second_combination_is_another_one() -> None:
    rows = (({"C_af": 1.0, "C_ar": -1.0}, 0.04), ({"sigma_f": 1.0, "sigma_r": -1.0}, 0.1))
    advice_text = tuple(map(combination_words, advice.determined(information_on(*rows), PRIOR_6)))
    assert advice_text == ("C_af/C_ar ±7.8 % (95 %)", "sigma_f/sigma_r ±20 % (95 %)")


def test_nothing_received_determines_nothing() -> None:
    nothing = np.zeros((6, 6))
    assert advice.determined(nothing, PRIOR_6) == ()
    assert advice.bound(nothing, PRIOR_6) == (None,) * 6
    assert advice.eigenvalues(nothing, PRIOR_6) == (0.0,) * 6


def test_the_bound_is_that_of_the_data_alone_and_open_where_they_are_silent() -> None:
    information = information_on(({"C_af": 1.0}, 0.04), ({"C_ar": 1.0, "C_ai": 1.0}, 0.1))
    first, *others = advice.bound(information, PRIOR_6)
    assert first == pytest.approx(0.04) and others == [None] * 5
    rng = np.random.default_rng(2)
    full = rng.normal(size=(20, 6))
    found = advice.bound(full.T @ full, PRIOR_6)
    np.testing.assert_allclose(
        np.array(found, dtype=np.float64), np.sqrt(np.diag(np.linalg.inv(full.T @ full)))
    )


def test_information_is_what_the_posterior_has_beyond_the_prior() -> None:
    information = information_on(({"C_af": 1.0, "C_ar": -0.5}, 0.04), ({"sigma_r": 1.0}, 0.3))
    posterior: Array = np.asarray(np.linalg.inv(np.diag(PRIOR_6**-2) + information), np.float64)
    np.testing.assert_allclose(advice.information_of(posterior, PRIOR_6), information, atol=1e-8)
    # A covariance that drifted a little beyond the prior tells nothing, not less than nothing.
    assert np.linalg.eigvalsh(advice.information_of(1.02 * np.diag(PRIOR_6**2), PRIOR_6)).min() >= 0.0


def test_prediction_is_that_of_the_bound_where_both_apply() -> None:
    """Positions and yaw rates, six unknown: identifiability.cramer_rao has another model of the sensors, a
    known first state and Python for its filter."""
    # Measured exactly, roll tells the cross slopes, which the other has not.
    quiet = [r.model_copy(update={"velocity_sd": 1e3, "roll_sd": 1e-3}) for r in MACHINE.receiver]
    machine = MACHINE.model_copy(update={"receiver": quiet})
    point = LINEAR.copy()
    point[AT["rolling"]] = 0.0
    # The other knows white pushes only, each on one state.
    point[AT["push_t"] : AT["uneven"] + 1] = [-20.0, -20.0, math.log(0.1), -20.0, -20.0]
    found = advice.information(machine, point, SPEED, CHIRP, linear=True)[SIX, SIX]
    time: Array = np.arange(round((advice.ADVICE.seconds + 1.0) * 50) + 1, dtype=np.float64) * 0.02
    delta = manoeuvre_named("chirp").wheel_angle(time, math.radians(5.0), np.random.default_rng(1))
    sensors = (
        Sensor("y_t", 0.018, 10), Sensor("psi_t", 0.0131, 10), Sensor("y_i", 0.018, 10),
        Sensor("psi_i", 0.0136, 10), Sensor("r_t", math.radians(0.3 / math.sqrt(2)), 10),
        Sensor("r_i", math.radians(0.3 / math.sqrt(2)), 10),
    )  # fmt: skip
    noise = {"v": 1e-9, "r_t": 0.1, "r_i": 1e-9}
    limit = cramer_rao(
        model_named("relaxation"), rig_of(MACHINE), SPEED, delta, 0.02, sensors, disturbances=noise
    )
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(found))), limit.sd, rtol=0.15)


def fitted(seed: int, machine: Machine, candidate: Candidate, known: list[int]) -> tuple[Array, Array]:
    """(errors, sds) of the six after one Gauss-Newton step from the truth, what was believed before drawn."""
    record, setup = simulated(seed, machine, candidate), rig_setup(machine, linear=True)
    nudges = 1e-3 * SD[known]
    points = np.tile(LINEAR, (len(known) + 2, 1))
    points[np.arange(1, len(known) + 1), known] += nudges
    # Wheel angles are straight lines between ticks: over a latency that is a tick's end, a difference to one
    # side is the slope of half a tick later. This one is over both sides.
    latency = known.index(AT["latency"])
    points[-1, AT["latency"]] -= nudges[latency]
    errors, variances = [], []
    for point in points:  # one by one: each with its own gains
        found = likelihood.innovations(record, setup, np.zeros(N_STATES), point)
        errors.append(found.e)
        variances.append(found.S)
    differences = np.array(errors[1:-1]) - errors[0]
    differences[latency] = (errors[1 + latency] - errors[-1]) / 2.0
    white = (differences / nudges[:, None] / np.sqrt(variances[0])).T
    relative = ((np.array(variances[1:-1]) - variances[0]) / nudges[:, None] / variances[0]).T
    score = -white.T @ (errors[0] / np.sqrt(variances[0]))
    score += 0.5 * relative.T @ (errors[0] ** 2 / variances[0] - 1.0)
    information = white.T @ white + 0.5 * relative.T @ relative
    believed = np.random.default_rng(1000 + seed).normal(0, SD[known])
    total = information + np.diag(SD[known] ** -2.0)
    step: Array = np.asarray(np.linalg.solve(total, score + believed / SD[known] ** 2), np.float64)
    return step[:6], np.asarray(np.sqrt(np.diag(np.linalg.inv(total)))[:6], np.float64)


@pytest.mark.coverage
@pytest.mark.parametrize(("degrees", "most"), [(3.0, 1.45), (8.0, 1.12)])
def test_a_chirp_brings_what_was_predicted(degrees: float, most: float) -> None:
    """Ten seconds on a linear plant with the model's own noise, all nuisances unknown. 40 runs put ±0.13
    on the mean square."""
    known = [
        k for k in range(len(NAMES)) if SD[k] > 0 and not unknowns.NOISE.start <= k < unknowns.NOISE.stop
    ]
    known.remove(AT["curvature"])
    held = np.zeros(len(NAMES))
    held[known] = SD[known] ** 2
    chirp = Candidate("chirp", degrees)
    predicted = advice.predicted(
        np.diag(held), advice.information(MACHINE, LINEAR, SPEED, chirp, linear=True)
    )
    runs = [fitted(seed, MACHINE, chirp, known) for seed in range(40)]
    achieved = np.mean([sd for _, sd in runs], axis=0)
    share = predicted / achieved
    # The disturbances' own colour tells the rest, sigma_i most. Never a promise that is not kept.
    assert (share > 0.95).all() and (share < most).all()
    normal = np.array([error / sd for error, sd in runs])
    assert 0.75 < float(np.mean(normal**2)) < 1.25  # what is called achieved is what errors show


@cache
def everything() -> dict[Candidate, Array]:
    """What each gentle manoeuvre would bring."""
    return {c: advice.information(MACHINE, MEAN, SPEED, c) for c in advice.gentle(MACHINE, SPEED)}


def test_advice_names_the_open_parameter_and_a_manoeuvre_that_closes_it() -> None:
    covariance = np.diag(SD**2)
    covariance[SIX, SIX] = np.diag(np.array([0.05, 0.05, 0.45, 0.05, 0.05, 0.1]) ** 2)
    advice_text = advice_sentence(advice.advise(MACHINE, MEAN, covariance, SPEED, everything()))
    start, _, offer = advice_text.partition("; ")
    assert start == "C_ai is not determined: -59 … +142 % (95 %)"
    assert offer.startswith("10 s of ") and offer.endswith(" % (95 %)")
    brought = re.search(r"would bring it to ±(\d+) %", offer)
    assert brought is not None
    after = int(brought[1]) / 1.96
    best = min(advice.predicted(covariance, brought)[2] for brought in everything().values())
    assert 95 * best < after < 25


def test_if_all_is_determined_the_least_known_is_named_without_a_manoeuvre() -> None:
    covariance = np.diag(SD**2)
    covariance[SIX, SIX] = np.eye(6) * 0.01**2
    advice_text = advice_sentence(advice.advise(MACHINE, MEAN, covariance, SPEED, everything()))
    assert (
        advice_text == "C_af is known least: ±2.0 % (95 %); no 10 s of steering at this speed would help much"
    )
    too_slow = advice.advise(MACHINE, MEAN, np.diag(SD**2), 0.5, {})
    assert too_slow == Advice(AdviceKind.TOO_SLOW, speed=1.5)
    assert advice_sentence(too_slow) == "nothing can be learned below 5.4 km/h"
    assert advice_sentence(advice.advise(MACHINE, MEAN, np.diag(SD**2), SPEED, everything())).startswith(
        "none of C_af, C_ar, C_ai, sigma_f, sigma_r and sigma_i is determined; 10 s of "
    )


def test_no_sharp_manoeuvre_at_speed() -> None:
    assert len(advice.gentle(MACHINE, 4.5)) == len(advice.CANDIDATES)
    assert max(c.degrees for c in advice.gentle(MACHINE, 8.0, turns=False)) == 5.0
    assert advice.gentle(MACHINE, 12.0) == (advice.TURN,)  # which nobody drives at that speed
    assert advice.gentle(MACHINE, 12.0, turns=False) == ()


def test_a_headland_turn_is_advised_where_it_tells_as_much() -> None:
    """It is driven anyway, slowly; what the model errs by in sharp turns is not promised."""
    covariance = np.diag(SD**2)
    covariance[SIX, SIX] = np.diag(np.array([0.3, 0.05, 0.05, 0.5, 0.05, 0.05]) ** 2)
    table = {c: everything()[c] for c in (advice.TURN, Candidate("step", 3.0))}
    text = advice_sentence(advice.advise(MACHINE, MEAN, covariance, SPEED, table))
    assert "10 s of a headland turn at 25° or more would bring" in text
    exact = advice.predicted(covariance, table[advice.TURN])
    assert (
        advice.predicted(covariance, table[advice.TURN], model_sd(True, 0.0, 0.006, MEAN[SIX])) > exact
    ).all()


def test_the_headland_turn_that_comes_anyway_is_said_beside_what_tells_more() -> None:
    step, covariance = Candidate("step", 8.0), np.diag(SD**2)
    table = {c: everything()[c] for c in (advice.TURN, step)}
    text = advice_sentence(advice.advise(MACHINE, MEAN, covariance, SPEED, table))
    offer, _, turn = text.partition("; ")[2].partition("; ")
    assert offer.startswith("10 s of a turn held at 8°")
    found = re.fullmatch(r"the next headland turn would bring (\w+) to .* \(95 %\)", turn)
    assert found is not None
    k, errors = PARAMETERS.index(found[1]), model_sd(True, 0.0, math.exp(MEAN[AT["uneven"]]), MEAN[SIX])
    after = advice.predicted(covariance, table[advice.TURN], errors) / SD[SIX]
    assert k == int(np.argmin(after)) and after[k] < advice.ADVICE.worthwhile
    alone = advice.advise(MACHINE, MEAN, covariance, SPEED, {step: table[step]})
    assert turn not in advice_sentence(alone)
    covariance[SIX, SIX] = np.eye(6) * 0.01**2  # known better than a turn can tell
    assert "headland" not in advice_sentence(advice.advise(MACHINE, MEAN, covariance, SPEED, table))


def test_more_is_known_after_a_wilder_manoeuvre_and_never_less_than_before() -> None:
    covariance = np.diag(SD**2)
    before = np.sqrt(np.diag(covariance)[SIX])
    mild, wild = (
        advice.predicted(covariance, advice.information(MACHINE, MEAN, SPEED, Candidate("chirp", a)))
        for a in (3.0, 8.0)
    )
    assert (mild < before).all() and (wild < mild).all()


def test_an_estimate_of_six_alone_is_taken_with_the_nuisances_of_the_machine_file() -> None:
    mean, covariance = embedded(
        MACHINE, MEAN[SIX] + 0.1, 0.01 * np.eye(6), {"wheel_zero": (0.004, 0.001), "odd": (1.0, 1.0)}
    )
    np.testing.assert_allclose(mean[SIX], MEAN[SIX] + 0.1)
    assert mean[AT["wheel_zero"]] == 0.004
    assert covariance[AT["wheel_zero"], AT["wheel_zero"]] == pytest.approx(1e-6)
    assert covariance[AT["rolling"], AT["rolling"]] == pytest.approx(SD[AT["rolling"]] ** 2)


def test_a_running_advisor_computes_one_candidate_at_a_time_and_continues_from_json() -> None:
    covariance = np.diag(SD**2)
    state = Advisor()
    texts = []
    for k in range(30):
        texts.append(advice.renew(state, MACHINE, MEAN, covariance, SPEED, 1 + k * 1_000_000_000))
        assert len(state.table) == k // 10 + 1
    assert len(set(texts[:10])) == 1 and "chirp" in advice_sentence(texts[-1])
    again = from_json_data(Advisor, to_json_data(state))
    later = 1 + 40 * 1_000_000_000
    assert advice.renew(again, MACHINE, MEAN, covariance, SPEED, later) == advice.renew(
        state, MACHINE, MEAN, covariance, SPEED, later
    )
    advice.renew(state, MACHINE, MEAN, covariance, 2 * SPEED, later + advice.ADVICE.every_ns)
    assert len(state.table) == 1  # of another speed


@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0])
@pytest.mark.parametrize(
    "off", [(-0.70, 0.39, 2.91, -0.43, 2.06, -2.51), (2.33, -0.78, 2.98, 2.01, 1.35, -2.59)]
)
def test_a_rig_that_runs_away_in_a_manoeuvre_learns_nothing_by_it(
    off: tuple[float, ...], speed: float
) -> None:
    """Far from any soil variances of innovations were negative, and advice was no number."""
    point = MEAN.copy()
    point[SIX] += off
    for candidate in advice.CANDIDATES:
        found = advice.information(MACHINE, point, speed, candidate)
        assert np.isfinite(found).all() and np.diag(found).min() >= 0.0
