"""From words to measurements: what the receivers say, with which deviation, and what is left out."""

import json
import math

import pytest
from paths import MACHINE_FILE

from tilth.schemas import can_id, flow
from tilth.schemas.decode import Decoder, claim, encode, frames_of
from tilth.schemas.flow import Frame, Mount
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.measures import MAKERS
from tilth.schemas.pgn_table import PGNS, Pgn
from tilth.schemas.rejections import Rejection
from tilth.schemas.signals import SIGNALS

RIG = parse_machine(
    MACHINE_FILE.read_text().replace(
        'name = "A00017000421E240"\n',
        'name = "A00017000421E240"\nposition_sd = 0.03\nvelocity_sd = 0.06\nyaw_rate_sd = 0.4\n'
        "heading_sd = 0.7\nroll_sd = 0.8\n",
    )
)
NAME = 0xA00017000421E240
OWN, STRANGER = 28, 99
UTC_NS = 1_760_000_000_250_000_000
DEG = math.pi / 180


def decoder() -> Decoder:
    """One that has heard the tractor's front receiver claim its address."""
    fresh = Decoder(RIG)
    fresh.measurements(Frame(0, 0, "can0", can_id.join(6, 60928, OWN), True, False, claim(NAME)))
    return fresh


def measurements_of(
    subject: Decoder,
    pgn: int,
    values: dict[str, flow.Word],
    selector: int | None = None,
    source: int = OWN,
    at_ns: int = 1000,
) -> list[flow.Measurement]:
    sid = 7 if any(row.has_sid for row in PGNS if row.pgn == pgn) else None
    frames = frames_of(pgn, encode(pgn, values, selector=selector, sid=sid), source)
    found = []
    for i, (identifier, data) in enumerate(frames):
        frame = Frame(at_ns + i, at_ns + i - 5, "can0", identifier, True, False, data)
        found += subject.measurements(frame)
    return found


HEAD = (1000, 995, flow.Origin("can0", OWN, NAME, Mount.TRACTOR_FRONT))
HERE: dict[str, flow.Word] = {"latitude_deg": 43.5, "longitude_deg": -83.25}

