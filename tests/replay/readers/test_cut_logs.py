"""Heads and ends of logs: cut anywhere, packed, filled with zeros, begun with comments, of any year."""

import gzip
import struct
import zlib
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_forms import CUT, WRITTEN, rows, text_of, whole
from logs import SECOND, drained, write_mcap

from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import EmptyLog, ForeignLog, LogError
from tilth.schemas.flow import Frame

UNPACKED = ("MCAP of ROS",)  # may not be packed
BINARY = ("EBL", "pcap", "pcapng", "tcpdump -i any", *UNPACKED)


def read(path: Path, content: bytes) -> tuple[list[Frame], bool, dict[str, int]]:
    """Frames, whether a cut was said, what was counted; an error is one sentence and says the cut too."""
    path.write_bytes(content)
    try:
        found, log = drained(path)
    except LogError as error:
        assert "\n" not in str(error)
        return [], True, {}
    return found, log.truncated, log.skipped


@pytest.mark.parametrize("name", [*CUT, *WRITTEN])
@given(st.integers(0, 2**20), st.sampled_from((512, 70_000)))
@settings(max_examples=40, deadline=None)
def test_cut_anywhere_what_is_there_is_read(
    name: str, tmp_path_factory: pytest.TempPathFactory, drawn: int, zeros: int
) -> None:
    content, wanted = whole()[name]
    cut = 1 + drawn % (len(content) - 1)
    path = tmp_path_factory.getbasetemp() / f"cut{name.replace(' ', '')}"
    plain, _, _ = read(path, content[:cut])
    assert plain == wanted[: len(plain)]
    filled, output, _ = read(path, content[:cut] + bytes(zeros))
    assert filled == wanted[: len(filled)] and len(filled) >= len(plain) - 1
    assert output


@pytest.mark.parametrize("name", [name for name in (*CUT, *WRITTEN[:4]) if name not in UNPACKED])
@given(st.integers(0, 2**20))
@settings(max_examples=25, deadline=None)
def test_gzip_cut_or_damaged_anywhere_gives_what_is_there_and_says_it(
    name: str, tmp_path_factory: pytest.TempPathFactory, drawn: int
) -> None:
    content, wanted = whole()[name]
    packed = gzip.compress(content, mtime=0)
    at = 1 + drawn % (len(packed) - 1)
    path = tmp_path_factory.getbasetemp() / f"gz{name.replace(' ', '')}"
    found, output, _ = read(path, packed[:at])
    assert output and found == wanted[: len(found)]
    damaged, output, _ = read(path, packed[:at] + b"\xff\x00\xff\x00" * 30)
    assert output and (
        name == "blf" or damaged[: max(0, len(found) - 1)] == found[:-1]
    )  # it packs many into one
    assert read(path, packed)[:2] == (wanted, False)
    assert read(path, packed + gzip.compress(b"", mtime=0) + bytes(9))[:2] == (wanted, False)


@pytest.mark.parametrize("name", [*CUT, *WRITTEN])
@given(st.lists(st.tuples(st.integers(0, 2**20), st.integers(0, 255)), min_size=1, max_size=9))
@settings(derandomize=True, max_examples=40, deadline=None)
def test_bytes_changed_anywhere_cost_a_sentence_or_a_count(
    name: str, tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[int, int]]
) -> None:
    content = bytearray(whole()[name][0])
    for at, octet in changes:
        content[at % len(content)] = octet
    path = tmp_path_factory.getbasetemp() / f"changed{name.replace(' ', '')}"
    found, _, _ = read(path, bytes(content))
    assert all(0 <= f.t_ns < 2**63 and 0 <= f.can_id < 2**29 for f in found)


@given(st.integers(0, 2**20))
@settings(derandomize=True, max_examples=40, deadline=None)
def test_behind_damaged_gzip_the_next_member_is_read(
    tmp_path_factory: pytest.TempPathFactory, drawn: int
) -> None:
    wanted = rows(60)
    member = gzip.compress(text_of(wanted), mtime=0)
    at = 10 + drawn % (len(member) - 10)
    damaged = bytearray(member)
    damaged[at] ^= 0x55
    path = tmp_path_factory.getbasetemp() / "members.log.gz"
    found, truncated, counted = read(path, member + bytes(damaged) + member)
    assert found[:60] == wanted and found[-60:] == wanted
    assert not truncated and counted["damaged_gzip"] == 1


def test_an_object_of_no_length_ends_a_blf(tmp_path: Path) -> None:
    """python-can alone would read it for ever."""
    content, wanted = whole()["blf"]
    objects = bytearray(zlib.decompress(content[176:]))
    second = objects.index(b"LOBJ", 16)
    objects[second + 8 : second + 12] = bytes(4)
    container = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(objects), 10, 0, len(objects))
    (tmp_path / "x.blf").write_bytes(content[:144] + container + bytes(objects))
    found, log = drained(tmp_path / "x.blf")
    assert found == wanted[:1] and log.truncated


