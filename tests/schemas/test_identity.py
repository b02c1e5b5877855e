"""Who speaks: claims, conflicts, re-claims, losers, fall-backs, and what is done with frames in between."""

import json

import pytest
from paths import MACHINE_FILE

from tilth.schemas import can_id
from tilth.schemas.decode import Decoder, claim, encode, frames_of
from tilth.schemas.flow import AddressClaim, Frame, Mount, Position
from tilth.schemas.identity import KnownAddress, split_name
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import notice_sentence

TEXT = MACHINE_FILE.read_text()
MS = 1_000_000

LOW, HIGH = 0xA00017000421E240, 0xA00017000421E241  # two StarFires: tractor_front, tractor_rear
N2K = 0xC07891000B002711
STRANGER_LOW, STRANGER_HIGH = 0x8000170004200001, 0xF000170004200001
FRONT, REAR = Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR


def machine(*receivers: str) -> Machine:
    """The demo's machine with these receivers."""
    head, tail = TEXT[: TEXT.index("[[receiver]]")], TEXT[TEXT.index("[wheel_angle]") :]
    blocks = "\n".join(
        f'[[receiver]]\nbus = "can0"\nposition = [{2.0 - i}, 0.0, 3.0]\n{text}\n'
        for i, text in enumerate(receivers)
    )
    return parse_machine(f"{head}\n{blocks}\n{tail}")


def named(mount: Mount, name: int, more: str = "") -> str:
    return f'mount = "{mount.value}"\nname = "{name:016X}"\n{more}'


BOTH = machine(named(FRONT, LOW), named(REAR, HIGH))


class Bus:
    """A bus with a clock: what is put on it goes through one decoder."""

    def __init__(self, rig: Machine) -> None:
        self.decoder = Decoder(rig)
        self.at_ms = 1000.0
        self.count = 0

    def _send(self, pgn: int, payload: bytes, source: int, bus: str) -> list[object]:
        ((identifier, data),) = frames_of(pgn, payload, source)
        t_ns = int(self.at_ms * MS)
        self.at_ms += 1.0
        frame = Frame(t_ns, t_ns, bus, identifier, True, False, data)
        return list(self.decoder.measurements(frame))

    def claim(self, source: int, name: int, bus: str = "can0") -> list[object]:
        return self._send(60928, claim(name), source, bus)

    def position_of(self, source: int, bus: str = "can0") -> tuple[Mount | None, int | None] | str:
        """Whose a position from that address is: mount and NAME, or why it was not used."""
        self.count += 1
        before = dict(self.decoder.rejected)
        payload = encode(65267, {"latitude_deg": 40.0 + self.count * 1e-6, "longitude_deg": -90.0})
        found = self._send(65267, payload, source, bus)
        if found:
            (position,) = found
            assert isinstance(position, Position)
            assert position.origin.source == source and position.origin.bus == bus
            return position.origin.mount, position.origin.name
        (reason,) = (r for r, n in self.decoder.rejected.items() if n != before.get(r, 0))
        return reason


def test_the_parts_of_a_name() -> None:
    # The NAME that torriem/gps_j1939 sends: identity 123456, manufacturer 33.
    assert split_name(0x800017000421E240) == (123456, 33)


def test_a_claim_binds_and_tells() -> None:
    bus = Bus(BOTH)
    assert bus.position_of(28) == "unknown_source"
    (decoded,) = bus.claim(28, LOW)
    assert isinstance(decoded, AddressClaim)
    assert (decoded.origin.name, decoded.origin.mount, decoded.origin.source) == (LOW, FRONT, 28)
    assert (decoded.identity, decoded.manufacturer) == (123456, 33)
    assert bus.position_of(28) == (FRONT, LOW)
    assert bus.position_of(28, "can1") == "unknown_source"  # another bus is another address


