"""Wheel-angle sensors as the machine file describes them: rows, DBC signals, PGN 127245."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import MACHINE_FILE

from tilth.schemas import can_id
from tilth.schemas.decode import Decoder, encode
from tilth.schemas.flow import Frame, WheelAngle
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.wheel_angle import WheelAngleSensor, compile_sensor

TEXT = MACHINE_FILE.read_text()
DANFOSS = 0x18FF0B15

ANY_SOURCE = 0x18FE14FE  # a J1939 file writes source 0xFE for "whoever sends it"
EXTENDED = 1 << 31  # how a DBC file marks a 29-bit identifier

DBC = f"""VERSION ""
NS_ :
BS_:
BU_: STEER

BO_ {DANFOSS | EXTENDED} WheelAngle: 8 STEER
 SG_ Angle : 7|16@0- (0.01,-5) [0|0] "deg" STEER
 SG_ Status : 16|4@1+ (1,0) [0|0] "" STEER
 SG_ Tail : 20|12@1+ (0.1,0) [0|0] "deg" STEER

BO_ {ANY_SOURCE | EXTENDED} AnySource: 8 STEER
 SG_ Wide : 0|16@1+ (0.02,-100) [0|0] "deg" STEER

BO_ 1200 Standard: 8 STEER
 SG_ Short : 8|16@1- (0.1,0) [0|0] "deg" STEER
 SG_ Which M : 0|4@1+ (1,0) [0|0] "" STEER
 SG_ Hidden m1 : 24|16@1- (0.1,0) [0|0] "deg" STEER
"""


def machine(keys: str, tractor: str = "", dbc_text: str | None = None) -> Machine:
    """The demo's machine with this wheel-angle section."""
    head, tail = TEXT[: TEXT.index("[wheel_angle]")], TEXT[TEXT.index("[log]") :]
    head = head.replace("cg_height = 1.1\n", f"cg_height = 1.1\n{tractor}\n", 1)
    return parse_machine(f'{head}\n[wheel_angle]\nbus = "can0"\n{keys}\n{tail}', dbc_text, plausible=False)


def sensor(keys: str, tractor: str = "", dbc_text: str | None = None) -> WheelAngleSensor:
    return compile_sensor(machine(keys, tractor, dbc_text))


ROW = f"id = {DANFOSS}\nstart_byte = 0\nscale = 0.01\n"

