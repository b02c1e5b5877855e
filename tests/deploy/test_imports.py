"""docs/imports.svg is what the code says, and there is no circle of imports."""

from collections.abc import Callable, Mapping
from xml.etree import ElementTree

import pytest

from tilth.deploy.imports import (
    COMMAND,
    DRAWING,
    HOLDS,
    Arrows,
    between_folders,
    between_rooms,
    circle,
    drawing,
    folders,
    follows,
    imported,
    in_order,
    sources,
)


def test_the_drawing_is_up_to_date() -> None:
    assert DRAWING.read_text(encoding="utf-8") == drawing(sources()), f"run `{COMMAND}` and look at it"


@pytest.mark.parametrize("between", [between_folders, between_rooms])
def test_there_is_no_circle(between: Callable[[Mapping[str, str]], Arrows]) -> None:
    assert circle(between(sources())) == []


def test_every_folder_and_room_is_drawn() -> None:
    modules = sources()
    rooms = {name.split(".")[1] for name in modules if name.startswith("estimator.") and name.count(".") > 1}
    assert set(between_folders(modules)) == set(folders())
    assert set(between_rooms(modules)) >= rooms
    assert set(HOLDS) <= set(folders()) | set(between_rooms(modules))
    root = ElementTree.fromstring(DRAWING.read_text(encoding="utf-8"))
    words = {element.text for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert words >= set(folders()) | rooms


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("schemas.flow", "from tilth.estimator.fold import step"),
        ("schemas.flow", "def late():\n    import tilth.estimator.fold"),
    ],
)
def test_a_circle_between_folders_is_found(module: str, source: str) -> None:
    modules = {"estimator.fold": "from tilth.schemas.flow import Frame", module: source}
    found = circle(between_folders(modules))
    assert set(found) == {"schemas", "estimator"} and found[0] == found[-1]
    with pytest.raises(ValueError, match="in a circle"):
        drawing(modules)


@pytest.mark.parametrize(
    "source",
    [
        "from tilth.estimator.methods import pem",
        "from tilth.estimator import fold",  # a module of the folder itself, which imports rooms
    ],
)
def test_a_circle_between_rooms_is_found(source: str) -> None:
    modules = sources()
    modules["estimator.pose.planted"] = source
    assert circle(between_rooms(modules))


def test_what_an_import_names() -> None:
    source = "import math\nfrom tilth.a import b, c\nif x:\n    import tilth.d.e as e"
    assert set(imported(source)) == {"a.b", "a.c", "d.e"}


def test_order_and_what_follows() -> None:
    found = {"c": frozenset({"a", "b"}), "b": frozenset({"a"}), "a": frozenset[str]()}
    assert in_order(found) == ["a", "b", "c"]
    assert follows(found, "c", "a") and not follows(found, "c", "b")