def test_all_of_a_gzip_that_is_cut_short_is_read(tmp_path: Path) -> None:
    """A frame that was packed before the cut is read, to the last one."""
    content = text_of(rows(40) * 200)
    packed = gzip.compress(content, mtime=0)
    path = tmp_path / "x.log.gz"
    for cut in (len(packed) // 3, len(packed) - 9, len(packed) - 1):
        path.write_bytes(packed[:cut])
        there = zlib.decompressobj(31).decompress(packed[:cut])
        found, log = drained(path)
        assert log.truncated and len(found) in (there.count(b"\n"), there.count(b"\n") + 1)
        path.write_bytes(packed[:cut] + b"\xff" * 20_000)
        damaged, log = drained(path)
        assert log.truncated and damaged[: len(found) - 1] == found[:-1]


@pytest.mark.parametrize("zeros", [1, 4096, 3_000_000])
def test_zeros_within_a_text_cost_the_lines_they_are_in(zeros: int, tmp_path: Path) -> None:
    content = text_of(rows())
    at = content.index(b"\n", 700) - 5
    path = tmp_path / "x.log"
    path.write_bytes(content[:at] + bytes(zeros) + content[at:])
    found, log = drained(path)
    assert len(found) == 39 and set(found) < set(rows())
    assert (log.skipped, log.truncated) == ({"unreadable_line": 2}, False)


@pytest.mark.parametrize("zeros", [1, 4096, 3_000_000])
def test_nothing_but_zeros_is_said(zeros: int, tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    for content in (bytes(zeros), b"# begun\n" + bytes(zeros)):
        path.write_bytes(content)
        with pytest.raises(EmptyLog, match="no frame is in it"):
            list(frames(path))


# Heads


@pytest.mark.parametrize("name", [name for name in (*CUT, *WRITTEN[:3]) if name not in BINARY])
def test_a_mark_of_utf_8_at_the_head_of_a_text(name: str, tmp_path: Path) -> None:
    content, wanted = whole()[name]
    assert read(tmp_path / "x", b"\xef\xbb\xbf" + content) == (wanted, False, {})


def test_any_length_of_comments_may_come_first(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    for packed in (False, True):
        content = b"# of a drive in the rain\n\n" * 20_000 + text_of(rows())
        path.write_bytes(gzip.compress(content) if packed else content)
        assert list(frames(path)) == rows()
    path.write_bytes(b"# of a drive in the rain\n" * 20_000 + b"prose\n" * 20_000 + text_of(rows()))
    with pytest.raises(ForeignLog):
        list(frames(path))


BAD_LINES = {
    "asc": (b"   x.005 1  18FEF3x Rx d 8 00\n", b"hello world\n"),
    "trc": (b"     9  1.000 XX  1 18FEF300 Rx -  8  00 01\n", b"hello\n", b"hello world in the rain\n"),
    "csv": (b"hello\n", b"1,2,3\n"),
}


@pytest.mark.parametrize(("suffix", "bad"), [(s, bad) for s, lines in BAD_LINES.items() for bad in lines])
def test_bad_lines_are_counted_in_every_text(suffix: str, bad: bytes, tmp_path: Path) -> None:
    content, wanted = whole()[suffix]
    lines = content.splitlines(keepends=True)
    broken = b"".join([*lines[:-9], bad, *lines[-9:-6], bad, *lines[-6:]])
    assert read(tmp_path / "x", broken) == (wanted, False, {"unreadable_line": 2})


@pytest.mark.parametrize("line", [b"     9) 1.0 1 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n",
                                  b"     9       1.059 ST         Rx    00 00 00 00\n"])  # fmt: skip
def test_other_events_of_trc_are_counted_as_such(line: bytes, tmp_path: Path) -> None:
    content, wanted = whole()["trc"]
    assert read(tmp_path / "x", content + line) == (wanted, False, {"other_event": 1})


YEARS = (1, 1677, 1969, 1970, 2026, 2262, 2263, 9999)


@pytest.mark.parametrize("year", YEARS)
def test_any_year_gives_a_frame_or_a_reason(year: int, tmp_path: Path) -> None:
    path = tmp_path / "x.raw"
    path.write_text(f"{year:04d}-01-01T00:00:00.000Z,2,127250,0,255,1,00\n"
                    f"{year:04d}-12-31-23:59:60.999999999-23:59,2,127250,0,255,1,00\n")  # fmt: skip
    text = path.read_bytes()
    path.write_bytes(b"2020-01-01-00:00:00,2,127250,0,255,1,00\n" + text)
    (_, *found), log = drained(path)
    assert len(found) + sum(log.skipped.values()) == 2
    assert set(log.skipped) <= {"negative_time_stamp", "time_stamp_after_2262"}
    for f in found:
        result = datetime.fromtimestamp(f.t_ns // SECOND, UTC)
        assert abs(result.year - year) <= 1
        write_mcap(tmp_path / f"{f.t_ns}.mcap", [f])
    texts = {
        "asc": f"date Sat Jan 01 00:00:00.000 {year:04d}\nbase hex  timestamps absolute\n"
        "internal events logged\n 0.5 1  18EEFF1Cx Rx d 1 00\n",
        "trc": f";$FILEVERSION=1.1\n;$STARTTIME={(year - 1900) * 365.25}\n  1)  0.5  Rx  18EEFF1C  1  00\n",
    }
    for suffix, written in texts.items():
        path = tmp_path / f"x.{suffix}"
        path.write_text(written)
        found, output, counted = read(path, path.read_bytes())
        assert output or len(found) + sum(counted.values()) >= 1
