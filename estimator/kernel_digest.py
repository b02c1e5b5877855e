"""All that a kernel reads, and a digest of it, which is part of the name of the stored code.

numba compiles the values of globals into the code. When it looks for stored code, it only checks whether the
file that holds the function has changed. So all that a kernel reads must be part of the name: constants, also
those of other modules, members of enums, fields of NamedTuples, arrays, the functions that it calls, and what
they read. A value whose text differs from process to process, as that of an object does that has none of its
own, is compiled anew by each of them.
"""

import dis
import hashlib
import typing
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple

import numpy as np

OURS: Final = "tilth."
"""Of packages whose functions are compiled with a kernel; of others the versions are part of the digest."""
INNER: Final = "inner"
INLINE: Final = "inline"


class Reading(NamedTuple):
    """What one function does and reads."""

    text: str  # its code and all that it reads, without the functions that it calls
    calls: tuple[FunctionType, ...]  # those functions
    types: frozenset[type]  # NamedTuples in its annotations


class KernelFunction:
    """Base class of a kernel: it holds the function. It is in this file, so that a digest needs no
    compiler."""

    __slots__ = ("function",)

    def __init__(self, function: FunctionType) -> None:
        if function.__closure__:
            names = ", ".join(function.__code__.co_freevars)
            raise TypeError(
                f"the kernel {function.__qualname__} uses {names} of the function around it: make it an "
                "argument or a constant of the module"
            )
        self.function = function


def mark(function: Callable[..., Any], way: str) -> None:
    """Remember how a kernel is compiled: INNER or INLINE."""
    function.__dict__["compiled_as"] = way


def is_marked(function: FunctionType, way: str) -> bool:
    """Whether it is compiled in that way."""
    return bool(function.__dict__.get("compiled_as", "") == way)


def called(function: FunctionType) -> dict[str, FunctionType]:
    """The functions of this project that a function calls by their bare names."""
    read = {name: _project_function(value) for name, value in _globals(function).items()}
    return {name: inner for name, inner in read.items() if inner is not None}


def readings(function: FunctionType) -> dict[FunctionType, Reading]:
    """The functions that are compiled together with this one, itself included, and what each does and
    reads."""
    found: dict[FunctionType, Reading] = {}
    queue = [function]
    while queue:
        item = queue.pop()
        if item not in found:
            found[item] = _reading(item)
            queue += found[item].calls
    return found


def digest(function: FunctionType, known: Mapping[FunctionType, Reading], versions: str = "") -> str:
    """Digest of one function and of all that it calls, 16 hexadecimal digits.

    known: readings of at least these functions. versions: of the packages that compile it.
    """
    found = {function: known[function].text}
    queue = [function]
    while queue:
        for inner in known[queue.pop()].calls:
            if inner not in found:
                found[inner] = known[inner].text
                queue.append(inner)
    function_text = found.pop(function)
    text = repr((versions, function_text, sorted(found.values())))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def check_arguments(function: FunctionType, known: Iterable[Reading], args: tuple[Any, ...]) -> None:
    """Raise TypeError where an argument holds a NamedTuple that no annotation of what is compiled together
    names: the order of its fields would not be part of the digest."""
    missing = _types_of(args).difference(*(reading.types for reading in known))
    if missing:
        names = ", ".join(sorted(kind.__qualname__ for kind in missing))
        raise TypeError(f"the kernel {function.__qualname__} is given {names}: name it in an annotation")


def _project_function(value: Any) -> FunctionType | None:
    inner = value.function if isinstance(value, KernelFunction) else value
    return inner if isinstance(inner, FunctionType) and inner.__module__.startswith(OURS) else None


def _codes(code: CodeType) -> list[CodeType]:
    """The code and that of functions and comprehensions in it."""
    return [code, *(each for one in code.co_consts if isinstance(one, CodeType) for each in _codes(one))]


@cache  # a function is asked for by each kernel that calls it, and this takes most of the time of a start
def _global_names(code: CodeType) -> tuple[str, ...]:
    """Names of globals and builtins that it reads."""
    steps = [step for each in _codes(code) for step in dis.get_instructions(each)]
    return tuple(sorted({step.argval for step in steps if step.opname == "LOAD_GLOBAL"}))


def _globals(function: FunctionType) -> dict[str, Any]:
    """Name -> value of each global that a function reads; builtins are left out."""
    names = _global_names(function.__code__)
    return {name: function.__globals__[name] for name in names if name in function.__globals__}


def _reading(function: FunctionType) -> Reading:
    read, attributes = _globals(function), set[str]()
    for code in _codes(function.__code__):
        attributes.update(code.co_names)
    for name, value in list(read.items()):  # what is read of another module: at most what is named here
        if isinstance(value, ModuleType) and value.__name__.startswith(OURS):
            read |= {f"{name}.{one}": getattr(value, one) for one in attributes if hasattr(value, one)}
    types = _annotated(function)
    defaults = (function.__defaults__, *(function.__kwdefaults__ or {}).items())
    text = repr((
        function.__module__, function.__qualname__, function.__dict__.get("compiled_as", ""),
        _code_text(function.__code__), _text(defaults),
        [(name, _text(read[name])) for name in sorted(read)], [_text(kind) for kind in types],
    ))  # fmt: skip
    return Reading(text, tuple(called(function).values()), frozenset(types))


def _code_text(code: CodeType) -> str:
    """The code without line numbers: a new comment changes no digest. Without its flags: numba takes one away
    in a process that is profiled."""
    constants = [_code_text(one) if isinstance(one, CodeType) else _text(one) for one in code.co_consts]
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
    return repr((code.co_code, code.co_exceptiontable, names, counts, constants))


def _text(value: Any) -> str:
    """A value as text; equal texts compile to equal code."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype.descr} {value.shape} {value.strides} {value.tobytes()!r}"
    if isinstance(value, tuple):
        return f"{_text(type(value))} {[_text(item) for item in value]}"
    if isinstance(value, Enum):
        return f"{_text(type(value))} {value.name}"
    if isinstance(value, ModuleType):
        return f"module {value.__name__}"
    named: Any = _project_function(value) or value
    if not hasattr(named, "__qualname__"):
        return repr(value)
    text = f"{named.__module__}.{named.__qualname__}"
    if _is_named_tuple(named):
        return f"{text} {named._fields} {[(key, _text(one)) for key, one in named._field_defaults.items()]}"
    if isinstance(named, type) and issubclass(named, Enum):
        text += f" {[(key, _text(one.value)) for key, one in named.__members__.items()]}"
    return text


def _is_named_tuple(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def _annotated(function: FunctionType) -> list[type]:
    """The NamedTuple types in the annotations of a function, with those of their fields."""
    found: list[type] = []
    queue: list[Any] = list(typing.get_type_hints(function).values())
    while queue:
        kind = queue.pop(0)
        queue += typing.get_args(kind)
        if _is_named_tuple(kind) and kind not in found:
            found.append(kind)
            queue += typing.get_type_hints(kind).values()
    return found


def _types_of(value: Any) -> set[type]:
    """The NamedTuple types in a value."""
    if not isinstance(value, tuple):
        return set()
    inner = {kind for item in value for kind in _types_of(item)}
    return inner | {type(value)} if _is_named_tuple(type(value)) else inner
