"""The virtual tractor's frames: bit-exact, in an order that a real bus allows, readable by the decoder."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from paths import MACHINE_FILE

from tilth.schemas.can_id import split
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import (
    AddressClaim,
    Fix,
    FixType,
    Frame,
    Measurement,
    Mount,
    Position,
    UtcTime,
    VehicleSpeed,
    WheelAngle,
    YawRate,
)
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.other_traffic import DEVICES, ROWS
from tilth.simulator.receivers import reports
from tilth.simulator.scenario import STEP_S, Fault, Reclaim, Scenario, Wheel
from tilth.simulator.traffic import simulate

SECONDS = 12.0


@pytest.fixture(scope="module")
def frames(machine: Machine) -> list[Frame]:
    return list(simulate(machine, 1, SECONDS))


def _measurements(machine: Machine, frames: list[Frame]) -> tuple[list[Measurement], dict[str, int]]:
    decoder = Decoder(machine)
    return [m for frame in frames for m in decoder.measurements(frame)], decoder.rejected


def test_the_same_seed_gives_the_same_frames(machine: Machine, frames: list[Frame]) -> None:
    assert list(simulate(machine, 1, SECONDS)) == frames
    assert list(simulate(machine, 2, SECONDS)) != frames


def test_the_mix_is_the_stated_one(frames: list[Frame]) -> None:
    assert len(frames) / SECONDS == pytest.approx(800, rel=0.06)  # receivers begin after half a second
    per_source: Counter[int] = Counter()
    for frame in frames:
        per_source[split(frame.can_id).source] += frame.t_ns > frames[0].t_ns + 2_000_000_000
    rates = {source: count / (SECONDS - 2.0) for source, count in per_source.items()}
    assert rates[28] == pytest.approx(51, rel=0.05)
    assert rates[70] == pytest.approx(58, rel=0.05)
    assert rates[0x15] == pytest.approx(100, rel=0.02)
    others = [source for source in rates if source in DEVICES and source != 0x15]
    assert sum(rates[s] for s in others) == pytest.approx(sum(rate for _, rate, _ in ROWS) + 30, rel=0.02)


def test_frames_follow_one_another_on_the_bus(machine: Machine, frames: list[Frame]) -> None:
    apart = np.diff([frame.t_ns for frame in frames])
    assert apart.min() >= 131 / 250_000 * 1e9 * 0.999
    assert len({frame.t_ns for frame in frames}) == len(frames)
    assert {len(frame.data) for frame in frames} == {8}


def test_a_clump_takes_10_to_30_ms_and_the_more_important_frame_goes_first(frames: list[Frame]) -> None:
    clumps: dict[int, list[int]] = {}
    for frame in frames:
        if split(frame.can_id).source == 28 and frame.t_ns > frames[0].t_ns + 1_000_000_000:
            clumps.setdefault((frame.t_ns - frames[0].t_ns) // 200_000_000, []).append(frame.t_ns)
    lengths = [(times[-1] - times[0]) * 1e-6 for times in clumps.values() if len(times) in (10, 11)]
    assert len(lengths) > 30
    assert 8.0 < np.median(lengths) < 30.0


def test_every_receiver_is_decoded(machine: Machine, frames: list[Frame]) -> None:
    measurements, rejected = _measurements(machine, frames)
    observed = Counter((type(m), m.origin.mount) for m in measurements)
    for mount in Mount:
        rate = 10 if mount.startswith("implement") else 5
        assert observed[Position, mount] == pytest.approx(rate * (SECONDS - 0.6), abs=14)
        assert observed[YawRate, mount] == pytest.approx(rate * (SECONDS - 0.6), abs=3)
    assert observed[WheelAngle, None] == 1201
    assert {m.fix for m in measurements if isinstance(m, Fix)} == {FixType.RTK_FIXED}
    assert all(m.direction == "forward" for m in measurements if isinstance(m, VehicleSpeed))
    assert set(rejected) <= {"address_conflict"}


def test_decoded_values_are_what_was_measured_to_one_bit(machine: Machine, frames: list[Frame]) -> None:
    truth = drive(machine, 1, SECONDS)
    measurements, _ = _measurements(machine, frames)
    for receiver in machine.receiver:
        rows = [r for r in reports(machine, truth, receiver, 0.5)]
        collected = [
            m
            for m in measurements
            if isinstance(m, Position) and m.origin.mount == receiver.mount and m.pgn != 129029
        ]
        assert len(rows) - len(collected) in (0, 1)  # the last may come after the end
        for row, position in zip(rows, collected, strict=False):
            assert position.latitude_deg == pytest.approx(row.latitude_deg, abs=0.51e-7)
            assert position.longitude_deg == pytest.approx(row.longitude_deg, abs=0.51e-7)
            arrival_s = (position.rx_ns - truth.scenario.utc_start_ns) * 1e-9 - truth.nuisances[
                "clock_offset"
            ]
            assert row.sent_s <= arrival_s < row.sent_s + 0.03
    wheel = [m.angle for m in measurements if isinstance(m, WheelAngle)]
    off = np.degrees(np.array(wheel) - truth.wheel_angle[: len(wheel)] - truth.nuisances["wheel_zero"])
    assert abs(off.mean()) < 0.01
    assert off.std() == pytest.approx(0.07, rel=0.1)


def test_star_fire_tells_time_to_a_quarter_of_a_second_only(machine: Machine, frames: list[Frame]) -> None:
    measurements, _ = _measurements(machine, frames)
    times = [m for m in measurements if isinstance(m, UtcTime)]
    star_fire = Counter(m.utc_ns % 1_000_000_000 // 1_000_000 for m in times if m.pgn == 65254)
    assert set(star_fire) == {0, 250, 500, 750}
    assert star_fire[0] == pytest.approx(2 * star_fire[750], abs=4)  # of x.0 and x.2 s: it has not begun x.25
    assert {m.utc_ns % 1_000_000_000 for m in times if m.pgn == 126992} == {0}


def test_sids_tie_one_epoch(machine: Machine, frames: list[Frame]) -> None:
    measurements, _ = _measurements(machine, frames)
    epochs: dict[int, list[int]] = {}
    for m in measurements:
        if m.origin.mount is Mount.IMPLEMENT_FRONT and m.sid is not None:
            epochs.setdefault(m.sid, []).append(m.rx_ns)
    assert len(epochs) > 100
    assert max(max(times) - min(times) for times in epochs.values()) < 30_000_000


def test_two_of_a_kind_settle_their_address_by_name(machine: Machine, frames: list[Frame]) -> None:
    measurements, _ = _measurements(machine, frames)
    claims = [m for m in measurements if isinstance(m, AddressClaim)]
    assert {m.origin.mount for m in claims} == {*Mount, None}
    sources = {m.origin.mount: m.origin.source for m in measurements if isinstance(m, Position)}
    assert sources == {
        Mount.TRACTOR_FRONT: 28,
        Mount.TRACTOR_REAR: 128,
        Mount.IMPLEMENT_FRONT: 70,
        Mount.IMPLEMENT_REAR: 129,
    }
    assert {m.origin.name for m in claims} >= set(DEVICES.values())
    # The front one's NAME is higher now.
    swapped = parse_machine(MACHINE_FILE.read_text().replace("E240", "E2FF"))
    measurements, _ = _measurements(swapped, list(simulate(swapped, 1, 2.0)))
    sources = {m.origin.mount: m.origin.source for m in measurements if isinstance(m, Position)}
    assert (sources[Mount.TRACTOR_FRONT], sources[Mount.TRACTOR_REAR]) == (128, 28)


def test_a_receiver_that_takes_another_ones_address(machine: Machine) -> None:
    scenario = Scenario(
        reclaims=(Reclaim(Mount.TRACTOR_REAR, 4.0, 28), Reclaim(Mount.TRACTOR_REAR, 4.4, 140))
    )
    measurements, rejected = _measurements(machine, list(simulate(machine, 1, 8.0, scenario)))
    start = scenario.utc_start_ns
    late = [m for m in measurements if isinstance(m, Position) and m.rx_ns > start + 5_500_000_000]
    assert {m.origin.source for m in late if m.origin.mount is Mount.TRACTOR_REAR} == {140}
    assert {m.origin.source for m in late if m.origin.mount is Mount.TRACTOR_FRONT} == {28}
    assert rejected["address_conflict"] > 2


SILENT = tuple(Fault(mount, 2.0, 4.0, "not_available") for mount in Mount)


@pytest.mark.parametrize(
    ("scenario", "absent", "present"),
    [
        (Scenario(wheel_sensor=False), WheelAngle, Position),
        (Scenario(claims=False), AddressClaim, WheelAngle),
        (Scenario(other_traffic=False), VehicleSpeed, Position),
    ],
    ids=["no wheel sensor", "no claims", "no other traffic"],
)
def test_what_can_be_left_out(
    machine: Machine, scenario: Scenario, absent: type[Measurement], present: type[Measurement]
) -> None:
    measurements, _ = _measurements(machine, list(simulate(machine, 1, 2.0, scenario)))
    kinds = {type(m) for m in measurements}
    assert absent not in kinds
    assert present in kinds


def test_receivers_without_data_go_on_talking(machine: Machine) -> None:
    scenario = Scenario(faults=SILENT)
    frames = list(simulate(machine, 1, 5.0, scenario))
    plain = list(simulate(machine, 1, 5.0))
    assert abs(len(frames) - len(plain)) <= 2
    measurements, rejected = _measurements(machine, frames)
    gap = [
        m
        for m in measurements
        if isinstance(m, Position) and 2.4 < (m.rx_ns - scenario.utc_start_ns) * 1e-9 < 3.6
    ]
    assert gap == []
    assert rejected["not_available"] > 50


def test_swapped_receivers_report_each_others_place(machine: Machine) -> None:
    pair = (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
    calm = Scenario(noise=0.0, latency_s=dict.fromkeys(Mount, 0.1))
    plain = drive(machine, 1, 3.0, calm)
    exchanged = drive(machine, 1, 3.0, replace(calm, swapped=pair))
    front, rear = machine.receiver[:2]
    assert [r.latitude_deg for r in reports(machine, exchanged, front, 0.5)] == [
        r.latitude_deg for r in reports(machine, plain, rear, 0.5)
    ]


def test_host_clock_and_utc_differ_as_the_truth_says(machine: Machine) -> None:
    scenario = Scenario(clock_offset_s=1.25, latency_s=dict.fromkeys(Mount, 0.08), noise=0.0)
    measurements, _ = _measurements(machine, list(simulate(machine, 1, 6.0, scenario)))
    late = [(m.rx_ns - m.utc_ns) * 1e-9 for m in measurements if isinstance(m, UtcTime) and m.pgn == 129029]
    assert min(late) == pytest.approx(1.25 + 0.08 + 0.004, abs=0.003)


def test_the_host_clock_runs_away_from_utc(machine: Machine) -> None:
    only_wheel = Scenario(
        other_traffic=False, claims=False, faults=tuple(Fault(m, 0.0, 999.0, "silent") for m in Mount)
    )
    truth = drive(machine, 1, 100.0, only_wheel)
    late = [f.rx_ns for f in simulate(machine, 1, 100.0, only_wheel)] - truth.time * 1e9
    assert (late[-1] - late[0]) * 1e-9 == pytest.approx(100.0 * truth.nuisances["clock_skew"], abs=1e-6)
    assert truth.nuisances["clock_skew"] != 0.0


def test_the_wheel_angle_comes_later_by_its_delay(machine: Machine) -> None:
    only_wheel = Scenario(
        other_traffic=False, claims=False, faults=tuple(Fault(m, 0.0, 999.0, "silent") for m in Mount)
    )
    slow = replace(only_wheel, wheel=Wheel(delay=0.04))
    early, late = (np.array([f.rx_ns for f in simulate(machine, 1, 2.0, s)]) for s in (only_wheel, slow))
    np.testing.assert_allclose((late - early) * 1e-9, 0.04, atol=1e-6)


def test_reverse_is_told_by_the_tractor(machine: Machine) -> None:
    scenario = Scenario(speed=((4.0, 2.0), (8.0, -1.0)), steering=((1.0, 0.0),))
    measurements, _ = _measurements(machine, list(simulate(machine, 1, 12.0, scenario)))
    collected = [m for m in measurements if isinstance(m, VehicleSpeed)]
    assert (collected[20].direction, collected[-1].direction) == ("forward", "reverse")
    assert collected[-1].speed == pytest.approx(1.0, abs=0.15)
    assert all(m.speed >= 0.0 for m in collected)


def test_several_buses(machine: Machine) -> None:
    text = MACHINE_FILE.read_text()
    second = (
        '[[bus]]\nname = "can1"\ninterface = "socketcan"\nchannel = "can1"\nbitrate = 500000\n\n[[receiver]]'
    )
    text = text.replace("[[receiver]]", second, 1)
    front, _, back = text.partition('mount = "implement_front"\nbus = "can0"')
    two = parse_machine(f'{front}mount = "implement_front"\nbus = "can1"{back}')
    frames = list(simulate(two, 1, 4.0))
    assert [f.t_ns for f in frames] == sorted(f.t_ns for f in frames)
    assert {split(f.can_id).source for f in frames if f.bus == "can1"} == {70}
    measurements, _ = _measurements(two, frames)
    assert {m.origin.mount for m in measurements if isinstance(m, Position)} == set(Mount)


@pytest.mark.parametrize(
    "sensor",
    [
        "pgn = 127245\nsource = 21\n",
        'id = 0x1A5\nextended = false\nstart_bit = 0\nscale = 0.02\nkingpin = "left"\n',
    ],
)
def test_other_wheel_angle_sensors(sensor: str) -> None:
    text = MACHINE_FILE.read_text()
    head, _, tail = text.partition("id = 0x18FF0B15")
    end = tail[tail.index("zero = ") :]
    head = head.replace("cg_height = 1.1\n", "cg_height = 1.1\nkingpin_distance = 1.7\n")
    machine = parse_machine(head + sensor + end)
    truth = drive(machine, 1, 9.0)
    measurements, _ = _measurements(machine, list(simulate(machine, 1, 9.0)))
    angles = np.array([m.angle for m in measurements if isinstance(m, WheelAngle)])
    off = np.degrees(angles - truth.wheel_angle[: len(angles)] - truth.nuisances["wheel_zero"])
    assert np.abs(off).max() < 0.4
    assert len(angles) == round(9.0 / STEP_S) + 1
