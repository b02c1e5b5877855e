"""`tilth calibrate --live` beside a real daemon: what was driven an hour ago is in its log folder, and the
tractor parks now. So a test need not drive for a quarter of an hour."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from field_rig import FieldRig
from loopback import PATIENCE_S

from tilth.logger.clock import Clock
from tilth.logger.log.runs import file_name, run_name
from tilth.simulator.scenario import parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to

HOUR_S = 3600
SECOND = 1_000_000_000
# As short as calibration takes it; less than LEAST_S of it moves, so no estimate begins by itself.
DRIVE = """
seconds = 65.0
noise = 0.5
clock_offset_s = 0.0
speed = [[2.0, 0.0], [9.0, 3.0], [14.0, 1.8], [13.0, 1.6], [13.0, 1.6], [14.0, 3.5]]
steering = [[2.0, 0.0], [9.0, 0.0], [14.0, -25.0], [13.0, 20.0], [13.0, -22.0], [14.0, 0.0]]
[soil]
grip = 0.7
rolling = 0.06
[ground]
slope_deg = 1.5
"""
PARKED = parse_scenario(
    "seconds = 60.0\nclock_offset_s = 0.0\nsteering = [[60.0, 0.0]]\nspeed = [[60.0, 0.0]]"
)
START = "import sys; from tilth.cli import main; sys.exit(main())"


def drive_before(rig: FieldRig, text: str = DRIVE) -> Path:
    """A run of an hour ago in the folder of the daemon."""
    began_s = Clock().t_ns() // SECOND - HOUR_S
    scenario = replace(parse_scenario(text), utc_start_ns=began_s * SECOND)
    log = rig.folder / file_name(run_name(rig.machine.name, began_s * SECOND), 1)
    source = SimulationInput(rig.machine, rig.text, scenario, text, 3, scenario.seconds)
    simulate_to(source, log, lambda what, at_s: None)
    return log


@contextmanager
def calibrating(*words: str) -> Iterator[subprocess.Popen[str]]:
    """The command as a person starts it where there is no terminal."""
    process = subprocess.Popen(
        [sys.executable, "-c", START, "calibrate", "--live", *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate(timeout=PATIENCE_S)