# PGN, selector, words, measurements that they make.
MADE: list[tuple[int, int | None, dict[str, flow.Word], list[flow.Measurement]]] = [
    (65267, None, HERE, [flow.Position(*HEAD, 65267, None, 43.5, -83.25, 0.03)]),
    (129025, None, HERE, [flow.Position(*HEAD, 129025, None, 43.5, -83.25, 0.03)]),
    (65256, None, {"course_rad": 0.0, "speed_mps": 2.5, "pitch_rad": 0.0, "altitude_m": 200.0}, [
        flow.Velocity(*HEAD, 65256, None, 0.0, 2.5, 0.06),
        flow.Attitude(*HEAD, 65256, None, None, 0.0, 0.8 * DEG),
    ]),
    (65254, None, {"utc_ns": UTC_NS}, [flow.UtcTime(*HEAD, 65254, None, UTC_NS, 0.25)]),
    (126992, None, {"utc_ns": UTC_NS}, [flow.UtcTime(*HEAD, 126992, 7, UTC_NS, 1e-4)]),
    (129033, None, {"utc_ns": UTC_NS}, [flow.UtcTime(*HEAD, 129033, None, UTC_NS, 1e-4)]),
    (65535, 0xE1, {"roll_rad": 0.0, "yaw_rate_radps": 0.0}, [
        flow.YawRate(*HEAD, 65535, None, 0.0, 0.4 * DEG),
        flow.Attitude(*HEAD, 65535, None, 0.0, None, 0.8 * DEG),
    ]),
    (65535, 0x53, {"fix": "rtk_fixed"}, [flow.Fix(*HEAD, 65535, None, flow.FixType.RTK_FIXED)]),
    (129026, None, {"course_rad": 1.5, "speed_mps": 2.0, "heading_reference": "true"}, [
        flow.Velocity(*HEAD, 129026, 7, 1.5, 2.0, 0.06),
    ]),
    (129029, None, {
        **HERE, "altitude_m": 210.5, "utc_ns": UTC_NS, "fix": "rtk_float", "satellites": 14, "hdop": 0.75,
    }, [
        flow.Position(*HEAD, 129029, 7, 43.5, -83.25, 0.03, 210.5),
        flow.Fix(*HEAD, 129029, 7, flow.FixType.RTK_FLOAT, 14, 0.75),
        flow.UtcTime(*HEAD, 129029, 7, UTC_NS, 1e-4),
    ]),
    (129029, None, {"fix": "none"}, [flow.Fix(*HEAD, 129029, 7, flow.FixType.NONE)]),
    (127250, None, {"heading_rad": 0.5, "heading_reference": "true"}, [
        flow.Heading(*HEAD, 127250, 7, 0.5, 0.7 * DEG),
    ]),
    (127251, None, {"yaw_rate_radps": -0.25}, [flow.YawRate(*HEAD, 127251, 7, -0.25, 0.4 * DEG)]),
    (127257, None, {"roll_rad": 0.05, "pitch_rad": -0.02, "yaw_rad": 1.0}, [
        flow.Attitude(*HEAD, 127257, 7, 0.05, -0.02, 0.8 * DEG),
    ]),
    (127257, None, {"roll_rad": 0.05}, [flow.Attitude(*HEAD, 127257, 7, 0.05, None, 0.8 * DEG)]),
    (65096, None, {"speed_mps": 2.0, "direction": "forward"}, [
        flow.VehicleSpeed(*HEAD, 65096, None, 2.0, "forward"),
    ]),
    (65097, None, {"speed_mps": 2.0}, [flow.VehicleSpeed(*HEAD, 65097, None, 2.0, None)]),
    (65258, None, {"whole_mass_kg": 8128.0, "carried_mass_kg": 6000.0}, [
        flow.Weight(*HEAD, 65258, None, 8128.0, 6000.0),
    ]),
    (44032, None, {"curvature_per_m": 0.01}, [flow.Curvature(*HEAD, 44032, None, 0.01)]),
]  # fmt: skip


@pytest.mark.parametrize(("pgn", "selector", "values", "expected"), MADE)
def test_what_a_receiver_says_becomes_measurements(
    pgn: int, selector: int | None, values: dict[str, flow.Word], expected: list[flow.Measurement]
) -> None:
    subject = decoder()
    found = measurements_of(subject, pgn, values, selector)
    # As a set: one message's measurements have one instant, their order says nothing.
    assert sorted(map(repr, found)) == sorted(map(repr, expected))
    assert subject.rejected == {}


def test_every_message_of_a_receiver_is_in_that_table() -> None:
    assert {(row.pgn, row.selector) for row in PGNS} - {(pgn, selector) for pgn, selector, _, _ in MADE} == {
        (61449, None), (60928, None), (127245, None), (44288, None),
    } | {(row.pgn, row.selector) for row in PGNS if row.decode_only}  # fmt: skip


@pytest.mark.parametrize("row", [row for row in PGNS if row.decode_only], ids=lambda row: str(row.pgn))
def test_what_is_only_told_costs_a_measuring_decoder_nothing(row: Pgn) -> None:
    """It is neither put together nor counted, from a receiver of the machine file or from a stranger."""
    for source in (OWN, STRANGER):
        subject = decoder()
        before = json.dumps(subject.dump()["assembler"])
        for identifier, data in frames_of(row.pgn, row.encode({}), source):
            assert subject.measurements(Frame(0, 0, "can0", identifier, True, False, data)) == []
        assert subject.rejected == {} and json.dumps(subject.dump()["assembler"]) == before


