"""Numeric kernels: compiled by numba at their first call, plain Python where numba is absent or cannot.

A kernel is an ordinary function of floats, tuples and arrays. It may call other functions of this layer and
of schemas by their bare names, which are compiled with it, so that an equation is written once for both
worlds. numba is imported at the first call of a kernel and not before: who needs none does not pay for it.
Compiled code is kept on disk under a name that holds a digest of all the functions in it.
"""

import hashlib
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

LAYERS = ("tilth.schemas", "tilth.estimator")


class Kernel(Generic[P, R]):
    """A function that compiles itself when it is first called. `how` says what became of it."""

    __slots__ = ("_run", "function", "how")

    def __init__(self, function: Callable[P, R]) -> None:
        assert isinstance(function, FunctionType)
        self.function: FunctionType = function
        self.how = "not called yet"  # then "compiled and kept", "compiled" or "interpreted: <reason>"
        self._run: Callable[P, R] | None = None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        assert not kwargs, "a kernel takes its arguments in order"
        if self._run is None:
            self._run = self._compile(args)
        return self._run(*args, **kwargs)

    def functions(self) -> list[FunctionType]:
        """All that is compiled with it, itself included."""
        made: dict[FunctionType, Any] = {}
        _linked(self.function, made, lambda linked: linked)
        return list(made)

    def plain(self) -> Callable[P, R]:
        """The same equations, interpreted."""
        made: dict[FunctionType, Any] = {}
        run: Callable[P, R] = _linked(self.function, made, lambda linked: linked)
        return run

    def _compile(self, args: tuple[Any, ...]) -> Callable[P, R]:
        """Compiled for arguments of these types, kept on disk if there is a place; else interpreted."""
        try:
            import numba
        except (ImportError, OSError) as error:
            self.how = f"interpreted: {error}"
            return self.plain()
        for how, keep in (("compiled and kept", True), ("compiled", False)):
            try:
                run = _linked(self.function, {}, numba.njit(cache=keep))
                run.compile(tuple(map(numba.typeof, args)))
            except Exception as error:  # whatever a compiler may say: the equations can still be interpreted
                self.how = f"interpreted: {type(error).__name__} {str(error)[:200]}"
                continue
            self.how = how
            made: Callable[P, R] = run
            return made
        return self.plain()


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Decorator: see the head of this file."""
    return Kernel(function)


def _linked(
    function: FunctionType, made: dict[FunctionType, Any], finish: Callable[[FunctionType], Any]
) -> Any:
    """`finish` of the function, after each function of LAYERS that it calls was replaced by the same."""
    if function not in made:
        scope = dict(function.__globals__)
        for name, inner in _called(function).items():
            scope[name] = _linked(inner, made, finish)
        linked = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
        linked.__module__ = function.__module__
        linked.__qualname__ = f"{function.__qualname__}-{_digest(function)}"
        made[function] = finish(linked)
    return made[function]


def _called(function: FunctionType) -> dict[str, FunctionType]:
    """The functions of LAYERS that a function names."""
    found = {}
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        inner = value.function if isinstance(value, Kernel) else value
        if isinstance(inner, FunctionType) and inner.__module__.startswith(LAYERS):
            found[name] = inner
    return found


def _digest(function: FunctionType) -> str:
    """Of what a function does: its code, the constants it names, and so on with all that it calls."""
    called, code = _called(function), function.__code__
    globals_ = [function.__globals__.get(name) for name in code.co_names if name not in called]
    constants = [c for c in (*globals_, *code.co_consts) if isinstance(c, (bool, int, float, str, tuple))]
    text = repr([code.co_code, code.co_names, [c for c in constants if not isinstance(c, CodeType)]])
    text += "".join(_digest(called[name]) for name in sorted(called))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
