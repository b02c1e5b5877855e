"""Which wheel carries the sensor and how curved its linkage is, on a rig that does not slip."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from kinematic_drive import GUIDED, MACHINE, ONE_SIDE, Plan, measurements
from sampled import sampled

from tilth.estimator.calibration import calibrate as calibrating
from tilth.estimator.calibration import drive as drives
from tilth.estimator.calibration import linkage
from tilth.estimator.calibration.changes import Changes, applied, heard_after, linkage_of
from tilth.schemas.flow import Measurement, WheelAngle
from tilth.schemas.machine import Machine
from tilth.simulator.receivers import _by_the_linkage, _of_the_kingpin
from tilth.simulator.scenario import Wheel

BASE = MACHINE.tractor.wheelbase
GENTLE: Plan = ((60, 3.0, 0), (30, 3.0, 3), (30, 3.0, -3), (60, 3.5, 0))
LONG: Plan = (*GUIDED, (30, 1.4, 10), (30, 1.4, -10), (25, 1.4, 30), (25, 1.4, -30))


@pytest.fixture(scope="module")
def heard() -> list[Measurement]:
    return measurements(LONG)


def _sent(made: list[Measurement], wheel: Wheel) -> list[Measurement]:
    """As the file with the mean of both wheels reads such a sensor: by the simulator's own formulas."""
    out = []
    for one in made:
        if isinstance(one, WheelAngle):
            shown = _of_the_kingpin(np.array([one.angle]), wheel, BASE)
            one = replace(one, angle=float(_by_the_linkage(shown, wheel.curve)[0]))
        out.append(one)
    return out


def _found(made: list[Measurement], machine: Machine = MACHINE) -> tuple[Changes, float]:
    heard = drives.MeasuredLists()
    for one in made:
        drives.take(heard, one)
    drive = drives.drive_of(heard, machine)
    changes, _, view, rolls = calibrating._initial_guess(machine, drive)
    return calibrating._with_linkage(machine, drive, changes, view, rolls)


@pytest.mark.parametrize("kingpin", sampled(("mean", "left", "right"), ("left",)))
@pytest.mark.parametrize("curve", [0.0, 0.06, -0.06])
def test_the_simulators_sensor_is_found(
    kingpin: Literal["mean", "left", "right"], curve: float, heard: list[Measurement]
) -> None:
    made = _sent(heard, Wheel(kingpin=kingpin, curve=curve))
    changes, sd = _found(made)
    assert changes.linkage.kingpin == kingpin and sd < 0.02
    assert changes.linkage.curve == pytest.approx(curve, abs=0.015)
    kinds = [f.kind for f in linkage.kingpin_faults(changes.linkage_before, changes.linkage)]
    assert kinds == ([] if kingpin == "mean" else [linkage.KINGPIN])
    reads = [heard_after(one, changes) for one in made]
    for true, read in zip(heard[::37], reads[::37], strict=True):
        if isinstance(true, WheelAngle) and isinstance(read, WheelAngle):
            assert read.angle == pytest.approx(true.angle, abs=0.012)


def test_a_file_with_the_right_kingpin_stays(heard: list[Measurement]) -> None:
    left = applied(MACHINE, Changes(linkage=linkage_of(MACHINE, "left")))
    changes, _ = _found(heard, left)  # what that file makes of its sensor is the mean
    assert changes.linkage.kingpin == "left"
    assert changes.linkage.curve == pytest.approx(0.0, abs=0.015)


@pytest.mark.parametrize("plan", [GENTLE, ONE_SIDE])
def test_a_drive_that_does_not_tell_leaves_it(plan: Plan) -> None:
    changes, sd = _found(_sent(measurements(plan), Wheel(curve=0.05)))
    assert changes.linkage.kingpin == "mean"
    assert sd > linkage.CURVE_SD / 2 or changes.linkage.curve == pytest.approx(0.05, abs=3 * sd)
