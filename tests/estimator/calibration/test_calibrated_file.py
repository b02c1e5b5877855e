"""The machine after a calibration: what was told is changed and as sure as it is now, the rest stays."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from logs import MACHINE

from tilth.estimator.calibration.calibrate import Calibration
from tilth.estimator.calibration.calibrated_file import calibrated_machine, identified_changes
from tilth.estimator.calibration.changes import Changes
from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.estimator.calibration.verdict import IDENTIFIED, NOT_IDENTIFIABLE, NumberVerdict, RigVerdict

FOUND = cast(  # what of a calibration goes into the file
    Calibration,
    SimpleNamespace(
        changes=Changes(hitch=np.array([0.12, -0.2]), wheel_zero=0.02, wheel_gain=1.1), delay_sd=np.zeros(3)
    ),
)


def verdict(**sds: float) -> RigVerdict:
    """Numbers that are named are told with that sd, the others are not told."""
    numbers = tuple(
        NumberVerdict(
            number,
            0.0,
            sds.get(number.name, 1.0),
            None,
            None,
            IDENTIFIED if number.name in sds else NOT_IDENTIFIABLE,
        )
        for number in SOUGHT
    )
    return RigVerdict(numbers, 0.0, 0, 1.0, {}, ())


def test_where_nothing_is_told_the_file_stays() -> None:
    changes = identified_changes(FOUND, verdict())
    assert not changes.hitch.any() and (changes.wheel_zero, changes.wheel_gain) == (0.0, 1.0)
    assert calibrated_machine(MACHINE, FOUND, verdict()) == MACHINE


def test_one_number_is_told_and_the_others_stay() -> None:
    after = calibrated_machine(MACHINE, FOUND, verdict(c=0.015))
    assert after.tractor.c.sd == 0.015
    assert abs(after.tractor.c.value - MACHINE.tractor.c.value) == pytest.approx(0.12)
    assert (after.implement, after.wheel_angle) == (MACHINE.implement, MACHINE.wheel_angle)


def test_units_are_those_of_the_file() -> None:
    wheel = calibrated_machine(MACHINE, FOUND, verdict(wheel_zero=0.003)).wheel_angle
    assert wheel.zero.sd == pytest.approx(math.degrees(0.003)) and wheel.gain == MACHINE.wheel_angle.gain
    assert abs(wheel.zero.value - MACHINE.wheel_angle.zero.value) == pytest.approx(math.degrees(0.02))
