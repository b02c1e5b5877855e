"""A machine file rewritten with what was found: comments stay, each changed value says what stood there."""

import difflib
import math
import re
from collections.abc import Mapping
from typing import Any, Final

import tomlkit
from tomlkit.items import AbstractTable, Item, Table

from tilth.estimator.filters.priors import PRIOR
from tilth.schemas.ballast import as_told
from tilth.schemas.machine import Machine, Quantity

EARLIER: Final = re.compile(r"^calibrate [0-9-]+(; was [^;]*)?(; |$)")  # of a calibration before
DIGITS: Final = 4  # after the point of a length, an angle or a time
_RECEIVER: Final = (
    "mount", "position", "survey_sd", "latency", "roll_zero", "roll_sign", "yaw_rate_sign", "roll_corrected",
)  # fmt: skip
_WHEEL: Final = (
    "bus", "id", "mask", "extended", "dbc", "signal", "pgn", "source", "instance", "not_available",
    "byte_order", "start_byte", "bits", "signed", "scale", "offset", "sign", "lookup", "zero", "gain",
    "kingpin", "curve",
)  # fmt: skip
_HEXADECIMAL: Final = ("id", "mask", "not_available")
_TRACTOR: Final = ("c", "ackermann", "pair_yaw_sd", "lever_sd", "kingpin_distance")
_UNSAID: Final = {"roll_zero": f"0 (sd {math.degrees(PRIOR.roll_zero_sd):.2g}) by default"}
"""What a key stands for that has no value without being written."""
_IMPLEMENT: Final = ("d", "pair_yaw_sd", "lever_sd")


def rewritten(text: str, before: Machine, after: Machine, places: Mapping[str, str], when: str) -> str:
    """text: of the machine file `before`. places: mount in it -> mount of the same device after. when: date
    of the drive, for the comments. Receivers stay in the order of the text."""
    document, before, after = tomlkit.parse(text), as_told(before), as_told(after)
    note = f"calibrate {when}"
    _section(_table(document, "tractor"), before.tractor, after.tractor, _TRACTOR, note)
    _section(_table(document, "implement"), before.implement, after.implement, _IMPLEMENT, note)
    by_mount = {r.mount.value: r for r in after.receiver}
    blocks: Any = document["receiver"]
    for block, receiver in zip(blocks, before.receiver, strict=True):
        there = by_mount[places[receiver.mount.value]]
        _section(block, receiver, there, _RECEIVER, note)
    wheel: Any = document["wheel_angle"]
    for key in ("start_bit", *_WHEEL):
        was = getattr(before.wheel_angle, key)
        if key in wheel and was is not None and getattr(after.wheel_angle, key) is None:
            wheel.remove(key)
    _section(wheel, before.wheel_angle, after.wheel_angle, _WHEEL, note)
    return tomlkit.dumps(document)


def _table(document: tomlkit.TOMLDocument, name: str) -> Any:
    """With the section's own keys: it may go on further down, as [[tractor.ballast]] behind others."""
    parts = [part for key, part in document.body if key is not None and key.key == name]
    return next((part for part in parts if isinstance(part, Table) and not part.is_super_table()), parts[0])


def _section(table: Any, before: Any, after: Any, keys: tuple[str, ...], note: str) -> None:
    for key in keys:
        old, new = getattr(before, key), getattr(after, key)
        if _plain(old, key) == _plain(new, key) or new is None:
            continue
        was = f"0x{old:X}" if key in _HEXADECIMAL and old is not None else _words(_plain(old, key))
        if key not in table:
            was = _UNSAID.get(key, "") if old is None else f"{was} by default"
        said = f"{note}; was {was}" if was else note
        _put(table, key, _plain(new, key), said)


def _put(table: AbstractTable, key: str, value: Any, said: str) -> None:
    items: Any = table.value
    known: Item | None = items.item(key) if key in table else None
    comment = known.trivia.comment.lstrip("# ") if known is not None and known.trivia.comment else ""
    comment = EARLIER.sub("", comment)
    table[key] = _hexadecimal(value) if key in _HEXADECIMAL else _item(value)
    items.item(key).comment(f"{said}; {comment}" if comment else said)


