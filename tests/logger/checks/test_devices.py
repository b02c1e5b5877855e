"""Who speaks on the buses against whom the machine file names: each difference in turn, simulated."""

from collections.abc import Iterable
from dataclasses import replace

import pytest
from logs import MACHINE_TEXT

from tilth.logger.checks.devices import Devices
from tilth.logger.checks.finding import CheckFinding, Level
from tilth.schemas.can_id import join, split
from tilth.schemas.decode import claim
from tilth.schemas.flow import Frame, Mount
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.scenario import Fault, Scenario
from tilth.simulator.traffic import simulate

MACHINE = parse_machine(MACHINE_TEXT)
HEMISPHERE = 88
SECONDS = 3.0


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return list(simulate(MACHINE, 1, SECONDS, Scenario(other_traffic=False)))


def findings_of(frames: Iterable[Frame], *edits: tuple[str, str]) -> dict[str, CheckFinding]:
    """What is found with the machine file after these edits; by what it is of, the last of several."""
    text = MACHINE_TEXT
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    devices = Devices(parse_machine(text))
    for frame in frames:
        devices.take(frame)
    return {finding.what: finding for finding in devices.findings()}


def address_of(frames: list[Frame], name: str) -> int:
    """Where it settles: the last address that it claims."""
    return next(split(f.can_id).source for f in reversed(frames) if f.data == claim(int(name, 16)))


def test_where_all_are_there_nothing_is_said(frames: list[Frame]) -> None:
    found = findings_of(frames)
    assert {finding.state for finding in found.values()} == {Level.OK}
    assert set(found) == {f"receiver {mount}" for mount in Mount} | {"wheel angle"}


def test_another_manufacturer_than_the_file_says(frames: list[Frame]) -> None:
    source = address_of(frames, "C07891000B002711")
    given = f"source = {source}\nmanufacturer = 275"
    one = findings_of(frames, ('name = "C07891000B002711"', given))["receiver implement_front"]
    assert one.state == Level.PROBLEM
    assert f"address {source} is Hemisphere" in one.text and "(88), the file says 275" in one.text
    assert (
        findings_of(frames, ('name = "C07891000B002711"', given.replace("275", "88")))[
            "receiver implement_front"
        ].state
        == Level.OK
    )


def test_a_name_that_nobody_has_and_who_may_be_meant(frames: list[Frame]) -> None:
    found = findings_of(frames, ("A00017000421E240", "A00017000421E24F"))
    one = found["receiver tractor_front"]
    assert one.state == Level.WARNING and "NAME A00017000421E24F is not heard" in one.text
    assert "NAME A00017000421E240" in one.text and "John Deere (33)" in one.text
    assert found["other receiver"].state == Level.NOTE and "A00017000421E240" in found["other receiver"].text


def test_an_address_that_is_silent(frames: list[Frame]) -> None:
    one = findings_of(frames, ('name = "A00017000421E240"', "source = 250"))["receiver tractor_front"]
    assert one.state == Level.WARNING and "address 250 is not heard" in one.text
    assert "positions come from address" in one.text and "A00017000421E240" in one.text


def test_one_that_sends_no_positions_yet() -> None:
    faults = (Fault(Mount.IMPLEMENT_REAR, 0.0, 99.0, "not_available"),)
    found = findings_of(simulate(MACHINE, 1, SECONDS, Scenario(other_traffic=False, faults=faults)))
    one = found["receiver implement_rear"]
    assert one.state == Level.WARNING and "positions without a value" in one.text


def test_without_claims_it_says_what_to_do() -> None:
    found = findings_of(simulate(MACHINE, 1, SECONDS, Scenario(other_traffic=False, claims=False)))
    one = found["receiver tractor_front"]
    assert one.state == Level.WARNING and "claim their address when they are switched on" in one.text
    assert found["device names"].state == Level.NOTE and "request_claims = true" in found["device names"].text
    asked = findings_of(
        simulate(MACHINE, 1, SECONDS, Scenario(other_traffic=False, claims=False)),
        ("bitrate = 250000", "bitrate = 250000\nrequest_claims = true"),
    )
    assert "device names" not in asked


def test_two_devices_with_one_name_are_named(frames: list[Frame]) -> None:
    one, other = (claim(int(name, 16)) for name in ("C07891000B002711", "C07891000B002712"))
    found = findings_of(replace(f, data=one) if f.data == other else f for f in frames)
    assert found["device names"].state == Level.PROBLEM
    assert "two devices claim NAME C07891000B002711 (addresses " in found["device names"].text


def test_a_receiver_on_another_bus(frames: list[Frame]) -> None:
    second = MACHINE_TEXT[MACHINE_TEXT.index("[[bus]]") : MACHINE_TEXT.index("[[receiver]]")]
    edits = (second, second + second.replace('name = "can0"', 'name = "can1"'))
    source = address_of(frames, "C07891000B002712")
    moved = [replace(f, bus="can1") if f.extended and split(f.can_id).source == source else f for f in frames]
    one = findings_of(moved, edits)["receiver implement_rear"]
    assert one.state == Level.PROBLEM and "is heard on can1; correct its bus" in one.text


def test_a_manufacturer_that_only_its_own_messages_tell(frames: list[Frame]) -> None:
    """Without a claim: the first bytes of NMEA 2000's proprietary messages."""
    source = address_of(frames, "C07891000B002711")
    silent = [f for f in frames if not f.extended or split(f.can_id).pgn != 60928]
    ours = bytes([0xE0, 20, *(HEMISPHERE | 0b10011 << 11).to_bytes(2, "little"), 1, 2, 3, 4])
    result = replace(silent[0], can_id=join(6, 130820, source), extended=True, data=ours)
    given = f"source = {source}\nmanufacturer = 275"
    one = findings_of([result, *silent], ('name = "C07891000B002711"', given))["receiver implement_front"]
    assert one.state == Level.PROBLEM and f"address {source} is Hemisphere" in one.text
    nobody = findings_of(silent, ('name = "C07891000B002711"', given))["receiver implement_front"]
    assert nobody.state == Level.OK, "where nothing tells whose it is, the file is believed"


def test_the_wheel_angle(frames: list[Frame]) -> None:
    one = findings_of(frames, ("0x18FF0B15", "0x18FF0B25"))["wheel angle"]
    assert one.state == Level.WARNING
    assert one.text == "no frame 0x18FF0B25 is heard on can0; the nearest that are heard: 0x18FF0B15 on can0"
    rudder = findings_of(frames, ("id = 0x18FF0B15", "pgn = 127245\nsource = 21"))["wheel angle"]
    assert rudder.state == Level.WARNING and "no frame PGN 127245 from address 21 is heard" in rudder.text
    mute = [replace(f, data=b"\x7f\xff") if f.can_id == 0x18FF0B15 else f for f in frames]
    none = findings_of(mute)["wheel angle"]
    assert none.state == Level.WARNING and "none with an angle" in none.text
