"""Compiled code that was kept is used again as long as nothing that it was made of has changed.

A package of kernels is written to disk and run in processes of its own with one folder for compiled code:
once to compile, once unchanged, once with all its constants changed.
"""

import cProfile
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from types import FunctionType, SimpleNamespace
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pytest

from tilth.estimator import kernel_digest
from tilth.estimator.compiled import Kernel
from tilth.estimator.filters import predictor, record_loop, row_filter, tracker_kernel
from tilth.estimator.methods.estimators import ESTIMATORS
from tilth.estimator.models import nonlinear
from tilth.estimator.models.generated import rolling_kernels

CONSTANTS = """
from enum import Enum, IntEnum
from typing import NamedTuple
import numpy as np

class Kind(IntEnum):
    ONE = 1
    TWO = 2

class Mode(Enum):
    SLOW = 0.5

class Pair(NamedTuple):
    first: float
    second: float

PLAIN = 1.0
TUPLE = (1.0, (2.0, 3.0))
PAIR = Pair(first=1.0, second=2.0)
ARRAY = np.array([1.0, 2.0])
DEFAULT = 1.0
CALLED = 1.0
FURTHER = 1.0
"""
CHANGED = (
    CONSTANTS.replace("1.0", "5.0")
    .replace("ONE = 1\n    TWO = 2", "ONE = 2\n    TWO = 1")
    .replace("SLOW = 0.5", "SLOW = 0.7")
    .replace("    first: float\n    second: float", "    second: float\n    first: float")
)
CALLED = """
from tilth.estimator.planted.constants import CALLED, DEFAULT, FURTHER
from tilth.estimator.compiled import kernel

def times(x):
    return x * CALLED

def by_default(x, factor=DEFAULT):
    return x * factor

@kernel
def further(x):
    return x * FURTHER
"""
KERNELS = """
from tilth.estimator.planted.called import by_default, further, times
from tilth.estimator.planted.constants import ARRAY, Kind, Mode, PAIR, Pair, PLAIN, TUPLE

def plain(x):
    return x * PLAIN

def tuple_item(x):
    return x * TUPLE[0]

def named_tuple_value(x):
    return x * PAIR.first

def named_tuple_made(x):
    return Pair(x, 5.0).first

def named_tuple_given(x, pair: Pair = Pair(first=1.0, second=2.0)):
    return x * pair.first

def array(x):
    return x * ARRAY[0]

def default(x):
    return by_default(x)

def int_enum(x):
    return 1.0 if int(x) == Kind.ONE else 5.0

def enum(x):
    return x * Mode.SLOW.value

def called_function(x):
    return times(x)

def called_kernel(x):
    return further(x)
"""
RUN = """
import json, sys
import tilth.estimator
tilth.estimator.__path__.append(sys.argv[1])
from types import FunctionType
from tilth.estimator.compiled import Kernel
from tilth.estimator.planted import constants, kernels

results = {}
for name, function in vars(kernels).items():
    if isinstance(function, FunctionType) and function.__module__ == kernels.__name__:
        kernel = Kernel(function)
        if name == "named_tuple_given":  # by names: what is first must not depend on the order
            value = kernel(1.0, constants.Pair(first=3.0, second=4.0))
        else:
            value = kernel(1.0)
        results[name] = value, kernel.how, sum(kernel._run.stats.cache_hits.values())
print(json.dumps(results))
"""
LOOPS = predictor.run_ticks, tracker_kernel.track_ticks, row_filter.run_gains, row_filter.run_response
Results = dict[str, tuple[float, str, int]]  # kernel -> value, how, taken from what was kept
BEFORE = {"enum": 0.5, "named_tuple_given": 3.0}
AFTER = {"enum": 0.7, "named_tuple_given": 3.0}
NAMES = [line[4 : line.index("(")] for line in KERNELS.splitlines() if line.startswith("def ")]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Results]:
    """As written, once more, and with other constants."""
    root = tmp_path_factory.mktemp("kernels")
    package = root / "planted"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "called.py").write_text(CALLED)
    (package / "kernels.py").write_text(KERNELS)
    return [_run(root, package, text) for text in (CONSTANTS, CONSTANTS, CHANGED)]


