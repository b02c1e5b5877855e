"""tests/ mirrors the folders: where the tests of a module are follows from where the module is."""

from collections.abc import Iterable, Mapping
from functools import cache
from itertools import accumulate
from pathlib import Path, PurePosixPath

from paths import ROOT

from tilth.deploy.imports import folders, imported, sources

LONG = 80  # lines of a module that wants a test
TESTS = ROOT / "tests"


def place(module: str) -> Path:
    """Where the test file of its own name would be."""
    top, *rest = module.removesuffix(".__init__").split(".")
    folder = Path(folders()[top].relative_to(ROOT), *rest[:-1]) if rest else Path()
    mirrored = PurePosixPath(folder).as_posix().replace("examples/adaptive_guidance", "examples")
    return TESTS / mirrored / f"test_{rest[-1] if rest else top}.py"


def named(module: str) -> bool:
    """Whether a test file, or a folder of test files, has its name in the mirrored folder."""
    own = place(module)
    return own.exists() or any((own.parent / own.stem.removeprefix("test_")).glob("test_*.py"))


def with_parents(names: Iterable[str]) -> frozenset[str]:
    """Names that are imported, and the packages and modules that they are in."""
    return frozenset(part for name in names for part in accumulate(name.split("."), "{}.{}".format))


def uses(names: frozenset[str], module: str) -> bool:
    return module.removesuffix(".__init__") in names


def held(module: str, modules: Mapping[str, frozenset[str]], tests: Mapping[Path, frozenset[str]]) -> bool:
    """By a test file of its name; by a test of the mirrored folder that imports it; or as a part: a module of
    its own folder, itself held in one of these ways, imports it. Given is what each imports, with parents."""

    def directly(one: str) -> bool:
        folder = place(one).parent
        return named(one) or any(folder in path.parents and uses(names, one) for path, names in tests.items())

    room = module.rpartition(".")[0]
    beside = [one for one, names in modules.items() if one.rpartition(".")[0] == room and uses(names, module)]
    return directly(module) or any(directly(one) for one in beside if one != module)


SOURCES = {name: text for name, text in sources().items() if "_pb2" not in name and ".generated." not in name}
PATHS = sorted(TESTS.rglob("test_*.py"))


@cache  # by one of the processes that run the tests, not by each as it collects them
def modules() -> dict[str, frozenset[str]]:
    return {name: with_parents(imported(text)) for name, text in SOURCES.items()}


@cache
def files() -> dict[Path, frozenset[str]]:
    return {path: with_parents(imported(path.read_text(encoding="utf-8"))) for path in PATHS}


def test_each_long_module_has_its_test_in_the_mirrored_folder() -> None:
    long = [name for name, text in SOURCES.items() if text.count("\n") > LONG]
    assert len(long) > 300
    missing = [place(one).relative_to(ROOT) for one in long if not held(one, modules(), files())]
    assert missing == [], "write them, or import each module in another test of its folder"


def test_each_folder_of_tests_mirrors_one() -> None:
    folders = {path.parent.relative_to(TESTS) for path in PATHS}
    assert [one for one in folders if not (ROOT / one).is_dir() and one.parts[:1] != ("vm",)] == []


def test_the_check_sees_a_module_without_a_test() -> None:
    new = "logger.log.planted"
    planted = {**modules(), new: frozenset[str]()}
    asked = with_parents({f"{new}.something"})
    assert not held(new, planted, files())
    assert not held(new, planted, {**files(), TESTS / "cli/test_planted.py": asked})
    assert held(new, planted, {**files(), TESTS / "logger/log/test_other.py": asked})
    assert held(new, {**planted, "logger.log.runs": asked}, files())
    assert not held(new, {**planted, "logger.daemon": asked}, files())
