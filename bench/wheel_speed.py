"""How soon other tyres are found by the wheels' speed, and how often slip is taken for them.

    python bench/wheel_speed.py [--seeds 40]

By speeds alone (tests/support/slipping_drive.py), without CAN; two minutes. Prints events in fields where no
tyre was changed, with implements that are lifted on headlands and with ones that never are, and delays after
a change.
"""

import argparse
import itertools
import math
import sys
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from slipping_drive import FACTOR, MACHINE, SlippingDrive, with_factor

from tilth.schemas.diagnosis import DiagnosisState

FIELDS, MINUTES = 6, 25.0
STAND_S: Final = 1000.0
LIMIT_NS: Final = 1_800_000_000_000
MACHINES: Final = {"no factor in the file": MACHINE, "factor in the file": with_factor(FACTOR)}


def false_events(key: str, lifts: bool, stand_s: float, seeds: int) -> int:
    count = 0
    for seed in range(seeds):
        row = float(np.random.default_rng(seed).uniform(100.0, 600.0))
        drive = SlippingDrive(seed, MACHINES[key], row, lifts)
        for _ in range(FIELDS):
            count += sum(found.state is DiagnosisState.ISOLATED for found in drive.other_fields(1, MINUTES))
            drive.stand(stand_s)
    return count


def delay(key: str, change: float, seed: int) -> float:
    """Minutes from the first driving with tyres of another radius on another field; infinite where missed."""
    drive = SlippingDrive(seed, MACHINES[key])
    drive.drive(20.0)
    drive.stand()
    drive.factor /= 1.0 + change
    drive.other_fields(1, 0.0)
    start_ns = drive.t_ns
    while drive.t_ns - start_ns < LIMIT_NS:
        if drive.drive(0.1):  # a row and its turn
            return (drive.t_ns - start_ns) / 60e9
    return math.inf


def main() -> None:
    parser = argparse.ArgumentParser(description="How soon other tyres are found, and how often wrongly.")
    parser.add_argument("--seeds", type=int, default=40)
    seeds = parser.parse_args().seeds
    hours = seeds * FIELDS * MINUTES / 60.0
    for lifts, key, stand_s in itertools.product((True, False), MACHINES, (0.0, STAND_S)):
        count = false_events(key, lifts, stand_s, seeds)
        said = "lifted on headlands" if lifts else "never lifted"
        print(f"{said}, {key}, standing {stand_s:.0f} s between fields: {count} events in {hours:.0f} h")
    for key, change in itertools.product(MACHINES, (-0.05, -0.03, 0.03, 0.05)):
        delays = np.array([delay(key, change, seed) for seed in range(seeds)])
        within, most = int(np.sum(delays <= 10.0)), delays.max()
        print(
            f"{key}, radius {100 * change:+.0f} %: median {np.median(delays):.1f} min, largest {most:.1f}, "
            f"within 10 min {within} of {seeds}"
        )


if __name__ == "__main__":
    main()