def test_a_claim_elsewhere_moves_the_receiver() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(130, LOW)
    assert bus.position_of(130) == (FRONT, LOW)
    assert bus.position_of(28) == "quarantine"
    bus.claim(28, HIGH)
    assert bus.position_of(28) == (REAR, HIGH)


def test_the_lower_name_takes_the_address_at_once_and_the_loser_waits_for_its_claim() -> None:
    bus = Bus(BOTH)
    bus.claim(28, HIGH)
    assert bus.position_of(28) == (REAR, HIGH)
    bus.claim(28, LOW)
    assert bus.decoder.rejected["address_conflict"] == 1
    assert bus.position_of(28) == (FRONT, LOW)
    bus.claim(130, HIGH)
    assert bus.position_of(130) == (REAR, HIGH)
    assert bus.position_of(28) == (FRONT, LOW)


def test_two_on_one_address_are_in_quarantine_until_the_holder_answers() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(28, HIGH)
    assert bus.position_of(28) == "quarantine"
    bus.claim(28, LOW)
    assert bus.position_of(28) == (FRONT, LOW)
    bus.claim(130, HIGH)
    assert bus.position_of(130) == (REAR, HIGH)


def test_the_quarantine_ends_where_the_challenger_goes_elsewhere() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(28, HIGH)
    bus.claim(130, HIGH)
    assert bus.position_of(28) == (FRONT, LOW)
    assert bus.position_of(130) == (REAR, HIGH)


def test_a_holder_that_still_sends_keeps_its_address_though_its_answer_was_not_heard() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.at_ms += 60_000
    assert bus.position_of(28) == (FRONT, LOW)
    bus.claim(28, HIGH)
    bus.at_ms += 240
    assert bus.position_of(28) == "quarantine"
    bus.at_ms += 20
    assert bus.position_of(28) == (FRONT, LOW)


def test_an_address_whose_holder_is_gone_goes_to_the_challenger() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.at_ms += 60_000
    bus.claim(28, HIGH)
    assert bus.position_of(28) == "quarantine"
    bus.at_ms += 300
    assert bus.position_of(28) == (REAR, HIGH)


def test_a_clock_that_steps_back_does_not_prolong_the_quarantine() -> None:
    bus = Bus(BOTH)
    bus.at_ms = 3_600_000
    bus.claim(28, LOW)
    bus.claim(28, HIGH)
    bus.at_ms = 1000
    assert bus.position_of(28) == (FRONT, LOW)


def test_who_cannot_claim_has_no_address() -> None:
    bus = Bus(BOTH)
    bus.claim(28, HIGH)
    bus.claim(can_id.NULL_ADDRESS, HIGH)
    assert bus.position_of(28) == "quarantine"
    assert bus.position_of(254) == "unknown_source"
    bus.claim(28, LOW)
    assert bus.position_of(28) == (FRONT, LOW)
    bus.claim(129, HIGH)
    assert bus.position_of(129) == (REAR, HIGH)


def test_the_challenger_has_the_address_where_the_holder_goes() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(28, HIGH)
    bus.claim(can_id.NULL_ADDRESS, LOW)
    assert bus.position_of(28) == (REAR, HIGH)


@pytest.mark.parametrize("stranger", [STRANGER_LOW, STRANGER_HIGH])
def test_a_stranger_on_a_receivers_address_is_not_the_receiver(stranger: int) -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(28, stranger)
    assert bus.position_of(28) == "quarantine"
    bus.claim(28, LOW)
    # The holder's answer ends a higher NAME's claim; against a lower one it loses again.
    assert bus.position_of(28) == ((FRONT, LOW) if stranger > LOW else "quarantine")
    bus.claim(131, LOW)
    assert bus.position_of(131) == (FRONT, LOW)


def test_swapped_addresses_after_power_up_follow_the_names() -> None:
    bus = Bus(BOTH)
    for source, name in ((28, LOW), (129, HIGH), (128, LOW), (28, HIGH)):
        bus.claim(source, name)
    assert bus.position_of(28) == (REAR, HIGH)
    assert bus.position_of(128) == (FRONT, LOW)
    assert bus.position_of(129) == "quarantine"


