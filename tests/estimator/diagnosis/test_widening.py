"""What a machine file may still be wrong by makes the published numbers as much wider, or withholds them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from circle import demo_machine
from hypothesis import given
from hypothesis import strategies as st

from tilth.estimator.diagnosis import consistency, open_numbers
from tilth.estimator.diagnosis.consistency import CONSISTENCY, Consistency
from tilth.estimator.diagnosis.open_numbers import HYPOTHESES, NAMES, OPEN, OpenEvidence
from tilth.estimator.diagnosis.widening import WIDENING, OfSoil, Widening, widened, widening_of
from tilth.estimator.methods import rows
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Status
from tilth.schemas.reasons import Code, Combination, Reason
from tilth.schemas.sentences import sentence

N = len(NAMES)
MASS = len(HYPOTHESES) - 1  # the tractor's
OPEN_SD = np.array([row.open_sd for row in OPEN])
LOOKED_AT = [name for name in NAMES if name != "m_i"]


def evidence(
    slopes: dict[str, float], found: dict[str, float], alone: float, learned: int = 100,
    excluded: bool = False,
) -> OpenEvidence:  # fmt: skip
    """slopes: of all six logarithms, by number. found: what each is off by, in sds by which people are wrong;
    alone: how well it is known, in the same. excluded: no number is wrong but what slopes tell of."""
    unknown = np.array([name in slopes or not excluded for name in NAMES])
    sd, off, moves = np.where(unknown, alone, 0.01) * OPEN_SD, np.zeros(N), np.zeros((6, N + 1))
    for name, value in found.items():
        off[NAMES.index(name)] = value * OPEN_SD[NAMES.index(name)]
    for name, value in slopes.items():
        moves[:, NAMES.index(name)] = value
    of_mass, mass_sd = -off[NAMES.index("I_t")], sd[NAMES.index("I_t")]  # as if nothing else told of it
    misfit = open_numbers.Misfit(
        float(np.sum((off / sd) ** 2)), off, sd, np.append(off, of_mass), np.append(sd, mass_sd), moves
    )
    return OpenEvidence(misfit, misfit, learned, 0.0, False)


def estimate(sd: float = 0.1) -> Estimate:
    six = tuple(ParameterEstimate(100.0, 100.0 * sd, Status.ESTIMATED, None, 1.0) for _ in PARAMETERS)
    ratio = Combination((1.0, -1.0, 0.0, 0.0, 0.0, 0.0), sd)
    return Estimate(
        5, "pem", "relaxation", six, tuple((np.eye(6) * sd**2).ravel().tolist()), (1.0, 2.0, 3.0),
        per_mass_sd=(sd, 2.0 * sd, 3.0 * sd), determined=(ratio,),
    )  # fmt: skip


@given(
    st.lists(st.floats(-3, 3), min_size=N, max_size=N), st.lists(st.floats(-2, 2), min_size=N, max_size=N),
    st.floats(0.05, 1.0), st.floats(0.02, 0.5),
)  # fmt: skip
def test_a_number_is_never_narrower_and_its_sd_is_that_of_the_covariance(
    found: list[float], slopes: list[float], alone: float, own: float
) -> None:
    given_ = estimate(own)
    wide = widened(
        widening_of(
            evidence(dict(zip(NAMES, slopes, strict=True)), dict(zip(NAMES, found, strict=True)), alone)
        ),
        given_,
    )
    covariance = np.reshape(wide.log_covariance, (6, 6))
    assert np.linalg.eigvalsh(covariance - own**2 * np.eye(6)).min() > -1e-9
    for k, p in enumerate(wide.parameters):
        if p.value is None or p.sd is None:
            assert p.reason is not None and p.reason.code in (Code.DOUBTED, Code.NOT_EXCLUDED)
            continue
        assert p.sd / p.value == pytest.approx(math.sqrt(covariance[k, k]))
        assert p.sd / p.value <= max(WIDENING.widest, WIDENING.least * own) + 1e-9
    for p, one, one_sd in zip(wide.parameters[:3], wide.per_mass, wide.per_mass_sd, strict=True):
        assert (one is None) == (one_sd is None) == (p.value is None)
        if one is not None and one_sd is not None and p.value is not None and p.sd is not None:
            assert one_sd / one == pytest.approx(p.sd / p.value)


def test_a_stiffness_that_only_the_mass_leaves_open_is_still_known_over_the_mass() -> None:
    given_ = estimate(0.1)
    six = list(given_.parameters)
    six[2] = ParameterEstimate(None, None, Status.UNESTIMATED, Reason(Code.OF_THE_MASS), 1.0)
    wide = widened(widening_of(evidence({"I_i": 0.1}, {}, 0.5)), replace(given_, parameters=tuple(six)))
    assert wide.parameters[2].value is None and wide.per_mass[2] == 3.0
    assert wide.per_mass_sd[2] is not None and 0.3 < wide.per_mass_sd[2] < 0.6


@pytest.mark.parametrize("name", LOOKED_AT)
@pytest.mark.parametrize("alone", [0.1, 0.3, 0.6, 1.0, 3.0])
def test_an_error_as_large_as_people_make_stays_within_four_sds(name: str, alone: float) -> None:
    """Whatever driving has told of it by then: nothing, a little, or all."""
    slope = 0.6
    for size in (0.3, 0.6, 1.0):
        for luck in (0.0, 1.0):
            told = evidence({name: slope}, {name: size + luck * alone}, alone, excluded=True)
            added = math.sqrt(widening_of(told).covariance[2, 2])
            assert slope * size * OPEN_SD[NAMES.index(name)] < 4.0 * math.hypot(added, 0.03), (size, luck)


@given(
    st.lists(st.floats(-3, 3), min_size=N, max_size=N), st.floats(0.05, 3.0),
    st.sampled_from([0.1, 1.0, 10.0]),
)  # fmt: skip
def test_at_most_one_number_of_a_file_is_taken_for_wrong(
    found: list[float], alone: float, how_far: float
) -> None:
    """However many are found off: variances of all are at most that of the worst."""
    off = {name: how_far * value for name, value in zip(NAMES, found, strict=True)}
    variances = [float(widening_of(evidence({name: 1.0}, off, alone)).covariance[2, 2]) for name in LOOKED_AT]
    most = max((abs(off[name]) + alone) * OPEN_SD[NAMES.index(name)] for name in LOOKED_AT)
    assert sum(variances) <= most**2


@pytest.mark.parametrize("name", LOOKED_AT)
def test_what_driving_has_excluded_adds_nothing(name: str) -> None:
    before, after = (
        math.sqrt(widening_of(evidence({name: 1.0}, {}, alone)).covariance[2, 2]) for alone in (1.0, 0.1)
    )
    assert after < 0.2 * before and after < 0.02 * OPEN_SD[NAMES.index(name)] / 0.5 + 0.02


def test_an_axle_that_uneven_ground_may_have_moved_is_not_blamed_for_the_wheels_scale() -> None:
    """As rig 601 had it: more is found of the axle, as it is of right files on uneven ground."""
    found = {"a": 0.35 / NUMBER["a"].open_sd, "wheel_gain": 0.2 / NUMBER["wheel_gain"].open_sd}
    told = evidence({"wheel_gain": 1.0}, found, 0.1 / NUMBER["a"].open_sd)
    even, rough = (float(widening_of(replace(told, uneven=share)).covariance[2, 2]) for share in (0.0, 1.0))
    assert even < 0.03**2 and rough > 4.0 * even


@pytest.mark.parametrize(("off", "sure"), [(0.0, True), (0.4, False), (-0.8, False)])
def test_of_the_implement_s_axle_a_fit_of_windows_is_believed(off: float, sure: bool) -> None:
    """The second tracker alone knows it to 20 cm at best. Of another number the fit changes nothing."""
    tracked = evidence({"e": 3.0}, {"e": 0.2}, 0.5)
    fit = evidence({}, {"e": off / NUMBER["e"].open_sd, "a": 2.0}, 0.08 / NUMBER["e"].open_sd).misfit
    before, after = (math.sqrt(widening_of(tracked, fit=one).covariance[2, 2]) for one in (None, fit))
    assert before > 0.15 and (after < 0.1) == sure and after >= 0.8 * 3.0 * abs(off)
    others = evidence({"wheel_gain": 1.0}, {}, 0.5)
    fit = evidence({}, {"wheel_gain": 2.0}, 0.5).misfit
    assert np.allclose(widening_of(others, fit=fit).covariance, widening_of(others).covariance, rtol=1e-6)


def test_the_implement_s_mass_is_in_the_methods_covariances_already() -> None:
    assert not widening_of(evidence({"m_i": 1.0}, {"m_i": -3.0}, 1.0)).covariance[2, 2]


def test_another_inertia_of_the_tractor_may_be_its_mass() -> None:
    """What moves stiffnesses is their part of the motion over the mass: all three, the implement's as far as
    its own mass, which the file tells, does not hold it; no length."""
    machine, n = demo_machine(), 6 + N
    inertial = np.array([name in ("m_i", "I_t", "I_i") for name in NAMES])
    heavier = open_numbers.misfit_of(-0.3 * inertial, 1e-4 * np.eye(n), np.zeros((n, n)), machine)
    assert heavier.found[MASS] == pytest.approx(0.3) and heavier.by_name.max() < heavier.total
    chi_square = (heavier.found / heavier.alone) ** 2
    assert chi_square[MASS] == pytest.approx(heavier.total) and np.argmax(chi_square) == MASS
    np.testing.assert_allclose(heavier.moves[:, MASS], [1, 1, 1, 0, 0, 0])
    held = 1e-4 * np.eye(n)
    held[2, 6 + NAMES.index("m_i")] = held[6 + NAMES.index("m_i"), 2] = 1e-4  # C_ai is learned over m_i
    assert abs(open_numbers.misfit_of(-0.3 * inertial, held, np.zeros((n, n)), machine).moves[2, MASS]) < 1.0
    added = np.sqrt(np.diag(widening_of(OpenEvidence(heavier, heavier, 100, 0.0, False)).covariance))
    assert added[0] > 0.05 and not added[3:].any()


@pytest.mark.parametrize(
    ("slope", "found", "own", "code"),
    [
        (0.3, 0.0, 0.1, None),
        (2.0, 0.0, 0.1, Code.WIDENED),
        (10.0, 0.0, 0.1, Code.NOT_EXCLUDED),
        (3.0, 2.5, 0.1, Code.DOUBTED),
        (10.0, 0.0, 0.35, Code.NOT_EXCLUDED),
    ],
)
def test_the_reason_says_which_number_and_what_to_do(
    slope: float, found: float, own: float, code: Code | None
) -> None:
    wide = widened(widening_of(evidence({"e": slope}, {"e": found}, 0.4)), estimate(own))
    one = wide.parameters[2]
    assert (None if one.reason is None else one.reason.code) == code
    assert (one.value is None) == (code in (Code.NOT_EXCLUDED, Code.DOUBTED))
    if code is not None:
        assert NUMBER["e"].key in sentence(one.reason)
    if code is Code.NOT_EXCLUDED and one.reason is not None:
        assert "steer to and fro by 3° or more" in sentence(one.reason)
        assert WIDENING.shortest_s <= one.reason.numbers[1] <= WIDENING.longest_s


@pytest.mark.parametrize(
    ("slope", "first", "again"), [(4.5, True, True), (7.0, False, True), (9.5, False, False)]
)
def test_a_number_that_was_given_is_withdrawn_later_than_a_new_one_is_given(
    slope: float, first: bool, again: bool
) -> None:
    file = widening_of(evidence({"e": slope}, {}, 0.4))
    for had, expected in ((False, first), (True, again)):
        given_ = widened(file, estimate(0.1), [had] * 6).parameters[2]
        assert (given_.value is not None) == expected


def test_where_no_error_alone_explains_what_is_found_it_counts_for_less() -> None:
    """Then the model is wrong: the file is less likely to be, and a method's own sd knows of it."""
    alone, doubt = {"e": 1.2}, dict.fromkeys(LOOKED_AT, 1.2)
    of_one, of_all = (
        math.sqrt(widening_of(evidence({"e": 1.0}, off, 0.3)).covariance[2, 2]) for off in (alone, doubt)
    )
    assert of_all < 0.5 * of_one
    same = widened(widening_of(evidence({}, doubt, 0.3)), estimate(0.1))
    assert same == estimate(0.1)


