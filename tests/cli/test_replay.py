"""`tilth replay`: its JSON, its table, its exit statuses, and where it publishes."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import zenoh
from asked import Answer, asked
from logs import (
    MACHINE,
    MACHINE_FILE,
    MACHINE_TEXT,
    SECOND,
    SECONDS,
    Live,
    altered,
    record,
    results_of,
    write_mcap,
)

from tilth.cli import main
from tilth.logger.zenoh.session import free_endpoint
from tilth.replay.readers.any_log import frames, open_log
from tilth.replay.readers.log import Logged
from tilth.schemas.decode import claim, encode
from tilth.schemas.flow import PARAMETERS, Frame
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.traffic import simulate


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    return record(tmp_path_factory.mktemp("live"), list(simulate(MACHINE, 3, SECONDS)), 3)


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    return asked(capsys, "replay")


def test_the_json_summary(live: Live, answer: Answer) -> None:
    status, out, err = answer(*live.parts, "--json", "--verify")
    assert (status, err, out.count("\n")) == (0, "", 1)
    found = json.loads(out)
    assert list(found) == [
        "frames", "measurements", "rejected", "poses", "duration_s", "truncated", "unknown_sources",
        "left_out", "events", "flags", "estimates", "nuisances", "verify", "simulated",
    ]  # fmt: skip
    assert found["frames"] == len(live.rows)
    assert found["truncated"] is False
    assert found["duration_s"] == pytest.approx(SECONDS, rel=0.01)
    assert found["verify"]["difference"] is None
    for method in ("steady_state", "recommended"):
        assert list(found["estimates"][method]) == list(PARAMETERS)
        for row in found["estimates"][method].values():
            assert list(row) == ["value", "sd", "status", "reason"]
            assert row["status"] in ("unestimated", "estimated", "stale", "invalid")
            assert (row["value"] is None) == (row["status"] == "unestimated")
        for row in found["nuisances"][method].values():
            assert list(row) == ["value", "sd"]


def test_a_table_for_a_person(live: Live, answer: Answer) -> None:
    status, out, _ = answer(live.parts[0], "--verify")
    assert status == 0
    assert "C_af" in out and "frames in" in out and "to the byte" in out
    last = out[out.index("frames in") :]
    assert "recommended" in last and all(name in last for name in PARAMETERS) and "by " in last


def test_out_and_its_second_time(live: Live, answer: Answer, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    assert answer(live.parts[0], "--out", out, "--json")[0] == 0
    assert results_of([out]) == results_of(live.parts[:1])
    before = out.read_bytes()
    status, _, err = answer(live.parts[0], "--out", out)
    assert status == 2 and "exists" in err
    assert out.read_bytes() == before
    status, _, err = answer(live.parts[0], "--out", tmp_path / "no" / "such" / "x.mcap")
    assert status == 2 and "no such file" in err


def test_the_json_tells_events_flags_and_strangers(live: Live, answer: Answer, tmp_path: Path) -> None:
    """A receiver falls silent after 12 s, the clock steps back once, and two strangers speak all the time."""
    silent = next(r.t_ns for r in live.rows if r.t_ns > live.rows[0].t_ns + 12 * SECOND)
    position = encode(65267, {"latitude_deg": 41.98, "longitude_deg": -93.64})
    rows: list[Frame] = []
    for at, frame in enumerate(live.rows):
        if frame.t_ns < silent or frame.can_id & 0xFF != 28:
            rows.append(frame)
        if at % 40 == 0:
            rows += [replace(frame, can_id=0x18FEF300 | source, data=position) for source in (90, 91)]
    name = claim(0xA00017000421FFFF)
    rows[0:0] = [replace(rows[0], can_id=0x18EEFF00 | 90, data=name)]
    path = write_mcap(tmp_path / "x.mcap", rows)
    status, out, _ = answer(path, "--json")
    found = json.loads(out)
    assert status == 0 and found["poses"] > 50
    strangers = found["unknown_sources"]
    assert [(s["source"], s["name"], s["device"]) for s in strangers if s["source"] in (90, 91)] == [
        (90, "A00017000421FFFF", "John Deere, navigation"),
        (91, None, None),
    ]
    assert sum(s["messages"] for s in strangers) == found["rejected"]["unknown_source"]
    flags = found["flags"]
    (lost,) = (flag for flag in flags if flag.startswith("lost:"))
    assert 0 < flags[lost]["poses"] < found["poses"]
    assert silent <= flags[lost]["first_ns"] <= flags[lost]["last_ns"] <= rows[-1].t_ns
    logged = [json.loads(row) for row in events_of(path, tmp_path)]
    told = [{key: event[key] for key in logged[0]} for event in found["events"]]
    assert told == logged and all({"t_ns", "kind", "text"} <= event.keys() for event in logged)
    _, out, _ = answer(path)
    assert "of can0 address 90, A00017000421FFFF (John Deere, navigation)" in out and f"poses {lost}" in out


def events_of(path: Path, folder: Path) -> list[str]:
    """The events that a replay writes to its log, each as JSON with the keys of the summary."""
    out = folder / "again.mcap"
    assert main(["replay", str(path), "--out", str(out)]) == 0
    log = open_log(out, ("/event",))
    with log.file:
        collected = [pb.Event.FromString(r.data) for r in log.records if isinstance(r, Logged)]
    return [
        json.dumps(
            {
                "t_ns": event.t_ns,
                "kind": event.kind,
                "text": event.text,
                "latitude_deg": event.latitude_deg if event.HasField("latitude_deg") else None,
                "longitude_deg": event.longitude_deg if event.HasField("longitude_deg") else None,
                "utc_ns": event.utc_ns if event.HasField("utc_ns") else None,
            }
        )
        for event in collected
    ]


def test_a_found_difference_is_exit_1(live: Live, answer: Answer, tmp_path: Path) -> None:
    path = altered(live, tmp_path, "/pose", 3, "value")
    status, out, _ = answer(path, "--verify", "--json")
    assert status == 1
    assert "tractor.heading" in json.loads(out)["verify"]["difference"]


def test_a_log_without_results_has_nothing_to_compare_with(answer: Answer, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "frames.mcap", simulate(MACHINE, 1, 4.0))
    status, out, _ = answer(path, "--verify", "--json")
    assert status == 1
    assert json.loads(out)["verify"]["difference"].startswith("these logs hold no results")


def test_logs_of_two_machine_files_are_said_to_be_that(answer: Answer, tmp_path: Path) -> None:
    texts = (MACHINE_TEXT, MACHINE_TEXT.replace("c = 2.1", "c = 2.4"))
    logs = [
        write_mcap(tmp_path / f"{k}.mcap", simulate(MACHINE, k, 3.0), text=text, run=f"r{k}")
        for k, text in enumerate(texts)
    ]
    _, _, err = answer(*logs, "--json")
    assert "1.mcap: its machine file differs in tractor.c; that of" in err
    _, _, err = answer(*logs, "--machine", MACHINE_FILE, "--json")
    assert "differs in" not in err


def test_a_log_cut_to_five_bytes_is_exit_0(answer: Answer, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(b"\x89MCAP")
    status, out, err = answer(path, "--machine", MACHINE_FILE, "--json")
    found = json.loads(out)
    assert (status, found["truncated"], found["frames"]) == (0, True, 0)
    assert "cut off" in err


def test_out_leaves_no_file_without_frames(answer: Answer, tmp_path: Path) -> None:
    log, out = tmp_path / "x.log", tmp_path / "out.mcap"
    log.write_text("(1.000000) can0 18EEFF1C#001122334455667\n")  # half a byte is missing
    for _ in range(2):
        status, _, err = answer(log, "--machine", MACHINE_FILE, "--out", out)
        assert (status, out.exists()) == (1, False)
        assert "not written, there was no frame" in err and "no frame is in it" in err


def test_a_cut_log_is_exit_0(live: Live, answer: Answer, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(live.parts[0].read_bytes()[:-1])
    status, out, err = answer(path, "--json")
    assert (status, json.loads(out)["truncated"]) == (0, True)
    assert "cut off" in err


WRONG: tuple[tuple[list[str], int, str], ...] = (
    (["{png}"], 2, "not a log of CAN frames"),
    (["{png}", "{log}", "--machine", "{machine}"], 2, "not a log of CAN frames"),
    (["{folder}"], 2, "a folder"),
    (["{missing}"], 2, "no such file"),
    (["{log}"], 2, "--machine"),
    (["{log}", "--machine", "{missing}"], 2, "cannot be read"),
    (["{log}", "--machine", "{png}"], 2, "UTF-8"),
    (["{log}", "--machine", "{machine}", "--verify"], 2, "--verify"),
    (["{log}", "--machine", "{machine}", "--bus", "slcan0=can7"], 2, "LOG=MACHINE"),
    (["{log}", "--machine", "{machine}", "--bus", "slcan0"], 2, "LOG=MACHINE"),
    (["{log}", "--machine", "{machine}", "--rate", "0"], 2, "--rate"),
    (["{log}", "--machine", "{machine}", "--rate", "fast"], 2, "--rate"),
    ([], 2, "LOG"),
    (["{empty}"], 1, "empty"),
    (["{cut}"], 2, "cut off before its machine file"),
    (["{empty}", "--machine", "{machine}"], 1, "empty"),
)


@pytest.mark.parametrize(("words", "status", "expected"), WRONG)
def test_wrong_use_is_told_in_one_line(
    words: list[str], status: int, expected: str, answer: Answer, tmp_path: Path
) -> None:
    places = {
        "png": tmp_path / "x.png",
        "log": tmp_path / "x.log",
        "empty": tmp_path / "empty.log",
        "cut": tmp_path / "cut.mcap",
        "missing": tmp_path / "missing.log",
        "folder": tmp_path,
        "machine": MACHINE_FILE,
    }
    places["png"].write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(50))
    places["log"].write_text("(1.000000) slcan0 18EEFF1C#0011223344556677\n")
    places["empty"].touch()
    places["cut"].write_bytes(b"\x89MCAP")
    found, out, err = answer(*(word.format(**places) for word in words))
    assert (found, out) == (status, "")
    assert expected in err and err.count("\n") == 1


def test_publishing_goes_under_the_replay_prefix_only(live: Live, answer: Answer, tmp_path: Path) -> None:
    endpoint = free_endpoint("tcp/127.0.0.1:0")
    config = zenoh.Config()
    for key, value in {
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "listen/endpoints": json.dumps([endpoint]),
    }.items():
        config.insert_json5(key, value)
    ours = free_endpoint("tcp/127.0.0.1:0")
    machine_file = tmp_path / "m.toml"
    machine_file.write_text(f'{MACHINE_TEXT}listen = ["{ours}"]\nconnect = ["{endpoint}"]\n')  # under [zenoh]
    received: list[tuple[str, bytes]] = []
    with zenoh.open(config) as session:
        token = session.liveliness().declare_subscriber("**")
        session.declare_subscriber(
            "**", lambda sample: received.append((str(sample.key_expr), bytes(sample.payload)))
        )
        # Eight seconds of log in 0.4 s: the two sessions find one another meanwhile.
        status, _, err = answer(
            live.parts[0], "--machine", machine_file, "--publish", "--rate", "20", "--json"
        )
        alive = token.recv()
    base = f"tilth/{MACHINE.name}/replay"
    assert status == 0 and f"publishing under {base}" in err
    assert str(alive.key_expr) == f"{base}/alive"
    assert {key for key, _ in received} > {f"{base}/pose"}
    assert all(key.startswith(f"{base}/") for key, _ in received)
    poses = {row.data for row in results_of(live.parts[:1])["/pose"]}
    assert {data for key, data in received if key == f"{base}/pose"} <= poses


def test_a_run_whose_first_file_is_empty(live: Live, answer: Answer, tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.touch()
    status, out, err = answer(empty, live.parts[0], "--out", tmp_path / "out.mcap", "--json")
    assert (status, err) == (0, f"tilth replay: {empty}: an empty file; no frame is in it\n")
    assert json.loads(out)["frames"] == sum(1 for _ in frames(tmp_path / "out.mcap"))
