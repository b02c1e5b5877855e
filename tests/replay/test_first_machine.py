"""A machine file of what is heard and answered: right numbers, and a sentence beside each wrong answer."""

import re
from dataclasses import replace

import pytest
from logs import MACHINE
from paths import MACHINE_FILE

from tilth.logger.machine_file import read_machine
from tilth.replay.discover import BusSurvey, Findings
from tilth.replay.first_machine import machine_text, usable, which, who
from tilth.replay.machine_draft import FILL_IN
from tilth.schemas import rule_of_thumb as rule
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Bus
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet_ranges import RANGES
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

DRIVE = Scenario(steering=((2.0, 0.0), (4.0, 8.0), (4.0, -8.0)))
BUSES = [Bus(name="can0", interface="socketcan", channel="can0")]
AHEAD = {"tractor_front": "2.8", "tractor_rear": "0,1", "implement_front": "1.4", "implement_rear": "-1.2"}


@pytest.fixture(scope="module")
def found() -> Findings:
    survey = BusSurvey()
    for frame in simulate(MACHINE, 1, 10.0, DRIVE):
        survey.take(frame)
    return survey.findings()


def answered(found: Findings) -> dict[str, str]:
    """As for the demo's rig, all by tape and scale."""
    answers = {
        "name": "jd7930", "tractor.wheelbase": "2,9", "tractor.hitch": " 0.9 ", "implement.drawbar": "3.72",
        "tractor.mass": "9391", "tractor.front": "3886", "implement.mass": "2127", "implement.tongue": "57",
        "wheel": which(found.wheel_angles[0]), "wheel.way": "scale", "wheel.scale": "0.01",
    }  # fmt: skip
    answers |= {f"{name}.how": "tape" for name in ("tractor.wheelbase", "tractor.hitch", "implement.drawbar")}
    answers |= {f"{name}.how": "scale" for name in ("tractor.mass", "implement.mass")}
    for i, device in enumerate(usable(found)):
        mount = tuple(Mount)[found.front_to_rear.index((device.bus, device.source))]
        one = {"mount": mount, "who": who(device), "ahead": AHEAD[mount], "right": "0", "height": "2.9"}
        answers |= {f"receiver.{i}.{part}": told for part, told in one.items()}
        answers |= {f"receiver.{i}.how": "tape", f"receiver.{i}.corrected": "yes"}
    return answers


def test_the_rig_that_was_measured_stands_in_the_file(found: Findings) -> None:
    text, told = machine_text(answered(found), found, BUSES)
    assert told == [] and FILL_IN not in text
    made = parse_machine(text)
    for body, keys in (("tractor", "a b c mass"), ("implement", "d e mass")):
        for key in keys.split():
            true, got = (getattr(getattr(one, body), key) for one in (MACHINE, made))
            assert got.value == pytest.approx(true.value, abs=0.002 * true.value + 0.001), key
    assert made.tractor.mass.sd == pytest.approx(94, abs=1) and made.tractor.a.sd < 0.03
    by_mount = {receiver.mount: receiver for receiver in MACHINE.receiver}
    for receiver in made.receiver:
        assert receiver.name == by_mount[receiver.mount].name and receiver.roll_corrected
        assert receiver.position[0] == pytest.approx(by_mount[receiver.mount].position[0], abs=0.003)
    assert made.wheel_angle.id == MACHINE.wheel_angle.id and made.wheel_angle.scale == 0.01


def test_what_nobody_has_weighed_is_wide(found: Findings) -> None:
    by_rule = answered(found) | {"tractor.front": "", "implement.tongue": "", "tractor.mass.how": "guess"}
    made = parse_machine(machine_text(by_rule, found, BUSES)[0])
    for body, key in (("tractor", "a"), ("tractor", "mass"), ("implement", "e")):
        true, got = (getattr(getattr(one, body), key) for one in (MACHINE, made))
        assert abs(got.value - true.value) < 2 * got.sd and got.sd > 0.08
    assert "cg_height" not in by_rule and made.tractor.cg_height.sd >= 0.08


def test_from_stop_to_stop_gives_scale_and_middle(found: Findings) -> None:
    wheel = found.wheel_angles[0]
    made = parse_machine(
        machine_text(answered(found) | {"wheel.way": "stops", "wheel.stops": "70"}, found, BUSES)[0]
    ).wheel_angle
    ends = [made.scale * raw + made.offset for raw in (wheel.lowest, wheel.highest)]
    assert ends == pytest.approx([-35.0, 35.0], abs=1e-3) and made.zero.sd == 2.0 and made.gain.sd == 0.1


