"""A replay gives what the live run gave, to the byte; and what it does with logs of every kind."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest
from logs import MACHINE, MACHINE_TEXT, SECONDS, Live, altered, record, results_of

from tilth.estimator import fold
from tilth.estimator.fold import State, use
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.snapshot import VERSION
from tilth.logger import guarded_fold
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.compare import IDENTICAL, Comparison
from tilth.replay.offline import LONGEST_WAIT_S, Pace, ReplayOutputs, ReplaySummary, replay
from tilth.replay.readers.any_log import frames, open_log
from tilth.replay.readers.log import EmptyLog, Logged
from tilth.schemas.channels import FIT_TOPIC
from tilth.schemas.flow import Frame, Publication
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.proto.tilth_pb2 import Snapshot
from tilth.schemas.sentences import event_sentence
from tilth.simulator.traffic import simulate


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    return record(tmp_path_factory.mktemp("live"), list(simulate(MACHINE, 3, SECONDS)), 3)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Live:
    """A later run of the same machine."""
    return record(tmp_path_factory.mktemp("other"), list(simulate(MACHINE, 5, 8.0)), 2, run="later")


def run(
    paths: Sequence[Path], comparison: Comparison | None = None, writer: LogWriter | None = None
) -> tuple[ReplaySummary, list[str]]:
    messages: list[str] = []
    outputs = ReplayOutputs(writer=writer, comparison=comparison)
    return replay(paths, MachineFile(MACHINE, MACHINE_TEXT), outputs=outputs, say=messages.append), messages


# Live is replay


def test_a_run_gives_its_own_bytes_again(live: Live) -> None:
    comparison = Comparison()
    summary, output = run(live.parts, comparison=comparison)
    assert comparison.difference == ""
    assert comparison.compared > 0.9 * live.results > 1000
    assert (summary.frames, summary.truncated, summary.faults) == (len(live.rows), False, 0)
    assert summary.poses > 50
    assert summary.measurements > 0.3 * summary.frames
    assert summary.duration_ns == pytest.approx(SECONDS * 1e9, rel=0.01)
    assert set(summary.estimates) == {row.method for row in rows_for(MACHINE)} | {"recommended"}
    assert output == []


@pytest.mark.long
def test_what_nobody_reads_changes_no_result(live: Live) -> None:
    file = MachineFile(MACHINE, MACHINE_TEXT)
    verified = replay(live.parts, file, outputs=ReplayOutputs(comparison=Comparison()))
    assert replay(live.parts, file) == verified


@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_part_replays_alone(live: Live, part: int) -> None:
    comparison = Comparison()
    run([live.parts[part]], comparison=comparison)
    assert comparison.difference == ""
    assert comparison.compared > 300


@pytest.mark.long
def test_the_parts_count_together_what_they_count_alone(live: Live) -> None:
    together, _ = run(live.parts)
    alone = [run([path])[0] for path in live.parts]
    for count in ("frames", "measurements", "poses"):
        assert getattr(together, count) == sum(getattr(summary, count) for summary in alone)
    reasons = {reason for summary in alone for reason in summary.rejected}
    assert together.rejected == {r: sum(s.rejected.get(r, 0) for s in alone) for r in reasons}


def test_out_holds_frames_and_results_and_replays(live: Live, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("again", 1, 0))
    run(live.parts[1:], writer=writer)
    writer.close()
    third = len(live.rows) - sum(1 for _ in frames(live.parts[0]))
    assert list(frames(path)) == live.rows[-third:]
    given, logged = results_of([path]), results_of(live.parts[1:])
    ends = {topic: len(logged.get(topic, [])) for topic in given}
    assert {topic: rows[: ends[topic]] for topic, rows in given.items() if ends[topic]} == logged
    # What follows is of the end, where the replay fits what was driven up to there.
    more = {topic: rows[ends[topic] :] for topic, rows in given.items() if len(rows) > ends[topic]}
    assert more.keys() <= {FIT_TOPIC, "/event", "/soil_tire", "/soil_tire/pem"}
    assert {row.t_ns for rows in more.values() for row in rows} <= {live.rows[-1].t_ns}
    comparison = Comparison()
    run([path], comparison=comparison)
    assert (comparison.difference, comparison.compared > 1000) == ("", True)


def test_a_state_of_another_machine_file_is_not_taken(live: Live) -> None:
    text = MACHINE_TEXT.replace("mass = 9391.0", "mass = 9400.0")
    messages: list[str] = []
    other = replay(live.parts[1:], MachineFile(parse_machine(text), text), say=messages.append)
    assert other.frames > 0
    assert len(messages) == 1 and "another machine file" in messages[0]


def test_a_state_of_another_version_is_not_taken(live: Live, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 2, 0))
    writer.snapshot(live.rows[0].t_ns, '{"format": "of the year 2040"}')
    for row in live.rows[:3000]:
        writer.frame(row)
    writer.close()
    summary, output = run([path])
    assert summary.poses > 0
    assert len(output) == 1 and "another version" in output[0]


def with_state(live: Live, path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """The second part of a run as another program, or a faulty disk, would have written its stored state."""
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 2, live.rows[0].t_ns))
    for row in open_log(live.parts[1]).records:
        if isinstance(row, Frame):
            writer.frame(row)
        elif isinstance(row, Snapshot):
            plain = json.loads(row.state_json)
            change(plain)
            writer.snapshot(row.t_ns, json.dumps(plain))
    writer.close()
    return path


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda plain: None, ""),
        (lambda plain: plain.pop("version"), "it is of another version: 1 or none, where this program knows"),
        (lambda plain: plain.update(version=VERSION - 1), f"it is of another version: {VERSION - 1}, where"),
        (lambda plain: plain["estimators"]["tracker"].pop("mean"), "TrackerState: mean is missing"),
        (lambda plain: plain["aligner"]["tracks"].popitem(), "it is of a machine with other receivers"),
    ],
    ids=["whole", "of the first version", "older", "damaged", "of another machine"],
)
def test_a_part_whose_state_is_refused_says_why_and_gives_poses_all_the_same(
    live: Live, tmp_path: Path, change: Callable[[dict[str, Any]], object], reason: str
) -> None:
    path, out = with_state(live, tmp_path / "x.mcap", change), tmp_path / "out.mcap"
    writer = LogWriter(out, MachineFile(MACHINE, MACHINE_TEXT), RunPart("again", 1, 0))
    summary, output = run([path], writer=writer)
    writer.close()
    assert summary.faults == 0 and summary.poses > 20
    collected = [event_sentence(event) for event in summary.events if event.kind == "stored_state"]
    assert len(collected) == len(output) == (reason != "")
    for text in (*collected, *output):
        assert reason in text and text.endswith("; continuing without it")
    retained = [
        pb.Event.FromString(row.data).kind
        for row in results_of([out], frozenset({"/event"})).get("/event", [])
    ]
    assert retained.count("stored_state") == len(collected)
    again, output = run([out])  # which begins with what was still known
    assert (again.poses, output) == (summary.poses, [])


@pytest.mark.long
def test_the_parts_of_a_run_go_on_from_one_another_where_their_states_are_refused(
    live: Live, tmp_path: Path
) -> None:
    def older(plain: dict[str, Any]) -> None:
        plain["version"] = VERSION - 1

    whole, _ = run(live.parts[:2])
    refused, output = run([live.parts[0], with_state(live, tmp_path / "x.mcap", older)])
    assert len(output) == 1 and "another version" in output[0]
    assert (refused.estimates, refused.poses) == (whole.estimates, whole.poses)


# Differences are found


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("value", "tractor.heading was"),
        ("time", "computed again for"),
        ("missing", "/pose"),
        ("twice", "/pose"),
    ],
)
def test_one_altered_result_is_found(live: Live, tmp_path: Path, change: str, expected: str) -> None:
    comparison = Comparison()
    run([altered(live, tmp_path, "/pose", 10, change)], comparison=comparison)
    assert comparison.difference.startswith("/pose")
    assert expected in comparison.difference


def test_what_is_missing_at_the_end_of_a_cut_log_is_no_difference() -> None:
    for truncated in (True, False):
        comparison = Comparison()
        comparison.logged(Logged("/pose", 1, b""))
        comparison.recomputed("/pose", 1, b"")
        comparison.recomputed("/pose", 2, b"")
        comparison.finish(truncated)
        assert bool(comparison.difference) != truncated
    comparison = Comparison()
    comparison.logged(Logged("/pose", 1, b""))
    comparison.finish(True)
    assert "not computed again" in comparison.difference


def cut_before_a_pose(live: Live, path: Path) -> Path:
    """The first part as the disk kept it that filled up between a frame and the pose that came of it."""
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", 1, live.rows[0].t_ns))
    observed = 0
    for row in open_log(live.parts[0], IDENTICAL).records:
        if isinstance(row, Frame):
            writer.frame(row)
        elif isinstance(row, Logged):
            observed += row.topic == "/pose"
            if observed == 20:
                break
            writer.message(row.topic, row.t_ns, row.data)
    writer.flush()
    writer.abandon()
    return path


def test_a_gap_in_the_middle_of_a_run_is_no_difference(live: Live, tmp_path: Path) -> None:
    comparison = Comparison()
    cut = cut_before_a_pose(live, tmp_path / "cut.mcap")
    summary, output = run([cut, *live.parts[1:]], comparison=comparison)
    assert (comparison.difference, summary.truncated) == ("", True)
    assert comparison.compared > 600
    assert output == [f"{cut}: cut off; replayed as far as it is whole"]


# Several runs, and parts out of order


ANOTHER = "another run begins here; counts are of all runs, estimates of the last one alone"


def test_another_run_starts_afresh(live: Live, other: Live, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    writer = LogWriter(out, MachineFile(MACHINE, MACHINE_TEXT), RunPart("again", 1, 0))
    comparison = Comparison()
    both, output = run([*live.parts, *other.parts], comparison=comparison, writer=writer)
    writer.close()
    first, second = run(live.parts)[0], run(other.parts)[0]
    assert comparison.difference == ""
    assert both.estimates == second.estimates != first.estimates
    for count in ("frames", "measurements", "poses", "duration_ns"):
        assert getattr(both, count) == getattr(first, count) + getattr(second, count)
    assert output == [f"{other.parts[0]}: {ANOTHER}"]
    comparison = Comparison()
    again, output = run([out], comparison=comparison)
    assert (comparison.difference, output, again.estimates) == ("", [], both.estimates)


def test_another_run_cut_before_its_first_frame_leaves_the_estimates(live: Live, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    LogWriter(cut, MachineFile(MACHINE, MACHINE_TEXT), RunPart("later", 1, 0)).abandon()
    summary, _ = run([live.parts[0], cut])
    assert summary.truncated
    assert summary.estimates == run(live.parts[:1])[0].estimates


NOT_IN_ORDER: tuple[tuple[tuple[int, ...], str], ...] = (
    ((0, 2), "part 3 of its run follows part 1; what is between is missing"),
    ((0, 2, 1), "part 2 after part 3 of the same run; give each once and in order"),
    ((1, 0), "part 1 after part 2 of the same run; give each once and in order"),
    ((0, 0), "part 1 after part 1 of the same run; give each once and in order"),
    ((0, -1), ANOTHER),  # -1: the second part of another run
)


@pytest.mark.parametrize(("order", "expected"), NOT_IN_ORDER)
def test_a_part_out_of_order_is_told_and_replays_as_it_ran(
    live: Live, other: Live, order: tuple[int, ...], expected: str
) -> None:
    paths = [(*live.parts, other.parts[1])[k] for k in order]
    comparison = Comparison()
    _, output = run(paths, comparison=comparison)
    assert comparison.difference == ""
    assert output[-1] == f"{paths[-1]}: {expected}"


# Logs of others


def test_logs_that_tell_no_run_go_on_as_one(live: Live, tmp_path: Path) -> None:
    rows = live.rows[: len(live.rows) // 2]
    whole = as_candump(rows, tmp_path / "whole.log", "can0")
    halves = [as_candump(rows[:3000], tmp_path / "a.log", "can0")]
    halves.append(as_candump(rows[3000:], tmp_path / "b.log", "can0"))
    wanted, found = run([whole]), run(halves)
    assert (found[0].estimates, found[0].poses, found[1]) == (wanted[0].estimates, wanted[0].poses, [])


def as_candump(rows: Sequence[Frame], path: Path, bus: str = "slcan0") -> Path:
    path.write_text(
        "".join(f"({r.t_ns / 1e9:.6f}) {bus} {r.can_id:08X}#{r.data.hex().upper()}\n" for r in rows)
    )
    return path


def test_other_formats_give_the_same_result(live: Live, tmp_path: Path) -> None:
    rows = live.rows[: len(live.rows) // 2]
    rounded = [replace(r, t_ns=r.t_ns // 1000 * 1000, rx_ns=r.t_ns // 1000 * 1000) for r in rows]
    wanted, _ = run([record(tmp_path, rounded, 1).parts[0]])
    dump = as_candump(rounded, tmp_path / "x.log")
    blf = tmp_path / "x.blf"
    with can.Logger(str(blf)) as writer:
        for r in rounded:
            writer.on_message_received(
                can.Message(timestamp=r.t_ns / 1e9, arbitration_id=r.can_id, data=r.data)
            )
    for path in (dump, blf):
        found, _ = run([path])
        assert (found.frames, found.measurements) == (wanted.frames, wanted.measurements)
        assert found.poses == pytest.approx(wanted.poses, abs=1)
    assert run([dump])[0].estimates == wanted.estimates


def test_the_one_bus_of_a_log_is_that_of_the_machine_file(live: Live, tmp_path: Path) -> None:
    path = as_candump(live.rows[:4000], tmp_path / "x.log")
    summary, output = run([path])
    assert summary.measurements > 1000
    assert output == [f"{path}: its bus slcan0 is taken for can0 of the machine file"]


def test_two_buses_are_not_guessed_but_can_be_named(live: Live, tmp_path: Path) -> None:
    path = as_candump(live.rows[:4000], tmp_path / "x.log")
    other = as_candump(live.rows[:10], tmp_path / "y.log", "slcan1")
    path.write_text(other.read_text() + path.read_text())
    summary, output = run([path])
    assert summary.poses == 0
    assert summary.rejected["unknown_source"] > 500
    assert len(output) == 1 and "slcan1, slcan0" in output[0] and "--bus LOG=MACHINE" in output[0]
    named = replay([path], MachineFile(MACHINE, MACHINE_TEXT), buses={"slcan0": "can0"})
    assert named.poses > 5


def test_a_clock_that_steps_back(live: Live, tmp_path: Path) -> None:
    half = len(live.rows) // 2
    rows = live.rows[:half] + [
        replace(r, t_ns=r.t_ns - 3_600_000_000_000, rx_ns=r.rx_ns - 3_600_000_000_000)
        for r in live.rows[half:]
    ]
    parts = record(tmp_path, rows, 1).parts
    comparison = Comparison()
    summary, output = run(parts, comparison=comparison)
    assert (summary.frames, comparison.difference) == (len(rows), "")
    assert summary.duration_ns == pytest.approx(SECONDS * 1e9, rel=0.01)
    assert summary.rejected["clock_step"] == 1
    assert len(output) == 1 and "stepped back" in output[0]


def test_frames_of_a_second_clock_are_neither_steps_nor_time(live: Live, tmp_path: Path) -> None:
    """A recorder wrote some frames with the time of another clock, seven seconds behind."""
    rows = [replace(r, t_ns=r.t_ns // 1000 * 1000, rx_ns=r.t_ns // 1000 * 1000) for r in live.rows]
    alone, _ = run([as_candump(rows, tmp_path / "alone.log")])
    mixed = []
    for i, row in enumerate(rows):
        mixed.append(row)
        if i % 7 == 0:
            mixed.append(replace(row, t_ns=row.t_ns - 7_456_000_000, can_id=0x18FF0001))
    summary, output = run([as_candump(mixed, tmp_path / "mixed.log")])
    assert len(output) == 1 and "is taken for can0" in output[0]
    assert summary.rejected["other_time"] == len(mixed) - len(rows)
    assert (summary.poses, summary.duration_ns) == (alone.poses, alone.duration_ns)
    assert summary.duration_ns == pytest.approx(SECONDS * 1e9, rel=0.01)


def test_a_clock_that_was_set_ahead_is_not_time_that_passed(live: Live, tmp_path: Path) -> None:
    """Of a log that others wrote; in a log of ours the same is a silence, for its clock is never set."""
    half, hour = len(live.rows) // 2, 3_600_000_000_000
    rows = live.rows[:half] + [replace(r, t_ns=r.t_ns + hour, rx_ns=r.rx_ns + hour) for r in live.rows[half:]]
    foreign, _ = run([as_candump(rows, tmp_path / "x.log")])
    assert foreign.duration_ns == pytest.approx(SECONDS * 1e9, rel=0.01)
    parts = record(tmp_path, rows, 1).parts
    comparison = Comparison()
    ours, _ = run(parts, comparison=comparison)
    assert comparison.difference == ""
    assert ours.duration_ns == pytest.approx(SECONDS * 1e9 + hour, rel=0.001)


def test_a_cut_log_replays_as_far_as_it_is_whole(live: Live, tmp_path: Path) -> None:
    content = live.parts[0].read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: len(content) // 2] + bytes(500))
    comparison = Comparison()
    summary, output = run([path], comparison=comparison)
    assert summary.truncated
    assert 0 < summary.frames < len(live.rows) // 3
    assert comparison.difference == ""
    assert output == [f"{path}: cut off; replayed as far as it is whole"]


def test_an_empty_log_among_others_is_passed_over(live: Live, tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.touch()
    summary, output = run([live.parts[0], empty, live.parts[1]])
    assert summary.frames > len(live.rows) // 2
    assert output == [f"{empty}: an empty file; no frame is in it"]
    with pytest.raises(EmptyLog):
        run([empty])


def test_a_fault_of_the_fold_costs_no_frame(
    live: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = live.rows[:6000]
    bad = next(frame for frame in rows[3000:] if frame.can_id == 0x18FF0B15)  # the wheel angle

    def failing(state: State, frame: Frame) -> list[Publication]:
        if frame == bad:  # the frame read back is equal to that one, not the same one
            raise ZeroDivisionError("planted")
        return use(state, frame)

    for module in (fold, guarded_fold):
        monkeypatch.setattr(module, "use", failing)
    (part,) = record(tmp_path, rows, 1).parts
    path = tmp_path / "out.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("again", 1, 0))
    comparison = Comparison()
    summary, output = run([part], writer=writer, comparison=comparison)
    writer.close()
    assert (summary.faults, summary.frames, comparison.difference) == (1, 6000, "")
    assert list(frames(path)) == rows
    assert len(output) == 1 and "planted" in output[0]


# Pace


def test_pace_waits_for_the_logs_time() -> None:
    now = 100.0
    waits: list[float] = []

    def sleep(seconds: float) -> None:
        nonlocal now
        waits.append(round(seconds, 6))
        now += seconds

    pace = Pace(2.0, clock=lambda: now, sleep=sleep)
    for t_s in (1000.0, 1001.0, 1001.0, 1001.5, 400.0, 400.2, 400.2 + LONGEST_WAIT_S + 1, 406.4):
        pace(round(t_s * 1e9))
    assert waits == [0.5, 0.25, 0.1, 0.1]
    now += 1.0  # the computer was busy: no wait until the log has caught up
    pace(round(407.4e9))
    assert waits[-1] == 0.1 and len(waits) == 4
