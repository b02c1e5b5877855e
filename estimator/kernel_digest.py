"""All that a kernel reads, as text: its digest is part of the name of the stored code.

numba compiles the values of globals into the code. When it looks for stored code, it only checks whether the
file that holds the function has changed. So all that a kernel reads must be part of the name: constants, also
those of other modules, members of enums, fields of NamedTuples, arrays, the functions that it calls, and what
they read. A value whose text differs from process to process, as that of an object does that has none of its
own, is compiled anew by each of them.
"""

import dis
import hashlib
import typing
from collections.abc import Iterable
from enum import Enum
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import numpy as np

OURS: Final = "tilth."
"""Of packages whose functions are compiled with a kernel; of others the versions are part of the digest."""

OPTION: Final = "kernel_options"
"""Attribute of a function: what numba is told of it."""

Known = dict[FunctionType, str]
"""Function -> what it does and reads, of those that were looked at so far; what is found is added to it."""


def called(function: FunctionType) -> dict[str, FunctionType]:
    """The functions of this project that a function calls by their bare names."""
    read = {name: _project_function(value) for name, value in _globals(function).items()}
    return {name: inner for name, inner in read.items() if inner is not None}


def digest(function: FunctionType, known: Known, versions: str = "") -> str:
    """Digest of a function and of all that it calls, 16 hexadecimal digits. versions: of what compiles it."""
    return hashlib.sha256(f"{versions}\n{_reading(function, known)}".encode()).hexdigest()[:16]


def check_arguments(function: FunctionType, args: tuple[Any, ...], known: Known) -> None:
    """Raise TypeError where an argument holds a NamedTuple that no annotation of what is compiled together
    names: the order of its fields would not be part of the digest."""
    _reading(function, known)
    named = "\n".join(known.values())
    missing = {kind.__qualname__ for kind in _types_of(args) if _text(kind, known) not in named}
    if missing:
        names = ", ".join(sorted(missing))
        raise TypeError(f"the kernel {function.__qualname__} is given {names}: name it in an annotation")


def _project_function(value: Any) -> FunctionType | None:
    inner = getattr(value, "function", value)  # a Kernel's
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


def _reading(function: FunctionType, known: Known) -> str:
    """What it does and reads; of a function that it calls, the digest."""
    if function not in known:
        codes, read = _codes(function.__code__), _globals(function)
        attributes = sorted({name for code in codes for name in code.co_names})
        for name, value in list(read.items()):  # what is read of another module: at most what is named here
            if isinstance(value, ModuleType) and value.__name__.startswith(OURS):
                read |= {f"{name}.{one}": getattr(value, one) for one in attributes if hasattr(value, one)}
        known[function] = "\n".join((
            f"{function.__module__} {function.__qualname__} {function.__dict__.get(OPTION)}",
            *(_code_text(code, known) for code in codes),
            _texts((function.__defaults__, *(function.__kwdefaults__ or {}).items()), known),
            *(f"{name}: {_text(kind, known)}" for name, kind in typing.get_type_hints(function).items()),
            *(f"{name} = {_text(value, known)}" for name, value in read.items()),
        ))  # fmt: skip
    return known[function]


def _code_text(code: CodeType, known: Known) -> str:
    """The code without line numbers: a new comment changes no digest. Without its flags: numba takes one away
    in a process that is profiled. Without the codes in it, which have texts of their own."""
    constants = [one for one in code.co_consts if not isinstance(one, CodeType)]
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
    return f"{code.co_code!r} {code.co_exceptiontable!r} {names} {counts} {_texts(constants, known)}"


def _texts(values: Iterable[Any], known: Known) -> str:
    return f"({', '.join(_text(one, known) for one in values)})"


def _text(value: Any, known: Known) -> str:
    """A value as text; equal texts compile to equal code."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype.descr} {value.shape} {value.strides} {value.tobytes()!r}"
    if isinstance(value, Enum):
        return f"{_text(type(value), known)} {value.name}"
    if isinstance(value, tuple):
        return f"{_text(type(value), known)} {_texts(value, known)}"
    if isinstance(value, ModuleType):
        return f"module {value.__name__}"
    if function := _project_function(value):
        return f"function {digest(function, known)}"
    if inner := typing.get_args(value):  # of an annotation such as tuple[Rig, ...]
        return f"{typing.get_origin(value)} {_texts(inner, known)}"
    if not hasattr(value, "__qualname__"):
        return repr(value)
    text = f"{value.__module__}.{value.__qualname__}"
    if _is_named_tuple(value):
        kinds = _texts(typing.get_type_hints(value).values(), known)
        text += f" {value._fields} {kinds} {_texts(value._field_defaults.items(), known)}"
    if isinstance(value, type) and issubclass(value, Enum):
        text += f" {_texts(((key, one.value) for key, one in value.__members__.items()), known)}"
    return text


def _is_named_tuple(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def _types_of(value: Any) -> set[type]:
    """The NamedTuple types in a value."""
    if not isinstance(value, tuple):
        return set()
    inner = {kind for item in value for kind in _types_of(item)}
    return inner | {type(value)} if _is_named_tuple(type(value)) else inner
