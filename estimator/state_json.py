"""State as plain data and back, exactly: dataclasses, deques and arrays as what JSON can hold.

Types come from the annotations, so a text cannot choose what is built (pickle would let it).
"""

import base64
import types
import typing
from collections import deque
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

SHORT = 16  # numbers; a longer array is text of base 64, faster and as exact


def to_plain(value: Any, skip: frozenset[str] = frozenset()) -> Any:
    """The value as lists, dicts, numbers, strings and None. Fields named in `skip` are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_plain(getattr(value, f.name), skip) for f in fields(value) if f.name not in skip}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        if value.size <= SHORT and (value.size or value.ndim == 1):  # a list of no rows has no columns
            return value.tolist()
        raw = np.ascontiguousarray(value, dtype="<f8").tobytes()
        return {"shape": list(value.shape), "base64": base64.b64encode(raw).decode("ascii")}
    if isinstance(value, np.generic):  # what arithmetic leaves in a field of float, int or bool
        return value.item()
    if isinstance(value, (list, tuple, deque)):
        return [to_plain(item, skip) for item in value]
    if isinstance(value, dict):
        return {key: to_plain(item, skip) for key, item in value.items()}
    return value


def from_plain(kind: Any, data: Any, given: dict[str, Any] | None = None) -> Any:
    """A value of type `kind` from what `to_plain` gave; `given` holds the fields that were skipped.

    Raises ValueError where the data does not fit.
    """
    try:
        return _build(kind, data, given or {})
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"this is no stored state of {getattr(kind, '__name__', kind)}: {error}") from None


def _build(kind: Any, data: Any, given: dict[str, Any]) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        if data is None:
            return None
        (inner,) = (a for a in arguments if a is not type(None))
        return _build(inner, data, given)
    if origin is np.ndarray:
        if isinstance(data, dict):
            raw = np.frombuffer(base64.b64decode(data["base64"]), dtype="<f8")
            return raw.reshape(data["shape"]).astype(np.float64)
        return np.array(data, dtype=np.float64)
    if origin in (list, deque):
        return [_build(arguments[0], item, given) for item in data]
    if origin is tuple:
        inner = arguments[:1] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(_build(a, item, given) for a, item in zip(inner, data, strict=True))
    if origin is dict:
        return {key: _build(arguments[1], item, given) for key, item in data.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        return _build_dataclass(kind, data, given)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(data)
    return data


def _build_dataclass(kind: Any, data: dict[str, Any], given: dict[str, Any]) -> Any:
    hints = typing.get_type_hints(kind)
    known = data.keys() <= {f.name for f in fields(kind)}
    values: dict[str, Any] = {}
    for f in fields(kind):
        if f.name in given and f.name not in data:
            values[f.name] = given[f.name]
            continue
        if f.name not in data and known and f.default is not MISSING:  # stored before there was that field
            values[f.name] = f.default
            continue
        value = _build(hints[f.name], data[f.name], given)
        if typing.get_origin(hints[f.name]) is deque and f.default_factory is not MISSING:
            empty: deque[Any] = f.default_factory()
            empty.extend(value)  # keeps its maximal length
            value = empty
        values[f.name] = value
    return kind(**values)