FALLBACK = machine(named(FRONT, LOW, "source = 28"), f'mount = "{REAR.value}"\nsource = 129')


def test_without_claims_the_machine_file_says_whose_an_address_is() -> None:
    bus = Bus(FALLBACK)
    assert bus.position_of(28) == (FRONT, None)
    assert bus.position_of(129) == (REAR, None)
    assert bus.position_of(130) == "unknown_source"


def test_a_strangers_claim_ends_the_fall_back() -> None:
    bus = Bus(FALLBACK)
    bus.claim(28, STRANGER_HIGH)
    assert bus.position_of(28) == "quarantine"
    bus.claim(140, STRANGER_HIGH)
    assert bus.position_of(28) == "quarantine"  # the address was somebody else's: it proves nothing now
    bus.claim(28, LOW)
    assert bus.position_of(28) == (FRONT, LOW)


def test_a_claim_elsewhere_ends_the_fall_back() -> None:
    bus = Bus(FALLBACK)
    bus.claim(133, LOW)
    assert bus.position_of(133) == (FRONT, LOW)
    assert bus.position_of(28) == "quarantine"


def test_a_receiver_given_by_its_address_alone_takes_the_first_name_and_keeps_it() -> None:
    bus = Bus(FALLBACK)
    bus.claim(129, HIGH)
    assert bus.position_of(129) == (REAR, HIGH)
    bus.claim(129, STRANGER_LOW)
    assert bus.position_of(129) == "quarantine"
    bus.claim(140, HIGH)
    assert bus.position_of(140) == (REAR, HIGH)


def test_a_receiver_with_a_manufacturer_takes_no_other_makes_name() -> None:
    bus = Bus(machine(f'mount = "{REAR.value}"\nsource = 129\nmanufacturer = 33'))
    bus.claim(129, N2K)
    assert bus.position_of(129) == "quarantine"
    bus.claim(129, HIGH)  # lower than N2K
    assert bus.position_of(129) == (REAR, HIGH)


# What is known of source 28, and what a 65535 with selector 0xE1 from it makes.
OWN_MESSAGE = [
    ("", None, "unidentified"),
    ("source = 28", None, "unidentified"),
    ("source = 28\nmanufacturer = 33", None, "measured"),
    ("source = 28\nmanufacturer = 98", None, "nothing"),
    ("source = 28\nmanufacturer = 33", N2K, "nothing"),
    ("source = 28", LOW, "measured"),
    (f'source = 28\nname = "{LOW:016X}"', None, "measured"),
]


@pytest.mark.parametrize(("keys", "name", "outcome"), OWN_MESSAGE)
def test_a_manufacturers_own_message_needs_its_manufacturer(
    keys: str, name: int | None, outcome: str
) -> None:
    rig = machine(f'mount = "{FRONT.value}"\n{keys}') if keys else BOTH
    decoder = Decoder(rig)
    if name is not None:
        decoder.measurements(Frame(0, 0, "can0", can_id.join(6, 60928, 28), True, False, claim(name)))
    payload = encode(65535, {"roll_rad": 0.1, "yaw_rate_radps": 0.2}, selector=0xE1)
    frame = Frame(MS, MS, "can0", can_id.join(6, 65535, 28), True, False, payload)
    found = decoder.measurements(frame)
    counted = decoder.rejected.get("unidentified", 0)
    assert (len(found), counted) == {"measured": (2, 0), "nothing": (0, 0), "unidentified": (0, 1)}[outcome]


def test_a_manufacturers_own_message_is_nobodys_once_its_address_is_free_again() -> None:
    decoder = Decoder()
    payload = encode(65535, {"roll_rad": 0.1}, selector=0xE1)
    collected = [
        decoder.messages(Frame(at, at, "can0", can_id.join(6, pgn, source), True, False, data))
        for at, (pgn, source, data) in enumerate(
            [(60928, 28, claim(LOW)), (65535, 28, payload), (60928, 254, claim(LOW)), (65535, 28, payload)]
        )
    ]
    assert [len(messages) for messages in collected] == [1, 1, 1, 0]
    assert decoder.rejected == {"unidentified": 1}


