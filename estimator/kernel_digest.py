"""All that a kernel reads, as text, and a digest of it. The digest is part of the name of the stored code.

numba compiles the values of globals into the code. When it looks for stored code, it only checks whether the
file that holds the function has changed. So all that a kernel reads must be part of the name: constants, also
those of other modules, members of enums, fields of NamedTuples, arrays, the functions that it calls, and what
they read. A value that cannot be written as text here is refused: the stored code would go stale without
notice.
"""

import builtins
import dis
import hashlib
import inspect
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import cache
from types import CodeType, EllipsisType, FunctionType, ModuleType, NoneType
from typing import Any, Final, NamedTuple

import numpy as np

LAYERS: Final = ("tilth.schemas.", "tilth.estimator.", "tilth.simulator.spatial.")
"""Whose functions are compiled with a kernel."""
KNOWN_PACKAGES: Final = frozenset({"builtins", "cmath", "math", "numba", "numpy", "operator", "typing"})
"""Packages whose functions and types are digested by name only: their versions are part of the digest."""
INNER: Final = "inner"
INLINE: Final = "inline"
LITERALS: Final = (bool, int, float, complex, str, bytes, NoneType, EllipsisType)
READABLE: Final = (
    "numbers, strings, tuples, enums, arrays, NamedTuples, and functions of tilth.schemas and tilth.estimator"
)


class NotDigestible(TypeError):
    """A kernel reads a value that cannot be part of its digest. The message names it."""


class Reading(NamedTuple):
    """What one function does and reads."""

    text: str  # its code and all that it reads, without the functions that it calls
    calls: tuple[FunctionType, ...]  # those functions


class KernelFunction:
    """Base class of a kernel: it holds the function. It is in this file, so that a digest needs no
    compiler."""

    __slots__ = ("function",)

    def __init__(self, function: FunctionType) -> None:
        if function.__closure__:
            names = ", ".join(function.__code__.co_freevars)
            raise NotDigestible(
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
    """The functions of LAYERS that a function calls by their bare names."""
    found = {}
    for path in _paths(function.__code__):
        inner = _project_function(function.__globals__.get(path[0]))
        if inner is not None:
            found[path[0]] = inner
    return found


def readings(function: FunctionType) -> dict[FunctionType, Reading]:
    """The functions that are compiled together with this one, itself included, and what each does and reads.

    Raises NotDigestible.
    """
    found: dict[FunctionType, Reading] = {}
    queue = [function]
    while queue:
        item = queue.pop()
        if item not in found:
            text = f"{item.__dict__.get('compiled_as', '')} {_function_text(item)}"
            found[item] = Reading(text, tuple(called(item).values()))
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


def check_arguments(function: FunctionType, known: Iterable[FunctionType], args: tuple[Any, ...]) -> None:
    """Check that the annotations of what is compiled together name each NamedTuple type among the arguments:
    else its fields are not read.

    Raises NotDigestible.
    """
    missing = _types_of(args).difference(*map(_annotated, known))
    if missing:
        names = ", ".join(sorted(kind.__qualname__ for kind in missing))
        raise NotDigestible(
            f"the kernel {function.__qualname__} is given {names}, which its annotations do not name: "
            "the order of its fields would not be part of the kernel's digest"
        )


def _project_function(value: Any) -> FunctionType | None:
    inner = value.function if isinstance(value, KernelFunction) else value
    is_ours = isinstance(inner, FunctionType) and f"{inner.__module__}.".startswith(LAYERS)
    return inner if is_ours else None


@cache  # kernels share most of what they call
def _paths(code: CodeType) -> tuple[tuple[str, ...], ...]:
    """The globals that the code reads, each with its chain of attributes: ("np", "linalg", "inv")."""
    return tuple(_read(code))


def _read(code: CodeType) -> Iterator[tuple[str, ...]]:
    path: tuple[str, ...] = ()
    for step in dis.get_instructions(code):
        if step.opname == "LOAD_GLOBAL":
            if path:
                yield path
            path = (step.argval,)
        elif path and step.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            path = (*path, step.argval)
        elif path and step.opname not in ("CACHE", "EXTENDED_ARG", "PUSH_NULL"):
            yield path
            path = ()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a function or a comprehension inside
            yield from _paths(constant)


def _function_text(function: FunctionType) -> str:
    if function.__closure__:
        KernelFunction(function)  # raises, with the reason
    read = {path: _value_text(function, path) for path in _paths(function.__code__)}
    defaults = [*(function.__defaults__ or ()), *sorted((function.__kwdefaults__ or {}).items())]
    return repr(
        (
            function.__module__,
            function.__qualname__,
            _code_text(function, function.__code__),
            [_text(function, "a default", value) for value in defaults],
            [_text(function, "an annotation", kind) for kind in _annotated(function)],
            sorted(read.items()),
        )
    )


def _code_text(function: FunctionType, code: CodeType) -> str:
    """The code without line numbers: a new comment changes no digest."""
    constants = [
        _code_text(function, item) if isinstance(item, CodeType) else _text(function, "a constant", item)
        for item in code.co_consts
    ]
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    flags = code.co_flags | inspect.CO_OPTIMIZED  # which numba takes away in a process that is profiled
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, flags)
    return repr((code.co_code, code.co_exceptiontable, names, counts, constants))


