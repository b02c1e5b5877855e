"""Reports the first problem of a file that a person wrote, in one sentence."""

import difflib
import re
import typing
from typing import Any

from pydantic import BaseModel, ValidationError


def sentence(error: ValidationError, raw: dict[str, Any], model: Any) -> str:
    """The first problem of validating `raw` as `model`, in a person's words: key, value, what is allowed, and
    the nearest right key."""
    problems = error.errors()
    # A key that is not known is what the person typed; a missing one is often just its other half.
    first = next((p for p in problems if p["type"] in _UNKNOWN), problems[0])
    where = _place(raw, first["loc"], first["type"] in (*_UNKNOWN, "missing"))
    key = ".".join(_number(part) for part in where).replace(".[", "[")
    if first["type"] in _UNKNOWN:
        known = list(_fields_at(model, where[:-1], raw))
        near = difflib.get_close_matches(str(where[-1]), known, n=1, cutoff=0.5)
        hint = f'; did you mean "{near[0]}"?' if near else "."
        return f"{key}: no such key{hint} Allowed here: {', '.join(known)}"
    if first["type"] == "missing":
        given = _keys_given(raw, where[:-1])
        near = difflib.get_close_matches(str(where[-1]), given, n=1, cutoff=0.6)
        if near:
            return f'{key}: missing (there is "{near[0]}")'
        meaning = _meaning_at(model, where, raw)
        return f"{key}: missing" + (f" ({meaning})" if meaning else "")
    if first["type"] == "kind" and isinstance(first["input"], dict) and "kind" in first["input"]:
        kind = first["input"]["kind"]
        near = difflib.get_close_matches(str(kind), re.findall(r"\w+", first["msg"]), n=1, cutoff=0.5)
        hint = f'did you mean "{near[0]}"? ' if near else ""
        return f"{key}.kind = {kind!r}: {hint}{first['msg']}"
    message = _section(first["type"], key, where, model, raw) or _in_words(first)
    if first["type"] in _NUMBERS:
        meaning = _meaning_at(model, where, raw)
        message += f" ({meaning})" if meaning else ""
    value = first.get("input")
    value_text = "" if isinstance(value, (dict, list, BaseModel)) else f" = {value!r}"
    return f"{key}{value_text}: {message}" if key else message


_PLAIN = {
    "int_from_float": "give a whole number", "int_parsing": "give a whole number",
    "int_type": "give a whole number", "float_parsing": "give a number", "float_type": "give a number",
    "finite_number": "give a finite number",
}  # fmt: skip
"""What pydantic says in words of its own."""
_OTHERS = {
    "string_type": "give a text in quotes", "bool_type": "give true or false",
    "bool_parsing": "give true or false", "literal_error": "give {expected}", "enum": "give {expected}",
    "string_pattern_mismatch": "give letters, digits, dots, dashes and underscores, without spaces",
    "too_short": "give at least {min_length} of them", "too_long": "give at most {max_length} of them",
    "tuple_type": "give a list, in [ ]", "list_type": "give a list, in [ ]",
    "dict_type": "give a table, in {{ }}", "mapping_type": "give a table, in {{ }}",
}  # fmt: skip
"""The same, of what is no number."""
_NUMBERS = ("less_than", "less_than_equal", "greater_than", "greater_than_equal", *_PLAIN)
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


def _in_words(problem: Any) -> str:
    kind = problem["type"]
    if kind in _OTHERS:
        return _OTHERS[kind].format(**problem.get("ctx", {}))
    text: str = problem["msg"]
    return _PLAIN.get(kind, text.removeprefix("Value error, ").replace("Input should be", "must be"))


def _section(kind: str, key: str, where: list[int | str], model: Any, raw: Any) -> str:
    """What to give where a section, or several, were expected at `where`; "" where none were."""
    if kind in ("tuple_type", "list_type") and where and isinstance(where[-1], str):
        field = _fields_at(model, where[:-1], raw).get(where[-1])
        if field is None or not _sections_of(field.annotation):
            return ""
    elif kind not in ("model_type", "dataclass_type") or not where:
        return ""
    elif isinstance(where[-1], str):
        return f"is a section: give [{key}] with its keys below it"
    return f"give [[{key.rpartition('[')[0] or key}]] with its keys below it, once for each"


def _place(raw: Any, where: tuple[int | str, ...], missing: bool) -> list[int | str]:
    """The keys that a person typed in pydantic's path, without names of validators and union members."""
    typed_keys: list[int | str] = []
    for number, part in enumerate(where):
        last = missing and number == len(where) - 1
        if (
            last
            or (isinstance(raw, dict) and part in raw)
            or (isinstance(raw, list) and isinstance(part, int))
        ):
            typed_keys.append(part)
            inner: Any = raw
            raw = None if last else inner[part]
    return typed_keys


def _number(part: int | str) -> str:
    return f"[{part + 1}]" if isinstance(part, int) else str(part)


def _keys_given(raw: Any, path: list[int | str]) -> list[str]:
    for part in path:
        raw = raw[part]
    return list(raw) if isinstance(raw, dict) else []


def _meaning_at(model: Any, where: list[int | str], raw: Any) -> str:
    """What the key at `where` means, with its unit; "" where nobody wrote it down."""
    while where and isinstance(where[-1], int):  # one of a list
        where = where[:-1]
    if not where:
        return ""
    field = _fields_at(model, where[:-1], raw).get(str(where[-1]))
    return (field.description or "") if field is not None else ""


def _fields_at(model: Any, path: list[int | str], raw: Any) -> dict[str, Any]:
    """Those that the section at `path` may have, by key."""
    models = [model]
    for part in path:
        raw = raw[part]
        fields = getattr(models[0] if models else None, "__pydantic_fields__", {})
        if not isinstance(part, int) and part in fields:
            models = _sections_of(fields[part].annotation)
        models = [one for one in models if _is_kind(one, raw)]
    return dict(getattr(models[0], "__pydantic_fields__", {})) if models else {}


def _sections_of(annotation: Any) -> list[Any]:
    if hasattr(annotation, "__pydantic_fields__"):
        return [annotation]
    return [section for inner in typing.get_args(annotation) for section in _sections_of(inner)]


def _is_kind(section: Any, raw: Any) -> bool:
    """Whether this member of a union, told apart by its key `kind`, is meant."""
    kind = section.__pydantic_fields__.get("kind")
    return kind is None or not isinstance(raw, dict) or raw.get("kind") in typing.get_args(kind.annotation)
