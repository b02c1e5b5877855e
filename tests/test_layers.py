"""The straight line of layers, and what the two inner ones must not know."""

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

import pytest
from paths import ROOT, SUPPORT

from tilth.deploy.imports import Arrows, arrows, circle, sources

LAYERS = (
    "schemas", "estimator", "logger", "replay", "simulator", "analysis", "client", "monitor",
    "adaptive_guidance", "cli",
)  # fmt: skip
ROOMS = {
    "estimator": (
        "models",
        "rig",
        "pose",
        "record",
        "filters",
        "diagnosis",
        "calibration",
        "results",
        "methods",
        "",
    ),
    "logger": ("can", "log", "zenoh", "", "checks"),
    "replay": ("readers", ""),
    "simulator": ("spatial", ""),
    "analysis": (
        "runs",
        "response",
        "fit",
        "workers",
        "validation",
        "experiment",
        "",
        "export",
        "report",
        "calibration",
        "sensitivity",
        "season",
    ),
}
"""Of each folder, in the order of imports; "" is the folder itself."""
UNDER_ALL = {
    "estimator": (
        "compiled",
        "driving",
        "kernel_digest",
        "kernel_store",
        "once",
        "state_json",
        "ties",
        "tuning",
    ),
    "logger": ("clock", "back_off"),
    "simulator": ("scenario",),
}
"""Modules of a folder itself that its rooms may use."""
HEARS_ZENOH_ONLY = ("client", "monitor")  # they can crash or lag without touching the recorder
CONTROLLER = ("plan", "law", "follower", "controller", "wires", "__main__")  # they hear Zenoh only
PURE = ("schemas", "estimator")
IMPURE = {
    "asyncio", "can", "concurrent", "datetime.datetime.now", "io", "logging", "mcap", "multiprocessing", "os",
    "pathlib", "random", "select", "selectors", "shutil", "signal", "socket", "subprocess", "sys", "tempfile",
    "threading", "time", "urllib", "zenoh",
}  # fmt: skip


def _modules() -> list[Path]:
    folders = [ROOT / ("examples" if layer == "adaptive_guidance" else "") / layer for layer in LAYERS]
    return [path for folder in folders for path in folder.rglob("*.py") if "_pb2" not in path.name]


def _nodes(source: str) -> Iterator[ast.AST]:
    return ast.walk(ast.parse(source))


@cache  # two checks ask for them
def _imports(source: str) -> tuple[str, ...]:
    found: list[str] = []
    for node in _nodes(source):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(found)


def _room(folder: str, parts: Sequence[str]) -> int:
    """Index of the room of a module whose name goes on with `parts` after the folder's."""
    if parts and parts[0] in ROOMS[folder]:
        return ROOMS[folder].index(parts[0])
    return ROOMS[folder].index("")


def _wrong_doors(folder: str, room: str, source: str) -> list[str]:
    """Imports from rooms that come after this one."""
    found = []
    for name in _imports(source):
        top, _, rest = name.partition(".")
        parts = rest.split(".")
        if top != "tilth" or parts[0] != folder or len(parts) < 2 or parts[1] in UNDER_ALL.get(folder, ()):
            continue
        if _room(folder, parts[1:]) > ROOMS[folder].index(room):
            found.append(name)
    return found


def _impure(node: ast.AST) -> str:
    """What it asks of the world, "" if nothing."""
    match node:
        case ast.Call(func=ast.Name(id="open" | "input" | "print" as name)):
            return name
        case ast.Call(func=ast.Attribute(value=ast.Name(id="datetime"), attr="now")):
            return "datetime.now"
        case ast.Attribute(value=ast.Name(id="np"), attr="random"):
            return "np.random"
    return ""


def _faults(layer: str, source: str, module: str = "") -> list[str]:
    """What this source of that layer may not do."""
    outer = LAYERS[LAYERS.index(layer) + 1 :]
    if layer in HEARS_ZENOH_ONLY or (layer == "adaptive_guidance" and module in CONTROLLER):
        outer += ("logger", "replay", "simulator", "analysis")
    barred = ("studies.", *(f"tilth.{o}." for o in outer))
    found = [name for name in _imports(source) if f"{name}.".startswith(barred)]
    if layer in PURE:
        found += [name for name in _imports(source) if name.split(".")[0] in IMPURE]
        found += filter(None, map(_impure, _nodes(source)))
    return found


def _layer(path: Path) -> str:
    parts = path.relative_to(ROOT).parts
    return parts[1] if parts[0] == "examples" else parts[0]


