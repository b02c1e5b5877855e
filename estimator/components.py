"""All records of tuning constants, found where they stand: none can be forgotten."""

import pkgutil
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any, Final, NamedTuple

import tilth.estimator

ROOM: Final = "tilth.estimator."


class Component(NamedTuple):
    """record: a dataclass, each field of it `tuning.tuned`."""

    name: str  # its file in estimator/
    record: Any


@cache
def components() -> tuple[Component, ...]:
    """Of all modules, in alphabetical order."""
    names = (info.name for info in pkgutil.walk_packages(tilth.estimator.__path__, ROOM) if not info.ispkg)
    modules = [import_module(name) for name in names if "generated" not in name]
    own = {id(record): (name, record) for module in modules for name, record in _records(module)}
    return tuple(Component(name, record) for name, record in sorted(own.values(), key=lambda one: one[0]))


def _records(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """(file, record) of those that stand in a module; where their class stands elsewhere, they are its own
    unless that module has them as well."""
    for value in vars(module).values():
        if isinstance(value, type) or not is_dataclass(value) or not fields(value):
            continue
        if all("unit" in item.metadata for item in fields(value)):
            home = import_module(type(value).__module__)
            where = home if any(one is value for one in vars(home).values()) else module
            yield where.__name__.removeprefix(ROOM).replace(".", "/"), value
