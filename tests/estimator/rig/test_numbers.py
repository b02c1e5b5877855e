"""Each row changes a machine file by its amount, where it says, and nothing else."""

import math

import pytest
from kinematic_drive import MACHINE

from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import HYPOTHESES, NUMBER, NUMBERS, RigNumber, changed
from tilth.schemas.machine import Machine

ROWS = pytest.mark.parametrize("row", NUMBERS, ids=lambda row: row.name)


def sections(before: Machine, after: Machine) -> set[str]:
    """Of the file, that are not alike."""
    names = ("tractor", "implement", "tyres", "receiver", "wheel_angle", "bus")
    return {name for name in names if getattr(before, name) != getattr(after, name)}


@ROWS
def test_a_number_changes_its_section_and_comes_back(row: RigNumber) -> None:
    by = 1.1 if row.name == "wheel_speed_factor" else 0.02
    after = changed(MACHINE, {row.name: Amount(by)})
    (section,) = sections(MACHINE, after)
    assert row.key.startswith(section)
    if row.name == "wheel_speed_factor":
        return
    for receiver, again in zip(
        MACHINE.receiver, changed(after, {row.name: Amount(-by)}).receiver, strict=True
    ):
        assert again.position == pytest.approx(receiver.position, abs=1e-3)
        assert again.latency.value == pytest.approx(receiver.latency.value)
    assert sections(MACHINE, changed(MACHINE, {row.name: Amount(0.0)})) == set()


@ROWS
def test_what_is_known_better_is_so_in_the_file(row: RigNumber) -> None:
    """Where it has a place there."""
    by = 1.1 if row.name == "wheel_speed_factor" else 0.0
    if row.name.startswith(("longer", "roll_zero")):
        return
    assert sections(MACHINE, changed(MACHINE, {row.name: Amount(by, 0.0123)}))


def test_sds_besides_those_of_the_file_make_them_larger() -> None:
    zero = MACHINE.wheel_angle.zero
    after = changed(MACHINE, {"wheel_zero": Amount(0.02, 0.004, besides=True)}).wheel_angle.zero
    assert after.value == pytest.approx(zero.value + math.degrees(0.02))
    assert after.sd == pytest.approx(math.hypot(zero.sd, math.degrees(0.004)))
    alone = changed(MACHINE, {"wheel_zero": Amount(0.02, 0.004)}).wheel_angle.zero
    assert alone.sd == pytest.approx(math.degrees(0.004))


def test_a_number_that_no_rig_has() -> None:
    with pytest.raises(KeyError, match="lever_x"):
        changed(MACHINE, {"lever_x": Amount(1.0)})


def test_names_are_those_that_others_know() -> None:
    assert len(NUMBER) == len(NUMBERS)
    assert all(name in NUMBER for one in HYPOTHESES for name in one.numbers)
    assert all(row.name in AT for row in NUMBERS if row.open_sd)
    assert all(not row.unknown or row.unknown in AT for row in NUMBERS)
    assert all(row.words and row.wanted_sd and row.drive and row.tape for row in SOUGHT)
    assert all(row.drift_sd for row in NUMBERS if row.watch_sd)