def test_a_claim_is_one_frame_and_nothing_else() -> None:
    bus = Bus(BOTH)
    for pgn, data in (
        (60416, bytes([32, 9, 0, 2, 255]) + (60928).to_bytes(3, "little")),
        (60160, b"\x01" + claim(LOW)[:7]),
        (60160, b"\x02" + claim(LOW)[7:] + bytes(6)),
    ):
        frame = Frame(0, 0, "can0", can_id.join(7, pgn, 28, 255), True, False, data)
        assert bus.decoder.measurements(frame) == []
    assert bus.position_of(28) == "unknown_source"


def test_an_unknown_selector_of_a_known_manufacturer_is_nobodys_business() -> None:
    decoder = Decoder()
    decoder.messages(Frame(0, 0, "can0", can_id.join(6, 60928, 28), True, False, claim(LOW)))
    frame = Frame(MS, MS, "can0", can_id.join(6, 65535, 28), True, False, b"\x51" + bytes(7))
    assert decoder.messages(frame) == [] and decoder.rejected == {}


def test_messages_carry_the_name_and_are_told_in_quarantine_too() -> None:
    decoder = Decoder()
    messages: list[int | None] = []
    for at, (pgn, payload) in enumerate(
        [
            (65267, encode(65267, {"latitude_deg": 1.0, "longitude_deg": 2.0})),
            (60928, claim(LOW)),
            (65267, encode(65267, {"latitude_deg": 1.1, "longitude_deg": 2.0})),
            (60928, claim(HIGH)),
            (65267, encode(65267, {"latitude_deg": 1.2, "longitude_deg": 2.0})),
            (60928, claim(LOW)),
            (65267, encode(65267, {"latitude_deg": 1.3, "longitude_deg": 2.0})),
        ]
    ):
        ((identifier, data),) = frames_of(pgn, payload, 28)
        (message,) = decoder.messages(Frame(at * MS, at * MS, "can0", identifier, True, False, data))
        messages.append(message.origin.name)
    assert messages == [None, LOW, LOW, HIGH, None, LOW, LOW]


@pytest.mark.parametrize(("source", "name"), [(28, (1 << 64) - 1), (255, LOW)])
def test_a_claim_that_says_nothing(source: int, name: int) -> None:
    bus = Bus(BOTH)
    assert bus.claim(source, name) == []
    assert bus.decoder.rejected == {"not_available": 1}


def test_the_book_survives_a_restart_in_every_state() -> None:
    steps: list[tuple[int, int]] = [
        (28, HIGH), (28, LOW), (129, HIGH), (28, STRANGER_HIGH), (254, LOW), (129, N2K), (28, STRANGER_LOW),
    ]  # fmt: skip
    for rig in (BOTH, FALLBACK):
        one, other = Bus(rig), Bus(rig)
        for source, name in steps:
            for bus in (one, other):
                bus.claim(source, name)
                bus.at_ms += 100
            assert one.position_of(28) == other.position_of(28)
            restored = Bus(rig)
            restored.decoder.load(json.loads(json.dumps(other.decoder.dump())))
            restored.at_ms, restored.count = other.at_ms, other.count
            other = restored
            for source_asked in (28, 129, 130):
                assert one.position_of(source_asked) == other.position_of(source_asked)
        assert one.decoder.dump() == other.decoder.dump()


# ---- two devices with one NAME, and what is known without a claim ----

