"""Published cornering stiffnesses and relaxation lengths, of a TOML file, and a fit beside them.

`published.toml` beside this file is the product's own; its head says what such a file holds.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

from tilth.analysis.fit.result import FitAnswer
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import of_parameter, scale_of

PER_DEG: Final = 180.0 / math.pi
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "C": {"kN/rad": 1e3, "N/rad": 1.0, "kN/deg": 1e3 * PER_DEG, "N/deg": PER_DEG},
    "sigma": {"m": 1.0, "mm": 1e-3},
}
"""Of the two kinds of parameters: unit -> how many of SI."""
_TEXTS: Final = ("title", "source", "where", "rig", "load", "tyre", "soil", "how")
_PER: Final = {"axle": 1.0, "tyre": 2.0}  # tyres side by side add up; a relaxation length is that of each


class PublishedError(ValueError):
    """The file is wrong; one sentence says where and what to do."""


@dataclass(frozen=True, slots=True)
class PublishedEntry:
    """One set of values, as its source has it; numbers in N/rad of the whole axle and m."""

    title: str
    source: str  # the full reference
    where: str
    rig: str
    load: str
    tyre: str
    soil: str
    how: str
    values: Mapping[str, tuple[float, float | None]]  # of PARAMETERS: value, sd or None where none is given

    def told(self, name: str) -> str:
        """Of one of PARAMETERS, for a table whose head says the unit and 95 %; "" where there is none."""
        if name not in self.values:
            return ""
        value, sd = self.values[name]
        if sd is None:
            return f"{scale_of(name) * value:.3g}"
        return of_parameter(name, value, sd, bare=True)


@dataclass(frozen=True, slots=True)
class BesidePublished:
    """A parameter of a fit beside a published one."""

    name: str
    ours: float  # N/rad or m
    ours_sd: float
    theirs: float
    theirs_sd: float | None
    ratio: float  # ours over theirs
    apart: float | None  # in sds of both together, of the logarithms; None where no sd was published


def own() -> tuple[PublishedEntry, ...]:
    """The product's own table."""
    return parsed(resources.files("tilth.analysis.fit").joinpath("published.toml").read_text("utf-8"))


def parsed(text: str) -> tuple[PublishedEntry, ...]:
    """Of a file's text. Raises PublishedError."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PublishedError(f"no TOML: {error}") from None
    entries, sources = raw.get("entry"), raw.get("source", {})
    if not isinstance(entries, list) or not entries or not isinstance(sources, dict):
        raise PublishedError("no published values: give [[entry]] with title, source and parameters")
    return tuple(_entry(f"entry[{k}]", one, sources) for k, one in enumerate(entries, 1))


def _entry(at: str, raw: Any, sources: Mapping[str, Any]) -> PublishedEntry:
    if not isinstance(raw, dict):
        raise PublishedError(f"{at}: give [[entry]] with keys in it")
    texts = {key: raw.get(key, "") for key in _TEXTS}
    for key, value in texts.items():
        if not isinstance(value, str) or (key in ("title", "source") and not value):
            raise PublishedError(f"{at}.{key}: give a text")
    if unknown := sorted(raw.keys() - {*_TEXTS, *PARAMETERS, "per"}):
        known = f"{', '.join(_TEXTS)}, per, {', '.join(PARAMETERS)}"
        raise PublishedError(f"{at}.{unknown[0]}: no such key; there are {known}")
    source = sources.get(texts["source"])
    if not isinstance(source, dict) or not isinstance(source.get("reference"), str):
        raise PublishedError(f"{at}.source: give [source.{texts['source']}] with its reference")
    per = raw.get("per", "axle")
    if per not in _PER:
        raise PublishedError(f'{at}.per: give "axle" or "tyre"')
    values = {name: _value(f"{at}.{name}", name, raw[name], _PER[per]) for name in PARAMETERS if name in raw}
    if not values:
        raise PublishedError(f"{at}: no parameter; give some of {', '.join(PARAMETERS)}")
    return PublishedEntry(**texts | {"source": source["reference"]}, values=values)


def _value(at: str, name: str, raw: Any, tyres: float) -> tuple[float, float | None]:
    units = UNITS[name.partition("_")[0]]
    if not isinstance(raw, dict) or not raw.keys() <= {"value", "sd", "unit"} or raw.get("unit") not in units:
        form = f'{{ value = 1.5, sd = 0.3, unit = "{next(iter(units))}" }}'
        raise PublishedError(f"{at}: give {form}, the sd where there is one; units are {', '.join(units)}")
    factor = units[raw["unit"]] * (tyres if name.startswith("C_") else 1.0)
    numbers = [raw.get("value"), *([raw["sd"]] if "sd" in raw else [])]
    for number in numbers:
        usable = isinstance(number, int | float) and not isinstance(number, bool)
        if not usable or not (math.isfinite(number) and number > 0):
            raise PublishedError(f"{at}: {number} is no number above zero")
    return factor * numbers[0], factor * numbers[1] if len(numbers) > 1 else None


def beside(answer: FitAnswer, entry: PublishedEntry) -> tuple[BesidePublished, ...]:
    """The joint fit beside an entry, of the parameters that both give."""
    found = []
    for name, (theirs, theirs_sd) in entry.values.items():
        ours = answer["joint"]["parameters"][name] if answer["joint"] else None
        if ours is None or ours["value"] is None or ours["sd"] is None:
            continue
        ratio, apart = ours["value"] / theirs, None
        if theirs_sd is not None:
            apart = math.log(ratio) / math.hypot(ours["sd"] / ours["value"], theirs_sd / theirs)
        found.append(BesidePublished(name, ours["value"], ours["sd"], theirs, theirs_sd, ratio, apart))
    return tuple(found)