def test_strangers_are_named_and_counted() -> None:
    subject = decoder()
    name = 0xA00017000421FFFF
    subject.measurements(Frame(0, 0, "can0", can_id.join(6, 60928, 90), True, False, claim(name)))
    for source, times in ((STRANGER, 3), (90, 2)):
        for _ in range(times):
            measurements_of(subject, 65267, HERE, source=source)
    assert subject.unknown == {flow.Origin("can0", STRANGER): 3, flow.Origin("can0", 90, name): 2}
    assert subject.rejected == {"unknown_source": 5}
    later = decoder()
    later.load(json.loads(json.dumps(subject.dump())))
    assert later.unknown == subject.unknown


@pytest.mark.parametrize("source", [STRANGER, 28])
def test_a_command_is_a_wish_and_no_measurement(source: int) -> None:
    subject = decoder()
    assert measurements_of(subject, 44288, {"commanded_curvature_per_m": 0.01}, source=source) == []
    assert subject.rejected == {}


def test_the_hand_wheel_is_anyones_and_its_yaw_rate_only_a_receivers() -> None:
    values: dict[str, flow.Word] = {"hand_wheel_angle_rad": 1.0, "yaw_rate_radps": 0.1}
    (angle,) = measurements_of(decoder(), 61449, values, source=STRANGER)
    assert isinstance(angle, flow.HandWheelAngle) and angle.angle == pytest.approx(1.0, abs=1e-3)
    assert angle.origin == flow.Origin("can0", STRANGER)
    assert {type(found) for found in measurements_of(decoder(), 61449, values)} == {
        flow.HandWheelAngle,
        flow.YawRate,
    }


@pytest.mark.parametrize(("pgn", "selector", "values", "expected"), MADE)
def test_a_strangers_position_is_not_the_machines(
    pgn: int, selector: int | None, values: dict[str, flow.Word], expected: list[flow.Measurement]
) -> None:
    subject = decoder()
    found = measurements_of(subject, pgn, values, selector, source=STRANGER)
    if pgn in (65096, 65097, 65258, 44032):
        assert len(found) == len(expected)
    else:
        assert found == []
        assert subject.rejected == {"unidentified" if selector else "unknown_source": 1}


# PGN, selector, words, why they make no measurement.
LEFT_OUT: list[tuple[int, int | None, dict[str, flow.Word], str]] = [
    (129025, None, {}, "not_available"),
    (129025, None, {"latitude_deg": 1.0}, "not_available"),
    (65267, None, {}, "not_available"),
    (65256, None, {"speed_mps": 0.0}, "not_available"),
    (65535, 0xE1, {}, "not_available"),
    (129029, None, {}, "not_available"),
    (44032, None, {}, "not_available"),
    (127250, None, {"heading_rad": 1.0, "heading_reference": "magnetic"}, "magnetic"),
    (129026, None, {"course_rad": 1.0, "speed_mps": 1.0, "heading_reference": "magnetic"}, "magnetic"),
    (127250, None, {"heading_rad": 1.0}, "no_reference"),
    (65254, None, {"utc_ns": 946_684_800_000_000_000}, "early_date"),
    (126992, None, {"utc_ns": 315_964_800_000_000_000}, "early_date"),
    (127245, None, {"wheel_angle_rad": 0.1}, "unknown_source"),
]


@pytest.mark.parametrize(("pgn", "selector", "values", "reason"), LEFT_OUT)
def test_what_is_left_out_is_counted(
    pgn: int, selector: int | None, values: dict[str, flow.Word], reason: str
) -> None:
    subject = decoder()
    assert measurements_of(subject, pgn, values, selector) == []
    assert subject.rejected == {reason: 1}
    assert reason in set(Rejection)


