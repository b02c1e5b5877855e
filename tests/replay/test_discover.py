"""What is heard on a bus, and the machine file drafted from it."""

import json
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tilth.cli import WrongUse, main
from tilth.cli.discover import parse_buses
from tilth.replay.discover import BusSurvey, Findings
from tilth.replay.machine_draft import FILL_IN, draft
from tilth.replay.readers.any_log import frames
from tilth.replay.wheel_search import WheelCandidate, candidates
from tilth.schemas import can_id
from tilth.schemas.decode import claim
from tilth.schemas.flow import Frame, Mount
from tilth.schemas.machine import Bus, Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.scenario import Fault, Scenario
from tilth.simulator.traffic import simulate

STEER = 0x18FF0B15
SECOND = 1_000_000_000
DRIVE = Scenario(steering=((3.0, 0.0), (6.0, 8.0), (6.0, -8.0)))


def _findings(frames: Iterator[Frame]) -> Findings:
    survey = BusSurvey()
    for frame in frames:
        survey.take(frame)
    return survey.findings()


@pytest.fixture(scope="module")
def found(machine: Machine) -> Findings:
    return _findings(simulate(machine, 1, 15.0, DRIVE))


def _filled(text: str) -> str:
    """A draft with every marked line filled in, as a person would."""
    values = {
        "name": '"my-rig"',
        "interface": '"socketcan"',
        "channel": '"can0"',
        "bus": '"can0"',
        "byte_order": '"big"',
        "start_byte": "0",
        "id": "0x18FF0B15",
        "source": "28",
        "manufacturer": "33",
        "mass": "9391.0",
        "yaw_inertia": "12000.0",
        "scale": "0.01",
        "offset": "-300.0",
    }
    mounts, places = iter(Mount), iter((1.6, -1.1, 1.3, -1.3))

    def fill(line: re.Match[str]) -> str:
        key = line[1]
        if key == "mount":
            return f'mount = "{next(mounts)}"'
        if key == "position":
            return f"position = [{next(places)}, 0.0, 3.0]"
        return f"{key} = {values.get(key, '1.5')}"

    return re.sub(rf"^(\w+) = {FILL_IN}.*$", fill, text, flags=re.MULTILINE)


def test_sources_and_their_messages(found: Findings) -> None:
    sources = {source.source: source for source in found.sources}
    star_fire, compass = sources[28], sources[70]
    assert star_fire.name == 0xA00017000421E240
    assert (star_fire.manufacturer_name, star_fire.function) == ("John Deere", 23)
    assert compass.manufacturer_name == "Hemisphere"
    rates = {(m.pgn, m.selector): m.per_s for m in star_fire.messages}
    assert rates[65267, None] == pytest.approx(5.0, abs=0.1)
    assert rates[65535, 0xE1] == pytest.approx(5.0, abs=0.1)
    rates = {(m.pgn, m.selector): m.per_s for m in compass.messages}
    assert rates[129025, None] == pytest.approx(10.0, abs=0.1)
    assert rates[129029, None] == pytest.approx(1.0, abs=0.1)  # messages, not their seven frames
    titles = {(m.pgn, m.selector): m.title for m in star_fire.messages}
    assert titles[65535, 0xE1] == "StarFire TCM"
    assert titles[65535, 0x51] == "proprietary"
    assert sources[0x2A].manufacturer_name == "John Deere"
    assert 254 not in sources


def test_receivers_and_the_wheel_angle(found: Findings) -> None:
    assert {receiver.source for receiver in found.receivers} == {28, 70, 128, 129}
    assert all(receiver.positions > 50 for receiver in found.receivers)
    best = found.wheel_angles[0]
    assert (best.can_id, best.start_byte, best.byte_order, best.signed) == (STEER, 0, "big", True)
    assert best.per_s == pytest.approx(100.0, abs=1.0)
    assert best.likely
    assert best.highest == pytest.approx(800, abs=60)
    assert len({c.can_id for c in found.wheel_angles}) == len(found.wheel_angles)


def test_the_draft_parses_once_it_is_filled_in(found: Findings, machine: Machine) -> None:
    text = draft(found, [Bus(name="can0", interface="socketcan", channel="can0")])
    assert "FILL IN" in text
    drafted = parse_machine(_filled(text))
    assert {r.name for r in drafted.receiver} == {r.name for r in machine.receiver}
    assert {r.name: r.roll_corrected for r in drafted.receiver} == {
        r.name: r.roll_corrected for r in machine.receiver
    }
    assert drafted.bus == machine.bus
    wheel = drafted.wheel_angle
    assert (wheel.id, wheel.byte_order, wheel.start_byte, wheel.sign) == (STEER, "big", 0, 1)


