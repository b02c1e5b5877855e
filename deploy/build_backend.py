"""setuptools, as it builds any package; a wheel's build also needs what kernels are compiled with and for."""

from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import (  # noqa: F401  # the rest of the interface of PEP 517 and 660
    build_editable,
    build_sdist,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)


def get_requires_for_build_wheel(config_settings: Any = None) -> list[str]:
    """The versions that are installed with it: code compiled for others would not be used."""
    needed = Path("deploy/constraints.txt").read_text(encoding="utf-8").splitlines()
    return [*build_meta.get_requires_for_build_wheel(config_settings), *needed]