@pytest.mark.parametrize(
    "bare", ["name", "tractor.mass", "implement.drawbar", "wheel.scale", "receiver.2.height"]
)
@pytest.mark.parametrize("text", ["", "x", "nan", "1e999", "2.9 m", "--3"])
def test_no_answer_is_no_number(found: Findings, bare: str, text: str) -> None:
    made, told = machine_text(answered(found) | {bare: text}, found, BUSES)
    if bare == "name" and text not in ("", "2.9 m", "--3"):  # a name may be anything
        assert made and not told
        return
    assert [one.field for one in told if one.refused] == [bare]
    assert bare == "name" or not made


@pytest.mark.parametrize(
    ("answer", "field", "says"),
    [
        ({"name": "ä b"}, "name", "without spaces"),
        ({"tractor.wheelbase": "29"}, "tractor.wheelbase", "must be from 0.3 to 5"),
        ({"tractor.wheelbase": "-2.9"}, "tractor.wheelbase", "above zero"),
        ({"tractor.wheelbase.how": "guess"}, "tractor.wheelbase.how", "choose one of tape"),
        ({"tractor.hitch": "-9"}, "tractor.hitch", "above zero"),
        ({"tractor.mass": "93910"}, "tractor.mass", "must be from 500 to 40000"),
        ({"tractor.front": "9391"}, "tractor.front", "a part of the 9391 kg"),
        ({"implement.tongue": "-1"}, "implement.tongue", "a part of"),
        ({"implement.drawbar": "0.1"}, "implement.drawbar", "must be from 0.5"),
        ({"implement.mass": "2", "implement.tongue": ""}, "implement.mass", "must be from"),
        ({"tractor.cg_height": "11"}, "tractor.cg_height", "must be from 0.3 to 2"),
        ({"receiver.0.ahead": "280"}, "receiver.0.ahead", "did you mean 0.2788"),
        ({"receiver.1.height": "29"}, "receiver.1.ahead", "position, up = "),
        ({"receiver.1.mount": "tractor_front"}, "receivers", "each place holds one"),
        ({"receiver.1.mount": "roof"}, "receiver.1.mount", "listen again"),
        ({"receiver.1.who": "can0 99"}, "receiver.1.mount", "listen again"),
        ({f"receiver.{i}.mount": "" for i in range(4)}, "receivers", "at least one receiver"),
        ({"wheel": "none"}, "wheel", "turn the wheel"),
        ({"wheel.scale": "0"}, "wheel.scale", "not zero"),
        ({"wheel.scale": "10"}, "wheel.scale", "no wheel sensor does"),
        ({"wheel.way": "stops", "wheel.stops": "-70"}, "wheel.stops", "above zero"),
    ],
)
def test_a_wrong_answer_is_told_beside_its_field(
    found: Findings, answer: dict[str, str], field: str, says: str
) -> None:
    text, told = machine_text(answered(found) | answer, found, BUSES)
    said = [one.text for one in told if one.refused and one.field == field]
    assert said and says in said[0], told
    assert text == "" or "[machine]" in text


def test_without_a_name_a_receiver_is_known_by_its_address(found: Findings) -> None:
    """And what others may have typed for its maker is a number or nothing."""
    bare = replace(found, sources=tuple(replace(one, name=None, manufacturer=None) for one in found.sources))
    answers = answered(bare) | {"receiver.0.maker": "33", "receiver.1.maker": '33"\n[x]'}
    made = parse_machine(machine_text(answers, bare, BUSES)[0])
    assert [receiver.name for receiver in made.receiver] == [None] * 4
    assert [receiver.manufacturer for receiver in made.receiver] == [33, None, None, None]


def test_a_name_is_text_and_nothing_else(found: Findings) -> None:
    text, told = machine_text(answered(found) | {"name": 'x"\n[log]\nfolder = "/'}, found, BUSES)
    assert [one.field for one in told] == ["name"] and not re.search(r"(?m)^folder", text)


def test_the_usual_shares_are_those_of_the_fleet() -> None:
    ranges = {(one.of, one.name): (one.low, one.high) for one in RANGES}
    low, high = ranges["any", "front_share"]
    assert low < rule.FRONT_SHARE.value < high and rule.FRONT_SHARE.sd >= (high - low) / 12**0.5
    low, high = ranges["any", "empty_tongue"][0], ranges["any", "full_tongue"][1]
    assert low < rule.TONGUE_SHARE.value < high and rule.TONGUE_SHARE.sd >= 0.8 * (high - low) / 12**0.5
    for kind in ("compact", "utility", "row_crop", "heavy"):
        height, wheelbase = (sum(ranges[kind, name]) / 2 for name in ("cg_height", "wheelbase"))
        assert height / wheelbase == pytest.approx(
            rule.CG_OVER_WHEELBASE.value, abs=rule.CG_OVER_WHEELBASE.sd
        )
    assert read_machine(MACHINE_FILE).machine == MACHINE
