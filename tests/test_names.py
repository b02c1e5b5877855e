"""One name, one thing: no two classes of the packages share a name."""

import ast
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from paths import ROOT

PACKAGES = (
    "schemas", "estimator", "logger", "replay", "simulator", "analysis", "client", "monitor", "cli", "deploy",
    "examples", "studies",
)  # fmt: skip
SHARED: Mapping[str, str] = {
    "WheelAngle": "a section of the machine file, by its published schema, and what that sensor measures",
    "Job": "what a method asks of the worker, in the module of each method; only that module looks inside",
}
"""Class name -> why two classes may share it."""


def modules() -> dict[str, str]:
    """Path -> source."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return {str(path.relative_to(ROOT)): path.read_text() for path in paths if "_pb2" not in path.name}


def classes(source: str) -> Iterable[str]:
    return (node.name for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef))


def shared_names(sources: Mapping[str, str]) -> dict[str, list[str]]:
    """Class name -> the modules that define it, where there are several."""
    found: dict[str, list[str]] = defaultdict(list)
    for path, source in sources.items():
        for name in classes(source):
            found[name].append(path)
    return {name: paths for name, paths in found.items() if len(paths) > 1}


def test_no_two_classes_share_a_name() -> None:
    found = shared_names(modules())
    assert {name: paths for name, paths in found.items() if name not in SHARED} == {}
    assert set(SHARED) == set(found), "a name that only one class bears needs no exception"


def test_the_check_sees_a_name_that_is_taken() -> None:
    taken = next(name for source in modules().values() for name in classes(source))
    assert taken in shared_names(modules() | {str(Path("logger/new.py")): f"class {taken}:\n    pass"})
