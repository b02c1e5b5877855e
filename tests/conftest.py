"""Options of the test run."""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: on few cores its threads wait for each other


import can  # noqa: F401  whole, with what reads MF4, before a command imports it lean
import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--refresh", action="store_true", help="write the golden files anew instead of comparing"
    )
