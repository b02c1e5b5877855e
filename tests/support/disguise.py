"""This computer as another kind of processor would be, for processes that tests start."""

import os
import subprocess
from pathlib import Path

from recorded import once

DISGUISES = {
    "another BLAS kernel": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "one without AVX": {"OPENBLAS_CORETYPE": "Nehalem"},
    "no fused multiply-add": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"},
    "no AVX-512": {
        "OPENBLAS_CORETYPE": "Haswell",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512DQ,-AVX512BW",
        "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX",
    },
    "another libm": {},
}
"""The same computer as another would be; on x86-64 with OpenBLAS and glibc."""
MUSL = Path("/usr/lib/x86_64-linux-musl/libc.a")  # of Debian's musl-dev
_MATHEMATICS = (
    "sin", "cos", "sincos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh",
    "atanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "cbrt", "hypot",
)  # fmt: skip


def disguised(name: str) -> dict[str, str]:
    """The environment of a process in disguise."""
    plain = {key: value for key, value in os.environ.items() if not key.startswith("OPENBLAS_CORE")}
    libm = {"LD_PRELOAD": str(once("musl", _musl))} if name == "another libm" else {}
    return plain | {"OPENBLAS_NUM_THREADS": "1"} | DISGUISES[name] | libm


def _musl(folder: Path) -> Path:
    """A library that answers before glibc's: the same functions from musl."""
    made, shown = folder / "libm_musl.so", folder / "shown"
    shown.write_text("{ global: " + "; ".join(_MATHEMATICS) + "; local: *; };")
    words = ["gcc", "-shared", "-nostdlib", f"-Wl,--version-script={shown}", "-o", str(made)]
    subprocess.run([*words, *(f"-Wl,-u,{name}" for name in _MATHEMATICS), str(MUSL)], check=True)
    return made
