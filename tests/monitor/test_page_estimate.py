"""What the page says in a driver's words, from sentences of the estimator and any number there can be."""

import json
import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from circle import demo_machine
from stage import estimate

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import NAMES, SIX
from tilth.estimator.results import advice
from tilth.monitor.json_safe import plain
from tilth.monitor.page_estimate import advised, page_estimate, priors
from tilth.schemas import spread
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import PARAMETERS, SoilPlace
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind
from tilth.schemas.sentences import advice_sentence

Fields = dict[str, Any]
MACHINE = demo_machine()
MEAN, SD = unknowns.prior(MACHINE)
SPEED = 4.5
DRIVEN = {
    "turn": "turn at the headland with the wheels at 25° or more",
    "step": "hold a turn for 10 s, wheels to about {:g}°",
    "steps": "turn to one side and the other, three seconds each, for 10 s, wheels to about {:g}°",
    "chirp": "weave the steering gently left and right, slow then quick, for 10 s, wheels to about {:g}°",
}
TELLING = np.zeros((len(NAMES), len(NAMES)))  # information of a drive that tells much of all six
TELLING[SIX, SIX] = np.eye(6) * 1e3


def received(scale: float = 1.0, since_s: float = 300.0, invalid: str = "") -> Fields:
    """An estimate as the page's server hears it."""
    payload = CHANNEL["/soil_tire"].encode(estimate(10**18, since_s, scale, since_s, invalid))
    return plain(pb.SoilTireEstimate.FromString(payload))


RIG = plain(pb.Rig.FromString(CHANNEL["/rig"].encode(MACHINE)))


def test_what_a_number_of_a_place_rests_on_is_a_bar_and_words() -> None:
    assert page_estimate(received(), RIG)["place"] is None
    of_place = SoilPlace(43.5, -83.4, 30.0, 0.4, 0.35, 0.25)
    payload = CHANNEL["/soil_tire"].encode(
        replace(estimate(10**18, 300.0, 1.0, 300.0, ""), of_place=of_place)
    )
    shown = page_estimate(plain(pb.SoilTireEstimate.FromString(payload)), RIG)["place"]
    assert shown["shares"] == [0.4, 0.35, 0.25]
    assert shown["words"] == (
        "Of this place: 40 % by this pass, 35 % by passes before, 25 % by the machine file. "
        "Soil is alike over 30 m."
    )


@pytest.mark.parametrize("candidate", advice.CANDIDATES, ids=str)
def test_every_manoeuvre_that_is_ever_advised_is_told_to_a_driver(candidate: advice.Candidate) -> None:
    covariance = np.diag(SD**2)
    covariance[SIX, SIX] = np.diag([0.01, 0.01, 0.01, 0.01, SD[SIX][4], 0.01]) ** 2
    found = advice.advise(MACHINE, MEAN, covariance, SPEED, {candidate: TELLING})
    text = advice_sentence(found)  # the engineer's
    assert f"{candidate.degrees:g}°" in text and "sigma_r is not determined" in text
    assert advised(asdict(found)) == (
        f"Where there is room, {DRIVEN[candidate.manoeuvre].format(candidate.degrees)}: "
        "it would tell more of the rear tyres."
    )


def test_what_else_is_advised_is_told_as_well() -> None:
    table = {advice.CANDIDATES[0]: TELLING}
    known = np.diag(SD**2)
    known[SIX, SIX] = np.eye(6) * 0.001**2
    for covariance, speed, part in (
        (np.diag(SD**2), 0.5, "Drive faster than 5.4 km/h"),
        (np.diag(SD**2), 12.0, "no gentle steering"),
        (known, SPEED, "no steering at this speed would tell much more"),
        (np.diag(SD**2), SPEED, "tell more of the front, rear and implement tyres."),
    ):
        found = advice.advise(MACHINE, MEAN, covariance, speed, table if speed < 12.0 else {})
        assert part in advised(asdict(found))


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (AdviceKind.NOTHING_HELPS, "Drive on: the next headland turn tells"),
        (AdviceKind.MANOEUVRE, "tyres. The next headland turn tells"),
    ],
)
def test_the_next_headland_turn_is_told_to_a_driver(kind: AdviceKind, told: str) -> None:
    chirp = Advice(kind, ("C_ai",), (0.3,), manoeuvre="chirp", seconds=10.0, degrees=5.0, after=(0.05,))
    with_turn = replace(chirp, turn_tells="sigma_r", turn_after=0.06)
    assert f"{told} more of the rear tyres" in advised(asdict(with_turn))
    assert "next headland turn" not in advised(asdict(chirp))


@pytest.mark.parametrize(
    "sent", [None, {"kind": ""}, {"kind": "later"}, {"kind": "manoeuvre", "manoeuvre": "x"}]
)
def test_what_is_no_advice_is_none(sent: Fields | None) -> None:
    assert advised(sent) == ""


def test_what_is_shown_is_95_percent_and_what_came_keeps_its_sd() -> None:
    came = received()
    before = json.dumps(came)
    page = page_estimate(came, RIG)
    sd = [math.sqrt(variance) for variance in came["log_covariance"][::7]]
    for name, within, ours in zip(PARAMETERS, page["within"], sd, strict=True):
        assert within == (None if name == "sigma_r" else pytest.approx(spread.WITHIN * ours, rel=1e-4))
    assert came["bound"][2] == pytest.approx(0.09) and page["known"][2] == "±18 %"
    assert came["bound"][4] is None and page["known"][4] is None
    assert json.dumps(came) == before
    sds = [prior["log_sd"] for prior in RIG["priors"]]
    assert [prior["within"] for prior in priors(RIG)["priors"]] == pytest.approx(
        [1.96 * sd for sd in sds], rel=1e-4
    )


def test_soft_soil_and_a_contradiction_in_words() -> None:
    assert [one["word"] for one in page_estimate(received(0.6), RIG)["ground"]] == ["soft"] * 3
    assert [one["word"] for one in page_estimate(received(), RIG)["ground"]] == ["as usual"] * 3
    why = "the wheel angle has the opposite sign of the yaw rate: wheel_angle.sign?"
    page = page_estimate(received(invalid=why), RIG)
    assert page["withdrawn"] == [f"Numbers withdrawn: {why}"]
    assert {one["word"] for one in page["ground"]} == {"withdrawn"}
    assert page["advised"] == "" and page["value"] == [None] * 6


def test_some_numbers_withdrawn_are_named_and_an_invalid_value_is_not_shown() -> None:
    came = received()
    came["parameters"][1] |= {"status": 3, "reason": "why"}
    came["parameters"][2] |= {"status": 7, "reason": ""}
    page = page_estimate(came, RIG)
    assert page["withdrawn"] == [
        "Numbers withdrawn (C_ar): why",
        "Numbers withdrawn (C_ai): the daemon gives no reason",
    ]
    assert page["value"][1] is None and page["value"][2] is None and page["value"][0] is not None


@pytest.mark.parametrize("value", [0.0, -1.0, 5e-324, 1e308, None])
@pytest.mark.parametrize("variance", [0.0, 1e300, -1.0, None])
def test_numbers_that_no_rig_has_break_nothing(value: float | None, variance: float | None) -> None:
    came = received()
    came["log_covariance"] = [variance] * 36
    for one in came["parameters"]:
        one |= {"value": value, "sd": 1e300, "status": 1, "reason": "±" + "9" * 400 + " %"}
    came["bound"] = [1e300, None, -1.0]
    json.dumps(page_estimate(came, RIG), allow_nan=False)
