"""State as JSON data and back, exactly: dataclasses, deques and arrays as dicts, lists, numbers and strings.

Types come from the annotations, so a text cannot choose what is built (with pickle it could). Data that do
not fit the annotations exactly are refused: the meaning of another version is never guessed.
"""

import base64
import types
import typing
from collections import deque
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

LONGEST_LIST = 16  # numbers; a longer array is stored as base 64, which is faster and as exact


NOT_STORED: Final = types.MappingProxyType({"stored": False})
"""Metadata of a field that is left out: `field(metadata=NOT_STORED)`."""


class Shape(NamedTuple):
    """What an array must have to be read back, in an annotation: `Annotated[Array, Shape((3,))]`. -1: any
    number."""

    sizes: tuple[int, ...]


def to_json_data(value: Any) -> Any:
    """The value as lists, dicts, numbers, strings and None."""
    if type(value) in _PLAIN:  # most are
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return {name: to_json_data(getattr(value, name)) for name in _stored(type(value))}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        if value.size <= LONGEST_LIST and (
            value.size or value.ndim == 1
        ):  # an empty list would lose a shape (0, n)
            return value.tolist()
        raw = np.ascontiguousarray(value, dtype="<f8").tobytes()
        return {"shape": list(value.shape), "base64": base64.b64encode(raw).decode("ascii")}
    if isinstance(value, np.generic):  # arithmetic leaves such scalars in fields of float, int or bool
        return value.item()
    if isinstance(value, (list, tuple, deque)):
        return [to_json_data(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_json_data(item) for key, item in value.items()}
    return value


def from_json_data(kind: Any, data: Any, given: Mapping[str, Any] | None = None) -> Any:
    """A value of type `kind` from the data of `to_json_data`. given: what fields that are NOT_STORED hold, by
    name; where nothing is given, their default.

    Raises ValueError if the data do not fit the type.
    """
    try:
        return _build(kind, data, given or {})
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{getattr(kind, '__name__', kind)}: {error}") from None


def _build(kind: Any, data: Any, given: Mapping[str, Any]) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _of_shape(_build(arguments[0], data, given), arguments[1])
    if origin in (typing.Union, types.UnionType):
        if data is None:
            return None
        (inner,) = (a for a in arguments if a is not type(None))
        return _build(inner, data, given)
    if np.ndarray in (origin, kind):
        if isinstance(data, dict):
            raw = np.frombuffer(base64.b64decode(data["base64"]), dtype="<f8")
            return raw.reshape(data["shape"]).astype(np.float64)
        return np.array(data, dtype=np.float64)
    _check_form(kind, data)
    if origin in (list, deque):
        return [_build(arguments[0], item, given) for item in data]
    if origin is tuple:
        inner = arguments[:1] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(_build(a, item, given) for a, item in zip(inner, data, strict=True))
    if origin in _TABLES:
        of_key, of_item = arguments
        return {_build(of_key, k, given): _build(of_item, item, given) for k, item in data.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        return _build_dataclass(kind, data, given)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(data)
    if isinstance(kind, type) and issubclass(kind, tuple) and kind is not tuple:  # a NamedTuple
        _check_form(tuple[Any, ...], data)
        return kind(*(_build(a, item, given) for a, item in zip(_hints(kind).values(), data, strict=True)))
    if not isinstance(data, _LEAVES.get(kind, object)):
        raise TypeError(f"{str(data)[:20]!r} is no {getattr(kind, '__name__', kind)}")
    return data


def _of_shape(array: NDArray[np.float64], shape: Shape) -> NDArray[np.float64]:
    sizes = shape.sizes
    fits = array.ndim == len(sizes) and all(
        n in (-1, size) for n, size in zip(sizes, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"an array of {array.shape}, not of {sizes}")
    return array


def _check_form(kind: Any, data: Any) -> None:
    """Raises TypeError if the type needs a JSON object or a list and the data are not one."""
    origin = typing.get_origin(kind)
    container = dict if origin in _TABLES or is_dataclass(kind) else list
    if (origin is not None or is_dataclass(kind)) and not isinstance(data, container):
        raise TypeError(f"{str(data)[:20]!r} is no {container.__name__}")


_PLAIN = frozenset({float, int, str, bool, types.NoneType})
_TABLES = (dict, Mapping)
_NUMBER = (bool, int, float)  # some JSON writers turn 1.0 into 1, and arithmetic mixes the types
_LEAVES: dict[Any, Any] = {bool: _NUMBER, int: _NUMBER, float: _NUMBER, str: str}


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Annotations of a dataclass or a NamedTuple; they are evaluated once."""
    return typing.get_type_hints(kind, include_extras=True)


@cache
def _stored(kind: Any) -> tuple[str, ...]:
    """Names of the fields of a dataclass that are stored."""
    return tuple(f.name for f in fields(kind) if f.metadata.get("stored", True))


def _build_dataclass(kind: Any, data: dict[str, Any], given: Mapping[str, Any]) -> Any:
    hints, stored = _hints(kind), _stored(kind)
    unknown = data.keys() - set(stored)
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))} is not known")
    values: dict[str, Any] = {}
    for f in fields(kind):
        if f.name not in stored:
            if f.name in given:
                values[f.name] = given[f.name]
            continue
        if f.name not in data:
            raise ValueError(f"{f.name} is missing")
        try:
            value = _build(hints[f.name], data[f.name], given)
        except (LookupError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{f.name}: {error}") from None
        if typing.get_origin(hints[f.name]) is deque and f.default_factory is not MISSING:
            empty: deque[Any] = f.default_factory()
            empty.extend(value)  # the default's maximal length stays
            value = empty
        values[f.name] = value
    return kind(**values)
