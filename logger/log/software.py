"""What computes here: versions of all that does, and the kind of arithmetic that the processor gives.

It stands in each log (metadata record "tilth"). Where it is the same, a replay gives the bytes that were
logged; elsewhere the libraries of mathematics and of linear algebra round otherwise in the last digits.
"""

import ctypes
import hashlib
import itertools
import math
import platform
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from tilth import estimator, schemas

PACKAGES: Final = (
    "python-can", "cantools", "mcap", "protobuf", "foxglove-schemas-protobuf", "eclipse-zenoh", "numpy",
    "scipy", "numba", "llvmlite", "pyproj", "pydantic",
)  # fmt: skip
OF_NUMBERS: Final = {
    "processor": "", "arithmetic": "arithmetic ", "blas": "", "libc": "", "python": "Python ",
    "version": "tilth ", "numpy": "numpy ", "scipy": "scipy ", "numba": "numba ", "llvmlite": "llvmlite ",
    "pyproj": "pyproj ",
}  # fmt: skip
"""What the last digit of a result depends on: key of the metadata -> how its value is introduced."""
_MATHEMATICS: Final[tuple[Callable[[float], float], ...]] = (
    math.sin, math.cos, math.tan, math.atan, math.exp, math.expm1, math.log, math.log1p, math.tanh, math.sinh,
)  # fmt: skip
_PRODUCTS: Final = (2, 3, 6, 13, 24, 40)  # rows of the matrices whose products and factors are looked at


@cache  # a search of the disk, and each new file of a run asks
def software() -> dict[str, str]:
    """Versions of all that computes and the kind of arithmetic, for the metadata record "tilth"."""

    def of(package: str) -> str:
        try:
            return version(package)
        except PackageNotFoundError:
            return "not installed"

    return {
        "version": of("tilth"),
        "python": platform.python_version(),
        "system": platform.platform(),
        "processor": platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "blas": _linear_algebra(),
        "arithmetic": _arithmetic(),
        "estimator": _estimator(),
        **{package: of(package) for package in PACKAGES},
    }


def computed_elsewhere(recorded: Mapping[str, str]) -> str:
    """What was other than here where a log was recorded; "" where its results are equal here to the byte.

    recorded: the log's metadata record "tilth". What older logs do not tell counts as equal.
    """
    here = software()
    other = [
        f"{word}{recorded[key]}, here {here[key]}"
        for key, word in OF_NUMBERS.items()
        if recorded.get(key, here[key]) != here[key]
    ]
    return "; ".join(other)


def _linear_algebra() -> str:
    """The libraries and the kernels that they chose for this processor."""
    import scipy.linalg.cython_blas  # noqa: F401  # loads what compiled kernels call
    from threadpoolctl import threadpool_info

    found = {
        f"{one['internal_api']} {one['version']} {one.get('architecture', '')}".strip()
        for one in threadpool_info()
        if one["user_api"] == "blas"
    }
    return ", ".join(sorted(found))


def _estimator() -> str:
    """A digest of the code that estimates: a version may be changed in a checkout."""
    found = hashlib.sha256()
    for package in (estimator, schemas):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            found.update(path.read_bytes())
    return found.hexdigest()[:12]


def _arithmetic() -> str:
    """A digest of last digits: equal where both libraries compute in the same way, whatever processor it is.

    What a processor can do is told nowhere completely: a library may be kept from using it.
    """
    found = hashlib.sha256()
    for part in _last_digits():
        found.update(part)
    return found.hexdigest()[:12]


def _last_digits() -> Iterator[bytes]:
    import numpy as np
    from scipy.linalg import get_blas_funcs, get_lapack_funcs

    arguments = [(k * 7919 % 4001 + 1) / 1009 for k in range(1500)]
    for function in _MATHEMATICS:
        yield b"".join(ctypes.c_double(function(x)) for x in arguments)
    yield b"".join(ctypes.c_double(math.atan2(x, y)) for x, y in itertools.pairwise(arguments))
    yield b"".join(ctypes.c_double(x**0.37) for x in arguments)
    gemm, gemv = get_blas_funcs(("gemm", "gemv"), dtype=np.float64)
    potrf, gesv = get_lapack_funcs(("potrf", "gesv"), dtype=np.float64)
    for n in _PRODUCTS:
        a = np.resize(np.array(arguments), (n, n + 1))
        square = a[:, :n] @ a[:, :n].T + n * np.eye(n)
        yield (a @ a.T).tobytes() + (a @ a[0]).tobytes() + np.linalg.inv(square).tobytes()
        yield gemm(1.0, a, a.T).tobytes() + gemv(1.0, a, a[0]).tobytes()
        yield potrf(square)[0].tobytes() + gesv(square, a)[2].tobytes()
        yield np.linalg.eigh(square)[0].tobytes() + np.linalg.svd(a)[1].tobytes()
