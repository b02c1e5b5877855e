"""Which channels are meant, and how old their values may be on a clock."""

import pytest

from tilth.analysis.export.naming import AGES_S, CAN, NAMES, TOPICS, UnknownChannel, age_s, choose
from tilth.schemas.channels import CHANNEL

ROWS: list[tuple[list[str], list[str]]] = [
    (["pose"], ["pose"]),
    (["/soil_tire/pem", "pose"], ["pose", "soil_tire_pem"]),
    (["gnss_*_rear", "can"], ["gnss_tractor_rear", "gnss_implement_rear", "can"]),
    (["pose", "pose", "po*"], ["pose"]),
]
WRONG: list[tuple[list[str], bool, str]] = [
    (["poses"], False, "poses: no such channel; pose?"),
    (["wheel_angle"], False, "; measurement_wheel_angle?"),
    (["xyzzy"], False, "xyzzy: no such channel; there are measurement_position, "),
    (["drawing_*"], False, "no such channel"),
    (["event"], True, "event has no values that hold for a while, as a common clock needs"),
    (["pose", ""], False, "no such channel"),
]


@pytest.mark.parametrize(("wanted", "chosen"), ROWS, ids=str)
def test_names_topics_and_patterns(wanted: list[str], chosen: list[str]) -> None:
    assert list(choose(wanted)) == chosen


def test_all_where_none_is_wanted() -> None:
    assert choose([]) == NAMES and CAN in NAMES
    assert {topic for topic in CHANNEL if "drawing" not in topic} == set(TOPICS.values())
    held = choose([], on_clock=True)
    without = {
        "measurement_address_claim",
        "event",
        "accepted",
        "load",
        "addresses",
        "fit",
        "ready",
        "tie",
        "rig",
        "report",
        "can",
    }
    assert set(NAMES) - set(held) == without
    assert all(0 < age_s(name) <= 3.0 for name in held)
    assert age_s("measurement_fix") == AGES_S["measurement_fix"] > age_s("measurement_position")


@pytest.mark.parametrize(("wanted", "on_clock", "said"), WRONG, ids=str)
def test_what_is_none_is_told_the_nearest(wanted: list[str], on_clock: bool, said: str) -> None:
    with pytest.raises(UnknownChannel) as error:
        choose(wanted, on_clock)
    assert said in str(error.value)
