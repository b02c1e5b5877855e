"""python-can as a recorder needs it: without asammdf."""

import importlib
import sys


def import_can() -> None:
    """Import python-can before anybody else does, without asammdf, which it would import to read MF4 logs.

    Where that is installed it brings pandas along: 100 MB and two seconds that a daemon never uses. Told that
    there is none, python-can goes without.
    """
    if "can" in sys.modules or "asammdf" in sys.modules:
        return
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # what Python takes for "not installed"
    try:
        importlib.import_module("can")
    finally:
        del sys.modules["asammdf"]