@pytest.mark.parametrize(
    ("correlation", "mark", "sign"),
    [
        (0.95, None, "sign = 1  # as the yaw rate says"),
        (-0.6, "follows the yaw rate by 60% only", "sign = -1  # as the yaw rate says"),
        (0.3, "follows the yaw rate by 30% only", "sign = 1  # turn the wheel right"),
        (None, "no turn was driven that would show", "sign = 1  # turn the wheel right"),
    ],
)
def test_a_doubt_about_the_wheel_angle_goes_with_what_its_sign_says(
    found: Findings, correlation: float | None, mark: str | None, sign: str
) -> None:
    best = replace(found.wheel_angles[0], yaw_correlation=correlation)
    text = draft(replace(found, wheel_angles=(best,)), [])
    line = next(line for line in text.splitlines() if line.startswith(f"id = 0x{STEER:X}"))
    assert line.partition(f"  {FILL_IN}, or leave it: moves smoothly, but ")[2].startswith(mark or "")
    assert (FILL_IN in line) == (mark is not None)
    assert sign in text


def test_nothing_is_filled_in_for_the_person(found: Findings) -> None:
    keys = set(re.findall(rf"^(\w+) = {FILL_IN}", draft(found, []), flags=re.MULTILINE))
    assert keys >= {"name", "a", "b", "c", "d", "e", "mass", "yaw_inertia", "cg_height", "mount", "position"}
    assert keys >= {"scale", "interface", "channel"}


def test_what_a_draft_has_as_comments_are_keys(found: Findings) -> None:
    text = re.sub(r"^# (size|pressure) =", r"#  \1 =", _filled(draft(found, [])), flags=re.MULTILINE)
    machine = parse_machine(re.sub(r"^# (\[\[|[a-z_]+ = )", r"\1", text, flags=re.MULTILINE))
    assert machine.tyres.rear.deflection is not None and machine.tyres.rear.dual_track is not None
    assert machine.tractor.hitch_height is not None and machine.tractor.suspended_front_axle
    assert machine.tractor.front_axle_mass is not None
    assert (len(machine.tractor.ballast), len(machine.implement.ballast)) == (1, 1)


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(claims=False),
        Scenario(wheel_sensor=False, other_traffic=False),
        Scenario(steering=((1.0, 0.0),)),
        Scenario(faults=tuple(Fault(mount, 0.0, 99.0, "silent") for mount in Mount)),
        Scenario(faults=tuple(Fault(mount, 0.0, 99.0, "not_available") for mount in Mount)),
    ],
    ids=["no claims", "no wheel sensor", "straight", "no receiver", "no position"],
)
def test_a_draft_of_little_parses_too(machine: Machine, scenario: Scenario) -> None:
    parse_machine(_filled(draft(_findings(simulate(machine, 1, 6.0, scenario)), [])))


def test_receivers_that_only_say_not_available_are_told_apart(machine: Machine) -> None:
    mute = Scenario(faults=(Fault(Mount.IMPLEMENT_REAR, 0.0, 99.0, "not_available"),))
    findings = _findings(simulate(machine, 1, 4.0, mute))
    receivers = {r.source: (r.positions > 0, r.empty_positions > 0) for r in findings.receivers}
    assert receivers == {28: (True, False), 128: (True, False), 70: (True, False), 129: (False, True)}
    text = draft(findings, [])
    assert text.count("[[receiver]]") == 3
    assert "Source 129" in text


def test_without_claims_the_address_stands_in_the_draft(machine: Machine) -> None:
    findings = _findings(simulate(machine, 1, 4.0, Scenario(claims=False)))
    assert all(source.name is None for source in findings.sources)
    text = draft(findings, [])
    assert "source = 128  # no address claim was heard" in text
    assert text.count("manufacturer = " + FILL_IN) == 4


def _words(kind: str, n: int = 600) -> np.ndarray:
    rng = np.random.default_rng(1)
    t = np.arange(n) / 50.0
    steer = 900 * np.sin(0.7 * t) + rng.normal(0, 5, n)
    words = {
        "wheel": steer,
        "offset wheel": steer + 0x7D00,
        "noise": rng.integers(0, 65536, n),
        "counter": np.arange(n) * 3,
        "byte counter": np.arange(n) % 256,
        "still": np.full(n, 77),
        "not available": np.full(n, 0xFFFF),
    }
    return words[kind].astype(np.int64) & 0xFFFF


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize(
    ("kind", "signed"),
    [
        ("wheel", True),
        ("offset wheel", False),
        ("noise", None),
        ("counter", None),
        ("byte counter", None),
        ("still", None),
        ("not available", None),
    ],
)
def test_what_moves_as_a_wheel_angle(kind: str, signed: bool | None, order: str) -> None:
    data = [
        b"\x10" + int(w).to_bytes(2, "big" if order == "big" else "little") + b"\xff" for w in _words(kind)
    ]
    times = [20_000_000 * k for k in range(len(data))]
    found = sorted(candidates("can0", STEER, True, times, data, []), key=lambda c: -c.score)
    if signed is None:
        assert found == []
        return
    best = found[0]
    assert (best.start_byte, best.byte_order, best.signed) == (1, order, signed)
    assert best.yaw_correlation is None
    assert not best.likely


