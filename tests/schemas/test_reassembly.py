"""Messages of several frames: whole or not at all, stamped with their first frame."""

import json
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.schemas import can_id
from tilth.schemas.flow import Frame
from tilth.schemas.reassembly import SLOTS, TP_CONTROL, TP_DATA, Assembled, Assembler, split_fast

GNSS = 129029
MS = 1_000_000
BOUNDED = settings(derandomize=True, max_examples=100, deadline=None)


def frame(at_ms: float, identifier: int, data: bytes, bus: str = "can0") -> Frame:
    t_ns = int(at_ms * MS)
    return Frame(t_ns, t_ns - 1000, bus, identifier, True, False, data)


def message(seed: int, length: int = 43) -> bytes:
    return bytes((seed * 37 + 11 * i) % 256 for i in range(length))


def fast(at_ms: float, payload: bytes, sequence: int, source: int = 40, bus: str = "can0") -> list[Frame]:
    """Frames half a millisecond apart."""
    identifier = can_id.join(3, GNSS, source)
    parts = split_fast(payload, sequence)
    return [frame(at_ms + 0.5 * i, identifier, data, bus) for i, data in enumerate(parts)]


def control(at_ms: float, source: int, destination: int, data: list[int], pgn: int = GNSS) -> Frame:
    body = bytes(data).ljust(5, b"\xff") + pgn.to_bytes(3, "little")
    return frame(at_ms, can_id.join(7, TP_CONTROL, source, destination), body)


def announce(
    at_ms: float, payload: bytes, destination: int = 255, source: int = 40, pgn: int = GNSS
) -> Frame:
    packets = (len(payload) + 6) // 7
    kind = 32 if destination == 255 else 16
    low, high = len(payload) & 255, len(payload) >> 8
    return control(at_ms, source, destination, [kind, low, high, packets, 255], pgn)


def packets(at_ms: float, payload: bytes, destination: int = 255, source: int = 40) -> list[Frame]:
    identifier = can_id.join(7, TP_DATA, source, destination)
    parts = [payload[i : i + 7].ljust(7, b"\xff") for i in range(0, len(payload), 7)]
    return [frame(at_ms + 50 * i, identifier, bytes([i + 1]) + part) for i, part in enumerate(parts)]


def by_turns(one: list[Frame], other: list[Frame]) -> list[Frame]:
    return [item for pair in zip(one, other, strict=True) for item in pair]


def run(
    frames: Iterable[Frame], assembler: Assembler | None = None
) -> tuple[list[Assembled], dict[str, int]]:
    rejected: dict[str, int] = {}
    assembler = assembler or Assembler(frozenset({GNSS}), rejected)
    whole = []
    for item in frames:
        head = can_id.split(item.can_id)
        if head.pgn == TP_CONTROL:
            assembler.control(item, head)
            continue
        done = assembler.transfer(item, head) if head.pgn == TP_DATA else assembler.fast(item, head)
        if done is not None:
            whole.append(done)
    return whole, rejected


A, B, C = message(1), message(2), message(3)
LONG = message(5, 1785)
FA, FB = fast(0, A, 0), fast(100, B, 1)
BAM = [announce(0, A), *packets(50, A)]
RTS = [announce(0, A, 7), control(10, 7, 40, [17, 7, 1]), *packets(20, A, 7)]
CTS_3 = control(200, 7, 40, [17, 5, 3])