SOURCES = machine(f'mount = "{FRONT.value}"\nsource = 28', f'mount = "{REAR.value}"\nsource = 129')
TWINS = [
    (SOURCES, (FRONT, LOW), (REAR, LOW)),
    (
        machine(named(FRONT, LOW, "source = 28"), f'mount = "{REAR.value}"\nsource = 129'),
        (FRONT, LOW),
        (REAR, LOW),
    ),
    (machine(named(FRONT, LOW, "source = 28"), named(REAR, LOW, "source = 129")), (FRONT, LOW), (REAR, LOW)),
    (BOTH, "twin_name", "twin_name"),
]


@pytest.mark.parametrize(("rig", "front", "rear"), TWINS)
@pytest.mark.parametrize("again", [False, True])
def test_two_devices_with_one_name_stay_with_their_addresses(
    rig: Machine, front: object, rear: object, again: bool
) -> None:
    bus = Bus(rig)
    bus.claim(28, LOW)
    bus.claim(129, LOW)
    assert bus.position_of(129) != (FRONT, LOW) or rig is BOTH  # one device that has moved, or two?
    bus.at_ms += 300
    if again:
        bus.claim(28, LOW)
        bus.claim(129, LOW)
        bus.at_ms += 300
    for _ in range(2):
        assert (bus.position_of(28), bus.position_of(129)) == (front, rear)
        bus.claim(28, LOW)
        bus.claim(129, LOW)
    ((kind, told),) = bus.decoder.addresses.news
    assert kind == "twin_name" and f"two devices claim NAME {LOW:016X} (addresses " in notice_sentence(told)
    assert bus.decoder.addresses.twins == {("can0", LOW)}
    stored = json.loads(json.dumps(bus.decoder.dump()))
    bus.decoder = Decoder(rig)
    bus.decoder.load(stored)
    assert (bus.position_of(28), bus.position_of(129)) == (front, rear)


def test_a_device_that_moves_is_no_pair_of_twins() -> None:
    bus = Bus(BOTH)
    bus.claim(28, LOW)
    bus.claim(130, LOW)
    bus.at_ms += 10_000
    assert bus.position_of(130) == (FRONT, LOW)
    bus.claim(28, HIGH)  # takes what is free
    assert bus.position_of(28) == (REAR, HIGH)
    assert not bus.decoder.addresses.twins and not bus.decoder.addresses.news


def test_what_is_known_without_a_claim_holds_until_one_is_heard() -> None:
    bus = Bus(BOTH)
    book = bus.decoder.addresses
    assert book.unplaced == {FRONT, REAR}
    assert book.recall(KnownAddress("can0", 28, LOW, FRONT, 1)) == FRONT
    assert book.recall(KnownAddress("can0", 40, STRANGER_LOW, None, 1)) is None
    assert bus.position_of(28) == (FRONT, LOW) and book.unplaced == {REAR}
    assert bus.decoder.origin("can0", 40).name == STRANGER_LOW
    stored = json.loads(json.dumps(bus.decoder.dump()))
    bus.decoder = Decoder(BOTH)
    bus.decoder.load(stored)
    book = bus.decoder.addresses
    assert bus.position_of(28) == (FRONT, LOW)
    bus.claim(28, HIGH)
    assert bus.position_of(28) == (REAR, HIGH) and book.unplaced == {FRONT}
    assert book.recall(KnownAddress("can0", 28, LOW, FRONT, 1)) is None  # a claim was heard
    book.place(KnownAddress("can0", 131, None, FRONT))
    assert bus.position_of(131) == (FRONT, None)
    bus.claim(132, LOW)
    assert bus.position_of(132) == (FRONT, LOW) and bus.position_of(131) == "unknown_source"


@pytest.mark.parametrize("sure", [True, False])
def test_what_was_only_known_from_before_can_be_taken_back(sure: bool) -> None:
    bus = Bus(BOTH)
    book = bus.decoder.addresses
    book.place(KnownAddress("can0", 28, LOW, FRONT, 0 if sure else 1))
    assert book.displace() == ([] if sure else [FRONT])
    assert bus.position_of(28) == ((FRONT, LOW) if sure else "unknown_source")