def test_the_one_that_turns_with_the_machine_comes_first() -> None:
    times = [20_000_000 * k for k in range(600)]
    yaw = [(t, 0.2 * np.sin(0.7e-9 * t - 0.1)) for t in times[::5]]
    ours = [int(w).to_bytes(2, "big") for w in _words("wheel")]
    mirrored = [((0x10000 - int(w)) & 0xFFFF).to_bytes(2, "big") for w in _words("wheel")]
    slow = [(500 + int(40 * np.sin(0.05 * k))).to_bytes(2, "big") for k in range(600)]
    best: list[WheelCandidate] = []
    for data in (ours, mirrored, slow):
        best += sorted(candidates("can0", STEER, True, times, data, yaw), key=lambda c: -c.score)[:1]
    assert best[0].likely
    assert best[1].likely
    assert (best[0].yaw_correlation or 0.0) > 0.95
    assert (best[1].yaw_correlation or 0.0) < -0.95
    assert best[2].score < best[0].score


@pytest.mark.parametrize(
    ("given", "bus"),
    [
        ("socketcan:can1", Bus(name="can1", interface="socketcan", channel="can1")),
        (
            "slcan:/dev/ttyUSB0,bitrate=500000,sleep_after_open=0.5",
            Bus(
                name="can0",
                interface="slcan",
                channel="/dev/ttyUSB0",
                bitrate=500_000,
                options={"sleep_after_open": 0.5},
            ),
        ),
        (
            "socketcand:can0,host=127.0.0.1,port=29536,tcp_tune=true",
            Bus(
                name="can0",
                interface="socketcand",
                channel="can0",
                options={"host": "127.0.0.1", "port": 29536, "tcp_tune": True},
            ),
        ),
    ],
)
def test_buses_are_given_in_words(given: str, bus: Bus) -> None:
    assert parse_buses([given]) == [bus]


@pytest.mark.parametrize(
    "given", ["can0", "socketcan:", ":can0", "socketcan:can0,listen", "socketcan:can0,bitrate=x"]
)
def test_a_bus_that_is_none(given: str) -> None:
    with pytest.raises(WrongUse, match=re.escape(given)):
        parse_buses([given])


def _candump(frames: Iterator[Frame], path: Path) -> Path:
    lines = [f"({f.rx_ns // 1000 / 1e6:.6f}) can0 {f.can_id:08X}#{f.data.hex().upper()}\n" for f in frames]
    path.write_text("".join(lines))
    return path


