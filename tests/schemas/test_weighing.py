"""A scale that a DBC file describes: bytes to kilograms, to what is used, and sentences for what is wrong."""

from pathlib import Path

import pytest
from cart import LOAD_TEXT
from logs import MACHINE_TEXT

from tilth.estimator import fold
from tilth.logger.machine_file import read_machine
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Event, Frame, LoadSource, Weight
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import unusual
from tilth.schemas.weighing import compile_weighing

SCALE = 0x18FF2A80
OTHER = 0x18FF2B80
STANDARD = 0x2A1
EXTENDED = 1 << 31  # how a DBC file marks a 29-bit identifier
DBC = f"""VERSION ""
NS_ :
BS_:
BU_: CART

BO_ {SCALE | EXTENDED} CartScale: 8 CART
 SG_ Gross : 7|16@0+ (0.01,0) [0|600] "t" CART
 SG_ Net : 16|16@1- (1,0) [0|0] "kg" CART
 SG_ Pounds : 32|20@1+ (1,0) [0|0] "lb" CART

BO_ {OTHER | EXTENDED} Other: 8 CART
 SG_ Bare : 32|16@1+ (2,0) [0|0] "" CART
 SG_ Labelled : 16|16@1- (1,0) [0|0] "t" CART
 SG_ Fine : 48|16@1+ (0.01,0) [0|0] "kg" CART
 SG_ Bar : 0|16@1+ (1,0) [0|0] "bar" CART

BO_ {STANDARD} Small: 4 CART
 SG_ Hopper : 0|32@1+ (0.1,-100) [0|0] "kg" CART
 SG_ Beyond : 56|24@1+ (1,0) [0|0] "kg" CART
"""


def keys(signal: str, more: str = "") -> str:
    return f'[implement.load.weighing]\nbus = "can0"\ndbc = "cart.dbc"\nsignal = "{signal}"\n{more}\n'


def machine(signal: str, more: str = "", dbc: str = DBC) -> Machine:
    return parse_machine(MACHINE_TEXT + LOAD_TEXT + keys(signal, more), f"\f{dbc}")


def frame(data: str, identifier: int = SCALE, t_ns: int = 1) -> Frame:
    return Frame(t_ns, t_ns, "can0", identifier, identifier > 0x7FF, False, bytes.fromhex(data))


CASES: list[tuple[str, str, int, str, float | str]] = [
    ("Gross", 'weighs = "whole"', SCALE, "032DFFFFFFFFFFFF", 8130.0),
    ("Gross", 'weighs = "whole"', SCALE, "FFFFFFFFFFFFFFFF", "not_available"),
    ("Net", "", SCALE, "FFFF7017FFFFFFFF", 6000.0),
    ("Net", "", SCALE, "FFFFE2FFFFFFFFFF", -30.0),
    ("Net", "not_available = 0x7FFF", SCALE, "FFFFFF7FFFFFFFFF", "not_available"),
    ("Net", "scale = 0.5\noffset = 100", SCALE, "FFFF7017FFFFFFFF", 3100.0),
    ("Net", "mask = 0x1FFFFF00", SCALE & ~0xFF | 0x33, "FFFF7017FFFFFFFF", 6000.0),
    ("Pounds", "", SCALE, "FFFFFFFFAC3300FF", 13228 * 0.45359237),
    ("Bare", "scale = 1", OTHER, "FFFFFFFFB80BFFFF", 6000.0),
    ("Hopper", "", STANDARD, "48EE0000", 6000.0),
    ("Hopper", "", STANDARD, "48EE", "short_frame"),
]


@pytest.mark.parametrize(("signal", "more", "identifier", "data", "expected"), CASES)
def test_bytes_of_a_scale(signal: str, more: str, identifier: int, data: str, expected: float | str) -> None:
    decoder = Decoder(machine(signal, more))
    found = decoder.measurements(frame(data, identifier))
    if isinstance(expected, str):
        assert decoder.rejected == {expected: 1} and not found
        return
    (weight,) = found
    assert isinstance(weight, Weight)
    whole = "whole" in more
    assert (weight.whole_mass if whole else weight.carried_mass) == pytest.approx(expected)
    assert (weight.carried_mass if whole else weight.whole_mass) is None
    (message,) = Decoder(machine(signal, more)).messages(frame(data, identifier))
    key = "whole_mass_kg" if whole else "carried_mass_kg"
    assert message.title == "scale" and message.values == {key: pytest.approx(expected)}


