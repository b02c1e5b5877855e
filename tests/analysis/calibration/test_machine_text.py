"""A machine file is rewritten with its comments; what did not change stays byte for byte."""

import numpy as np
import pytest
from kinematic_drive import MACHINE
from paths import MACHINE_FILE

from tilth.analysis.calibration.machine_text import difference, from_to, rewritten, unfilled
from tilth.estimator.calibration.changes import CHANGES, Changes, applied, linkage_of
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.replay.wheel_by_way import WheelWord, reading_as
from tilth.schemas.machine_toml import parse_machine

TEXT = MACHINE_FILE.read_text(encoding="utf-8")
SAME = {mount.value: mount.value for mount in MOUNTS}


def test_nothing_changes_nothing() -> None:
    assert rewritten(TEXT, MACHINE, MACHINE, SAME, "2026-05-04") == TEXT
    assert difference(TEXT, TEXT, ("a.toml", "b.toml")) == ""


def test_changed_values_say_what_stood_there_and_comments_stay() -> None:
    text = TEXT.replace("c = 2.1\n", "c = 2.1  # to the pin, by tape\n")
    changes = Changes(
        hitch=np.array([0.05, 0.0]), pair=np.array([0.02, 0.0]), wheel_gain=1.1, roll_sign=(1, 1, -1, 1),
        roll_zero=np.array([0.0, 0.0, 0.01, 0.0]),
    )  # fmt: skip
    after = applied(MACHINE, changes)
    made = rewritten(text, MACHINE, after, SAME, "2026-05-04")
    assert "c = {value = 2.15, sd = 0.02} # calibrate 2026-05-04; was 2.1 (sd 0.02); to the pin" in made
    assert "# The dissertation's rig (Karkee 2009" in made
    again = parse_machine(made)
    assert again.tractor.c.value == pytest.approx(2.15)
    assert again.wheel_angle.scale == pytest.approx(0.01 / 1.1, rel=1e-6)
    for one, other in zip(again.receiver, after.receiver, strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-4)
        assert one.roll_sign == other.roll_sign
    changed = [
        line for line in difference(text, made, ("a.toml", "b.toml")).splitlines() if line.startswith("-")
    ]
    assert len(changed) == 1 + 1 + 2 + 1  # the heading, c, the tractor's positions, scale; others are new


def test_a_file_with_ballast_keeps_what_is_about_the_bare_body() -> None:
    """What driving finds is of the rig as it drove; written is what the file tells, without its ballast."""
    ballast = "\n[[tractor.ballast]]\nmass = 900\nahead_of_axle = 4.1\nheight = 0.9\n"
    text = TEXT + ballast
    machine = parse_machine(text)
    assert machine.tractor.c.value > MACHINE.tractor.c.value + 0.1
    assert rewritten(text, machine, machine, SAME, "2026-05-04") == text
    after = applied(machine, Changes(hitch=np.array([0.05, 0.0])))
    made = rewritten(text, machine, after, SAME, "2026-05-04")
    assert "c = {value = 2.15, sd = 0.02} # calibrate 2026-05-04; was 2.1 (sd 0.02)" in made
    assert from_to(machine, after, SAME)["c"] == "c 2.1 → 2.15"
    assert parse_machine(made).tractor.c.value == pytest.approx(after.tractor.c.value)


def test_a_second_calibration_says_what_the_first_one_put_there() -> None:
    """Only that, and what people wrote: comments do not grow with each drive."""
    text = TEXT.replace("c = 2.1\n", "c = 2.1  # to the pin, by tape\n")
    once = applied(MACHINE, Changes(hitch=np.array([0.05, 0.0]), lateral_offset=np.array([0.1, 0.0])))
    made = rewritten(text, MACHINE, once, SAME, "2026-05-04")
    twice = applied(once, Changes(hitch=np.array([-0.02, 0.0]), lateral_offset=np.array([0.1, 0.0])))
    again = rewritten(made, parse_machine(made), twice, SAME, "2026-05-06")
    assert "c = {value = 2.13, sd = 0.02} # calibrate 2026-05-06; was 2.15 (sd 0.02); to the pin" in again
    assert "2026-05-04" not in again and again.count("was [") == 2


def test_keys_that_stood_at_their_default_say_it() -> None:
    changes = Changes(roll_zero=np.array([0.01, 0.0, 0.0, 0.0]), ackermann=-0.1, delay=np.full(4, 0.02))
    made = rewritten(TEXT, MACHINE, applied(MACHINE, changes), SAME, "2026-05-04")
    ackermann = MACHINE.tractor.ackermann
    assert f"was {ackermann.value:g} (sd {ackermann.sd:g}) by default\n" in made
    assert "; was 0 (sd 0.57) by default\n" in made and "; was 0.1 (sd 0.05) by default\n" in made