def test_a_log_is_looked_into(machine: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = _candump(simulate(machine, 1, 12.0, DRIVE), tmp_path / "candump.log")
    assert main(["discover", str(log), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["frames"] > 9000
    assert answer["wheel_angles"][0]["id"] == STEER
    assert {receiver["source"] for receiver in answer["receivers"]} == {28, 70, 128, 129}
    parse_machine(_filled(answer["machine_file"]))
    out = tmp_path / "draft.toml"
    assert main(["discover", str(log), "--out", str(out)]) == 0
    assert out.read_text() == answer["machine_file"]
    output = capsys.readouterr()
    assert "A00017000421E240" in output.out
    assert str(out) in output.err
    assert main(["discover", str(log), "--out", str(out)]) == 2  # never overwritten


_NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("Z", "C")), min_size=1, max_size=30).filter(
    lambda name: name[0] not in "#(<\ufeff" and not name.isspace()
)


@pytest.fixture(scope="module")
def short_drive(machine: Machine) -> list[Frame]:
    return list(simulate(machine, 1, 3.0, DRIVE))


@given(st.lists(_NAMES, min_size=2, max_size=2))
@example(["/dev/ttyUSB0@115200", "/dev/ttyUSB1@115200"])
@example(["a/b", "a.b"])
@example(["a/b", "a_b"])
@example(['"', "\\"])
@settings(max_examples=15, deadline=None)
def test_whatever_a_log_calls_its_buses_the_draft_parses(
    machine: Machine, short_drive: list[Frame], tmp_path_factory: pytest.TempPathFactory, names: list[str]
) -> None:
    path = tmp_path_factory.getbasetemp() / "named.log"
    by_bus = {f.can_id & 0xFF: names[f.can_id & 1] for f in short_drive}
    path.write_text(
        "".join(
            f"({f.rx_ns / SECOND:.6f}) {by_bus[f.can_id & 0xFF]} {f.can_id:08X}#{f.data.hex()}\n"
            for f in short_drive
        ),
        encoding="utf-8",
    )
    findings = _findings(frames(path))
    drafted = parse_machine(_filled(draft(findings, [])))
    assert {bus.name for bus in drafted.bus} == set(findings.buses)
    assert len(findings.buses) == len(set(names))
    assert {r.name for r in drafted.receiver} == {r.name for r in machine.receiver}


_WORDS = st.text(max_size=20)


@given(
    st.lists(_WORDS.filter(lambda word: "," not in word), min_size=1, max_size=4),
    st.text(min_size=1, max_size=9),
    st.dictionaries(_WORDS, _WORDS | st.integers() | st.booleans() | st.floats(allow_nan=False), max_size=3),
)
@example(["/dev/ttyUSB0@115200", "can1"], "slcan", {"a b": 'x"\x7f\x00\n'})
@settings(max_examples=60, deadline=None)
def test_whatever_bus_is_listened_to_the_draft_parses(
    found: Findings, channels: list[str], interface: str, options: dict[str, str | int | float | bool]
) -> None:
    pairs = "".join(f",{key}={value}" for key, value in options.items())
    try:
        buses = parse_buses([f"{interface}:{channel}{pairs}" for channel in channels])
    except WrongUse:
        return
    heard = replace(
        found,
        buses=tuple(bus.name for bus in buses),
        sources=tuple(replace(source, bus=buses[0].name) for source in found.sources),
        wheel_angles=tuple(replace(c, bus=buses[0].name) for c in found.wheel_angles),
    )
    assert list(parse_machine(_filled(draft(heard, buses))).bus) == buses


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["--bus", "virtual:x", "log.mcap"],
        ["--bus", "no-such:x"],
        ["--bus", "virtual:x", "--seconds", "0"],
    ],
)
def test_wrong_use(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status: object = main(["discover", *words])
    except SystemExit as left:
        status = left.code
    assert status == 2
    assert capsys.readouterr().out == ""


def test_a_bus_on_which_nothing_is_heard(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["discover", "--bus", "virtual:silence", "--seconds", "0.3"]) == 1
    assert "no frame was heard" in capsys.readouterr().err


def test_it_listens_and_never_sends(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    done = threading.Event()
    sent: list[can.Message] = []

    def talk() -> None:
        frames = list(simulate(machine, 1, 2.0))
        with can.Bus(interface="virtual", channel="talk", receive_own_messages=False) as bus:
            while not done.is_set():
                for frame in frames:
                    bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=True))
                done.wait(0.1)
            while (message := bus.recv(0)) is not None:
                sent.append(message)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        status = main(["discover", "--bus", "virtual:talk", "--seconds", "1", "--json"])
    finally:
        done.set()
        thread.join()
    answer = json.loads(capsys.readouterr().out)
    assert status == 0
    assert answer["frames"] > 0
    assert answer["buses"] == ["talk"]
    assert sent == []


def _twins(machine: Machine) -> Iterator[Frame]:
    """The rear receiver of the implement has the NAME of the front one."""
    names = {r.mount: r.name for r in machine.receiver}
    one, other = names[Mount.IMPLEMENT_FRONT], names[Mount.IMPLEMENT_REAR]
    assert one is not None and other is not None
    for frame in simulate(machine, 1, 6.0):
        yield replace(frame, data=claim(one)) if frame.data == claim(other) else frame


def test_where_two_devices_have_one_name_the_draft_gives_their_addresses(machine: Machine) -> None:
    findings = _findings(_twins(machine))
    assert [s.source for s in findings.receivers if s.shares_name] == [70, 129]
    text = draft(findings, [])
    assert text.count("# two devices claim NAME C07891000B002711: it identifies neither") == 2
    drafted = parse_machine(_filled(text))
    assert [(r.name is None, r.source) for r in drafted.receiver if r.source] == [(True, 70), (True, 129)]


def test_a_device_that_changes_its_address_is_drafted_once(machine: Machine) -> None:
    frames = list(simulate(machine, 1, 6.0))
    moved = can_id.join(6, 60928, 140)
    half = frames[len(frames) // 2]
    name = next(r.name for r in machine.receiver if r.mount is Mount.IMPLEMENT_REAR)
    assert name is not None
    late = [
        replace(f, can_id=f.can_id - 129 + 140) if f.can_id & 0xFF == 129 else f
        for f in frames[len(frames) // 2 :]
    ]
    said = replace(half, can_id=moved, extended=True, data=claim(name))
    text = draft(_findings(iter([*frames[: len(frames) // 2], said, *late])), [])
    assert text.count(f"{name:016X}") == 1 and text.count("[[receiver]]") == 4
