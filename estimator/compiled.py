"""Numeric kernels: compiled by numba at their first call, plain Python where numba is absent or cannot.

A kernel is an ordinary function of floats, tuples and arrays. It may call other functions of this layer and
of schemas by their bare names, which are compiled with it, so that an equation is written once for both
worlds. numba is imported at the first call of a kernel and not before: who needs none does not pay for it.
Compiled code is kept on disk under a name that holds a digest of all that is compiled into it
(kernel_digest.py); a kernel that reads what cannot be part of the digest is refused at its first call.
"""

import importlib.util
from collections.abc import Callable
from types import FunctionType
from typing import Any, Generic, ParamSpec, TypeVar

from tilth.estimator import kernel_digest
from tilth.estimator.kernel_digest import KernelFunction, called

P = ParamSpec("P")
R = TypeVar("R")

Finish = Callable[[FunctionType, FunctionType], Any]  # (linked function, function as written)


class Kernel(KernelFunction, Generic[P, R]):
    """A function that compiles itself when it is first called. `how` says what became of it."""

    __slots__ = ("_run", "how")

    def __init__(self, function: Callable[P, R]) -> None:
        assert isinstance(function, FunctionType)
        super().__init__(function)
        self.how = "not called yet"  # then "compiled and kept", "compiled" or "interpreted: <reason>"
        self._run: Callable[P, R] | None = None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        assert not kwargs, "a kernel takes its arguments in order"
        if self._run is None:
            self._run = self._compile(args)
        return self._run(*args, **kwargs)

    @property
    def called(self) -> bool:
        """Whether it is compiled, or interpreted for want of a compiler, in this process already."""
        return self._run is not None

    def functions(self) -> list[FunctionType]:
        """All that is compiled with it, itself included."""
        made: dict[FunctionType, Any] = {}
        _linked(self.function, made, lambda linked, written: linked)
        return list(made)

    def plain(self) -> Callable[P, R]:
        """The same equations, interpreted."""
        run: Callable[P, R] = _linked(self.function, {}, lambda linked, written: linked)
        return run

    def _compile(self, args: tuple[Any, ...]) -> Callable[P, R]:
        """Compiled for arguments of these types, kept on disk if there is a place; else interpreted.

        Raises NotDigestible, also where numba is absent: a mistake in a kernel shows on every computer.
        """
        kernel_digest.check_arguments(self.function, args)
        known = kernel_digest.readings(self.function)
        try:
            import numba
            import numpy
        except (ImportError, OSError) as error:
            self.how = f"interpreted: {error}"
            return self.plain()
        versions = repr((numba.__version__, numpy.__version__, importlib.util.MAGIC_NUMBER))
        for how, keep in (("compiled and kept", True), ("compiled", False)):
            compiler = numba.njit(cache=keep)

            def finish(linked: FunctionType, written: FunctionType, compiler: Any = compiler) -> Any:
                digest = kernel_digest.digest(written, known, versions)
                linked.__qualname__ = f"{written.__qualname__}-{digest}"
                return compiler(linked)

            try:
                run = _linked(self.function, {}, finish)
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


def _linked(function: FunctionType, made: dict[FunctionType, Any], finish: Finish) -> Any:
    """`finish` of the function, after each function that it calls was replaced by the same."""
    if function not in made:
        scope = dict(function.__globals__)
        for name, inner in called(function).items():
            scope[name] = _linked(inner, made, finish)
        linked = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
        linked.__kwdefaults__ = function.__kwdefaults__
        linked.__module__ = function.__module__
        linked.__qualname__ = function.__qualname__
        made[function] = finish(linked, function)
    return made[function]
