"""How far a calibration drive is does not depend on order, interruption or portions, nor on a wrong file."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from calibration_shown import take_all
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic_drive import MACHINE, Plan, measurements

from tilth.estimator.calibration import stage_words, stages
from tilth.estimator.calibration.changes import Changes, heard_after
from tilth.estimator.calibration.stages import StageFold, StageTally
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.schemas.flow import Fix, FixType, Measurement, Mount, WheelAngle

pytestmark = pytest.mark.long


PARK: Plan = ((24, 0.0, 0),)
STRAIGHT: Plan = ((60, 3.0, 0), (13.7, 1.8, 20.3), (60, 3.0, 0))
CIRCLES: Plan = tuple(
    (s, 1.4, side * angle) for angle, s in ((10, 84), (18, 48), (28, 32)) for side in (1, -1)
)
FOLDS: Plan = tuple((7, 1.8, side * 26) for _ in range(5) for side in (1, -1))
WEAVING: Plan = tuple((3, pace, side * 6) for pace in (2.3, 4.5) for _ in range(10) for side in (1, -1))
BY_NAME = {"park": PARK, "straight": STRAIGHT, "circles": CIRCLES, "fold": FOLDS, "weave": WEAVING}
NAMES = tuple(BY_NAME)
APART_TICKS = 50  # between two stages: more than a gap


@pytest.fixture(scope="module")
def parts() -> dict[str, list[Measurement]]:
    """Each stage alone, its times from 0 on."""
    found = {}
    for name, plan in BY_NAME.items():
        made = measurements(plan)
        found[name] = [_later(one, -(made[0].rx_ns // ALIGNMENT.pose_ns) * ALIGNMENT.pose_ns) for one in made]
    return found


def _later(one: Measurement, by_ns: int) -> Measurement:
    return replace(one, t_ns=one.t_ns + by_ns, rx_ns=one.rx_ns + by_ns)


def _one_after_the_other(parts: Sequence[Sequence[Measurement]]) -> list[Measurement]:
    found: list[Measurement] = []
    begin = 1000
    for part in parts:
        found += [_later(one, begin * ALIGNMENT.pose_ns) for one in part]
        begin = found[-1].rx_ns // ALIGNMENT.pose_ns + APART_TICKS
    return found


def _driven(made: Sequence[Measurement]) -> StageFold:
    return take_all(stages.initial(MACHINE), made)


def _same(one: StageTally, other: StageTally) -> None:
    assert (one.parked, one.swings, one.weaved, one.moving) == (
        other.parked, other.swings, other.weaved, other.moving,
    )  # fmt: skip
    np.testing.assert_allclose(one.straight, other.straight, atol=1e-6)
    np.testing.assert_allclose(one.rounds, other.rounds, atol=1e-9)


def test_each_stage_is_complete_by_what_it_asks_for_and_by_nothing_else(
    parts: dict[str, list[Measurement]],
) -> None:
    for name in NAMES:
        far = stage_words.progress(_driven(parts[name]))
        assert name in {one.stage.name for one in far if one.complete}, [one.far.done for one in far]
        others = {one.stage.name for one in far if one.complete and one.stage.name != name}
        # Circles one after the other fold the implement from side to side as well.
        assert others <= ({"fold"} if name == "circles" else set()), (name, others)


@settings(max_examples=4, deadline=None)
@given(order=st.permutations(NAMES))
def test_any_order_gives_the_same(order: list[str], parts: dict[str, list[Measurement]]) -> None:
    straight_through = _driven(_one_after_the_other([parts[name] for name in NAMES]))
    other = _driven(_one_after_the_other([parts[name] for name in order]))
    _same(straight_through.tally, other.tally)
    assert all(one.complete for one in stage_words.progress(other))
    assert stage_words.next_step(other, stage_words.progress(other)) == ""


@settings(max_examples=12, deadline=None)
@given(shares=st.lists(st.floats(0.0, 1.0), max_size=6))
def test_portions_give_the_same(shares: list[float], parts: dict[str, list[Measurement]]) -> None:
    made = _one_after_the_other([parts["fold"], parts["straight"]])
    cuts = [0, *sorted(round(share * len(made)) for share in shares), len(made)]
    state = stages.initial(MACHINE)
    for first, last in pairwise(cuts):
        take_all(state, made[first:last])
    assert repr(state) == repr(_driven(made))


@settings(max_examples=12, deadline=None)
@given(cut_s=st.floats(5.0, 125.0))
def test_an_interruption_costs_only_what_was_under_way(
    cut_s: float, parts: dict[str, list[Measurement]]
) -> None:
    """Two logs with hours between them: what was driven counts, but for the seconds that a course needs."""
    made = parts["straight"]
    cut = next(k for k, one in enumerate(made) if one.rx_ns > cut_s * 1e9)
    hours = 3 * 3600 * 5 * ALIGNMENT.pose_ns
    interrupted = _driven([*made[:cut], *(_later(one, hours) for one in made[cut:])]).tally
    whole = _driven(made).tally
    assert whole.moving - 10 <= interrupted.moving <= whole.moving
    assert whole.straight.sum() - 4.0 * 3.0 <= interrupted.straight.sum() <= whole.straight.sum() + 1e-6


@pytest.mark.parametrize(
    "bad",
    [
        Changes(assignment=(1, 0, 2, 3)),
        Changes(assignment=(1, 0, 3, 2)),
        Changes(assignment=(2, 3, 0, 1)),
        Changes(wheel_sign=-1, wheel_gain=3.0),
        Changes(pair=np.radians([3.0, -3.0]), delay=np.array([0.1, 0.0, 0.05, 0.15])),
    ],
)
def test_a_wrong_file_spoils_no_stage(bad: Changes, parts: dict[str, list[Measurement]]) -> None:
    made = _one_after_the_other([parts[name] for name in NAMES])
    far = stage_words.progress(_driven([heard_after(one, bad) for one in made]))
    assert [one.stage.name for one in far if not one.complete] == []


def test_what_is_missing_is_asked_for_step_by_step(parts: dict[str, list[Measurement]]) -> None:
    """What is being driven first, then the order of the table."""

    def said(state: StageFold) -> str:
        return stage_words.next_step(state, stage_words.progress(state))

    state = stages.initial(MACHINE)
    assert said(state).startswith("Stand still for 20 s more")
    assert stage_words.happening(state) == "Nothing has been measured yet."
    made = parts["straight"]
    take_all(state, [one for one in made if one.rx_ns < 30e9])
    assert said(state).startswith("Drive straight, ")
    assert stage_words.happening(state) == "This counts for: Straight there and back."
    take_all(state, [one for one in made if 30e9 <= one.rx_ns < 63e9])
    assert said(state).startswith("Turn round and drive back on the same line, 150 m more")
    circles = [_later(one, 2000 * ALIGNMENT.pose_ns) for one in parts["circles"] if one.rx_ns < 30e9]
    take_all(state, circles)
    assert said(state) == "Hold the wheels a little (about 10°) to the left and drive one round, at 5 km/h."


def _without_rtk(one: Measurement) -> Measurement:
    if isinstance(one, Fix) and one.origin.mount is Mount.IMPLEMENT_REAR:
        return replace(one, fix=FixType.RTK_FLOAT)
    return one


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        (_without_rtk, "does not count; without RTK fix: implement rear. Check the correction service"),
        (
            lambda one: None if isinstance(one, WheelAngle) else one,
            "[wheel_angle] of the machine file fits no",
        ),
        (
            lambda one: None if one.origin.mount is Mount.TRACTOR_FRONT else one,
            "does not count; not heard: tractor front. Check power and plugs",
        ),
    ],
)
def test_what_does_not_count_is_said(kept, words: str, parts: dict[str, list[Measurement]]) -> None:  # type: ignore[no-untyped-def]
    state = _driven([found for one in parts["straight"] if (found := kept(one)) is not None])
    assert words in stage_words.happening(state)
    assert state.tally.moving == 0 and not state.tally.straight.any()
    assert all(one.far.share == 0.0 for one in stage_words.progress(state))


def test_who_stands_for_long_is_told_to_drive() -> None:
    state = _driven(measurements(((100, 0.0, 0),)))
    assert stage_words.happening(state).startswith("Standing for 9") and math.isclose(
        stage_words.progress(state)[0].far.share, 1.0
    )
