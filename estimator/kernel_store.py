"""Where compiled kernels lie: in the package, which carries them as built, else where numba keeps them.

A wheel is built for a baseline that all processors of a family have had for ten years, and a checkout
compiles for the same. A processor that lacks the baseline compiles for itself, at the first start.

The name of a file holds the digest of all that is compiled into it (kernel_digest.py) and what it is compiled
for, so that what is found by its name is never stale, wherever it was built.
"""

import functools
import platform
from importlib import resources
from typing import Any, Final

from llvmlite.binding import get_host_cpu_features, get_host_cpu_name
from numba.core import config
from numba.core.caching import FunctionCache, InTreeCacheLocator

BASELINES: Final = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "aarch64": ("generic", ()),  # armv8-a
}
"""Processor family -> what LLVM calls its baseline, and the features that make it up."""
LACKING: Final = (
    "this processor ({}) lacks {}: a package's kernels are not for it, so they are compiled for it once, "
    "at the installation or the first start"
)
PACKAGED: Final = resources.files("tilth.estimator") / "kernels"
_asked: Final[set[str]] = set()  # names of functions, with their digests, that this process looked for


class InPackage(InTreeCacheLocator):
    """numba's locator of kernels in the package: of those that it holds, even if it cannot be written, and of
    others where numba was told no folder for them, as in a checkout and while a wheel is built."""

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)  # type: ignore[no-untyped-call]
        self._cache_path = str(PACKAGED)

    def get_source_stamp(self) -> Any:
        return ""  # the name says all

    def get_disambiguator(self) -> str:
        return target()

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        _asked.add(py_func.__qualname__)
        if any(py_func.__qualname__ in name for name in _names()):
            return cls(py_func, py_file)
        elsewhere = config.CACHE_DIR or not PACKAGED.is_dir()  # type: ignore[attr-defined]
        return None if elsewhere else super().from_function(py_func, py_file)  # type: ignore[no-untyped-call]


def choose() -> str:
    """Have numba look here and compile for the baseline, unless it was told otherwise. Returns the target."""
    settings: Any = config  # numba sets its attributes itself
    if not settings.CACHE_LOCATOR_CLASSES:
        ours = f"{__name__}.{InPackage.__name__}"
        settings.CACHE_LOCATOR_CLASSES = f"{ours},UserProvidedCacheLocator,UserWideCacheLocator"
    if settings.CPU_NAME is None and not lacking():
        settings.CPU_NAME, settings.CPU_FEATURES = BASELINES[platform.machine()][0], ""
    return target()


def folder() -> str:
    """Where kernels are, or would be kept; "" where they cannot be."""
    choose()
    if any(f"-{target()}." in name for name in _names()):
        return str(PACKAGED)
    try:
        return str(FunctionCache(folder).cache_path)
    except RuntimeError:
        return ""


def lacking() -> str:
    """What this processor lacks of its family's baseline, and what follows from it; "" where it has all."""
    family, there = platform.machine(), get_host_cpu_features()
    if family not in BASELINES:
        return LACKING.format(family, "a baseline")
    lacks = [feature for feature in BASELINES[family][1] if not there.get(feature, False)]
    return LACKING.format(family, ", ".join(lacks)) if lacks else ""


def target() -> str:
    """What kernels are compiled for: a name without a slash."""
    settings: Any = config
    name: str = settings.CPU_NAME or get_host_cpu_name()
    return name


def is_used(name: str) -> bool:
    """Whether this process has a use for a file of the package's kernels: not for one of sources as they were
    once, of other processors, of other Pythons."""
    return f"-{target()}." in name and any(asked in name for asked in _asked)


@functools.cache
def _names() -> frozenset[str]:
    """Of the files that the package held when the process first asked."""
    return frozenset(entry.name for entry in PACKAGED.iterdir()) if PACKAGED.is_dir() else frozenset()
