"""A machine file is rewritten with its comments; what did not change stays byte for byte."""

import numpy as np
import pytest
from kinematic_drive import FILE, MACHINE

from tilth.analysis.calibration.machine_text import difference, rewritten, unfilled
from tilth.estimator.calibration.changes import Changes, applied
from tilth.estimator.calibration.drive import MOUNTS
from tilth.schemas.machine import parse_machine

TEXT = FILE.read_text(encoding="utf-8")
SAME = {mount.value: mount.value for mount in MOUNTS}


def test_nothing_changes_nothing() -> None:
    assert rewritten(TEXT, MACHINE, MACHINE, SAME, "2026-05-04") == TEXT
    assert difference(TEXT, TEXT, "m.toml") == ""


def test_changed_values_say_what_stood_there_and_comments_stay() -> None:
    text = TEXT.replace("c = 2.1\n", "c = 2.1  # to the pin, by tape\n")
    changes = Changes(
        hitch=np.array([0.05, 0.0]), pair=np.array([0.02, 0.0]), wheel_gain=1.1, roll_sign=(1, 1, -1, 1),
        roll_zero=np.array([0.0, 0.0, 0.01, 0.0]),
    )  # fmt: skip
    after = applied(MACHINE, changes)
    made = rewritten(text, MACHINE, after, SAME, "2026-05-04")
    assert "c = 2.15 # calibrate 2026-05-04; was 2.1; to the pin, by tape" in made
    assert "# The dissertation's rig (Karkee 2009" in made
    again = parse_machine(made)
    assert again.tractor.c.value == pytest.approx(2.15)
    assert again.wheel_angle.scale == pytest.approx(0.01 / 1.1, rel=1e-6)
    for one, other in zip(again.receiver, after.receiver, strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-4)
        assert one.roll_sign == other.roll_sign
    changed = [line for line in difference(text, made, "m.toml").splitlines() if line.startswith("-")]
    assert len(changed) == 1 + 1 + 2 + 1  # the heading, c, the tractor's positions, scale; others are new


def test_exchanged_receivers_stay_in_their_order() -> None:
    changes = Changes(who=(1, 0, 2, 3))
    places = {MOUNTS[who].value: MOUNTS[k].value for k, who in enumerate(changes.who)}
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