def test_a_combination_that_the_error_does_not_move_stays_as_sharp() -> None:
    """An error that moves both stiffnesses alike leaves their ratio."""
    wide = widened(widening_of(evidence({"e": 3.0}, {"e": 3.0}, 0.5)), estimate(0.1))
    assert all(p.value is None for p in wide.parameters)
    (ratio,) = wide.determined
    assert ratio.log_sd < 0.17


def test_nothing_is_changed_where_nothing_is_known_of_the_file() -> None:
    given_ = estimate()
    assert widened(Widening(), given_) is given_
    bare = replace(given_, log_covariance=())
    assert widened(widening_of(evidence({"e": 3.0}, {}, 1.0)), bare) is bare


def test_a_right_file_that_driving_doubts_is_not_silent() -> None:
    """As behind a stranger's cart of 8 t: its inertia came out at a third, by what the model leaves out."""
    machine, state = demo_machine(), Consistency()
    state.rates_known = True
    off = {"I_i": math.log(0.35) / NUMBER["I_i"].open_sd}
    doubt = evidence({"I_i": 0.5}, off, 0.9, learned=300)
    for _ in range(600):  # poses, 2 min
        consistency._update(state, {}, doubt, 0)
    loads = estimate(0.09)
    said = consistency.withheld(state, loads)
    assert all(p.status is Status.ESTIMATED for p in said.parameters), machine
    stiffness = said.parameters[2]
    assert stiffness.sd is not None and stiffness.value is not None
    assert 0.15 < stiffness.sd / stiffness.value <= WIDENING.widest
    assert "implement.yaw_inertia" in sentence(stiffness.reason)