def test_what_the_file_goes_from_and_to() -> None:
    """The zero is on what is measured: with the scale both change."""
    changes = Changes(
        wheel_gain=1.1, wheel_zero=np.radians(3.0), hitch=np.array([0.05, 0.0]),
        lateral_offset=np.array([0.1, 0.0]),
        delay=np.array([0.05, -0.02, 0.0, 0.0]), roll_zero=np.array([0.0, 0.01, 0.0, 0.0]),
        assignment=(1, 0, 2, 3),
    )  # fmt: skip
    places = {MOUNTS[device].value: MOUNTS[k].value for k, device in enumerate(changes.assignment)}
    found = from_to(MACHINE, applied(MACHINE, changes), places)
    assert found["wheel_gain"] == "scale 0.01 → 0.00909091"
    assert found["wheel_zero"] == "zero 0 → 2.7273"
    assert (found["c"], found["d"]) == ("c 2.1 → 2.15", "")
    assert found["aside_t"] == found["pair_t"] == "position" and found["aside_i"] == ""
    assert found["latency"] == "latency 0.1 → 0.08, 0.15, 0.1, 0.1"
    assert found["roll_zero_tractor_rear"] == "roll_zero 0 → 0.573"
    assert set(found) == {number.name for number in SOUGHT}


def test_exchanged_receivers_stay_in_their_order() -> None:
    changes = Changes(assignment=(1, 0, 2, 3))
    places = {MOUNTS[device].value: MOUNTS[k].value for k, device in enumerate(changes.assignment)}
    again = parse_machine(rewritten(TEXT, MACHINE, applied(MACHINE, changes), places, "2026-05-04"))
    assert [r.name for r in again.receiver] == [r.name for r in MACHINE.receiver]
    assert [r.mount for r in again.receiver[:2]] == [MOUNTS[1], MOUNTS[0]]
    assert again.receiver[0].position == MACHINE.receiver[1].position


def test_lines_of_a_draft() -> None:
    draft = (
        "[tractor]\na =  # FILL IN: m\nb = 1.2\n[[receiver]]\nposition = # FILL IN: [forward, right, up]\n"
    )
    assert unfilled(draft) == [(2, "tractor.a"), (5, "receiver.position")]
    assert unfilled(TEXT) == []


def _word(**given: object) -> WheelWord:
    plain: dict[str, object] = {
        "bus": "can0", "can_id": 0x18FFA044, "extended": True, "start_byte": 2, "byte_order": "little",
        "bits": 16, "signed": False, "instance": None, "no_data": None, "zero": 32000.0, "per_degree": -128.0,
        "explained": 0.99, "lead_s": 0.2, "longer_s": 0.15,
    }  # fmt: skip
    return WheelWord(**{**plain, **given})  # type: ignore[arg-type]


def test_another_message_for_the_wheel_angle() -> None:
    made = rewritten(TEXT, MACHINE, reading_as(MACHINE, _word()), SAME, "2026-05-04")
    assert "id = 0x18FFA044 # calibrate 2026-05-04; was 0x18FF0B15" in made
    assert "signed = false # calibrate 2026-05-04; was True" in made and "not_available" not in made
    wheel = parse_machine(made).wheel_angle
    assert (wheel.id, wheel.start_byte, wheel.byte_order, wheel.signed) == (0x18FFA044, 2, "little", False)
    assert wheel.sign == -1
    assert wheel.scale == pytest.approx(1 / 128, rel=0.01)
    assert wheel.offset == pytest.approx(-250.0, abs=1.0)
    rudder = reading_as(MACHINE, _word(can_id=0x09F10D4D, instance=0))
    again = parse_machine(rewritten(TEXT, MACHINE, rudder, SAME, "2026-05-04")).wheel_angle
    assert (again.pgn, again.source, again.id, again.start_byte) == (127245, 0x4D, None, None)


def test_a_kingpin_and_a_curvature_are_written() -> None:
    linkage = linkage_of(MACHINE, "left")._replace(curve=0.05)
    made = rewritten(TEXT, MACHINE, applied(MACHINE, Changes(linkage=linkage)), SAME, "2026-05-04")
    again = parse_machine(made)
    assert again.wheel_angle.kingpin == "left" and again.wheel_angle.curve.value == pytest.approx(0.05)
    assert again.tractor.kingpin_distance == CHANGES.kingpin_distance
