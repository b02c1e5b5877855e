"""One name, one thing: no two classes share a name, and the estimators' names are the field's."""

import ast
import io
import tokenize
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import pytest
from paths import ROOT

PACKAGES = (
    "schemas", "estimator", "logger", "replay", "simulator", "analysis", "client", "monitor", "cli", "deploy",
    "examples", "studies",
)  # fmt: skip
SHARED: Mapping[str, str] = {
    "WheelAngle": "a section of the machine file, by its published schema, and what that sensor measures",
    "Job": "what a method asks of the worker, in the module of each method; only that module looks inside",
    "Fit": "what the worker answers to a job, beside it",
}
"""Class name -> why two classes may share it."""

FILTERS, CALIBRATION = "estimator/filters/", "estimator/calibration/"
NOT_OUR_WORDS: Sequence[tuple[str, str, str]] = (
    ("push", "estimator/", "disturbance"),
    ("pushes", "estimator/", "disturbances"),
    ("aside", "estimator/", "lateral_offset"),
    ("shrink", "estimator/", "slip_dependence"),
    ("sway", "estimator/", "roll_compensation"),
    ("pin", "estimator/filters/", "pivot_height"),
    ("pin", "estimator/models/", "pivot_height"),
    ("companion", "estimator/", "perturbed filter"),
    ("companions", "estimator/", "perturbed_filters"),
    ("suspects", "estimator/", "hypotheses"),
    ("driven", FILTERS + "transition.py", "coupled"),
    ("driven", FILTERS + "joint_update.py", "coupled"),
    ("driven", FILTERS + "predictor.py", "coupled, or instruments"),
    ("driven", FILTERS + "likelihood.py", "instruments"),
    ("steered", FILTERS, "instrument"),
    ("carried", FILTERS, "sensitivities"),
    ("late", FILTERS + "sensors/roll.py", "delay"),
    ("who", CALIBRATION, "assignment"),
    ("late", CALIBRATION + "changes.py", "delay"),
    ("late", CALIBRATION + "initial_guess.py", "delay"),
)
"""(part of an identifier, paths, the word of docs/notation.md). Published names are strings, and stay."""


def modules() -> dict[str, str]:
    """Path -> source."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return {str(path.relative_to(ROOT)): path.read_text() for path in paths if "_pb2" not in path.name}


@cache  # two tests read each source
def classes(source: str) -> Sequence[str]:
    return [node.name for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)]


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


def parts(source: str) -> set[str]:
    """Of all identifiers: `AT_PUSH` has `at` and `push`."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {part for t in tokens if t.type == tokenize.NAME for part in t.string.lower().split("_")}


def unusual(sources: Mapping[str, str]) -> list[str]:
    """Words that docs/notation.md has another for."""
    used = {
        path: parts(source) | parts(Path(path).stem)
        for path, source in sources.items()
        if path.startswith("estimator/") and "/generated/" not in path  # published names there are symbols
    }
    return [
        f"{path}: {word}; say {instead}"
        for word, where, instead in NOT_OUR_WORDS
        for path, those in used.items()
        if path.startswith(where) and word in those
    ]


def test_the_estimators_use_the_words_of_the_dictionary() -> None:
    assert unusual(modules()) == []


@pytest.mark.parametrize(("word", "where", "instead"), NOT_OUR_WORDS)
def test_the_check_sees_a_word_that_comes_back(word: str, where: str, instead: str) -> None:
    path = where if where.endswith(".py") else f"{where}new.py"
    assert unusual({path: f"AT_{word.upper()} = 1"}) == [f"{path}: {word}; say {instead}"]
    assert unusual({f"{where.removesuffix('.py')}/{word}.py": ""}) or where.endswith(".py")
    assert unusual({"logger/new.py": f"{word} = 1"}) == []
