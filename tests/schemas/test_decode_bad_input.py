"""Whatever is on the wire: nothing raises, every loss has a reason, and a decoder goes on from its dump."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import MACHINE_FILE, shared

from tilth.replay.readers.any_log import frames
from tilth.schemas import can_id
from tilth.schemas.decode import ROUTES, Decoder, claim, encode, frames_of
from tilth.schemas.flow import Frame, Measurement, Message
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.pgn_table import PGNS
from tilth.schemas.reassembly import TP_CONTROL, TP_DATA
from tilth.schemas.rejections import Rejection
from tilth.schemas.sentences.rejections import REJECTIONS
from tilth.schemas.signals import SIGNALS

RIG = parse_machine(MACHINE_FILE.read_text())
NAMES = [receiver.name or 0 for receiver in RIG.receiver]
BOUNDED = settings(derandomize=True, max_examples=80, deadline=None)

PGN_ON_THE_WIRE = st.sampled_from([*(row.pgn for row in PGNS), TP_CONTROL, TP_DATA, 59904, 61444])
SOURCES = st.sampled_from([28, 29, 99, 254, 255])
EDGES = st.sampled_from([0x00, 0x01, 0x20, 0x53, 0x7F, 0x80, 0xE1, 0xFA, 0xFB, 0xFD, 0xFE, 0xFF])
OCTET = st.one_of(EDGES, st.integers(0, 255))


@st.composite
def any_data(draw: st.DrawFn) -> bytes:
    kind = draw(st.sampled_from(["bytes", "claim", "announcement", "long"]))
    if kind == "claim":
        return claim(draw(st.sampled_from([*NAMES, (1 << 64) - 1, 0])))
    if kind == "announcement":
        control, length = (
            draw(st.sampled_from([16, 17, 19, 32, 255])),
            draw(st.sampled_from([0, 9, 43, 1785])),
        )
        pgn = draw(st.sampled_from([129029, 65535, 60928, 0]))
        head = [control, length & 255, length >> 8, (length + 6) // 7 & 255, 255]
        return bytes(head) + pgn.to_bytes(3, "little")
    return bytes(draw(st.lists(OCTET, max_size=64 if kind == "long" else 8)))


@st.composite
def any_frames(draw: st.DrawFn) -> list[Frame]:
    """Frames of the PGNs and addresses that matter, with time that may step."""
    t_ns, decoded = draw(st.sampled_from([0, 10**18])), []
    for _ in range(draw(st.integers(1, 25))):
        t_ns += draw(st.sampled_from([0, 500_000, 100_000_000, 2_000_000_000, -5_000_000_000]))
        if draw(st.integers(0, 9)):
            destination = draw(st.sampled_from([255, 28, 0x1E]))
            identifier = can_id.join(
                draw(st.integers(0, 7)), draw(PGN_ON_THE_WIRE), draw(SOURCES), destination
            )
        else:
            identifier = draw(st.one_of(st.integers(0, (1 << 29) - 1), st.just(0x18FF0B15)))
        extended, error = draw(st.integers(0, 9)) > 0, draw(st.integers(0, 19)) == 0
        decoded.append(Frame(t_ns, t_ns, "can0", identifier, extended, error, draw(any_data())))
    return decoded


def check(found: list[Message] | list[Measurement], frame: Frame, decoder: Decoder) -> None:
    assert decoder.rejected.keys() <= set(Rejection)
    for item in found:
        assert item.origin.bus == frame.bus
        if isinstance(item, Message):
            assert item.values.keys() <= SIGNALS.keys()
            json.dumps(dict(item.values), allow_nan=False)


@pytest.mark.parametrize("rig", [None, RIG], ids=["no machine", "a machine"])
@BOUNDED
@given(any_frames())
def test_anything_on_the_wire(rig: Machine | None, decoded: list[Frame]) -> None:
    for_messages, for_measurements = Decoder(rig), Decoder(rig)
    for frame in decoded:
        check(for_messages.messages(frame), frame, for_messages)
        check(for_measurements.measurements(frame), frame, for_measurements)


@BOUNDED
@given(any_frames(), st.data())
def test_a_decoder_goes_on_from_its_dump(decoded: list[Frame], data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(decoded)))
    one, other = Decoder(RIG), Decoder(RIG)
    for frame in decoded[:cut]:
        one.measurements(frame)
    other.load(json.loads(json.dumps(one.dump())))
    for frame in decoded[cut:]:
        assert other.measurements(frame) == one.measurements(frame)
    assert other.rejected == one.rejected
    assert other.dump() == one.dump()


def test_a_decoder_goes_on_from_its_dump_in_recorded_traffic() -> None:
    decoded = list(frames(shared("data/canboat") / "simulator2.raw"))
    for cut in range(0, len(decoded), 97):
        one, other = Decoder(), Decoder()
        for frame in decoded[:cut]:
            one.messages(frame)
        other.load(json.loads(json.dumps(one.dump())))
        for frame in decoded[cut : cut + 200]:
            assert other.messages(frame) == one.messages(frame)
        assert other.dump() == one.dump()


@BOUNDED
@given(st.data())
def test_recorded_traffic_with_bits_flipped(data: st.DataObject) -> None:
    decoded = list(frames(shared("data/canboat") / "simulator2.raw"))
    first = data.draw(st.integers(0, len(decoded) - 60))
    decoder = Decoder()
    for frame in decoded[first : first + 60]:
        change = data.draw(st.sampled_from(["none", "none", "bit", "cut", "id"]))
        octets, identifier = bytearray(frame.data), frame.can_id
        if change == "bit" and octets:
            at = data.draw(st.integers(0, 8 * len(octets) - 1))
            octets[at // 8] ^= 1 << at % 8
        elif change == "cut":
            del octets[data.draw(st.integers(0, len(octets))) :]
        elif change == "id":
            identifier ^= 1 << data.draw(st.integers(0, 28))
        bent = Frame(frame.t_ns, frame.rx_ns, frame.bus, identifier, True, False, bytes(octets))
        check(decoder.messages(bent), bent, decoder)


def test_memory_does_not_grow_with_foreign_identifiers() -> None:
    decoder = Decoder(RIG)
    for identifier in range(3 * ROUTES):
        assert decoder.measurements(Frame(0, 0, "can0", identifier, False, False, b"")) == []
    assert len(decoder._routes) <= ROUTES
    # What was learnt before is kept: a claim binds its address still.
    source, name = 28, NAMES[0]
    decoder.measurements(Frame(0, 0, "can0", can_id.join(6, 60928, source), True, False, claim(name)))
    for identifier in range(2 * ROUTES):
        decoder.measurements(Frame(0, 0, "can0", identifier, False, False, b""))
    payload = encode(65267, {"latitude_deg": 1.0, "longitude_deg": 2.0})
    ((identifier, data),) = frames_of(65267, payload, source)
    (found,) = decoder.measurements(Frame(1, 1, "can0", identifier, True, False, data))
    assert found.origin.name == name


def test_receivers_that_say_nothing_but_not_available_make_no_measurement() -> None:
    decoder = Decoder(RIG)
    counted = 0
    for source, name in enumerate(NAMES, start=28):
        decoder.measurements(Frame(0, 0, "can0", can_id.join(6, 60928, source), True, False, claim(name)))
        for row in PGNS:
            if row.pgn in (60928, 127245) or row.decode_only:
                continue
            found = [
                item
                for identifier, data in frames_of(row.pgn, row.encode({}), source)
                for item in decoder.measurements(Frame(1, 1, "can0", identifier, True, False, data))
            ]
            assert found == []
            # The two that sit on the implement are no StarFires: the message is not theirs.
            ours = row.selector is None or name >> 21 & 0x7FF == row.manufacturer
            counted += ours and not row.wish  # which would be none in any case
    assert decoder.rejected == {"not_available": counted}


def test_reasons_are_sentences_for_people() -> None:
    assert REJECTIONS.keys() == set(Rejection)
    for reason, sentence in REJECTIONS.items():
        assert reason.replace("_", "").isalpha() and len(sentence) > 20 and "_" not in sentence
