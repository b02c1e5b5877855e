"""Whatever lies in the log folder when a run begins, it begins, and records."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE
from loopback import numbered, rig

from tilth.estimator import fold
from tilth.estimator.diagnosis.information import InformationForm
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.fold import save_learned
from tilth.estimator.methods import pem
from tilth.estimator.rig.numbers import WHEEL
from tilth.logger import warm_start_file
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log import whole_file
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.traffic import simulate

NOW = 1_800_000_000_000_000_000
VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-found"\n\n'

pytestmark = pytest.mark.usefixtures("prepared")


class Told(NoDisplay):
    def __init__(self) -> None:
        self.events: list[Event] = []

    def event(self, event: Event) -> None:
        self.events.append(event)


@pytest.fixture
def talker() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel="tilth-found") as bus:
        yield bus


def kept() -> dict[str, Any]:
    """What a run that has learned something writes."""
    state = fold.initial(MACHINE)
    state.diagnosis.consistency.confirmed = True
    state.estimators[pem.METHOD].informed_ns = NOW - 5_000_000_000
    moved = Moved([WHEEL], np.array([0.0175]), 1e-6 * np.eye(1), NOW, InformationForm(), InformationForm())
    text = warm_start_file.text_of(MACHINE, save_learned(state, NOW), NOW, moved=[moved])
    return dict(json.loads(text))


def _large(path: Path) -> None:
    path.touch()
    os.truncate(path, 100_000_000)


LYING_THERE: dict[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a link to an endless file": lambda path: path.symlink_to("/dev/zero"),
    "brackets": lambda path: path.write_text("[" * 200_000),
    "braces": lambda path: path.write_text('{"a":' * 100_000),
    "no text": lambda path: path.write_bytes(bytes(range(256))),
    "a file of 100 MB": _large,
    "a long number": lambda path: path.write_text('{"format": 3, "utc_ns": ' + "9" * 5000 + "}"),
}


@pytest.mark.parametrize("what", LYING_THERE)
def test_whatever_lies_there_a_run_begins_and_records(what: str, tmp_path: Path, talker: can.BusABC) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    path = warm_start_file.path_of(tmp_path, machine)
    LYING_THERE[what](path)
    earlier = tmp_path / f"{machine.name}_20260101T000000Z"
    os.mkfifo(earlier.with_suffix(".json"))
    os.mkfifo(tmp_path / f"{earlier.name}_001.mcap")
    told = Told()
    daemon = Daemon(MachineFile(machine, text), tmp_path, None, told, keep=True)
    daemon.turn(0.0)
    assert [event.kind for event in told.events] == ["warm_start"]
    for frame in numbered(500):
        daemon.take(frame)
    summary = daemon.close()
    assert summary.recorded == 500 and not summary.not_recorded


@pytest.mark.parametrize("what", sorted({*LYING_THERE} - {"a folder"}))
def test_it_is_replaced_by_what_a_run_has_learned(what: str, tmp_path: Path) -> None:
    path = warm_start_file.path_of(tmp_path, MACHINE)
    LYING_THERE[what](path)
    whole_file.write(path, json.dumps(kept()).encode())
    assert warm_start_file.read(path, MACHINE, NOW) is not None
    assert list(tmp_path.iterdir()) == [path]


def taken_up(plain: object, folder: Path) -> tuple[list[str], GuardedFold]:
    """What a start says of it, and the fold that begins with it."""
    path = warm_start_file.path_of(folder, MACHINE)
    path.write_text(plain if isinstance(plain, str) else json.dumps(plain))
    told: list[str] = []
    guarded = GuardedFold(MACHINE)
    warm_start_file.take_up(
        path, MACHINE, NOW, guarded.warm, lambda kind, one: told.append(notice_sentence(one))
    )
    return told, guarded


@pytest.mark.parametrize(
    "utc_ns", ["Infinity", "-Infinity", "NaN", "1e999", '"now"', "null", "-1", "1" + 400 * "0", "[]"]
)
def test_a_time_that_is_none_is_not_used(utc_ns: str, tmp_path: Path) -> None:
    told, _ = taken_up(json.dumps(kept() | {"utc_ns": "HERE"}).replace('"HERE"', utc_ns), tmp_path)
    assert "is not used" in told[0]


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_no_value_in_it_ends_a_start(data: st.DataObject) -> None:
    """Each place of a good file, with anything that JSON can say."""
    leaf = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    anything = leaf | st.lists(leaf, max_size=3) | st.dictionaries(st.text(max_size=3), leaf, max_size=2)
    plain = kept()
    place: Any = plain
    while True:
        key = data.draw(st.sampled_from([*place] if isinstance(place, dict) else range(len(place))))
        if not (isinstance(place[key], (dict, list)) and place[key] and data.draw(st.booleans())):
            break
        place = place[key]
    place[key] = data.draw(anything)
    with TemporaryDirectory() as folder:
        _, guarded = taken_up(plain, Path(folder))
        for frame in simulate(MACHINE, 3, 0.1):
            guarded.take(frame)