def _value_text(function: FunctionType, path: tuple[str, ...]) -> str:
    """The value at the end of the modules on a path, as text; attributes after it are part of that value."""
    name, *rest = path
    if name in function.__globals__:
        value = function.__globals__[name]
    elif hasattr(builtins, name):
        return f"builtin {name}"
    else:
        raise _refusal(function, name, "which is not there")
    full_name = name
    while isinstance(value, ModuleType):
        if not rest:
            raise _refusal(function, full_name, "a module, without naming at once what of it")
        attribute = rest.pop(0)
        module, full_name = value, f"{full_name}.{attribute}"
        if not hasattr(module, attribute):
            raise _refusal(function, full_name, "which is not there")
        value = getattr(module, attribute)
        if _project_function(value) is not None:
            raise _refusal(
                function, full_name, "which must be imported by its bare name to be compiled with it"
            )
    return _text(function, full_name, value)


def _text(function: FunctionType, name: str, value: Any) -> str:
    """A value as text; equal texts compile to equal code. name: of the value, for the message of a
    refusal."""
    if type(value) in LITERALS:
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, type):
        return _type_text(function, name, value)
    if isinstance(value, Enum):
        return f"{_type_text(function, name, type(value))} member {value.name}"
    if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
        return f"array {value.dtype.descr} {value.shape} {value.strides} {value.tobytes()!r}"
    if isinstance(value, np.dtype) and not value.hasobject:
        return f"dtype {value.descr}"
    if isinstance(value, (tuple, frozenset)):
        inner = [_text(function, name, item) for item in value]
        kind = _type_text(function, name, type(value))
        return f"{kind} {sorted(inner) if isinstance(value, frozenset) else inner}"
    inner_function = _project_function(value)
    if inner_function is not None:  # its code is digested too, under its own reading
        return f"function {inner_function.__module__}.{inner_function.__qualname__}"
    if callable(value) and _is_known(type(value)) and _is_known(value):
        return f"function {getattr(value, '__module__', '')}.{value.__name__}"
    raise _refusal(function, name, f"which is {type(value).__name__}")


def _type_text(function: FunctionType, name: str, kind: type) -> str:
    """A type by name, with all that a kernel can read of it: members of an enum, fields of a NamedTuple."""
    known = f"type {kind.__module__}.{kind.__qualname__}"
    if issubclass(kind, Enum):
        members = {key: _text(function, name, item.value) for key, item in kind.__members__.items()}
        return f"{known} {members}"
    if _is_named_tuple(kind):
        fields: Any = kind
        defaults = {key: _text(function, name, item) for key, item in fields._field_defaults.items()}
        return f"{known} {fields._fields} {defaults}"
    if _is_known(kind) or issubclass(kind, Exception):
        return known
    raise _refusal(function, name, "a class that is neither an enum nor a NamedTuple")


def _is_known(value: Any) -> bool:
    return str(getattr(value, "__module__", None) or "builtins").partition(".")[0] in KNOWN_PACKAGES


def _is_named_tuple(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def _annotated(function: FunctionType) -> list[type]:
    """The NamedTuple types in the annotations of a function, with those of their fields."""
    found: list[type] = []
    queue: list[Any] = list(_hints(function, function))
    while queue:
        kind = queue.pop(0)
        queue += typing.get_args(kind)
        if _is_named_tuple(kind) and kind not in found:
            found.append(kind)
            queue += _hints(function, kind)
    return found


def _hints(function: FunctionType, of: Any) -> list[Any]:
    try:
        return list(typing.get_type_hints(of).values())
    except NameError as error:
        raise _refusal(function, f"annotations of {of.__qualname__}", f"of which {error}") from None


def _types_of(value: Any) -> set[type]:
    """The NamedTuple types in a value."""
    if not isinstance(value, tuple):
        return set()
    inner = {kind for item in value for kind in _types_of(item)}
    return inner | {type(value)} if _is_named_tuple(type(value)) else inner


def _refusal(function: FunctionType, name: str, what: str) -> NotDigestible:
    return NotDigestible(
        f"the kernel {function.__qualname__} of {function.__module__} reads {name}, {what}: code that was "
        f"compiled for one value of it would be used for another; kernels may read {READABLE}"
    )
