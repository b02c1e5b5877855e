"""Numeric kernels: compiled by numba at their first call, interpreted where numba is absent or fails. That it
failed is a warning, since what took seconds takes minutes then.

A kernel is an ordinary function of floats, tuples and arrays. It may call other functions of estimator and
schemas by their bare names; they are compiled with it. So an equation is written once, for compiled and for
interpreted code. numba is imported at the first call of a kernel: a program that calls none does not wait for
the import. Compiled code is stored on disk. Its name holds a digest of all that is compiled into it
(kernel_digest.py).

Other threads run while a kernel does: the fold of a replay beside a fit.

Code of numba counts who holds each array: a call with a tuple of twenty arrays counts forty times, by locked
instructions. An inner kernel makes no array, so it does without: with the counting a fit takes 1.3 to 1.5
times as long, a segment of the tracker 1.8 times, and all take 1.1 times as long to compile.

numba also optimises all that a function calls anew with each of its callers: code seven calls deep seven
times. So a step of a long chain that has few callers is inline, and the arrays of a run are made in Python,
not by a kernel around its loop. A function with many callers, or a short one, compiles sooner by itself. Each
type of an argument is compiled for, and to numba the constant 0 is one of its own.
"""

import functools
import gc
import importlib.util
import warnings
from collections.abc import Callable
from hashlib import sha256
from types import FunctionType
from typing import Any, Final, Generic, ParamSpec, TypeVar, cast

from tilth.estimator import kernel_digest
from tilth.estimator.kernel_digest import OPTION, called

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS: Final = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": True}
"""Of the compiler. As numpy's arrays, kernels divide by zero without an error; nobody needs a C function.
`_nrt`, whether it counts who holds an array, is said of all: else a function takes it from its caller."""

INNER: Final = {"_nrt": False}  # numba's stubs do not name it; its own functions use it in the same way
INLINE: Final = {"inline": "always"}

Finish = Callable[[FunctionType, FunctionType], Any]  # (linked copy, function as written)


class InterpretedWarning(RuntimeWarning):
    """numba could not compile a kernel."""


class Kernel(Generic[P, R]):
    """A function that compiles itself at its first call. `how` says whether it was compiled."""

    __slots__ = ("_run", "function", "how")

    def __init__(self, function: Callable[P, R]) -> None:
        assert isinstance(function, FunctionType)
        if function.__closure__:
            names = ", ".join(function.__code__.co_freevars)
            raise TypeError(
                f"the kernel {function.__qualname__} uses {names} of the function around it: make it an "
                "argument or a constant of the module"
            )
        self.function = function
        self.how = (
            "not called yet"  # later "compiled and kept" (on disk), "compiled", "interpreted: <reason>"
        )
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
        """All functions that are compiled together, this one included, without those that are inline."""
        linked: dict[FunctionType, Any] = {}
        _linked(self.function, linked, lambda copy, written: copy)
        return [written for written in linked if written.__dict__.get(OPTION) != INLINE]

    def with_steps(self, **steps: Callable[..., Any]) -> "Kernel[P, R]":
        """The same kernel where these names, of functions that it calls, mean other ones: a loop with steps
        of its user. Raises KeyError for a name that it does not call."""
        written = self.function
        missing = steps.keys() - called(written).keys()
        if missing:
            raise KeyError(f"{written.__qualname__} does not call {', '.join(sorted(missing))}")
        return Kernel(_copied(written, written.__globals__ | steps))

    def interpreted(self) -> Callable[P, R]:
        """The same equations, interpreted."""
        linked: Callable[P, R] = _linked(self.function, {}, lambda copy, written: copy)
        return linked

    def _compile(self, args: tuple[Any, ...]) -> Callable[P, R]:
        """The function compiled for arguments of these types, else interpreted.

        The code is stored on disk if a folder for it can be written."""
        try:
            import numba
            import numpy
            from numba.core import config

            from tilth.estimator import kernel_store
        except (ImportError, OSError) as error:
            self.how = f"interpreted: {error}"
            return self.interpreted()
        for_what = (kernel_store.choose(), numba.__version__, numpy.__version__, importlib.util.MAGIC_NUMBER)
        known: kernel_digest.Known = {}
        given = kernel_digest.kinds(args, known)
        for how, keep in (("compiled and kept", True), ("compiled", False)):

            def finish(copy: FunctionType, written: FunctionType, keep: bool = keep) -> Any:
                within = written is not self.function  # who calls it from Python calls another copy
                read = kernel_digest.digest(written, known)
                told = repr((read, within or given, for_what, OPTIONS))
                copy.__qualname__ = f"{written.__qualname__}-{sha256(told.encode()).hexdigest()[:16]}"
                told_of = written.__dict__.get(OPTION, {})
                own = {"cache": keep and told_of != INLINE, "no_cpython_wrapper": within}
                options: dict[str, Any] = OPTIONS | own | told_of
                return numba.njit(**options)(copy)

            collecting = gc.isenabled()
            gc.disable()  # the compiler's objects are many and stay: looking through them takes a tenth of it
            try:
                linked: Any = _linked(self.function, {}, finish)
                linked.compile(tuple(map(numba.typeof, args)))
            except Exception as error:  # any failure of the compiler: the equations can still be interpreted
                self.how = f"interpreted: {type(error).__name__} {str(error)[:200]}"
            else:
                self.how = how
                return cast(Callable[P, R], linked)
            finally:
                if collecting:
                    gc.enable()
        if not getattr(config, "DISABLE_JIT", 0):  # where nobody has asked for it
            warnings.warn(f"{self.function.__qualname__} is {self.how}", InterpretedWarning, stacklevel=3)
        return self.interpreted()


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Decorator that makes a function a kernel; see the head of this file."""
    return Kernel(function)


def inner_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Decorator of a kernel that makes no array and returns none: it works in those that it is given."""
    function.__dict__[OPTION] = INNER
    return Kernel(function)


def inline_kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Decorator of a kernel that is compiled only as a part of those that call it. Within an inner kernel it
    makes no array either."""
    function.__dict__[OPTION] = INLINE
    return Kernel(function)


def _linked(function: FunctionType, linked: dict[FunctionType, Any], finish: Finish) -> Any:
    """`finish` of a copy of the function, which calls the linked copies of the functions that it called.

    linked: function as written -> its linked copy, of those made so far; added to.
    """
    if function not in linked:
        scope = dict(function.__globals__)
        for name, inner in called(function).items():
            scope[name] = _linked(inner, linked, finish)
        linked[function] = finish(_copied(function, scope), function)
    return linked[function]


def _copied(function: FunctionType, scope: dict[str, Any]) -> FunctionType:
    """The function with other globals."""
    copy = FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
    functools.update_wrapper(copy, function)
    return copy