def test_a_repeated_position_is_marked_and_counted() -> None:
    subject = decoder()
    there: dict[str, flow.Word] = {"latitude_deg": 43.5000001, "longitude_deg": -83.25}
    marks = []
    for values in (HERE, HERE, there, {}, there, HERE):
        marks += [
            found.repeat
            for found in measurements_of(subject, 65267, values)
            if isinstance(found, flow.Position)
        ]
    assert marks == [False, True, False, True, False]
    assert subject.rejected == {"repeat": 2, "not_available": 1}
    # Another message or another source that says the same place repeats nothing.
    for pgn, source in ((129025, OWN), (129029, OWN)):
        (first, *_), (again, *_) = (measurements_of(subject, pgn, HERE, source=source) for _ in range(2))
        assert isinstance(first, flow.Position) and isinstance(again, flow.Position)
        assert (first.repeat, again.repeat) == (False, True)


def test_messages_mark_repeats_too() -> None:
    subject = Decoder()
    ((identifier, data),) = frames_of(129025, encode(129025, HERE), 5)
    collected = [subject.messages(Frame(t, t, "can0", identifier, True, False, data))[0] for t in range(2)]
    assert [message.repeat for message in collected] == [False, True]


# Data of a frame from a receiver and the one reason that it is counted under.
FAULTY = [
    (129025, "00000040000000F0", "out_of_range"),  # 107 deg north
    (129025, "00000010", "short_frame"),
    (65267, "", "short_frame"),
    (127251, "00FFFFFF1FFFFFFF", "out_of_range"),
    (126992, "00FF034290A6CD", "short_frame"),
]


@pytest.mark.parametrize(("pgn", "data", "reason"), FAULTY)
def test_a_faulty_message_is_counted_once(pgn: int, data: str, reason: str) -> None:
    frame = Frame(1, 1, "can0", can_id.join(3, pgn, OWN), True, False, bytes.fromhex(data))
    subject = decoder()
    assert subject.measurements(frame) == [] and subject.rejected == {reason: 1}
    subject = Decoder()
    (decoded,) = subject.messages(frame)
    assert subject.rejected == {reason: 1}
    assert decoded.values.keys() <= {"latitude_deg", "longitude_deg"}


def test_an_absurd_altitude_does_not_spoil_the_position() -> None:
    (found, *_) = measurements_of(decoder(), 129029, {**HERE, "altitude_m": 5_000_000.0})
    assert isinstance(found, flow.Position) and found.altitude_m is None


def test_error_frames_are_counted_and_read_by_nobody() -> None:
    subject = decoder()
    ((identifier, data),) = frames_of(65267, encode(65267, HERE), OWN)
    assert subject.measurements(Frame(0, 0, "can0", identifier, True, True, data)) == []
    assert subject.messages(Frame(0, 0, "can0", 0x204, False, True, data)) == []
    assert subject.rejected == {"error_frame": 2}


def test_a_message_that_a_log_holds_assembled() -> None:
    subject = decoder()
    payload = encode(129029, HERE, sid=3)
    frame = Frame(9, 9, "can0", can_id.join(3, 129029, OWN), True, False, payload)
    (found,) = subject.measurements(frame)
    assert isinstance(found, flow.Position) and (found.t_ns, found.sid) == (9, 3)


def test_a_message_by_transport_protocol() -> None:
    subject = decoder()
    payload = encode(129029, HERE, sid=3)
    announcement = bytes([32, len(payload), 0, 7, 255]) + (129029).to_bytes(3, "little")
    parts = [payload[i : i + 7].ljust(7, b"\xff") for i in range(0, len(payload), 7)]
    found = []
    for at, (pgn, data) in enumerate(
        [(60416, announcement), *((60160, bytes([i + 1]) + part) for i, part in enumerate(parts))]
    ):
        found += subject.measurements(
            Frame(100 + at, 50 + at, "can0", can_id.join(7, pgn, OWN, 255), True, False, data)
        )
    (position,) = found
    assert isinstance(position, flow.Position)
    assert (position.t_ns, position.rx_ns, position.pgn, position.sid) == (100, 50, 129029, 3)


def test_makers_ask_for_words_that_there_are() -> None:
    for maker in MAKERS:
        assert maker.signals <= set(SIGNALS)
