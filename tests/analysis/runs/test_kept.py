"""What is kept is data: whole to the byte or made anew, and it runs nothing."""

import ast
import json
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE
from numpy.typing import NDArray

from tilth.analysis.runs.kept import load, store
from tilth.schemas.flow import Status

CHECKOUT = Path(__file__).parents[3]


@dataclass(frozen=True, slots=True)
class Result:
    name: str
    value: float
    array: NDArray[np.float64]
    flags: tuple[Status, ...]
    counts: dict[str, int]
    other: "float | None" = None


RESULT = Result("ä", 0.1, np.arange(40.0).reshape(20, 2), tuple(Status)[:2], {"a": 1, "b": 1 << 60})


def same(one: Result | None, other: Result) -> bool:
    return one is not None and repr(one) == repr(other) and one.array.tobytes() == other.array.tobytes()


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kept") / "deep" / "a.fit"
    store(path, RESULT, MACHINE.log)
    return path


def test_it_comes_back_as_it_was(stored: Path) -> None:
    assert same(load(stored, Result), RESULT)
    assert [path.name for path in stored.parent.iterdir()] == ["a.fit"]


@settings(max_examples=400, deadline=None)
@given(data=st.data())
def test_flipped_cut_or_longer_it_is_none(stored: Path, data: st.DataObject) -> None:
    whole = stored.read_bytes()
    at = data.draw(st.integers(0, len(whole) - 1))
    kind = data.draw(st.sampled_from(["flip", "cut", "longer", "zeros", "without"]))
    other = data.draw(st.integers(1, 255))
    damaged = {
        "flip": whole[:at] + bytes([whole[at] ^ other]) + whole[at + 1 :],
        "cut": whole[:at],
        "longer": whole + bytes([other]),
        "zeros": whole[:at].ljust(len(whole), b"\0"),
        "without": whole[:at] + whole[at + 1 :],
    }[kind]
    path = stored.with_name("damaged.fit")
    path.write_bytes(damaged)
    found = load(path, Result)
    assert found is None or (damaged == whole and same(found, RESULT))  # zeros in the place of zeros


class Runs:
    """Unpickled, it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def test_a_prepared_one_runs_nothing(tmp_path: Path) -> None:
    path, made = tmp_path / "a.fit", tmp_path / "made"
    path.write_bytes(pickle.dumps(Runs(made)))
    assert load(path, Result) is None and not made.exists()


@pytest.mark.parametrize("other", [{"name": "a"}, [], "text", {"name": 1}, None, "[" * 100_000])
def test_whole_but_of_another_form_it_is_none(other: object, tmp_path: Path) -> None:
    path = tmp_path / "a.fit"
    store(path, other, MACHINE.log)
    assert load(path, Result) is None
    assert json.dumps(load(path, type(other))) == json.dumps(other) or other is None


def test_a_cache_that_cannot_be_written_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    store(tmp_path / "file" / "a.fit", RESULT, MACHINE.log)
    assert load(tmp_path / "file" / "a.fit", Result) is None


def test_nothing_that_is_kept_on_a_disk_is_a_pickle() -> None:
    """Pickles pass between a process and the one that it has started, and nowhere else."""
    between = {"logger/child.py"}
    found = {
        str(path.relative_to(CHECKOUT))
        for folder in (CHECKOUT / ".typing/tilth").iterdir()
        for path in folder.resolve().rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.Import) and any(a.name in ("pickle", "shelve", "dill") for a in node.names))
        or (isinstance(node, ast.ImportFrom) and node.module in ("pickle", "joblib", "shelve"))
    }
    assert found == between
