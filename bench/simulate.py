"""How many times real time does a scenario run, and how does that compare with a general integrator?

    python bench/simulate.py [--seconds N]

The plant alone against the same equations given to scipy's solve_ivp, as one would without a kernel; then
whole scenarios: driving, frames, and all three files on disk.
"""

import argparse
import os
import platform
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from timing import best

from tilth.estimator.models import nonlinear
from tilth.schemas.machine import Machine
from tilth.simulator.drive import drive
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import traffic

SCENARIOS = Path(__file__).resolve().parents[1] / "examples" / "scenarios"
OUTPUTS = ("demo", "row_autosteer", "side_slope", "soil_change", "field_day")
REFERENCE_S = 10.0  # of the run that solve_ivp gets


def reference(truth: Truth, until_s: float) -> NDArray[np.float64]:
    """The last state by solve_ivp with the same inputs, no step longer than the kernel's."""

    def slope(t: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
        delta = float(np.interp(t, truth.time, truth.wheel_angle))
        return nonlinear.derivative(truth.rig, x, nonlinear.inputs_of(1, delta=delta, speed=4.5)[0])

    span = (0.0, until_s)
    return np.asarray(
        solve_ivp(slope, span, truth.states[0], max_step=nonlinear.NONLINEAR.max_step_s).y[:, -1]
    )


def count(machine: Machine, truth: Truth) -> int:
    return sum(1 for _ in traffic(machine, truth))


def plant(machine: Machine, seconds: float) -> None:
    even = Scenario(speed_sd=0.0)
    drive(machine, 1, seconds, even)  # compiled from here on
    truth = drive(machine, 1, seconds, even)
    ours = seconds / best(lambda: drive(machine, 1, seconds, even))
    start = time.perf_counter()
    last = reference(truth, REFERENCE_S)
    other = REFERENCE_S / (time.perf_counter() - start)
    off = np.abs(last - truth.states[round(REFERENCE_S / 0.01)])[:2].max()
    print(f"plant: {ours:.0f} times real time, solve_ivp {other:.1f}; ratio {ours / other:.0f}")
    print(f"       ({off * 1e3:.2f} mm apart after {REFERENCE_S:.0f} s)")


def scenarios(machine: Machine, text: str, seconds: float) -> None:
    print(f"\n{'times real time':16} {'driving':>9} {'frames':>9} {'both':>9} {'to disk':>9}")
    for name in OUTPUTS:
        scenario_text = (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8")
        scenario = parse_scenario(scenario_text)
        truth = drive(machine, 1, seconds, scenario)
        driving = best(partial(drive, machine, 1, seconds, scenario))
        frames = best(partial(count, machine, truth))
        source = SimulationInput(machine, text, scenario, scenario_text, 1, seconds)
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            simulate_to(source, Path(folder) / "run.mcap")
            disk = time.perf_counter() - start
        rates = (seconds / t for t in (driving, frames, driving + frames, disk))
        print(f"{name:16} " + " ".join(f"{rate:9.0f}" for rate in rates))


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the virtual tractor.")
    parser.add_argument("--seconds", type=float, default=90.0, help="of driving")
    args = parser.parse_args()
    machine, text = packaged_file()
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}, {args.seconds:.0f} s of driving")
    plant(machine, args.seconds)
    scenarios(machine, text, args.seconds)


if __name__ == "__main__":
    main()
