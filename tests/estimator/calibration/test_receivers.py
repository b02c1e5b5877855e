"""How often a receiver sends and how much it jitters, whatever the rig does meanwhile."""

from dataclasses import replace

import numpy as np
import pytest
from kinematic_drive import MACHINE, measurements

from tilth.estimator.calibration.receivers import HeardReceivers, ReceiverRow, rows, take
from tilth.schemas.flow import Measurement, Mount, Position

FRONT, NOISE_DEG = Mount.TRACTOR_FRONT, 1e-7  # 11 mm to the north


def _rows(made: list[Measurement], places: dict[str, str] | None = None) -> dict[str, ReceiverRow]:
    heard = HeardReceivers()
    for measurement in made:
        take(heard, measurement)
    return {row.mount: row for row in rows(heard, MACHINE, places or {})}


def _parked(creep_deg: float) -> list[Measurement]:
    """Of positions that jitter by NOISE_DEG to the north alone; creep_deg: to the north, each of them."""
    rng = np.random.default_rng(1)
    made, k = measurements(((30, 0.0, 0), (20, 3.0, 0)), noise=0.0), 0
    for at, one in enumerate(made):
        if isinstance(one, Position) and one.origin.mount is FRONT:
            k += 1
            made[at] = replace(one, latitude_deg=one.latitude_deg + rng.normal(0, NOISE_DEG) + k * creep_deg)
    return made


@pytest.mark.parametrize("creep_deg", [0.0, 5e-8])
def test_jitter_is_that_of_standing_and_not_of_creeping_or_driving(creep_deg: float) -> None:
    found = _rows(_parked(creep_deg))
    assert found[FRONT].jitter == pytest.approx(0.0111, rel=0.15)
    assert found[FRONT].per_s == pytest.approx(5.0, abs=0.05)
    rear = found[Mount.TRACTOR_REAR].jitter
    assert rear is not None and rear < 1e-3


def test_what_is_not_known_is_said() -> None:
    made = [m for m in measurements(((30, 3.0, 0),)) if m.origin.mount is not Mount.IMPLEMENT_REAR]
    found = _rows(made)
    assert found[Mount.IMPLEMENT_REAR].words == "implement rear: not heard"
    assert ", no standstill, latency 100 ms by the file" in found[FRONT].words
    assert _rows([])[FRONT].words == "tractor front: not heard"


def test_receivers_are_where_they_stand() -> None:
    """Not where the file says."""
    places = {"tractor_front": "tractor_rear", "tractor_rear": "tractor_front"}
    by_file, found = _rows(_parked(0.0)), _rows(_parked(0.0), places)
    assert found["tractor_rear"].jitter == by_file["tractor_front"].jitter
