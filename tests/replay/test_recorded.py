"""A recorded run by time: what was last said before any of them, also of cut logs and steps of the clock."""

import math
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE, MACHINE_TEXT, SECOND, chunk_ends, write_mcap
from recorded_run import MARKS, START_NS, TURN_S, logged, write_run

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.readers.log import EmptyLog, ForeignLog
from tilth.replay.recorded import MOST_ROWS, Recorded, RecordedRun
from tilth.replay.turns import LEAST_RAD, turns
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def paths(folder: Path) -> list[Path]:
    return write_run(folder, 120.0, parts=3)


def plain(seconds: float = 120.0) -> list[Recorded]:
    return [Recorded(t_ns - START_NS, t_ns, topic, data) for topic, t_ns, data in logged(seconds) if topic]


def test_all_results_come_in_the_order_of_the_file(paths: list[Path]) -> None:
    run = RecordedRun(paths)
    assert run.length_ns == 120 * SECOND and not run.text and run.has_poses
    assert list(run.after(-1)) == plain()
    run.close()


def test_at_any_time_the_last_of_each_topic_is_found(paths: list[Path]) -> None:
    run, rows = RecordedRun(paths), plain()
    rng = np.random.default_rng(1)
    for at_ns in [0, 1, 120 * SECOND, *map(int, rng.integers(0, 120 * SECOND, 60))]:
        last = {row.topic: row for row in rows if row.at_ns <= at_ns and row.topic != "/event"}
        assert {row.topic: row for row in run.before(at_ns)} == last
        after = run.after(at_ns)
        assert [next(after, None) for _ in range(3)] == [
            *[row for row in rows if row.at_ns > at_ns][:3],
            *[None] * 3,
        ][:3]
    run.close()


def test_one_can_jump_to_marks_and_turns(paths: list[Path]) -> None:
    run = RecordedRun(paths)
    marks = [(place.at_ns, place.text) for place in run.places if place.kind == "mark"]
    assert marks == [(round(at_s * SECOND), text) for at_s, text in MARKS]
    found = [place for place in run.places if place.kind == "turn"]
    assert len(found) == 2 and all(place.t_ns == START_NS + place.at_ns for place in found)
    assert found[0].at_ns * 1e-9 == pytest.approx(TURN_S, abs=0.3)
    assert [place.text.split(",")[0] for place in found] == ["right", "left"]
    assert [float(place.text.split()[1].rstrip("°")) for place in found] == pytest.approx([180, 180], abs=5)
    assert [place.at_ns for place in run.places] == sorted(place.at_ns for place in run.places)
    run.close()


def test_the_overview_has_every_event_and_stays_small(folder: Path) -> None:
    run = RecordedRun(write_run(folder, 1000.0, start_ns=START_NS + 3600 * SECOND))
    poses = [row for row in run.overview if row.topic == "/pose"]
    assert MOST_ROWS / 2 <= len(poses) < MOST_ROWS
    assert np.diff([row.at_ns for row in poses]).max() <= 2 * SECOND
    assert sum(row.topic == "/event" for row in run.overview) == len(MARKS)
    run.close()


def test_a_cut_log_plays_as_far_as_it_is_whole(folder: Path) -> None:
    (whole,) = write_run(folder, 60.0, start_ns=START_NS + 7200 * SECOND)
    content = whole.read_bytes()
    path = folder / "cut.mcap"
    path.write_bytes(content[: chunk_ends(content)[2] + 1000])
    run = RecordedRun([path])
    rows = list(run.after(-1))
    assert 0 < len(rows) < len(plain(60.0)) and run.length_ns == rows[-1].at_ns
    assert run.text == "cut.mcap is cut off: it plays as far as it is whole"
    run.close()


def test_a_damaged_part_is_left_out(folder: Path) -> None:
    (whole,) = write_run(folder, 60.0, start_ns=START_NS + 10_800 * SECOND)
    content = bytearray(whole.read_bytes())
    content[chunk_ends(bytes(content))[2] - 100] ^= 0xFF
    path = folder / "damaged.mcap"
    path.write_bytes(content)
    run = RecordedRun([path])
    assert run.text == "1 damaged parts are left out" and run.length_ns == 60 * SECOND
    run.close()


def test_after_a_step_of_the_clock_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "stepped.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, START_NS))
    for number, t_s in enumerate((3600, 3601, 3602, 10, 11, 12)):
        event = Event(START_NS + t_s * SECOND, "mark", in_words(str(number)))
        writer.message("/event", event.t_ns, CHANNEL["/event"].encode(event))
        writer.flush()
    writer.close()
    run = RecordedRun([path])
    assert [row.at_ns // SECOND for row in run.after(-1)] == [0, 1, 2, 2, 3, 4]
    assert [place.text for place in run.places] == list("012345")
    run.close()


def test_what_holds_no_result_is_told(tmp_path: Path) -> None:
    (frames,) = write_run(tmp_path, 5.0, results=False)
    with pytest.raises(EmptyLog, match="no result is in it"):
        RecordedRun([frames])
    text = tmp_path / "candump.log"
    text.write_text("(1700000000.000000) can0 123#11\n")
    with pytest.raises(ForeignLog, match="frames only"):
        RecordedRun([text])
    with pytest.raises(ForeignLog, match="cannot be read"):
        RecordedRun([tmp_path / "none.mcap"])
    empty = write_mcap(tmp_path / "empty.mcap", [])
    with pytest.raises(EmptyLog):
        RecordedRun([empty])


def test_progress_is_told_and_may_end_it(paths: list[Path]) -> None:
    shares: list[float] = []
    RecordedRun(paths, shares.append).close()
    assert shares == sorted(shares) and 0 <= shares[0] < 0.1 and 0.8 < shares[-1] <= 1.0

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        RecordedRun(paths, stop)


def yaw_rates(*parts: tuple[float, float]) -> list[tuple[int, float]]:
    """Of (seconds, yaw rate), ten a second."""
    rates = [rate for seconds, rate in parts for _ in range(round(10 * seconds))]
    return [(number * SECOND // 10, rate) for number, rate in enumerate(rates)]


def test_turns_are_told_from_corrections() -> None:
    sharp = math.radians(20)
    (turn,) = turns(yaw_rates((30, 0.0), (6, sharp), (1, 0.0), (3, sharp), (30, 0.0)))
    assert turn.begin_ns == 30 * SECOND and turn.end_ns == 39.9 * SECOND
    assert turn.angle == pytest.approx(math.radians(180), abs=0.6) and turn.text.startswith("right, ")
    assert turns(yaw_rates((30, 0.0), (1, sharp), (30, 0.0))) == []  # a correction
    assert turns(yaw_rates((60, math.radians(2)))) == []  # a bend of the field
    both = turns(yaw_rates((5, sharp), (5, -sharp)))
    assert [math.copysign(1, turn.angle) for turn in both] == [1, -1]
    assert all(abs(turn.angle) >= LEAST_RAD for turn in both)
    assert turns([]) == []


def test_the_last_pose_is_that_of_its_time(paths: list[Path]) -> None:
    run = RecordedRun(paths)
    found = {row.topic: row for row in run.before(round(50.05 * SECOND))}
    assert pb.Pose.FromString(found["/pose"].data).t_ns == START_NS + 50 * SECOND
    run.close()
