"""Other tyres are found by the wheels' speed, slip is not taken for them, and what is accepted is over."""

import math
from dataclasses import replace

import numpy as np
import pytest
from circle import START_NS
from slipping_drive import FACTOR, MACHINE, SlippingDrive, with_factor

from tilth.estimator import fold
from tilth.estimator.diagnosis import watch, wheel_speed
from tilth.estimator.diagnosis.accepted import acceptance, corrected, line_of
from tilth.estimator.diagnosis.wheel_speed import TYRE_WATCH, Instant, floor_of
from tilth.estimator.pose import aligner
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.rig.numbers import HYPOTHESIS, WHEEL_SPEED
from tilth.estimator.snapshot import restore, snapshot
from tilth.schemas.diagnosis import DiagnosisState
from tilth.schemas.flow import Accepted, Origin, VehicleSpeed
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.sentences import notice_sentence, sentence


def with_other_tyres(drive: SlippingDrive, change: float) -> SlippingDrive:
    """After twenty minutes, of a radius that differs by `change`; in another field."""
    assert drive.drive(20.0) == []
    drive.stand()
    drive.factor /= 1.0 + change
    drive.field(0.06)
    return drive


MACHINES = {"none in the file": MACHINE, "one in the file": with_factor(FACTOR)}


@pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)
@pytest.mark.parametrize("stand_s", [0.0, 600.0])
@pytest.mark.parametrize("seed", range(6))
def test_slip_that_varies_is_no_other_tyre(seed: int, stand_s: float, machine: Machine) -> None:
    drive = SlippingDrive(seed, machine, row=100.0 + 80.0 * seed)
    found = []
    for _ in range(5):
        found += drive.other_fields(1, 20.0)
        drive.stand(stand_s)
    assert found == []


@pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)
@pytest.mark.parametrize("change", [-0.03, 0.03])
def test_three_percent_are_found_within_ten_minutes_but_on_soils_that_hide_them(
    change: float, machine: Machine
) -> None:
    """Light driving slips by up to 1.1 % more or less on the other field here."""
    drives = [with_other_tyres(SlippingDrive(seed, machine, row=200.0), change) for seed in range(12)]
    found = [drive.drive(10.0) for drive in drives]
    assert all(len(one) <= 1 for one in found) and sum(map(len, found)) >= 11
    for (one,) in filter(None, found):
        assert one.state is DiagnosisState.ISOLATED
        assert one.amounts[1] / one.amounts[0] - 1.0 == pytest.approx(change, abs=0.015)


@pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)
@pytest.mark.parametrize("change", [-0.05, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_five_percent_are_found_within_ten_minutes_and_over_when_accepted(
    seed: int, change: float, machine: Machine
) -> None:
    drive = with_other_tyres(SlippingDrive(seed, machine, row=200.0), change)
    (found,) = drive.drive(10.0)
    assert found.state is DiagnosisState.ISOLATED and found.since_ns == drive.state.since_ns
    assert found.amounts[1] / found.amounts[0] - 1.0 == pytest.approx(change, abs=0.015)
    assert "the tyres' radius has changed by" in sentence(found.reason)
    accepted = wheel_speed.proposal(drive.state, drive.t_ns)
    assert accepted is not None and accepted.what == WHEEL_SPEED
    assert accepted.amounts[0] == pytest.approx(drive.factor, abs=0.015)
    drive.machine = corrected(machine, [accepted])
    wheel_speed.accept(drive.state)
    assert drive.drive(20.0) == [] and wheel_speed.proposal(drive.state, 1) is None
    drive.stand()
    assert drive.drive(20.0) == []


@pytest.mark.parametrize("change", [-0.05, 0.05])
def test_the_old_tyres_again_are_said_to_be_back(change: float) -> None:
    drive = SlippingDrive(1, row=200.0)
    for factor in (FACTOR, FACTOR * (1.0 + change), FACTOR):
        drive.factor = factor
        found = drive.drive(20.0)
        drive.stand()
    assert [one.state for one in found] == [DiagnosisState.CLEARED] and drive.state.change is None


def test_less_slip_from_field_to_field_is_no_larger_tyre() -> None:
    """What is known is the lightest driving before the last stand, not before the first one."""
    drive = SlippingDrive(3, row=200.0)
    for slip in (0.030, 0.015, 0.005):
        drive.factor = FACTOR * (1.0 + slip)  # as slip all over a field looks
        assert drive.drive(20.0) == []
        drive.stand()


def test_larger_tyres_need_no_standstill_and_smaller_ones_do() -> None:
    """More slip all over looks like smaller tyres; no slip looks like larger ones."""
    for factor, expected in ((0.96, [DiagnosisState.ISOLATED]), (1.04, [])):
        drive = SlippingDrive(2, with_factor(FACTOR), row=200.0)
        assert drive.drive(20.0) == []
        drive.factor *= factor
        assert [one.state for one in drive.drive(20.0)] == expected


@pytest.mark.parametrize("seed", range(3))
def test_a_short_stop_begins_nothing_anew(seed: int) -> None:
    drive = SlippingDrive(seed, row=200.0)
    drive.drive(15.0)
    since_ns = drive.state.since_ns
    drive.stand(TYRE_WATCH.stand_ns * 1e-9 - 5.0)
    drive.drive(1.0)
    assert drive.state.since_ns == since_ns
    drive.stand(TYRE_WATCH.stand_ns * 1e-9 + 5.0)
    drive.drive(1.0)
    assert drive.state.since_ns > since_ns


@pytest.mark.parametrize("missing", ["ground", "wheels", "yaw_rate"])
def test_without_one_of_the_speeds_it_learns_nothing(missing: str) -> None:
    drive = SlippingDrive(1)
    take = wheel_speed.take
    for k in range(2000):
        speeds = {"ground": 3.0, "wheels": 3.1, "yaw_rate": 0.0} | {missing: None}
        now = Instant(
            START_NS + k * ALIGNMENT.pose_ns, speeds["ground"], speeds["wheels"], speeds["yaw_rate"]
        )
        assert take(drive.state, MACHINE, now) is None
    assert drive.state.averages == [] and drive.state.lows == []


def test_a_floor_needs_stretches_that_agree() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        lows = rng.uniform(0.0, 0.05, 5).tolist()
        floor = floor_of(lows)
        ordered = sorted(lows)
        spans = [ordered[k + TYRE_WATCH.agreeing - 1] - ordered[k] for k in range(2)]
        assert (floor is None) == (min(spans) >= TYRE_WATCH.agree)
        assert floor is None or min(lows) <= floor <= max(lows)
    assert floor_of([0.0, 0.001, 0.002]) is None
    assert floor_of([math.inf, 0.0, 0.001, 0.002, 0.003]) == pytest.approx(0.0015)


def test_only_wheel_based_speed_of_one_sender_is_taken() -> None:
    state = aligner.initial(MACHINE)
    sent = VehicleSpeed(5, 5, Origin("can0", 0xF0), 65096, None, 2.0, "forward")
    aligner.take(state, replace(sent, pgn=65097, speed=9.0))
    aligner.take(state, sent)
    aligner.take(state, replace(sent, origin=Origin("can0", 0xF1), speed=9.0))
    aligner.take(state, replace(sent, origin=Origin("can1", 0xF0), speed=9.0))
    assert list(state.wheel_speeds) == [(5, 2.0, 0.0)]


def test_a_stored_state_goes_on_alike() -> None:
    straight, stored = SlippingDrive(3, row=200.0), SlippingDrive(3, row=200.0)
    for drive in (straight, stored):
        drive.drive(20.0)
        drive.stand()
        drive.factor *= 0.96
        drive.drive(3.3)
    state = fold.initial(MACHINE)
    state.diagnosis.watch.wheel_speed = stored.state
    text = snapshot(state)
    again = restore(MACHINE, text)
    assert snapshot(again) == text
    stored.state = again.diagnosis.watch.wheel_speed
    assert straight.drive(7.0) == stored.drive(7.0) != []
    assert straight.state == stored.state


@pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)
def test_an_accepted_factor_stands_in_the_machine_file(machine: Machine) -> None:
    one = Accepted(1, WHEEL_SPEED, (0.98, 1.02), (0.006, 0.005))
    new = corrected(machine, [one])
    assert new.tractor.wheel_speed_factor == Quantity(value=0.98, sd=0.006)
    assert new.model_copy(update={"tractor": machine.tractor}) == machine
    assert HYPOTHESIS[WHEEL_SPEED].key == "tractor.wheel_speed_factor"
    assert line_of(new, WHEEL_SPEED) == "[tractor] wheel_speed_factor = { value = 0.9800, sd = 0.0060 }"
    assert "changed by 4.1 ± 1.5 % (95 %)" in notice_sentence(acceptance(new, one))


def test_the_fold_says_it_and_learns_on() -> None:
    """No estimate uses the wheels' speed, so that none is withheld."""
    drive = SlippingDrive(4, row=200.0)
    drive.drive(20.0)
    drive.stand()
    drive.factor *= 0.95
    drive.drive(10.0)
    state = fold.initial(MACHINE)
    state.diagnosis.watch.wheel_speed = drive.state
    assert [one.of for one in watch.found_now(state.diagnosis.watch)] == [(WHEEL_SPEED,)]
    assert not watch.contradictions(state.diagnosis.watch) and not watch.left_out(state.diagnosis.watch)
    accepted = watch.proposal(state.diagnosis.watch, MACHINE, WHEEL_SPEED, 9)
    assert accepted is not None
    (event,) = [one.value for one in fold.accept(state, accepted)]
    assert "tractor.wheel_speed_factor" in str(event)
    assert (
        watch.found_now(state.diagnosis.watch) == []
        and state.aligner.machine.tractor.wheel_speed_factor is not None
    )
