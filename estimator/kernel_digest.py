"""All that a kernel reads, as text: its digest is part of the name of the stored code.

numba compiles the values of globals into the code. When it looks for stored code, it only checks whether the
file that holds the function has changed. So all that a kernel reads must be part of the name: constants, also
those imported from other modules, members of enums, fields of NamedTuples, arrays, the functions that it
calls, and what they read. A kernel that reads anything else is refused: its stored code might be stale.
"""

import dis
import hashlib
import typing
from collections.abc import Iterable
from functools import cache
from types import BuiltinFunctionType, CodeType, EllipsisType, FunctionType, ModuleType, NoneType
from typing import Any, Final

import numpy as np

OURS: Final = "tilth."
"""Of packages whose functions are compiled with a kernel; of others the versions are part of the digest."""

OPTION: Final = "kernel_options"
"""Attribute of a function: what numba is told of it."""

PLAIN: Final = (int, float, complex, str, bytes, np.generic, NoneType, EllipsisType, BuiltinFunctionType)
"""Types of values that their repr says all of."""

Known = dict[FunctionType, str]
"""Function -> its digest, of those that were looked at so far; what is found is added to it."""


def called(function: FunctionType) -> dict[str, FunctionType]:
    """The functions of this project that a function calls by their bare names."""
    read = {name: _project_function(value) for name, value in _globals(function).items()}
    return {name: inner for name, inner in read.items() if inner is not None}


def digest(function: FunctionType, known: Known) -> str:
    """Digest of a function and of all that it reads and calls, 64 hexadecimal digits. Raises TypeError for
    one that reads what has no text.

    Without line numbers: a new comment changes no digest. Without the code's flags: numba takes one away in a
    process that is profiled.
    """
    if function not in known:
        code = function.__code__
        names = function.__module__, function.__qualname__, code.co_names, code.co_varnames, code.co_argcount
        hints = typing.get_type_hints(function)
        read = (
            code.co_code, code.co_exceptiontable, code.co_consts, *hints.items(), *_globals(function).items(),
            function.__defaults__, function.__kwdefaults__,
        )  # fmt: skip
        text = f"{names} {function.__dict__.get(OPTION)} {_texts(read, known)}"
        known[function] = hashlib.sha256(text.encode()).hexdigest()
    return known[function]


def kinds(value: Any, known: Known) -> str:
    """The type of a value, with those of its items, as text: annotations of a function may not name them."""
    inner = [kinds(one, known) for one in value] if isinstance(value, tuple) else ()
    return f"{_text(type(value), known)} {inner}"


def _project_function(value: Any) -> FunctionType | None:
    inner = getattr(value, "function", value)  # a Kernel's
    return inner if isinstance(inner, FunctionType) and inner.__module__.startswith(OURS) else None


@cache  # a function is asked for by each kernel that calls it, and this takes most of the time of a start
def _global_names(code: CodeType) -> list[str]:
    """Names of globals and builtins that it reads."""
    return sorted({step.argval for step in dis.get_instructions(code) if step.opname == "LOAD_GLOBAL"})


def _globals(function: FunctionType) -> dict[str, Any]:
    """Name -> value of each global that a function reads; builtins are left out."""
    names = _global_names(function.__code__)
    return {name: function.__globals__[name] for name in names if name in function.__globals__}


def _texts(values: Iterable[Any], known: Known) -> str:
    return f"({', '.join(_text(one, known) for one in values)})"


def _text(value: Any, known: Known) -> str:
    """A value as text; equal texts compile to equal code."""
    if function := _project_function(value):
        return f"function {digest(function, known)}"
    if isinstance(value, PLAIN):
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"array {value.dtype.descr} {value.shape} {value.strides} {value.tobytes()!r}"
    if isinstance(value, tuple):
        return f"{_text(type(value), known)} {_texts(value, known)}"
    if inner := typing.get_args(value):  # of an annotation such as tuple[Rig, ...]
        return f"{typing.get_origin(value)} {_texts(inner, known)}"
    if isinstance(value, type):
        fields = typing.get_type_hints(value) if hasattr(value, "_fields") else {}  # of a NamedTuple
        members = {name: one.value for name, one in getattr(value, "__members__", {}).items()}  # of an Enum
        read = *fields.items(), *getattr(value, "_field_defaults", {}).items(), *members.items()
        return f"{value.__module__}.{value.__qualname__} {_texts(read, known)}"
    if isinstance(value, ModuleType) and not value.__name__.startswith(OURS):
        return f"module {value.__name__}"
    raise TypeError(f"a kernel cannot read {value!r}: import what it needs of a module by its name")
