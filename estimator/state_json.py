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
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

LONGEST_LIST = 16  # numbers; a longer array is stored as base 64, which is faster and as exact


class Shape(NamedTuple):
    """What an array must have to be read back, in an annotation: `Annotated[Array, Shape((3,))]`. -1: any
    number."""

    sizes: tuple[int, ...]


def to_json_data(value: Any, skip: frozenset[str] = frozenset()) -> Any:
    """The value as lists, dicts, numbers, strings and None. Fields named in `skip` are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: to_json_data(getattr(value, f.name), skip) for f in fields(value) if f.name not in skip
        }
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
        return [to_json_data(item, skip) for item in value]
    if isinstance(value, Mapping):
        return {key: to_json_data(item, skip) for key, item in value.items()}
    return value


def from_json_data(kind: Any, data: Any, skipped: dict[str, Any] | None = None) -> Any:
    """A value of type `kind` from the data of `to_json_data`. skipped: the fields that were left out there.

    Raises ValueError if the data do not fit the type.
    """
    try:
        return _build(kind, data, skipped or {})
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{getattr(kind, '__name__', kind)}: {error}") from None


class Stored:
    """The parts of a stored state; each is read once. All methods raise ValueError with the name of the
    part."""

    def __init__(self, raw: Any, of: str) -> None:
        """raw: the parsed JSON; of: what it is the state of, for error messages."""
        if not isinstance(raw, Mapping):
            raise ValueError(f"{of} is not a table of names and values")
        self._unread = dict(raw)
        self._of = of

    def raw(self, key: str) -> Any:
        """A part as parsed JSON."""
        if key not in self._unread:
            raise ValueError(f"{self._of} lacks {key}")
        return self._unread.pop(key)

    def value(self, kind: type[T], key: str, skipped: dict[str, Any] | None = None) -> T:
        """A part, as a value of type `kind`. skipped: as in `from_json_data`."""
        raw = self.raw(key)
        try:
            value: T = from_json_data(kind, raw, skipped)
        except ValueError as error:
            raise ValueError(f"{self._of}, {key}: {error}") from None
        return value

    def optional(self, kind: type[T], key: str) -> T | None:
        """A part that may be None."""
        if key in self._unread and self._unread[key] is None:
            del self._unread[key]
            return None
        return self.value(kind, key)

    def end(self) -> None:
        """Call it last: raises ValueError if a part has not been read."""
        if self._unread:
            raise ValueError(f"{self._of} has {', '.join(sorted(self._unread))}, which is not known")


def _build(kind: Any, data: Any, skipped: dict[str, Any]) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _of_shape(_build(arguments[0], data, skipped), arguments[1])
    if origin in (typing.Union, types.UnionType):
        if data is None:
            return None
        (inner,) = (a for a in arguments if a is not type(None))
        return _build(inner, data, skipped)
    if np.ndarray in (origin, kind):
        if isinstance(data, dict):
            raw = np.frombuffer(base64.b64decode(data["base64"]), dtype="<f8")
            return raw.reshape(data["shape"]).astype(np.float64)
        return np.array(data, dtype=np.float64)
    _check_form(kind, data)
    if origin in (list, deque):
        return [_build(arguments[0], item, skipped) for item in data]
    if origin is tuple:
        inner = arguments[:1] * len(data) if arguments[-1] is Ellipsis else arguments
        return tuple(_build(a, item, skipped) for a, item in zip(inner, data, strict=True))
    if origin in _TABLES:
        of_key, of_item = arguments
        return {_build(of_key, k, skipped): _build(of_item, item, skipped) for k, item in data.items()}
    if isinstance(kind, type) and is_dataclass(kind):
        return _build_dataclass(kind, data, skipped)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(data)
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


_TABLES = (dict, Mapping)
_NUMBER = (bool, int, float)  # some JSON writers turn 1.0 into 1, and arithmetic mixes the types
_LEAVES: dict[Any, Any] = {bool: _NUMBER, int: _NUMBER, float: _NUMBER, str: str}


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Annotations of a dataclass; they are evaluated once."""
    return typing.get_type_hints(kind, include_extras=True)


def _build_dataclass(kind: Any, data: dict[str, Any], skipped: dict[str, Any]) -> Any:
    hints = _hints(kind)
    unknown = data.keys() - hints.keys()
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))} is not known")
    values: dict[str, Any] = {}
    for f in fields(kind):
        if f.name in skipped and f.name not in data:
            values[f.name] = skipped[f.name]
            continue
        if f.name not in data:
            raise ValueError(f"{f.name} is missing")
        try:
            value = _build(hints[f.name], data[f.name], skipped)
        except (LookupError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{f.name}: {error}") from None
        if typing.get_origin(hints[f.name]) is deque and f.default_factory is not MISSING:
            empty: deque[Any] = f.default_factory()
            empty.extend(value)  # the default's maximal length stays
            value = empty
        values[f.name] = value
    return kind(**values)