def test_before_the_open_tracker_has_learned_the_reason_says_how_long_to_steer() -> None:
    state = Consistency()
    state.rates_known = True
    for learned, seconds in ((0, 8), (30, 2)):
        consistency._update(state, {}, evidence({}, {}, 1.0, learned), 0)
        said = consistency.withheld(state, estimate())
        assert all(p.value is None for p in said.parameters)
        assert sentence(said.parameters[0].reason).endswith(f"at working speed for {seconds} s")
    consistency._update(state, {}, evidence({}, {}, 0.1, CONSISTENCY.least_segments), 0)
    assert consistency.withheld(state, estimate()).parameters[0].value is not None


def test_what_was_known_holds_until_a_restarted_open_tracker_has_learned_again() -> None:
    state = Consistency()
    state.rates_known = state.open_restarted = True
    state.judged, state.widening = True, widening_of(evidence({"e": 1.0}, {"e": 1.0}, 0.5))
    before = state.widening.covariance
    consistency._update(state, {}, evidence({}, {}, 0.5, CONSISTENCY.least_segments), 0)
    assert state.widening.covariance is before and state.judged
    consistency._update(state, {}, evidence({}, {}, 0.5, CONSISTENCY.least_after_restart), 0)
    assert state.widening.covariance is not before


@pytest.mark.parametrize(
    ("own", "soil", "code"),
    [(0.1, 0.05, None), (0.1, 0.2, Code.OTHER_SOIL), (0.1, 0.5, Code.NOT_KNOWN_HERE), (0.4, 0.0, None)],
)
def test_soil_that_may_be_otherwise_here_widens(own: float, soil: float, code: Code | None) -> None:
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = soil**2
    said, one = estimate(own), widened(OfSoil(covariance), estimate(own))
    for before, after in zip(said.parameters[:3], one.parameters[:3], strict=True):
        assert after.value == (None if code is Code.NOT_KNOWN_HERE else before.value)
        assert (after.reason.code if after.reason else None) is code
        if after.sd is not None and after.value is not None:
            assert after.sd / after.value == pytest.approx(math.hypot(own, soil))
    assert one.parameters[3:] == said.parameters[3:]
    logs = np.reshape(one.log_covariance, (6, 6)) - np.reshape(said.log_covariance, (6, 6))
    assert logs == pytest.approx(covariance)


def test_what_a_fit_tells_of_the_file_is_itself_again_as_it_is_read_back() -> None:
    """A fit is used as it is read back from its text: a tuple with names came back as a list, and the
    estimators stopped with the first fit of rows that told of the file."""
    told = evidence({"e": 1.0}, {"e": 1.0}, 0.5).misfit
    six, n = np.zeros(6), np.eye(6)
    made = rows.Fit(six, n, 0.9, 0.01, 120.0, 5, 1.0, False, False, None, None, told)
    again = from_json_data(rows.Fit, json.loads(json.dumps(to_json_data(made))))
    found = rows.tells_of_file(again)
    assert found is not None and found[1] == 120.0
    assert found[0].by_name == pytest.approx(told.by_name)
