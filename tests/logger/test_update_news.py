"""News of the updater is in a log once, whatever the recorder does when it comes."""

import json
from pathlib import Path

from loopback import numbered, records_of
from one_recording import Recorder

from tilth.logger.update_news import STATE, UpdateNews
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.notices import Notice
from tilth.schemas.proto import tilth_pb2 as pb


def tell(folder: Path, *texts: str) -> None:
    entries = [{"id": text, "code": "of_a_later_release", "values": {}, "text": text} for text in texts]
    folder.with_name(STATE).write_text(json.dumps({"news": entries}))


def start(folder: Path) -> tuple[Recorder, UpdateNews]:
    folder.mkdir(exist_ok=True)
    run = Recorder(folder, log="ignition_off_s = 3")

    def report(kind: str, told: Notice) -> None:
        t_ns = run.clock.t_ns()
        run.recording.message("/event", t_ns, CHANNEL["/event"].encode(Event(t_ns, kind, told)))

    return run, UpdateNews(folder.with_name(STATE), folder, report, run.recording)


def told(folder: Path) -> list[str]:
    return [
        event.text for path in sorted(folder.glob("*.mcap")) for event in records_of(path, "/event", pb.Event)
    ]


def test_what_comes_at_rest_is_told_by_the_run_that_records_next(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    run, news = start(folder)
    tell(folder, "one")
    news.turn()
    run.until(lambda: run.recording.resting)
    tell(folder, "one", "two")
    news.turn()
    news.turn()
    run.recording.close()  # an update is applied at rest: what waited for the next run is gone
    assert told(folder) == ["one"]

    run, news = start(folder)
    news.turn()
    run.until(lambda: run.recording.resting)
    tell(folder, "one", "two", "three")
    news.turn()
    for frame in run.from_now(numbered(2)):
        run.take(frame)
    news.turn()
    run.recording.close()
    run, news = start(folder)
    news.turn()
    run.recording.close()
    assert told(folder) == ["one", "two", "three"]
