"""A season in short: the whole daemon under the load of four full buses."""

import json
import subprocess
import sys

import pytest
from paths import ROOT

pytestmark = pytest.mark.soak
BENCH = ROOT / "bench/recorder.py"


def test_four_full_buses_lose_nothing() -> None:
    """`python bench/recorder.py soak --seconds 600` is the same for ten minutes."""
    command = [sys.executable, str(BENCH), "soak", "--seconds", "20"]
    output = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (
        output["sent"] == output["recorded"] == 7600 * 20 and output["lost"] == output["lost_in_kernel"] == 0
    )
    assert output["resident_mb"][-1] < output["resident_mb"][0] + 100
