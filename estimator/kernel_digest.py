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
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import numpy as np

OURS: Final = "tilth."
"""Of packages whose functions are compiled with a kernel; of others the versions are part of the digest."""

OPTION: Final = "kernel_options"
"""Attribute of a function: what numba is told of it."""

Known = dict[FunctionType, str]
"""Function -> its digest, of those that were looked at so far; what is found is added to it."""


def called(function: FunctionType) -> dict[str, FunctionType]:
    """The functions of this project that a function calls by their bare names."""
    read = {name: _project_function(value) for name, value in _globals(function).items()}
    return {name: inner for name, inner in read.items() if inner is not None}


def digest(function: FunctionType, known: Known) -> str:
    """Digest of a function and of all that it reads and calls, 64 hexadecimal digits."""
    if function not in known:
        codes, read = _codes(function.__code__), _globals(function)
        for name, value in list(read.items()):  # what is read of another module: at most what is named here
            if isinstance(value, ModuleType) and value.__name__.startswith(OURS):
                named = {one for code in codes for one in code.co_names if hasattr(value, one)}
                read |= {f"{name}.{one}": getattr(value, one) for one in sorted(named)}
        text = "\n".join((
            f"{function.__module__} {function.__qualname__} {function.__dict__.get(OPTION)}",
            *(_code_text(code, known) for code in codes),
            _texts((function.__defaults__, *(function.__kwdefaults__ or {}).items()), known),
            _texts(typing.get_type_hints(function).items(), known),
            _texts(read.items(), known),
        ))  # fmt: skip
        known[function] = hashlib.sha256(text.encode()).hexdigest()
    return known[function]


def kinds(value: Any, known: Known) -> str:
    """The type of a value, with those of its items, as text: annotations of a function may not name them."""
    inner = [kinds(one, known) for one in value] if isinstance(value, tuple) else ()
    return f"{_text(type(value), known)} {inner}"


def _project_function(value: Any) -> FunctionType | None:
    inner = getattr(value, "function", value)  # a Kernel's
    return inner if isinstance(inner, FunctionType) and inner.__module__.startswith(OURS) else None


def _codes(code: CodeType) -> list[CodeType]:
    """The code and that of functions and comprehensions in it."""
    return [code, *(each for one in code.co_consts if isinstance(one, CodeType) for each in _codes(one))]


@cache  # a function is asked for by each kernel that calls it, and this takes most of the time of a start
def _global_names(code: CodeType) -> list[str]:
    """Names of globals and builtins that it reads."""
    steps = [step for each in _codes(code) for step in dis.get_instructions(each)]
    return sorted({step.argval for step in steps if step.opname == "LOAD_GLOBAL"})


def _globals(function: FunctionType) -> dict[str, Any]:
    """Name -> value of each global that a function reads; builtins are left out."""
    names = _global_names(function.__code__)
    return {name: function.__globals__[name] for name in names if name in function.__globals__}


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
    if fields := getattr(value, "_fields", ()):  # of a NamedTuple
        hints = _texts(typing.get_type_hints(value).values(), known)
        text += f" {fields} {hints} {_texts(value._field_defaults.items(), known)}"
    members = getattr(value, "__members__", {})  # of an Enum
    return f"{text} {_texts(((name, one.value) for name, one in members.items()), known)}"
