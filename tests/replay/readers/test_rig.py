"""Names of buses in a log and in the machine file."""

from pathlib import Path

import pytest
from logs import MACHINE

from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import LogError
from tilth.replay.readers.rig import LEFT_OUT, bus_names, machine_in, on_buses_of
from tilth.schemas.flow import Frame
from tilth.schemas.machine import MachineError

LINE = "(1700000000.{:06d}) {} 09F8011C#A7DF521F4A624103\n"
OURS = MACHINE.bus[0].name


def log_of(folder: Path, *buses: str) -> Path:
    path = folder / "a.log"
    path.write_text("".join(LINE.format(k, bus) for k, bus in enumerate(buses)))
    return path


@pytest.mark.parametrize(
    ("buses", "given", "heard", "said"),
    [
        ([OURS], {}, {OURS}, ""),
        (["vcan7"], {}, {OURS}, f"its bus vcan7 is taken for {OURS}"),
        (["vcan7", "vcan8"], {}, {"vcan7", "vcan8"}, "say which is which with --bus"),
        (["vcan7", "vcan8"], {"vcan7": OURS}, {OURS, "vcan8"}, ""),
        (["vcan7", "vcan8"], {"vcan8": LEFT_OUT}, {OURS}, f"its bus vcan7 is taken for {OURS}"),
        ([OURS], {"vcan9": OURS}, {OURS}, "--bus names vcan9; it begins with"),
    ],
)
def test_frames_have_the_bus_names_of_the_machine_file(
    buses: list[str], given: dict[str, str], heard: set[str], said: str, tmp_path: Path
) -> None:
    told: list[str] = []
    log = open_log(log_of(tmp_path, *buses))
    records = list(on_buses_of(MACHINE, log, given, told.append))
    log.file.close()
    assert {record.bus for record in records if isinstance(record, Frame)} == heard
    assert said in " ".join(told) and bool(told) == bool(said)


def test_pairs_of_the_command_line() -> None:
    assert bus_names([f"vcan7={OURS}", "vcan8="], MACHINE) == {"vcan7": OURS, "vcan8": LEFT_OUT}
    for pairs, machine in (([f"vcan7={OURS}"], None), (["vcan7"], MACHINE), (["vcan7=no_bus"], MACHINE)):
        with pytest.raises(MachineError, match="--bus"):
            bus_names(pairs, machine)


def test_a_log_without_a_machine_file_says_what_to_give(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no machine file is in this log; give --machine"):
        machine_in([log_of(tmp_path, OURS)])
