"""Logs of two rigs are refused in a sentence; one more receiver on the rig is not."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, OTHER_TEXT, write_candump

from tilth.analysis.calibration.reading import LogHeard, read
from tilth.estimator.calibration.calibrate import CannotCalibrate
from tilth.schemas.flow import Frame
from tilth.schemas.machine import parse_machine
from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to
from tilth.simulator.traffic import simulate

AWAY = parse_scenario("seconds = 45.0\nsteering = [[45.0, 0.0]]\nspeed = 4.0\n")
PARKED = parse_scenario("seconds = 45.0\nsteering = [[45.0, 0.0]]\nspeed = 0.0\n")


def _frames(text: str, scenario: Scenario, addresses: int = 0) -> list[Frame]:
    """addresses: added to all of them, so that two rigs do not claim the same."""
    made = list(simulate(parse_machine(text), 3, scenario.seconds, scenario))
    shifted = [replace(f, can_id=f.can_id & ~0xFF | (f.can_id + addresses) & 0xFF) for f in made]
    return shifted if addresses else made


def _log(path: Path, frames: Iterable[Frame]) -> Path:
    return write_candump(path, sorted(frames, key=lambda one: one.t_ns))


def _read(*paths: Path) -> LogHeard:
    return read(paths, MACHINE, {}, lambda said: None, lambda done, of: None)


def test_two_rigs_on_one_bus(tmp_path: Path) -> None:
    log = _log(tmp_path / "both.log", [*_frames(MACHINE_TEXT, AWAY), *_frames(OTHER_TEXT, PARKED, 100)])
    with pytest.raises(CannotCalibrate, match=r"two rigs are in this: .* away from the rig"):
        _read(log)


def test_two_rigs_one_after_the_other(tmp_path: Path) -> None:
    first = _log(tmp_path / "first.log", _frames(MACHINE_TEXT, AWAY))
    late = [replace(f, t_ns=f.t_ns + 10**11, rx_ns=f.rx_ns + 10**11) for f in _frames(OTHER_TEXT, AWAY)]
    with pytest.raises(CannotCalibrate, match="heard while none of the rig's receivers was"):
        _read(first, _log(tmp_path / "second.log", late))


def test_two_daemons_at_the_same_time(tmp_path: Path) -> None:
    one, other = (_log(tmp_path / f"{k}.log", _frames(MACHINE_TEXT, AWAY)) for k in range(2))
    with pytest.raises(CannotCalibrate, match=r"1\.log begins before .*0\.log ends"):
        _read(one, other)


def test_logs_with_other_machine_files(tmp_path: Path) -> None:
    paths = []
    for k, text in enumerate((MACHINE_TEXT, OTHER_TEXT)):
        source = SimulationInput(parse_machine(text), text, AWAY, "", 3, 5.0)
        paths.append(tmp_path / f"{k}.mcap")
        simulate_to(source, paths[-1])
    with pytest.raises(CannotCalibrate, match="by the machine files in them they have other receivers"):
        _read(*paths)


def test_one_more_receiver_on_the_rig(tmp_path: Path) -> None:
    """It drives along: noted, not refused."""
    frames = [*_frames(MACHINE_TEXT, AWAY), *_frames(OTHER_TEXT, AWAY, 100)]
    heard = _read(_log(tmp_path / "both.log", frames))
    assert heard.strangers and all(not one.of_another_rig for one in heard.strangers.values())
    assert heard.measurements and heard.messages.times_ns
