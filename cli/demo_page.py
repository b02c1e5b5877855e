"""The page of `tilth demo`, a process of its own: `python -m tilth.cli.demo_page ENDPOINT HOST`.

It says its address on stdout. Until the daemon is ready it plays a recorded drive. A line of JSON on stdin is
what the demo gave; what comes of an ordered report is then a line on stdout.
"""

import argparse
import json
import signal
import sys
import threading
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

from tilth.cli.invite import invite
from tilth.cli.recorded_runs import play
from tilth.logger.child import words_of
from tilth.logger.job import Job, JobEnded
from tilth.logger.log.derived import REPORTS
from tilth.monitor.addresses import EVERYWHERE, listening_socket, urls
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.first_drive import FirstDrive
from tilth.monitor.server import serve
from tilth.monitor.view import OVER, View
from tilth.simulator import first_drive

PREFIX = "tilth"


def main(endpoint: str, host: str) -> None:
    with closing(listening_socket(host, 0)) as listener, ExitStack() as stack:
        daemon_data = DaemonData(endpoint, None, PREFIX, "", False)
        stack.callback(daemon_data.close)
        live = View(daemon_data, endpoint)
        options = argparse.Namespace(
            config=None, replay=False, machine="", bus=[], prefix=PREFIX, logs=[first_drive.path()]
        )
        player = DaemonData(play(options, stack, aloud=False), None, PREFIX, "", False, gone_s=0.0)
        stack.callback(player.close)
        shown = FirstDrive(player, View(player, endpoint), live)
        threading.Thread(target=_hear, args=(live, daemon_data), daemon=True).start()
        port = listener.getsockname()[1]
        invitation = invite(host, port)
        print(urls("http", "127.0.0.1" if host in EVERYWHERE else host, port)[0] + "/", flush=True)
        serve(daemon_data, shown, listener, invitation)


def _hear(live: View, daemon_data: DaemonData) -> None:
    """Until the demo says what it gave, if it ever does."""
    line = sys.stdin.readline()
    if line:
        over = json.loads(line)
        live.tell(OVER, over)
        report = live.last("report") or {}
        if over["files"] and report.get("state") in ("making", "ready"):
            live.tell("report", _finished(report, over["files"], daemon_data))


def _finished(report: dict[str, Any], files: list[str], daemon_data: DaemonData) -> dict[str, Any]:
    """A report that was ordered while the demo ran: made now where it was not ready, of the whole drive."""
    folder = Path(files[0]).parent / REPORTS
    out = folder / report.get("text", "")
    if report["state"] == "making":
        folder.mkdir(exist_ok=True)
        out = folder / f"{Path(files[0]).stem}_report_0.html"
        out.unlink(missing_ok=True)
        with (
            suppress(JobEnded),
            closing(Job(words_of("tilth.cli", "report", *files, "--out", str(out)))) as job,
        ):
            job.end()
    try:
        daemon_data.kept_report = out.read_bytes()
    except OSError as error:
        return report | {"state": "failed", "text": str(error)}
    print(f"the report that was ordered: {out}", flush=True)
    return report | {
        "state": "ready",
        "text": out.name,
        "ended_ns": report.get("ended_ns") or report["began_ns"],
    }


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
