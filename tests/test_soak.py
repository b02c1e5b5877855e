"""A season in short: the whole daemon under the load of four full buses, noise by the million."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from test_socketcan import Wire, fuzz

pytestmark = pytest.mark.soak
BENCH = Path(__file__).resolve().parents[1] / "bench/recorder.py"


def test_four_full_buses_lose_nothing() -> None:
    """`python bench/recorder.py soak --seconds 600` is the same for ten minutes."""
    command = [sys.executable, str(BENCH), "soak", "--seconds", "20"]
    said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert said["sent"] == said["recorded"] == 7600 * 20 and said["lost"] == said["lost_in_kernel"] == 0
    assert said["resident_mb"][-1] < said["resident_mb"][0] + 100


def test_a_million_mutated_frames() -> None:
    wire = Wire()
    fuzz(wire, 1_000_000)
    wire.close()