def _item(value: Any) -> Item:
    if isinstance(value, dict):
        inline = tomlkit.inline_table()
        inline.update(value)
        return inline
    made: Item = tomlkit.item(value)
    return made


def _hexadecimal(value: int) -> Item:
    item: Item = tomlkit.value(f"0x{value:X}")
    return item


def _plain(value: Any, key: str) -> Any:
    """As it stands in the file, rounded."""
    if isinstance(value, Quantity):
        if value.sd == 0.0:
            return _round(value.value, key)
        return {"value": _round(value.value, key), "sd": float(f"{value.sd:.2g}")}
    if isinstance(value, (list, tuple)):
        return [_plain(one, key) for one in value]
    if isinstance(value, float):
        return _round(value, key)
    return getattr(value, "value", value)  # of an enum


def _round(value: float, key: str) -> float:
    if key.endswith("_sd"):
        return float(f"{value:.2g}")
    return float(f"{value:.7g}") if key in _WHEEL and key not in ("zero", "curve") else round(value, DIGITS)


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return f"{value['value']:g} (sd {value['sd']:g})"
    if isinstance(value, list):
        return "[" + ", ".join(_words(one) for one in value) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def from_to(before: Machine, after: Machine, places: Mapping[str, str]) -> dict[str, str]:
    """Name of a number -> the key of the file that holds it, with what it goes from and to. Arguments as of
    `rewritten`."""
    before, after = as_told(before), as_told(after)
    by_mount = {r.mount.value: r for r in after.receiver}
    pairs = [(r, by_mount[places[r.mount.value]]) for r in before.receiver]
    wheel = before.wheel_angle, after.wheel_angle
    if wheel[0].lookup is None and wheel[0].pgn is None:
        gain = _key("scale", wheel)
    else:
        gain = "lookup" if wheel[0].lookup != wheel[1].lookup else ""
    found = {
        "c": _key("c", (before.tractor, after.tractor)),
        "d": _key("d", (before.implement, after.implement)),
        "ackermann": _key("ackermann", (before.tractor, after.tractor)),
        "wheel_zero": _key("zero", wheel),
        "wheel_gain": gain,
        "wheel_curve": _key("curve", wheel),
        "latency": _key("latency", *pairs),
    }
    found |= {f"roll_zero_{there.mount.value}": _key("roll_zero", (r, there)) for r, there in pairs}
    for body, suffix in (("tractor", "t"), ("implement", "i")):
        moved = any(r.position != there.position for r, there in pairs if there.mount.body == body)
        found |= {f"{name}_{suffix}": "position" if moved else "" for name in ("pair", "aside", "lever")}
    return found


def _key(key: str, *pairs: tuple[Any, Any]) -> str:
    """ "" where nothing changes. pairs: of sections, before and after."""
    olds, news = ([_bare(getattr(pair[k], key), key) for pair in pairs] for k in (0, 1))
    if olds == news:
        return ""
    return f"{key} {', '.join(dict.fromkeys(olds))} → {', '.join(news)}"


def _bare(value: Any, key: str) -> str:
    """As it stands in the file, without its sd."""
    if value is None:
        return "0"
    plain = _plain(value, key)
    number = plain["value"] if isinstance(plain, dict) else plain
    return f"{number:g}"


def difference(before: str, after: str, names: tuple[str, str]) -> str:
    """What changes, line by line; "" where nothing does. names: of the files."""
    lines = difflib.unified_diff(
        before.splitlines(keepends=True), after.splitlines(keepends=True), *names, n=0
    )
    return "".join(lines)


def unfilled(text: str) -> list[tuple[int, str]]:
    """(number, key) of the lines of a draft that have no value yet."""
    found, section = [], ""
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        if bare.startswith("["):
            section = bare.partition("]")[0].strip("[")  # what follows is a comment
        key, equals, rest = bare.partition("=")
        if equals and "FILL IN" in rest and not rest.split("#")[0].strip():
            found.append((number, f"{section}.{key.strip()}"))
    return found
