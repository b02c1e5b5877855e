"""The page of a demo: a recorded drive until the daemon is ready, then it, then what the demo gave."""

import json
from contextlib import closing
from typing import Any

import pytest
from loopback import PATIENCE_S
from stage import Stage
from websockets.sync.client import connect

from tilth.cli import demo_page
from tilth.logger.child import words_of
from tilth.logger.job import Job


@pytest.mark.long
def test_a_recorded_drive_is_shown_until_the_daemon_is_ready() -> None:
    with Stage(rate=4.0) as stage:
        stage.order(preparing="compiling", ready_in_s=40.0)
        words = words_of(demo_page.__name__, stage.endpoint, "127.0.0.1")
        with closing(Job(words, [], aloud=True)) as page:
            address = (page.next(PATIENCE_S) or b"").decode().removeprefix("http://").rstrip("/")
            with connect(f"ws://{address}/live", max_size=None) as stream:

                def wait_for(field: str) -> dict[str, Any]:
                    while True:
                        said = json.loads(stream.recv(timeout=PATIENCE_S))
                        found: dict[str, Any] = said.get("whole") or said["new"]
                        if found.get(field):
                            return found

                first = wait_for("first_drive")
                while not first["first_drive"].get("preparing"):
                    first = wait_for("first_drive")
                assert first["first_drive"]["preparing"] == "compiling" and first["simulated"]
                assert wait_for("player")["player"]["run"] == "first_drive"
                stage.order(preparing="")
                live = wait_for("status")
                while "run" not in live["status"] or "player" in live:
                    live = wait_for("status")
                assert "first_drive" not in live and not live["status"]["preparing"]
                page.send(json.dumps({"rows": [], "files": [], "next": [["look", "tilth logs"]]}).encode())
                assert wait_for("over")["over"]["next"] == [["look", "tilth logs"]]
