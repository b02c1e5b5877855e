"""This computer as another kind of processor would be, for processes that tests start."""

import os

DISGUISES = {
    "another BLAS kernel": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "one without AVX": {"OPENBLAS_CORETYPE": "Nehalem"},
    "no fused multiply-add": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"},
    "no AVX-512": {
        "OPENBLAS_CORETYPE": "Haswell",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512DQ,-AVX512BW",
        "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX",
    },
}
"""The same computer as another would be; on x86-64 with OpenBLAS and glibc."""


def disguised(name: str) -> dict[str, str]:
    """The environment of a process in disguise."""
    plain = {key: value for key, value in os.environ.items() if not key.startswith("OPENBLAS_CORE")}
    return plain | {"OPENBLAS_NUM_THREADS": "1"} | DISGUISES[name]