@pytest.mark.parametrize("layer", LAYERS)
def test_imports_go_left_and_the_core_is_pure(layer: str) -> None:
    paths = [path for path in _modules() if _layer(path) == layer]
    assert paths
    faults = {str(path.relative_to(ROOT)): _faults(layer, path.read_text(), path.stem) for path in paths}
    if layer in ROOMS:
        for path in paths:
            parts = path.relative_to(ROOT).parts
            room = parts[1] if len(parts) > 2 else ""
            assert room in ROOMS[layer], f"{layer}/{room} is no room: add it to ROOMS"
            faults[str(path.relative_to(ROOT))] += _wrong_doors(layer, room, path.read_text())
    assert {name: found for name, found in faults.items() if found} == {}


@pytest.mark.parametrize(
    ("folder", "room", "source"),
    [
        ("estimator", "models", "from tilth.estimator.pose.geometry import wrap"),
        ("estimator", "filters", "from tilth.estimator.results import advice"),
        ("estimator", "methods", "from tilth.estimator import fold"),
        ("logger", "can", "from tilth.logger.log import runs"),
        ("logger", "log", "import tilth.logger.daemon"),
        ("replay", "readers", "from tilth.replay.offline import replay"),
        ("analysis", "", "from tilth.analysis.sensitivity import outputs"),
        ("simulator", "spatial", "from tilth.simulator.tractor import draw"),
    ],
)
def test_the_check_sees_a_wrong_door(folder: str, room: str, source: str) -> None:
    assert _wrong_doors(folder, room, source)


def _between_files(modules: Mapping[str, str]) -> Arrows:
    """Module → those that it imports anywhere in it: at its head, in a function, for a type only."""

    def file(name: str) -> str | None:
        while name and name not in modules and f"{name}.__init__" not in modules:
            name = name.rpartition(".")[0]
        return name if name in modules else f"{name}.__init__" if name else None

    return arrows(modules, file)


def test_no_two_files_import_each_other() -> None:
    assert circle(_between_files(sources())) == []


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("schemas.machine", "def late():\n    from tilth.schemas.plausible import doubts"),
        ("schemas.machine", "if TYPE_CHECKING:\n    from tilth.schemas import plausible_wheel"),
        ("simulator.noise", "import tilth.simulator.drive"),
        ("analysis.runs.run", "import tilth.analysis"),  # a package's own file
    ],
)
def test_a_circle_between_files_is_found(module: str, source: str) -> None:
    modules = sources()
    found = circle(_between_files({**modules, module: f"{modules[module]}\n{source}\n"}))
    assert module in found


def _of_the_models(source: str) -> list[str]:
    return [name for name in _imports(source) if name.startswith("tilth.estimator.models")]


def test_the_spatial_plant_shares_no_equation_with_the_estimators() -> None:
    """Its room imports nothing of the models, and of the estimator only what compiles a kernel."""
    room = [path.read_text() for path in (ROOT / "simulator" / "spatial").glob("*.py")]
    assert len(room) > 5
    of_estimator = {name for text in room for name in _imports(text) if "estimator" in name}
    assert of_estimator == {"tilth.estimator.compiled.kernel"}
    assert not any(map(_of_the_models, room))
    assert _of_the_models("from tilth.estimator.models import nonlinear")


@pytest.mark.parametrize(
    ("layer", "source"),
    [
        ("adaptive_guidance", "from tilth.cli import demo"),
        ("schemas", "from tilth.estimator.fold import step"),
        ("estimator", "import time"),
        ("estimator", "import tilth.logger.can.buses"),
        ("schemas", "def f():\n    open('x')"),
        ("estimator", "import numpy as np\nnp.random.normal()"),
        ("estimator", "from datetime import datetime\nat = datetime.now()"),
        ("logger", "from tilth.replay import readers"),
        ("replay", "from tilth.client import follow"),
        ("replay", "from tilth.simulator import traffic"),
        ("simulator", "from tilth.analysis import plots"),
        ("monitor", "from tilth.logger import status"),
        ("cli", "from studies.dissertation import page"),
    ],
)
def test_the_check_sees_what_it_is_for(layer: str, source: str) -> None:
    assert _faults(layer, source)


LONGEST_FUNCTION = 60  # lines, of a function that nobody generates


def test_functions_are_short() -> None:
    long = [
        f"{path.relative_to(ROOT)}: {node.name}"
        for path in [*_modules(), *(ROOT / "studies").rglob("*.py")]
        if "generated" not in path.parts
        for node in _nodes(path.read_text(encoding="utf-8"))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno >= LONGEST_FUNCTION
    ]
    assert long == []


def test_whoever_gives_tests_a_marker_is_known() -> None:
    """A run of one marker reads only the files that name it, or call `sampled` (`tests/conftest.py`)."""
    own = re.compile(r"pytest\.mark\.(?!skipif|parametrize|usefixtures)")
    assert {path.name for path in SUPPORT.glob("*.py") if own.search(path.read_text())} == {"sampled.py"}
