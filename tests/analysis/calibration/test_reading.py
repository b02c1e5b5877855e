"""Logs of two rigs are refused in a sentence; one more receiver on the rig is not."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, OTHER_TEXT, write_candump

from tilth.analysis.calibration.reading import LogHeard, read
from tilth.estimator.calibration.calibrate import CannotCalibrate
from tilth.replay.readers.rig import Say, bus_names
from tilth.schemas.can_id import split
from tilth.schemas.flow import Frame, Position
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to
from tilth.simulator.traffic import simulate

pytestmark = pytest.mark.long


AWAY = parse_scenario("seconds = 45.0\nsteering = [[45.0, 0.0]]\nspeed = 4.0\n")
PARKED = parse_scenario("seconds = 45.0\nsteering = [[45.0, 0.0]]\nspeed = 0.0\n")


def _frames(text: str, scenario: Scenario, addresses: int = 0) -> list[Frame]:
    """addresses: added to all of them, so that two rigs do not claim the same."""
    made = list(simulate(parse_machine(text), 3, scenario.seconds, scenario))
    shifted = [replace(f, can_id=f.can_id & ~0xFF | (f.can_id + addresses) & 0xFF) for f in made]
    return shifted if addresses else made


def _log(path: Path, frames: Iterable[Frame]) -> Path:
    return write_candump(path, sorted(frames, key=lambda one: one.t_ns))


def _read(*paths: Path, say: Say = lambda said: None, buses: tuple[str, ...] = ()) -> LogHeard:
    return read(paths, MACHINE, bus_names(buses, MACHINE), say, lambda done, of: None)


def _later(frames: Iterable[Frame], seconds: int) -> list[Frame]:
    by_ns = seconds * 10**9
    return [replace(f, t_ns=f.t_ns + by_ns, rx_ns=f.rx_ns + by_ns) for f in frames]


def test_two_rigs_on_one_bus(tmp_path: Path) -> None:
    log = _log(tmp_path / "both.log", [*_frames(MACHINE_TEXT, AWAY), *_frames(OTHER_TEXT, PARKED, 100)])
    with pytest.raises(CannotCalibrate, match=r"two rigs are in this: .* away from the rig"):
        _read(log)


def test_two_rigs_one_after_the_other(tmp_path: Path) -> None:
    frames = [*_frames(MACHINE_TEXT, AWAY), *_later(_frames(OTHER_TEXT, AWAY), 100)]
    with pytest.raises(CannotCalibrate, match="heard after the rig's receivers have fallen silent"):
        _read(_log(tmp_path / "both.log", frames))


def test_a_log_without_the_rig_does_not_count_beside_one_with_it(tmp_path: Path) -> None:
    """Of another rig, or of this one where the claims of its NAMEs were missed: nobody can tell."""
    first = _log(tmp_path / "first.log", _frames(MACHINE_TEXT, AWAY))
    other = _log(tmp_path / "other.log", _later(_frames(OTHER_TEXT, AWAY), 100))
    unnamed = (f for f in _frames(MACHINE_TEXT, AWAY) if not _claims(f))
    before = _log(tmp_path / "before.log", _later(unnamed, -100))
    said = list[str]()
    heard = _read(before, first, other, say=said.append)
    assert said == [
        f"{path.name} does not count: none of the machine file's receivers is heard in it"
        for path in (before, other)
    ]
    positions = [m for m in heard.measurements if isinstance(m, Position)]
    assert len(positions) == len([m for m in _read(first).measurements if isinstance(m, Position)])


def _claims(frame: Frame) -> bool:
    return split(frame.can_id).pgn == 60928


def test_names_that_are_claimed_late_are_not_of_another_rig(tmp_path: Path) -> None:
    frames = _frames(MACHINE_TEXT, AWAY)
    delay = [*(f for f in frames if not _claims(f)), *_later((f for f in frames if _claims(f)), 40)]
    heard = _read(_log(tmp_path / "late.log", delay))
    assert heard.rig and not heard.strangers


def test_a_file_of_another_rig_is_not_two_rigs(tmp_path: Path) -> None:
    heard = _read(_log(tmp_path / "other.log", _frames(OTHER_TEXT, AWAY)))
    assert not heard.rig
    assert sorted(one.words for one in heard.strangers.values())[0].startswith("address 128 on can0 (NAME ")


def test_the_bus_of_the_other_rig_is_left_out(tmp_path: Path) -> None:
    other = [replace(f, bus="can1") for f in _frames(OTHER_TEXT, PARKED)]
    log = _log(tmp_path / "both.log", [*_frames(MACHINE_TEXT, AWAY), *other])
    with pytest.raises(CannotCalibrate, match=r"or leave the other's bus out with --bus can1=$"):
        _read(log)
    heard = _read(log, buses=("can1=",))
    assert heard.rig and not heard.strangers


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
