"""A fractional design on the virtual fleet: which manoeuvre, ground, plant and slope rig number k drives.

Manoeuvre k mod 5, ground k mod 3, plant and slope k mod 4: these have no factor in common, so each 60 rigs in
a row are all cells once, and fewer are nearly balanced.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

from tilth.simulator.fleet import FleetRig, ground_of, headlands_of, scenario_of
from tilth.simulator.fleet_files import NMEA_2000, STAR_FIRE
from tilth.simulator.scenario import DrivenManoeuvre, Fieldwork, Scenario, Steering


class FleetManoeuvre(NamedTuple):
    name: str
    seconds: float
    receivers: int  # NAME of the first: at 5 or 10 Hz
    steering: Callable[[FleetRig], Steering]


MANOEUVRES: Final = (
    FleetManoeuvre("random", 124.0, STAR_FIRE, lambda rig: DrivenManoeuvre("random", 6.0)),
    FleetManoeuvre("chirp", 90.0, NMEA_2000, lambda rig: DrivenManoeuvre("chirp", 5.0)),
    FleetManoeuvre("steps", 90.0, STAR_FIRE, lambda rig: ((4.0, 0.0), (11.0, 6.0), (4.0, 0.0), (11.0, -6.0))),
    FleetManoeuvre("slalom", 126.0, STAR_FIRE, lambda rig: ((2.5, 5.0), (2.5, -5.0))),
    FleetManoeuvre(
        "headlands",
        200.0,
        STAR_FIRE,
        lambda rig: Fieldwork(length=60.0, turns=headlands_of(rig), turn_speed=3.0),
    ),
)
GROUNDS: Final = (0.0, 0.01, 0.02)  # m, rms
PLANTS: Final = (
    ("planar", 0.0),
    ("spatial", 0.0),
    ("planar", 3.0),
    ("spatial", 3.0),
)  # with degrees of slope


class Cell(NamedTuple):
    """Of the design."""

    manoeuvre: FleetManoeuvre
    rms: float
    plant: str
    slope_deg: float


def cell_of(k: int) -> Cell:
    return Cell(MANOEUVRES[k % len(MANOEUVRES)], GROUNDS[k % len(GROUNDS)], *PLANTS[k % len(PLANTS)])


def scenario(rig: FleetRig, cell: Cell) -> Scenario:
    downhill = (90.0, -90.0, 40.0)[rig.seed % 3]
    base = Scenario(
        seconds=cell.manoeuvre.seconds,
        seed=rig.seed,
        plant="spatial" if cell.plant == "spatial" else "planar",
        speed=rig.speed,
        steering=cell.manoeuvre.steering(rig),
        ground=ground_of(cell.plant, cell.rms, cell.slope_deg, downhill),
        other_traffic=False,
    )
    return scenario_of(rig, base)