def test_the_dbc_file_is_read_as_cantools_reads_it() -> None:
    cantools = pytest.importorskip("cantools")
    database = cantools.database.load_string(DBC, "dbc", strict=False)
    for data in (bytes(range(8)), bytes(range(40, 48)), bytes.fromhex("0102030405860708")):
        theirs = database.decode_message(SCALE, data)
        for signal, kg in (("Gross", 1000.0), ("Net", 1.0), ("Pounds", 0.45359237)):
            signal_of = compile_weighing(machine(signal))
            assert signal_of is not None and signal_of.reading(data) == pytest.approx(theirs[signal] * kg)


MISTAKES = [
    (("Nett",), r'weighing\.signal = "Nett": is not in it; the signals there are: Bar, Bare, Beyond'),
    (("Bare",), r"has no unit in cart\.dbc, which is not kg, t or lb; give implement.load.weighing"),
    (("Bar",), r'is in "bar" in cart\.dbc'),
    (("Labelled",), r"a bit of it is 1,000 kg, a full load 6,000 kg; check its unit"),
    (("Net", "scale = 1000"), r"a bit of it is 1,000 kg"),
    (("Fine",), r"its 16 bits tell 655 kg at most, a full one has 6,000 kg; check its unit"),
    (("Beyond",), r"its field ends in byte 9, a frame has bytes 0 to 7"),
    (("Net", "not_available = [5, 2]"), r"weighing\.not_available = \[5, 2\]: give one raw value"),
    (("Net", "scale = -1"), r"implement.load.weighing.scale = -1"),
    (("Net", 'weighs = "axle"'), r"weighs"),
    (("Net", "sacle = 2"), r"sacle"),
    (("Net", "", "what is this?"), r'weighing\.dbc = "cart\.dbc": not a DBC file'),
]


@pytest.mark.parametrize(("given", "complaint"), MISTAKES)
def test_a_mistake_gets_one_clear_line(given: tuple[str, ...], complaint: str) -> None:
    with pytest.raises(MachineError, match=complaint) as caught:
        machine(*given)
    assert "\n" not in str(caught.value)


def test_its_bus_is_one_of_the_file() -> None:
    with pytest.raises(MachineError, match=r'implement\.load\.weighing: bus = "can7" is no \[\[bus\]\]'):
        parse_machine(MACHINE_TEXT + LOAD_TEXT + keys("Net").replace("can0", "can7"), f"\f{DBC}")


def test_what_it_says_is_used_as_any_scales_word() -> None:
    state = fold.initial(machine("Net"))
    told = [p.value for p in fold.step(state, frame("FFFF7017FFFFFFFF")) if isinstance(p.value, Event)]
    assert [event.notice.code for event in told] == ["load_told"]
    assert state.carried is not None and state.carried.source is LoadSource.SCALE
    assert state.carried.mass == pytest.approx(6000.0)
    second = 1_000_000_000
    for k in range(1, 41):  # an empty scale shows somewhat less than nothing
        fold.step(state, frame("FFFFE2FFFFFFFFFF", t_ns=k * second))
    assert state.scale is not None and state.scale.mass == pytest.approx(0.0, abs=1.0)
    assert not state.rejected
    fold.step(state, frame("FFFF0080FFFFFFFF", t_ns=41 * second))  # a broken one far less
    assert state.rejected == {"out_of_range": 1} and state.scale.mass == pytest.approx(0.0, abs=1.0)


def test_a_scale_that_is_described_is_the_one_that_is_meant() -> None:
    decoder = Decoder(machine("Net"))
    of_the_tractor = bytes.fromhex("FFFFFFE00FB80BFF")  # PGN 65258
    assert not decoder.measurements(Frame(1, 1, "can0", 0x1CFEEA00, True, False, of_the_tractor))


def test_its_file_lies_beside_the_file_that_names_it(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text(MACHINE_TEXT + LOAD_TEXT + keys("Net"))
    with pytest.raises(MachineError, match=r"cart\.dbc: the implement\.load\.weighing\.dbc cannot be read"):
        read_machine(file)
    (tmp_path / "cart.dbc").write_text(DBC)
    read = read_machine(file)
    assert read.machine.weighing is not None and read.machine.weighing.dbc_text == DBC
    # A log holds both texts; what is read of it is the same machine.
    assert parse_machine(read.text, read.machine.dbc_text) == read.machine
    assert not [text for text in unusual(read.machine) if "weighing" in text]