# Keys of the machine file, data, mean road-wheel angle in degrees or the reason why there is none.
CASES: list[tuple[str, str, float | str]] = [
    (ROW + 'byte_order = "big"', "03E8FFFFFFFFFFFF", 10.0),
    (ROW + 'byte_order = "big"', "FC18FFFFFFFFFFFF", -10.0),
    (ROW + 'byte_order = "little"', "E803FFFFFFFFFFFF", 10.0),
    (ROW + "signed = false\noffset = -327.68", "E883FFFFFFFFFFFF", 10.0),
    (ROW + "sign = -1", "E803FFFFFFFFFFFF", -10.0),
    (ROW + "zero = 1.5", "E803FFFFFFFFFFFF", 8.5),
    (ROW + "sign = -1\nzero = { value = 1.5, sd = 0.2 }", "E803FFFFFFFFFFFF", -11.5),
    (ROW + "offset = 2.0", "E803FFFFFFFFFFFF", 12.0),
    (ROW.replace("_byte = 0", "_byte = 3") + 'byte_order = "big"', "FFFFFF03E8FFFFFF", 10.0),
    (ROW.replace("_byte = 0", "_byte = 6"), "FFFFFFFFFFFFE803", 10.0),
    # As in a DBC file: bit 7 is the most significant of byte 0, bit 0 the least.
    (ROW.replace("start_byte = 0", "start_bit = 7") + 'byte_order = "big"', "03E8FFFFFFFFFFFF", 10.0),
    (
        ROW.replace("start_byte = 0", "start_bit = 3") + 'byte_order = "big"\nbits = 12',
        "F3E8FFFFFFFFFFFF",
        10.0,
    ),
    (ROW.replace("start_byte = 0", "start_bit = 12") + "bits = 12", "FF8F3EFFFFFFFFFF", 10.0),
    (ROW + "not_available = 0x7FFF", "FF7FFFFFFFFFFFFF", "not_available"),
    (ROW + "not_available = 0x8000", "0080FFFFFFFFFFFF", "not_available"),  # as read, unsigned
    (ROW + "not_available = [0xFB00, 0xFFFF]\nsigned = false", "00FBFFFFFFFFFFFF", "not_available"),
    (ROW + "not_available = [0xFB00, 0xFFFF]", "FFFFFFFFFFFFFFFF", "not_available"),
    (ROW + "not_available = [0xFB00, 0xFFFF]\nsigned = false\nscale = 0.001", "FFFA000000000000", 64.255),
    (ROW, "E8", "short_frame"),
    (ROW, "", "short_frame"),
    (ROW, "FF7FFFFFFFFFFFFF", "out_of_range"),  # 327 deg
    (ROW + "lookup = [[-20, -30], [0, 0], [20, 24]]", "E803FFFFFFFFFFFF", 12.0),
    (ROW + "lookup = [[-20, -30], [0, 0], [20, 24]]", "18FCFFFFFFFFFFFF", -15.0),
    (ROW + "lookup = [[-20, -30], [0, 0], [20, 24]]\nsign = -1\nzero = 1", "18FCFFFFFFFFFFFF", 14.0),
    (ROW + "lookup = [[-20, -30], [20, 24]]", "D207FFFFFFFFFFFF", "out_of_range"),  # 20.02, past its end
]
CASES = [
    (keys.replace("scale = 0.01\n", "", 1) if keys.count("scale") > 1 else keys, d, e) for keys, d, e in CASES
]


@pytest.mark.parametrize(("keys", "data", "expected"), CASES)
def test_a_sensor_as_a_row(keys: str, data: str, expected: float | str) -> None:
    found = sensor(keys).read(bytes.fromhex(data))
    if isinstance(expected, str):
        assert found == expected
    else:
        assert isinstance(found, float) and math.degrees(found) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("angle_deg", [-35.0, -5.0, 0.0, 1e-3, 20.0, 40.0])
def test_a_kingpin_is_turned_to_the_mean_of_the_axle(angle_deg: float) -> None:
    """Both wheels' axes meet in one point on the line of the rear axle: the mean wheel's does too."""
    wheelbase, width = 2.9, 1.8
    mean = math.radians(angle_deg)
    for side, across in (("left", -width / 2), ("right", width / 2)):
        if angle_deg:
            radius = wheelbase / math.tan(mean)  # of the turn, to the right, from the middle of the axle
            kingpin = math.atan(wheelbase / (radius - across))
        else:
            kingpin = 0.0
        raw = kingpin / math.radians(1e-6)
        row = f'id = {DANFOSS}\nstart_byte = 0\nbits = 32\nscale = 1e-6\nkingpin = "{side}"'
        compiled = sensor(row, f"kingpin_distance = {width}")
        found = compiled.read(round(raw).to_bytes(4, "little", signed=True))
        assert found == pytest.approx(mean, abs=1e-7)
        assert compiled.read(compiled.data(mean)) == pytest.approx(mean, abs=1e-7)


HEARS = [
    ("", (DANFOSS, True, "can0"), True),
    ("", (DANFOSS, False, "can0"), False),
    ("", (DANFOSS, True, "can1"), False),
    ("", (DANFOSS + 1, True, "can0"), False),
    ("mask = 0x1FFFFF00", (DANFOSS + 1, True, "can0"), True),
    ("mask = 0x1FFFFF00", (DANFOSS + 256, True, "can0"), False),
    ("mask = 0x03FFFF00", (DANFOSS & 0x3FFFFFF, True, "can0"), True),  # whatever the priority and the source
]


@pytest.mark.parametrize(("more", "received", "expected"), HEARS)
def test_which_frames_are_the_sensors(more: str, received: tuple[int, bool, str], expected: bool) -> None:
    identifier, extended, bus = received
    frame = Frame(0, 0, bus, identifier, extended, False, bytes(8))
    assert sensor(ROW + more).hears(frame) == expected
    found = Decoder(machine(ROW + more)).measurements(frame)
    assert [type(item) for item in found] == ([WheelAngle] if expected else [])


