"""A drive that tells all that a calibration looks for."""

from pathlib import Path

from logs import MACHINE, MACHINE_TEXT, with_exact_lengths

from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to

DRIVE = """
seconds = 160.0
noise = 0.5
speed = [
    [12.0, 0.0], [16.0, 3.0], [22.0, 1.8], [16.0, 3.5], [26.0, 1.4], [26.0, 1.4], [20.0, 1.8], [22.0, 4.0],
]
steering = [
    [12.0, 0.0], [16.0, 0.0], [22.0, -25.0], [16.0, 0.0], [26.0, 20.0], [26.0, -22.0],
    [5.0, 26.0], [5.0, -26.0], [5.0, 26.0], [5.0, -26.0], [22.0, "random"],
]
[soil]
grip = 0.7
rolling = 0.06
[ground]
slope_deg = 1.5
"""


def simulated_drive(folder: Path, text: str) -> Path:
    scenario: Scenario = parse_scenario(text)
    log = folder / "drive.mcap"
    source = SimulationInput(with_exact_lengths(MACHINE), MACHINE_TEXT, scenario, text, 3, scenario.seconds)
    simulate_to(source, log, lambda what, at_s: None)
    return log