# What is heard, whole messages, what is counted.
CASES = {
    "two fast packets": ([*FA, *FB], [A, B], {}),
    "interleaved": (by_turns(FA, fast(0.1, B, 1)), [A, B], {}),
    "interleaved sources": (by_turns(FA, fast(0.1, B, 0, 41)), [A, B], {}),
    "interleaved buses": (by_turns(FA, fast(0.1, B, 0, 40, "can1")), [A, B], {}),
    "first frame lost": ([*FA[1:], *FB], [B], {"broken_fast_packet": 1}),
    "middle frame lost": ([*FA[:3], *FA[4:], *FB], [B], {"broken_fast_packet": 1}),
    "last frame lost, sequence used again": (
        [*FA[:6], *fast(100, B, 0)], [B], {"broken_fast_packet": 1},
    ),
    "last frame lost, sequence used much later": (
        [*FA[:6], *fast(900, B, 0)], [B], {"stale_fast_packet": 1},
    ),
    "every frame doubled": ([x for f in FA for x in (f, f)], [A], {"duplicate_frame": 7}),
    "an old frame again": ([*FA[:4], FA[1], *FA[4:], *FB], [B], {"broken_fast_packet": 1}),
    "two frames exchanged": ([FA[0], FA[2], FA[1], *FA[3:], *FB], [B], {"broken_fast_packet": 1}),
    "a pause of 751 ms": (
        [*FA[:3], *(f for f in fast(751, A, 0)[3:])], [], {"stale_fast_packet": 1, "broken_fast_packet": 1},
    ),
    "a pause of 749 ms": ([*FA[:3], *fast(749, A, 0)[3:]], [A], {}),
    "mixed with the next of the same sequence": (
        [*FA[:3], *fast(10, B, 0)[4:], *fast(20, C, 0)], [C], {"broken_fast_packet": 1},
    ),
    "a length of 255": (
        [frame(0, FA[0].can_id, b"\x00\xff" + bytes(6)), *FA[1:]], [], {"broken_fast_packet": 1},
    ),
    "a length that fits one frame": ([frame(0, FA[0].can_id, b"\x00\x02" + A[:6])], [A[:2]], {}),
    "a frame without content": ([frame(0, FA[0].can_id, b"\x00"), *FA], [A], {"short_frame": 1}),
    "a middle frame that is cut off": (
        [FA[0], frame(0.5, FA[0].can_id, FA[1].data[:5]), *FA[2:], *FB], [B], {"broken_fast_packet": 1},
    ),
    "a clock that steps back": ([*FA[:3], *fast(-5000, A, 0)], [A], {"stale_fast_packet": 1}),
    "BAM": (BAM, [A], {}),
    "BAM of 1785 bytes": ([announce(0, LONG), *packets(1, LONG)], [LONG], {}),
    "BAM, a packet lost": ([*BAM[:3], *BAM[4:]], [], {"broken_transport": 1}),
    "BAM, packets exchanged": ([BAM[0], BAM[2], BAM[1], *BAM[3:]], [], {"broken_transport": 1}),
    "BAM, every frame doubled": ([x for f in BAM for x in (f, f)], [A], {"duplicate_frame": 7}),
    "BAM, announced anew": ([*BAM[:3], announce(300, B), *packets(350, B)], [B], {"broken_transport": 1}),
    "BAM, unfinished": ([*BAM[:3], announce(2000, B), *packets(2050, B)], [B], {"stale_transport": 1}),
    "BAM, announcement lost": (BAM[1:], [], {}),
    "BAM of two sources": (
        by_turns(BAM, [announce(1, B, source=41), *packets(51, B, source=41)]), [A, B], {},
    ),
    "BAM of a message that nobody wants": ([announce(0, A, pgn=65226), *packets(50, A)], [], {}),
    "BAM of too many packets": (
        [control(0, 40, 255, [32, 43, 0, 9]), *packets(50, A)], [], {"broken_transport": 1},
    ),
    "RTS and CTS": ([*RTS, control(900, 7, 40, [19, 43, 0, 7])], [A], {}),
    "RTS, asked for again": (
        [*RTS[:6], CTS_3, *packets(150, A, 7)[2:]], [A], {},
    ),
    "RTS, aborted by the receiver": (
        [*RTS[:4], control(90, 7, 40, [255, 3]), *RTS[4:]], [], {"broken_transport": 1},
    ),
    "RTS, aborted by the sender": (
        [*RTS[:4], control(90, 40, 7, [255, 3]), *RTS[4:]], [], {"broken_transport": 1},
    ),
    "RTS, answered after 1.2 s": ([RTS[0], control(1200, 7, 40, [17, 7, 1]), *packets(1300, A, 7)], [A], {}),
    "RTS to two at once": (
        by_turns([announce(0, A, 7), *packets(20, A, 7)], [announce(1, B, 8), *packets(21, B, 8)]),
        [A, B], {},
    ),
    "a control frame that is cut off": ([frame(0, BAM[0].can_id, b"\x20\x2b")], [], {"short_frame": 1}),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_whole_or_not_at_all(case: str) -> None:
    frames, whole, counted = CASES[case]
    found, rejected = run(frames)
    assert [item.payload for item in found] == whole
    assert rejected == counted


@pytest.mark.parametrize("frames", [FA, BAM, RTS], ids=["fast packet", "BAM", "RTS"])
def test_stamped_with_the_first_frame(frames: list[Frame]) -> None:
    ((pgn, payload, t_ns, rx_ns),), _ = run([*frames])
    assert (pgn, payload, t_ns, rx_ns) == (GNSS, A, frames[0].t_ns, frames[0].rx_ns)
    ((_, _, t_ns, _),), _ = run([x for f in frames for x in (f, f)])
    assert t_ns == frames[0].t_ns


def test_memory_is_bounded_and_the_oldest_goes_first() -> None:
    starts = [fast(i, A, i % 8, source=i % 250, bus=f"can{i // 2000}")[0] for i in range(5000)]
    rejected: dict[str, int] = {}
    assembler = Assembler(frozenset({GNSS}), rejected)
    run(starts, assembler)
    assert len(assembler.dump()) == SLOTS
    assert rejected.pop("stale_fast_packet") > 4000 and not rejected.keys() - {"broken_fast_packet"}


def test_split_of_too_much() -> None:
    assert len(split_fast(bytes(223), 0)) == 32
    with pytest.raises(ValueError, match="at most 223"):
        split_fast(bytes(224), 0)


@st.composite
def traffic(draw: st.DrawFn) -> tuple[list[bytes], list[Frame]]:
    """Messages of three senders, fast and by BAM; frames lost, doubled, displaced, mixed."""
    sent, streams = [], []
    for source in (40, 41, 42):
        stream: list[Frame] = []
        for number in range(draw(st.integers(1, 4))):
            payload = message(10 * source + number, draw(st.sampled_from([43, 60, 9])))
            sent.append(payload)
            if draw(st.booleans()):
                stream += fast(0, payload, number, source)
            else:
                stream += [announce(0, payload, source=source), *packets(0, payload, source=source)]
        streams.append(stream)
    mixed: list[Frame] = []
    while any(streams):
        stream = draw(st.sampled_from([s for s in streams if s]))
        mixed.append(stream.pop(0))
    for _ in range(draw(st.integers(0, 6))):
        at = draw(st.integers(0, len(mixed) - 1))
        edit = draw(st.sampled_from(["lose", "double", "exchange", "repeat later"]))
        if edit == "lose" and len(mixed) > 1:
            del mixed[at]
        elif edit == "double":
            mixed.insert(at, mixed[at])
        elif edit == "repeat later":
            mixed.insert(draw(st.integers(at, len(mixed))), mixed[at])
        elif at + 1 < len(mixed):
            mixed[at], mixed[at + 1] = mixed[at + 1], mixed[at]
    times = draw(st.lists(st.sampled_from([0.5, 10, 100, 800]), min_size=len(mixed), max_size=len(mixed)))
    at_ms, stamped = 0.0, []
    for item, step in zip(mixed, times, strict=True):
        at_ms += step
        stamped.append(frame(at_ms, item.can_id, item.data))
    return sent, stamped


@BOUNDED
@given(traffic())
def test_only_messages_that_were_sent_come_out(decoded: tuple[list[bytes], list[Frame]]) -> None:
    sent, frames = decoded
    whole, _ = run(frames)
    assert {item.payload for item in whole} <= set(sent)


@BOUNDED
@given(traffic(), st.data())
def test_a_dump_goes_on_as_the_original(
    decoded: tuple[list[bytes], list[Frame]], data: st.DataObject
) -> None:
    _, frames = decoded
    cut = data.draw(st.integers(0, len(frames)))
    original, restored = (Assembler(frozenset({GNSS}), {}) for _ in range(2))
    run(frames[:cut], original)
    restored.load(json.loads(json.dumps(original.dump())))
    assert run(frames[cut:], restored)[0] == run(frames[cut:], original)[0]
    assert restored.dump() == original.dump()