def test_an_eleven_bit_sensor_has_no_source() -> None:
    rig = machine(
        "id = 0x2B0\nextended = false\nstart_byte = 0\nscale = 0.1\nsd = 0.2\nnot_available = 0x7FFF"
    )
    decoder = Decoder(rig)
    (found,) = decoder.measurements(Frame(5, 3, "can0", 0x2B0, False, False, bytes.fromhex("6400")))
    assert found == WheelAngle(5, 3, found.origin, 0, None, math.radians(10.0), math.radians(0.2))
    assert (found.origin.source, found.origin.name, found.origin.mount) == (-1, None, None)
    (decoded,) = decoder.messages(Frame(5, 3, "can0", 0x2B0, False, False, bytes.fromhex("6400")))
    assert decoded.values == {"wheel_angle_rad": pytest.approx(math.radians(10.0))}
    assert decoder.measurements(Frame(6, 6, "can0", 0x2B0, False, False, b"\xff\x7f")) == []
    assert decoder.rejected == {"not_available": 1}
    assert decoder.measurements(Frame(7, 7, "can0", 0x2B0, True, False, b"\x64\x00")) == []


def dbc(signal: str, more: str = "") -> str:
    return f'dbc = "steer.dbc"\nsignal = "{signal}"\n{more}'


DBC_CASES: list[tuple[str, int, bool, str, float | str]] = [
    (dbc("Angle"), DANFOSS, True, "03E8FFFFFFFFFFFF", 5.0),
    (dbc("Angle", "not_available = 0x7FFF"), DANFOSS, True, "7FFFFFFFFFFFFFFF", "not_available"),
    (dbc("Angle", "scale = -2.0\noffset = 1.0"), DANFOSS, True, "03E8FFFFFFFFFFFF", -9.0),
    (dbc("Tail"), DANFOSS, True, "FFFF4F06FFFFFFFF", 10.0),
    (dbc("Wide"), ANY_SOURCE & 0x3FFFF00 | 0x0C000033, True, "7C15FFFFFFFFFFFF", 10.0),
    (dbc("Short"), 1200, False, "FF6400FFFFFFFFFF", 10.0),
]


@pytest.mark.parametrize(("keys", "identifier", "extended", "data", "expected"), DBC_CASES)
def test_a_signal_of_a_dbc_file(
    keys: str, identifier: int, extended: bool, data: str, expected: float | str
) -> None:
    decoder = Decoder(machine(keys, dbc_text=DBC))
    found = decoder.measurements(Frame(0, 0, "can0", identifier, extended, False, bytes.fromhex(data)))
    if isinstance(expected, str):
        assert decoder.rejected == {expected: 1} and not found
    else:
        (angle,) = found
        assert isinstance(angle, WheelAngle) and math.degrees(angle.angle) == pytest.approx(expected)


def test_the_dbc_file_is_read_as_cantools_reads_it() -> None:
    cantools = pytest.importorskip("cantools")
    database = cantools.database.load_string(DBC, "dbc")
    for data in (bytes(range(8)), bytes(range(40, 48)), bytes.fromhex("0102030405060708")):
        for signal, identifier in (("Angle", DANFOSS), ("Tail", DANFOSS), ("Wide", ANY_SOURCE)):
            theirs = database.decode_message(identifier, data)[signal]
            ours = sensor(dbc(signal), dbc_text=DBC).read(data)
            assert (
                ours == "out_of_range" if abs(theirs) >= 90 else ours == pytest.approx(math.radians(theirs))
            )


