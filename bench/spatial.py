"""How many seconds does the spatial plant simulate in one?

    python bench/spatial.py [--seconds N]

Beside it the planar plant on the same drive, which has no bodies in space to solve.
"""

import argparse
import os
import platform

from timing import best

from tilth.schemas.machine import Machine
from tilth.simulator.drive import drive
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import DrivenManoeuvre, Ground, Scenario, Spatial
from tilth.simulator.spatial.engine import NotInstalled, check_installed

STEERING = DrivenManoeuvre("random", 6.0)
CASES = {
    "planar": Scenario(steering=STEERING),
    "spatial, even ground": Scenario(plant="spatial", steering=STEERING),
    "spatial, 1 cm": Scenario(plant="spatial", steering=STEERING, ground=Ground(rms=0.01)),
    "spatial, 1 cm, 1 ms": Scenario(
        plant="spatial", steering=STEERING, ground=Ground(rms=0.01), spatial=Spatial(step=0.001)
    ),
}


def rate(machine: Machine, scenario: Scenario, seconds: float) -> float:
    """Simulated seconds in one."""
    drive(machine, 1, seconds, scenario)  # compiled from here on
    return seconds / best(lambda: drive(machine, 1, seconds, scenario))


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the virtual tractor in space.")
    parser.add_argument("--seconds", type=float, default=60.0, help="of driving")
    args = parser.parse_args()
    try:
        check_installed()
    except NotInstalled as error:
        raise SystemExit(str(error)) from None
    machine = packaged_file().machine
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}, {args.seconds:.0f} s of driving")
    for name, scenario in CASES.items():
        print(f"{name:22} {rate(machine, scenario, args.seconds):7.0f} times real time")


if __name__ == "__main__":
    main()