def _run(root: Path, package: Path, constants: str) -> Results:
    (package / "constants.py").write_text(constants)
    environment = {"NUMBA_CACHE_DIR": str(root / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(root)],
        env={**os.environ, **environment},
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    results: Results = {name: tuple(one) for name, one in json.loads(done.stdout).items()}
    assert list(results) == NAMES
    return results


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.long
def test_a_changed_constant_recompiles_and_an_unchanged_one_does_not(runs: list[Results], name: str) -> None:
    first, again, changed = (run[name] for run in runs)
    assert first == (BEFORE.get(name, 1.0), "compiled and kept", 0)
    assert again == (BEFORE.get(name, 1.0), "compiled and kept", 1)
    assert changed == (AFTER.get(name, 5.0), "compiled and kept", 0)


def _function(source: str, **scope: Any) -> FunctionType:
    names: dict[str, Any] = {"__name__": "typed_in", **scope}
    exec(source, names)
    made = names["f"]
    assert isinstance(made, FunctionType)
    return made


class Wrong(NamedTuple):
    first: float


@pytest.mark.parametrize(
    ("source", "value"),
    [
        ("A", kernel_digest),
        ("A.called", kernel_digest),
        ("A.first", SimpleNamespace(first=1.0)),
        ("A[0]", [1.0]),
        ("(lambda y: y * A)(x)", 1.0),
    ],
)
def test_what_might_be_stale_is_refused(source: str, value: object) -> None:
    """The attributes of a module of ours, what can be changed, and what functions within it read."""
    with pytest.raises(TypeError, match="a kernel cannot read"):
        digest(_function(f"def f(x):\n    return x * {source}", A=value))


def test_variables_of_the_function_around_it_are_refused_at_once() -> None:
    factor = 2.0

    def scaled(x: float) -> float:
        return factor * x

    with pytest.raises(TypeError, match="uses factor of the function around it"):
        Kernel(scaled)


def test_fields_that_no_annotation_names_are_part_of_the_kernels_name() -> None:
    """Those of the arguments, and of what is in them."""

    class Wrong(NamedTuple):
        second: float

    Wrong.__qualname__ = Wrong.__name__
    Wrong.__module__ = globals()["Wrong"].__module__
    kinds = [kernel_digest.kinds((1.0, (one(1.0), 2)), {}) for one in (globals()["Wrong"], Wrong)]
    assert kinds[0] != kinds[1] and kinds[0] == kinds[1].replace("second", "first")


class Sides(Wrong, Enum):
    LEFT = (1.0,)


def test_an_enum_of_named_tuples_is_read_as_both() -> None:
    """Its members and its fields: each was left out once, where the other was looked at first."""

    class Sides(Wrong, Enum):
        LEFT = (2.0,)

    Sides.__qualname__ = Sides.__name__
    source = "def f(x):\n    return x * Sides.LEFT.first"
    digests = {digest(_function(source, Sides=sides)) for sides in (globals()["Sides"], Sides)}
    assert len(digests) == 2


def test_each_inner_kernel_names_the_named_tuples_that_it_is_given() -> None:
    """It is kept by itself: were a field moved, one that is given Any would read the one that was there. The
    loop hands what it is given to its steps, which name it and are part of its digest."""
    given = {
        f"{inner.__module__}.{inner.__name__}": list(get_type_hints(inner).values())
        for row in ESTIMATORS
        for kernel in (*row.kernels, *LOOPS)
        for inner in kernel.functions()
        if inner is not kernel.function
    }
    assert len(given) > 40
    loop = f"{record_loop.__name__}.over_ticks"
    assert [name for name, kinds in given.items() if Any in kinds] == [loop]


def digest(function: Callable[..., Any]) -> str:
    assert isinstance(function, FunctionType)
    return kernel_digest.digest(function, {})


def test_the_name_follows_the_versions_of_other_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    function = _function("def f(x):\n    return math.sin(np.pi * x) + np.sum(x)", math=math, np=np)

    def name() -> str:
        kernel: Kernel[[float], float] = Kernel(function)
        kernel(1.0)
        assert kernel._run is not None
        return kernel._run.__qualname__

    before = name()
    assert name() == before
    monkeypatch.setattr(np, "__version__", "of a year later")
    assert name() != before


def test_the_digest_follows_a_constant_three_calls_down(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest(nonlinear.integrate.function)
    assert digest(nonlinear.integrate.function) == before
    monkeypatch.setattr(nonlinear, "ROLLING_SPEED", 0.2)
    assert digest(nonlinear.integrate.function) != before


def test_the_digest_follows_what_is_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    before = digest(predictor.run_ticks.function)
    written = rolling_kernels.motion.function
    code = written.__code__
    other = tuple(2.5 * item if isinstance(item, float) else item for item in code.co_consts)
    monkeypatch.setattr(written, "__code__", code.replace(co_consts=other))
    assert digest(predictor.run_ticks.function) != before


def test_the_digest_does_not_depend_on_where_a_function_stands() -> None:
    source = "def f(x):\n    # why\n    return 2.0 * x"
    assert digest(_function(source)) == digest(_function("\n\n" + source.replace("    # why\n", "")))
    assert digest(_function(source)) != digest(_function(source.replace("2.0", "2")))


def profiled_half(x: float) -> float:
    return 0.5 * x


def test_the_digest_does_not_depend_on_whether_a_kernel_was_profiled() -> None:
    """numba clears a flag of the code that it runs for a profiler: all that shares it was compiled anew."""
    whole = digest(profiled_half)
    cProfile.Profile().runcall(Kernel(profiled_half), 3.0)
    assert digest(profiled_half) == whole


def test_a_loop_has_the_steps_of_its_user() -> None:
    assert len({loop.function.__code__ for loop in LOOPS}) == 1
    assert len({digest(loop.function) for loop in LOOPS}) == len(LOOPS)
    with pytest.raises(KeyError, match="over_ticks does not call take_rows"):
        predictor.run_ticks.with_steps(take_rows=predictor.take_row)


def test_an_inline_kernel_is_compiled_in_its_callers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {function.__name__ for function in predictor.run_ticks.functions()}
    assert {"over_ticks", "propagate"} <= names and "begin_tick" not in names

    before = digest(predictor.run_ticks.function)
    monkeypatch.delitem(predictor.begin_tick.function.__dict__, kernel_digest.OPTION)
    assert "begin_tick" in {one.__name__ for one in predictor.run_ticks.functions()}
    assert digest(predictor.run_ticks.function) != before