FLOAT = f"\nSIG_VALTYPE_ {ANY_SOURCE | EXTENDED} Wide : 1;\n"
MISTAKES = [
    (dbc("Angel"), DBC, '"Angel": is not in it; the signals there are: Angle, Hidden, Short, Status, Tail'),
    (dbc("Hidden"), DBC, '"Hidden": is multiplexed.*plain signals of that message: Which, Short'),
    (dbc("Angle"), DBC.replace("SG_ Short", "SG_ Angle"), "stands in 2 messages"),
    (dbc("Wide"), DBC.replace("0|16@1+", "0|32@1-") + FLOAT, "is a floating-point number"),
    (dbc("Angle"), "what is this?", "not a DBC file"),
    (dbc("Angle"), None, "its text was not read"),
    (ROW + "not_available = [5, 2]", None, "give one raw value, or"),
    (ROW + "not_available = [5]", None, "give one raw value, or"),
]


@pytest.mark.parametrize(("keys", "text", "complaint"), MISTAKES)
def test_a_mistake_gets_one_clear_line(keys: str, text: str | None, complaint: str) -> None:
    with pytest.raises(MachineError, match=complaint) as caught:
        Decoder(machine(keys, dbc_text=text))
    assert "\n" not in str(caught.value)


RUDDER = "pgn = 127245\nsource = 60\nsign = -1\nzero = 0.5\n"


def rudder(source: int, angle: float | None, instance: int = 0) -> Frame:
    values: dict[str, float | int | str] = {"instance": instance}
    if angle is not None:
        values["wheel_angle_rad"] = angle
    identifier = can_id.join(2, 127245, source)
    return Frame(0, 0, "can0", identifier, True, False, encode(127245, values))


@pytest.mark.parametrize(
    ("more", "frame", "expected"),
    [
        ("", rudder(60, 0.1), -0.1 - math.radians(0.5)),
        ("", rudder(61, 0.1), "unknown_source"),
        ("", rudder(60, None), "not_available"),
        ("instance = 0", rudder(60, 0.1), -0.1 - math.radians(0.5)),
        ("instance = 1", rudder(60, 0.1), "unknown_source"),
    ],
)
def test_pgn_127245(more: str, frame: Frame, expected: float | str) -> None:
    decoder = Decoder(machine(RUDDER + more))
    found = decoder.measurements(frame)
    if isinstance(expected, str):
        assert found == [] and decoder.rejected == {expected: 1}
    else:
        (angle,) = found
        assert isinstance(angle, WheelAngle) and angle.angle == pytest.approx(expected, abs=1e-12)
        assert angle.pgn == 127245 and angle.origin.source == 60
        # The message says what the device said; sign and zero are the machine file's.
        (decoded,) = decoder.messages(frame)
        assert decoded.values == {"instance": 0, "wheel_angle_rad": pytest.approx(0.1)}


ENCODED = [
    ROW + 'byte_order = "big"\nnot_available = 0x7FFF',
    ROW + "sign = -1\nzero = 1.5\noffset = 3.0",
    ROW.replace("_byte = 0", "_bit = 13") + "bits = 14",
    ROW.replace("_byte = 0", "_bit = 13") + 'bits = 14\nbyte_order = "big"',
    ROW + "lookup = [[-60, 50], [-20, 20], [0, 0], [60, -50]]",
    ROW + 'kingpin = "left"',
    ROW + 'kingpin = "right"\nsign = -1',
    RUDDER + "instance = 3",
]


@pytest.mark.parametrize("keys", ENCODED)
@settings(derandomize=True, max_examples=50, deadline=None)
@given(angle=st.floats(-0.7, 0.7))
def test_the_same_row_encodes(keys: str, angle: float) -> None:
    compiled = sensor(keys, "kingpin_distance = 1.8" if "kingpin" in keys else "")
    data = compiled.data(angle)
    assert len(data) == 8
    assert compiled.read(data) == pytest.approx(angle, abs=1.2 * math.radians(compiled.scale))


def test_what_does_not_fit_is_not_sent() -> None:
    for keys, angle in ((ROW + "bits = 12", 0.7), (ROW + "lookup = [[-20, -30], [20, 24]]", 0.5)):
        with pytest.raises(ValueError, match="does not fit"):
            sensor(keys).data(angle)
    with pytest.raises(ValueError, match="does not fit"):
        sensor(ROW + "not_available = 0").data(0.0)
