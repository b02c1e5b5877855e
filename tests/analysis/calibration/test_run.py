"""What a calibration tells of the drive's logs."""

import math
from pathlib import Path

import numpy as np
import pytest
from calibrated_drive import DRIVE, simulated_drive
from logs import MACHINE, MACHINE_TEXT

from tilth.analysis.calibration.page import report_of
from tilth.analysis.calibration.reading import read
from tilth.analysis.calibration.run import STATUS_WORDS, calibrate_logs, steering
from tilth.analysis.report.document import ReportTable
from tilth.estimator.calibration.changes import Changes
from tilth.estimator.calibration.steering_response import SteeringResponse
from tilth.schemas.decode import encode, frames_of
from tilth.schemas.flow import Frame, Word
from tilth.schemas.machine_toml import MachineFile

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated_drive(tmp_path_factory.mktemp("drive"), DRIVE)


@pytest.mark.parametrize("sign", [1, -1])
def test_how_the_wheels_follow_is_told_by_the_wheel_angle_of_the_found_file(drive: Path, sign: int) -> None:
    """Commands that the wheels follow after 0.15 s, time constant 0.3 s; the sensor's sign may be wrong."""
    truth = np.genfromtxt(f"{drive}.truth.csv", delimiter=",", names=True)
    sensor = MACHINE.wheel_angle.model_copy(update={"sign": sign * MACHINE.wheel_angle.sign})
    heard = read(
        [drive], MACHINE.model_copy(update={"wheel_angle": sensor}), {}, print, lambda done, of: None
    )
    base = MACHINE.tractor.wheelbase
    asked = truth["delta"] + 0.3 * np.gradient(truth["delta"], truth["t_ns"] * 1e-9)
    for t in np.arange(1.0, 158.0, 0.1):
        at_ns = heard.first_ns + round(t * 1e9)
        angle = float(np.interp(at_ns + 0.15e9, truth["t_ns"], asked))
        words: dict[str, Word] = {"command_status": "intended"}
        words["commanded_curvature_per_m"] = math.tan(angle) / base
        ((can_id, data),) = frames_of(44288, encode(44288, words), 0x1C, 0xF0)
        heard.commands.take(Frame(at_ns, at_ns, "can0", can_id, True, False, data))
    told = steering(heard, MACHINE, Changes(wheel_sign=sign))
    assert isinstance(told, SteeringResponse), told
    held = 0.05  # s: a command is half its interval old in the mean
    assert told.dead_time == pytest.approx(0.15 - held, abs=0.03)
    assert told.time_constant == pytest.approx(0.3, abs=0.03)
    assert told.gain > 0.9


def test_the_report_has_all_that_was_found(drive: Path) -> None:
    found = calibrate_logs([drive], MachineFile(MACHINE, MACHINE_TEXT), {}, print, lambda what, share: None)
    report = report_of(found)
    assert [section.id for section in report.sections][:2] == ["glance", "numbers"]
    (table,) = [part for part in report.sections[1].parts if isinstance(part, ReportTable)]
    assert len(table.rows) == len(found.verdict.numbers) > 10 and report.data == found.as_json()
    for row, one in zip(table.rows, found.verdict.numbers, strict=True):
        assert row[-1].text == STATUS_WORDS[one.status] != one.status
