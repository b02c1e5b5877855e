"""Which estimate is recommended: a table of cases, and what must never be."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from tilth.estimator.results.recommend import (
    PATCHY,
    RECOMMENDATION,
    RECOMMENDED,
    SINCE_CHANGE,
    beside_better,
    disagreement,
    recommend,
)
from tilth.schemas.flow import Estimate, ParameterEstimate, Status
from tilth.schemas.reasons import Code, Reason, text_reason
from tilth.schemas.sentences import sentence
from tilth.schemas.sentences.reasons import ENGLISH, METHODS

SIX = (220e3, 430e3, 100e3, 1.3, 1.6, 1.0)
E, S, U, I = Status.ESTIMATED, Status.STALE, Status.UNESTIMATED, Status.INVALID  # noqa: E741


def estimate(
    method: str,
    statuses: Status | tuple[Status, ...] = E,
    *,
    age: float = 10.0,
    sd: float = 0.05,
    off: float = 0.0,
    change: float | None = None,
) -> Estimate:
    """off: of each logarithm. change: s since the soil changed."""
    six = (statuses,) * 6 if isinstance(statuses, Status) else statuses
    parameters = tuple(
        ParameterEstimate(None, None, s, text_reason("why"), None)
        if s is U
        else ParameterEstimate(v * math.exp(off), v * sd, s, None, age)
        for v, s in zip(SIX, six, strict=True)
    )
    covariance = tuple((np.eye(6) * sd**2).ravel().tolist())
    text = {} if change is None else {SINCE_CHANGE: change}
    return Estimate(5, method, "m", parameters, covariance, (), excitation=text)


THREE = (E, E, E, U, U, U)
CASES: tuple[tuple[str, tuple[Estimate, ...], str, str], ...] = (
    ("pem first", (estimate("steady_state", THREE), estimate("tracker"), estimate("pem")), "pem", "first of"),
    ("none", (estimate("steady_state", U), estimate("pem", U)), "pem", "no method gives"),
    (
        "pem has nothing yet",
        (estimate("steady_state", THREE), estimate("pem", U)),
        "steady_state",
        "first of",
    ),
    (
        "rows know more",
        (estimate("rows", sd=0.04), estimate("pem")),
        "rows",
        "±7.8 % (95 %) on average, pem to ±10",
    ),
    ("rows know less", (estimate("rows", sd=0.06), estimate("pem")), "pem", "first of"),
    ("rows have fewer", (estimate("rows", THREE, sd=0.01), estimate("pem")), "pem", "first of"),
    ("rows have more", (estimate("rows", sd=0.06), estimate("steady_state", THREE)), "rows", "in turns"),
    (
        "rows alone",
        (estimate("rows", sd=0.2), estimate("pem", U), estimate("tracker", U)),
        "rows",
        "in turns",
    ),
    ("new rows before stale", (estimate("rows", sd=0.2), estimate("pem", S)), "rows", "in turns"),
    ("stale rows", (estimate("rows", S, sd=0.01), estimate("pem")), "pem", "first of"),
    (
        "rows beside the one that is best in turns",
        (estimate("rows", sd=0.04), estimate("pem", age=121.0, sd=0.01), estimate("tracker")),
        "rows",
        "tracker to ±10",
    ),
    (
        "changed since the rows",
        (estimate("rows", sd=0.01), estimate("tracker", change=5.0), estimate("pem", age=4.0)),
        "pem",
        "first of",
    ),
    (
        "soil in patches",
        (replace(estimate("place", sd=0.2), excitation={PATCHY: 0.99}), estimate("pem")),
        "place",
        "differs from place to place",
    ),
    (
        "one soil",
        (replace(estimate("place", sd=0.2), excitation={PATCHY: 0.5}), estimate("pem")),
        "pem",
        "first of",
    ),
    ("pem is old", (estimate("tracker"), estimate("pem", age=121.0)), "tracker", "is 121 s old"),
    ("pem has no window yet", (estimate("tracker"), estimate("pem", U)), "tracker", "not been driven yet"),
    ("pem is old, alone", (estimate("steady_state", U), estimate("pem", age=121.0)), "pem", "first of"),
    ("stale before none", (estimate("steady_state", U), estimate("pem", S, age=400.0)), "pem", "though old"),
    ("new before stale", (estimate("steady_state", THREE), estimate("pem", S)), "steady_state", "first of"),
    ("changed since", (estimate("tracker", change=5.0), estimate("pem", age=10.0)), "tracker", "5 s ago"),
    (
        "changed since, nothing learned of it yet",
        (estimate("steady_state", THREE), estimate("tracker", U, change=5.0), estimate("pem", age=10.0)),
        "steady_state",
        "first of",
    ),
    (
        "changed since, no other number",
        (estimate("tracker", U, change=5.0), estimate("pem", age=10.0)),
        "tracker",
        "no method gives",
    ),
    ("changed before", (estimate("tracker", change=50.0), estimate("pem", age=10.0)), "pem", "first of"),
    ("invalid", (estimate("steady_state", I), estimate("pem", I)), "pem", "no method gives"),
    ("not one of the offered", (estimate("pem_two_step"), estimate("pem", U)), "pem", "no method gives"),
)


def by_method(*estimates: Estimate) -> Mapping[str, Estimate]:
    return {e.method: e for e in estimates}


def said(rule: str) -> str:
    """With what people hear of the methods."""
    for name, words in METHODS[ENGLISH].items():
        rule = rule if name == "place" else re.sub(rf"\b{name}\b", words, rule)
    return rule


@pytest.mark.parametrize(("case", "given", "chosen", "rule"), CASES, ids=[c[0] for c in CASES])
def test_the_rule(case: str, given: tuple[Estimate, ...], chosen: str, rule: str) -> None:
    for order in (given, given[::-1]):
        best = recommend(by_method(*order), 7)
        expected = next(e for e in given if e.method == chosen)
        assert best.log_covariance == expected.log_covariance
        assert [p.status for p in best.parameters] == [p.status for p in expected.parameters]
        assert said(rule) in sentence(best.rule)
        assert METHODS[ENGLISH][chosen] in sentence(best.rule) or best.rule == Reason(Code.NO_METHOD)
        assert (best.method, best.t_ns) == (RECOMMENDED, 7)


def test_of_a_place_the_rig_is_what_pem_knows_of_it() -> None:
    of_place = replace(estimate("place"), excitation={PATCHY: 0.99})
    best = recommend(
        by_method(of_place, replace(estimate("pem"), nuisances={"wheel_zero": (0.01, 0.001)})), 7
    )
    assert best.rule is not None and best.rule.code is Code.IN_PATCHES
    assert best.nuisances == {"wheel_zero": (0.01, 0.001)}


def test_the_last_recommendation_is_not_one_of_the_methods() -> None:
    given = by_method(estimate("steady_state", U), estimate(RECOMMENDED))
    assert recommend(given, 7).rule == Reason(Code.NO_METHOD)


def test_an_invalid_number_is_not_passed_on() -> None:
    best = recommend(by_method(estimate("pem", (E, E, E, E, E, I))), 7)
    assert [p.value is None for p in best.parameters] == [False] * 5 + [True]


@pytest.mark.parametrize("bad", [math.nan, math.inf, 0.0, -1.0])
def test_what_is_no_number_is_not_recommended(bad: float) -> None:
    pem = estimate("pem")
    first = replace(pem.parameters[0], value=bad)
    spoilt = replace(pem, parameters=(first, *pem.parameters[1:]))
    best = recommend(by_method(spoilt, estimate("steady_state", THREE)), 7)
    assert sentence(best.rule).startswith(METHODS[ENGLISH]["steady_state"])
    unsure = replace(pem, log_covariance=(math.nan,) * 36)
    assert METHODS[ENGLISH]["steady_state"] in sentence(
        recommend(by_method(unsure, estimate("steady_state", THREE)), 7).rule
    )


def apart(squared: float, count: int, sd: float = 0.05) -> float:
    """Difference of each of `count` logarithms that gives a squared distance between two of that sd."""
    return math.sqrt(squared * 2.0 * sd**2 / count)


def test_a_disagreement_begins_late_and_ends_later() -> None:
    pem = estimate("pem")
    for share, before, found in (
        (0.99 * RECOMMENDATION.disagree_above[3], False, False),
        (1.01 * RECOMMENDATION.disagree_above[3], False, True),
        (0.99 * RECOMMENDATION.disagree_above[3], True, True),
        (1.01 * RECOMMENDATION.agree_below[3], True, True),
        (0.99 * RECOMMENDATION.agree_below[3], True, False),
    ):
        steady = estimate("steady_state", THREE, off=apart(share, 3))
        reason = disagreement(by_method(pem, steady), before)
        assert (reason is not None) == found
        text = sentence(reason)
        assert not found or (said("pem and steady_state") in text and "for 3 parameters" in text)


@pytest.mark.parametrize("sd", [0.02, 0.2, 0.3])
@pytest.mark.parametrize("knows_more", ["pem", "tracker"])
def test_where_methods_disagree_the_one_that_uses_more_of_the_drive_is_recommended(
    sd: float, knows_more: str
) -> None:
    """However much the other one claims: steady_state never stands against a method with numbers."""
    more, steady = estimate(knows_more), estimate("steady_state", THREE, sd=sd, off=2.0)
    assert disagreement(by_method(more, steady), False)
    best = recommend(by_method(more, steady), 7, disagree=True)
    assert best.parameters == more.parameters and best.rule is not None
    assert best.rule == Reason(Code.KNOWS_MORE, (knows_more, "steady_state"))
    assert sentence(best.rule).startswith(
        f"{METHODS[ENGLISH][knows_more]}: it uses more of the drive than steady turns"
    )


def test_rows_that_know_more_stay_while_others_disagree() -> None:
    pem, steady = estimate("pem"), estimate("steady_state", THREE, off=2.0)
    best = recommend(by_method(estimate("rows", sd=0.04), pem, steady), 7, disagree=True)
    assert best.rule is not None and best.rule.code is Code.ROWS_KNOW_MORE


def test_only_what_is_estimated_now_can_disagree() -> None:
    far = estimate("steady_state", (S, S, S, U, U, U), off=3.0)
    assert disagreement(by_method(estimate("pem"), far), False) is None
    assert disagreement(by_method(estimate("pem"), estimate("pem_two_step", off=3.0)), False) is None


def test_covariances_that_cannot_be_compared_are_no_agreement() -> None:
    none = replace(estimate("steady_state", THREE), log_covariance=(0.0,) * 36)
    assert disagreement(by_method(replace(estimate("pem"), log_covariance=(0.0,) * 36), none), False)


def test_leans_and_slope_are_those_of_the_tracker_whichever_method_is_recommended() -> None:
    leaning = replace(estimate("tracker"), excitation={"lean_tractor_deg": 0.6, "rows": 4.0})
    result = recommend({"tracker": leaning, "pem": estimate("pem")}, 9)
    assert sentence(result.rule).startswith(METHODS[ENGLISH]["pem"]) and result.excitation == {
        "lean_tractor_deg": 0.6
    }


@pytest.mark.parametrize(
    ("others", "kept"),
    [
        ((estimate("pem"),), True),
        ((estimate("pem", off=0.6),), False),
        ((estimate("pem", U), estimate("tracker", off=-0.6)), False),
        ((estimate("pem", S, off=0.6), estimate("tracker")), True),  # of before
        ((estimate("pem", off=0.6, age=130.0), estimate("tracker", change=50.0)), True),
        ((estimate("place", off=0.6), estimate("rows", off=0.6)), True),  # they may rightly differ
    ],
)
def test_steady_state_has_no_number_where_one_that_knows_more_disagrees(
    others: tuple[Estimate, ...], kept: bool
) -> None:
    own = estimate("steady_state", THREE, sd=0.15)
    shown = beside_better(own, {one.method: one for one in (*others, own)})
    assert (shown == own) == kept
    if not kept:
        assert all(one.value is None and one.status is not E for one in shown.parameters)
        assert [one.status for one in shown.parameters] == [I, I, I, U, U, U]
        assert "steady turns disagree" in sentence(shown.parameters[0].reason)
    for other in others:
        assert beside_better(other, {one.method: one for one in (*others, own)}) == other


@pytest.mark.parametrize(
    ("others", "sd"),
    [
        ((), 0.15),
        ((estimate("pem", sd=0.05),), 0.15),
        ((estimate("pem", sd=0.25),), 0.25),
        ((estimate("pem", sd=0.25), estimate("tracker", sd=0.2)), 0.2),
        ((estimate("pem", U, sd=0.5),), 0.15),  # which has learned nothing
        ((estimate("pem", sd=0.5),), None),
    ],
)
def test_steady_state_is_no_surer_than_methods_that_know_more(
    others: tuple[Estimate, ...], sd: float | None
) -> None:
    own = estimate("steady_state", THREE, sd=0.15)
    shown = beside_better(own, {one.method: one for one in (*others, own)})
    for before, now in zip(own.parameters[:3], shown.parameters[:3], strict=True):
        assert before.value is not None
        if sd is None:
            assert now.value is None and now.reason is not None and now.reason.code == Code.WIDE
        else:
            assert now.value == before.value and now.sd == pytest.approx(sd * before.value)


def test_what_is_recommended_is_no_surer_either() -> None:
    """Where pem has used the drive and has no number of it, steady_state is not the way round that."""
    wide, own = estimate("pem", U, sd=0.5), estimate("steady_state", THREE, sd=0.15)
    rows = tuple(replace(one, age_s=5.0) for one in wide.parameters)
    both = {"pem": replace(wide, parameters=rows), "steady_state": own}
    result = recommend({method: beside_better(one, both) for method, one in both.items()}, 9)
    assert all(one.value is None for one in result.parameters)
