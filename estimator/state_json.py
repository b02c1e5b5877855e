"""State as plain data and back, exactly: records, deques and arrays as what JSON can hold.

Types come from the annotations, so a text cannot choose what is built (pickle would let it). What does not
fit them exactly is refused: there is no guessing at what another version may have meant.
"""

import base64
import types
import typing
from collections import deque
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

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
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{getattr(kind, '__name__', kind)}: {error}") from None


class Stored:
    """The parts of a stored state, each to be read once. All raise ValueError, with the name of the part."""

    def __init__(self, plain: Any, of: str) -> None:
        """plain: as JSON gave it; of: whose state, for who reads an error."""
        if not isinstance(plain, Mapping):
            raise ValueError(f"{of} is not a table of names and values")
        self._left = dict(plain)
        self._of = of

    def plain(self, key: str) -> Any:
        """A part as JSON gave it."""
        if key not in self._left:
            raise ValueError(f"{self._of} lacks {key}")
        return self._left.pop(key)

    def value(self, kind: type[T], key: str, given: dict[str, Any] | None = None) -> T:
        """A part of a type; given: as in `from_plain`."""
        plain = self.plain(key)
        try:
            value: T = from_plain(kind, plain, given)
        except ValueError as error:
            raise ValueError(f"{self._of}, {key}: {error}") from None
        return value

    def maybe(self, kind: type[T], key: str) -> T | None:
        """A part that may be None."""
        if key in self._left and self._left[key] is None:
            del self._left[key]
            return None
        return self.value(kind, key)

    def array(self, key: str, *shape: int) -> NDArray[np.float64]:
        """An array of this shape; -1 where any number of rows or columns will do."""
        found: NDArray[np.float64] = self.value(np.ndarray, key)
        wanted = tuple(n if k == -1 else k for n, k in zip(found.shape, shape, strict=False))
        if found.shape != wanted or len(shape) != len(wanted):
            raise ValueError(f"{self._of}, {key}: an array of {found.shape}, not of {shape}")
        return found

    def end(self) -> None:
        """Nothing may be left."""
        if self._left:
            raise ValueError(f"{self._of} has {', '.join(sorted(self._left))}, which is not known")


def _build(kind: Any, data: Any, given: dict[str, Any]) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
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
    if origin is dict:
        return {key: _build(arguments[1], item, given) for key, item in data.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        return _build_dataclass(kind, data, given)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(data)
    if not isinstance(data, _LEAVES.get(kind, object)):
        raise TypeError(f"{str(data)[:20]!r} is no {getattr(kind, '__name__', kind)}")
    return data


def _check_form(kind: Any, data: Any) -> None:
    """Raises TypeError where a JSON object or a list is expected and is not there."""
    origin = typing.get_origin(kind)
    expected = dict if origin is dict or is_dataclass(kind) else list
    if (origin is not None or is_dataclass(kind)) and not isinstance(data, expected):
        raise TypeError(f"{str(data)[:20]!r} is no {expected.__name__}")


_NUMBER = (bool, int, float)  # JSON does not keep 1.0 and 1 apart everywhere, and arithmetic mixes them
_LEAVES: dict[Any, Any] = {bool: _NUMBER, int: _NUMBER, float: _NUMBER, str: str}


def _build_dataclass(kind: Any, data: dict[str, Any], given: dict[str, Any]) -> Any:
    hints = typing.get_type_hints(kind)
    unknown = data.keys() - hints.keys()
    if unknown:
        raise KeyError(f"{', '.join(sorted(unknown))} is not known")
    values: dict[str, Any] = {}
    for f in fields(kind):
        if f.name in given and f.name not in data:
            values[f.name] = given[f.name]
            continue
        value = _build(hints[f.name], data[f.name], given)
        if typing.get_origin(hints[f.name]) is deque and f.default_factory is not MISSING:
            empty: deque[Any] = f.default_factory()
            empty.extend(value)  # keeps its maximal length
            value = empty
        values[f.name] = value
    return kind(**values)
