"""A package from folder to recording and back: updater and recorder for real, killed at many instants."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from loopback import free_port, machine_text, records_of, udp_bus, until
from releases import SigningKey, release_of
from setup_box import Box, without_tilth

from tilth.deploy import install, update
from tilth.logger.update_news import STATE
from tilth.schemas.notices import NoticeCode
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb: not on Debian")
KEY = SigningKey(0xA1)
CUTS = int(os.environ.get("TILTH_CUTS", "4"))


@pytest.fixture
def box(tmp_path: Path, wheel: Path, monkeypatch: pytest.MonkeyPatch) -> Box:
    """Version 0.1.0 is installed, its machine file has one bus."""
    made = Box(tmp_path, without_tilth(tmp_path / "needed"))
    for name in ("PIP_NO_DEPS", "PIP_NO_COMPILE", "NUMBA_DISABLE_JIT", "PYTHONPATH"):
        monkeypatch.setenv(name, made.environment[name])
    machine = tmp_path / "machine.toml"
    machine.write_text(machine_text(tmp_path, udp_bus("can0", free_port())))
    done = made.setup("install", wheel, "--machine", machine)
    assert done.returncode == 0, done.stderr
    keys = made.root / update.KEYS
    keys.mkdir(parents=True)
    (keys / "ours.pub").write_text(KEY.public())
    return made


def codes(box: Box) -> list[str]:
    return [entry["code"] for entry in json.loads((box.root / "opt/tilth" / STATE).read_text())["news"]]


def said(box: Box) -> str:
    """By the recorder."""
    return box.root.with_name("said").read_text()


def version(box: Box, link: str = "current") -> str:
    release = install.Box(box.root).release(link)
    return "" if release is None else install.version_of(release)


@pytest.mark.long
def test_a_release_that_records_is_kept_and_said_and_one_that_does_not_is_taken_back(
    box: Box, wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stick = tmp_path / "stick"
    KEY.sign(release_of(wheel, stick, "9.0.0"))
    look = ["--root", str(box.root), str(stick)]
    logs = box.root / install.LOGS
    logs.mkdir(parents=True)
    run = ["run", str(box.root / install.MACHINE), "--log", str(logs), "--no-zenoh", "--plain"]

    # While the one before records, it is prepared and waits.
    with Recorder(box, *run):
        until(lambda: install.is_recording(install.Box(box.root)))
        assert update.main(look) == 0
        assert (version(box), version(box, "next")) == ("0.1.0", "9.0.0")
        assert codes(box) == [NoticeCode.UPDATE_READY]
    monkeypatch.setattr(update, "TRIAL_S", 30.0)
    looking = threading.Thread(target=update.main, args=(look,))
    looking.start()
    until(lambda: version(box) == "9.0.0")
    with Recorder(box, *run) as after:
        until(lambda: not looking.is_alive(), lambda: looking.join(0.1))
        assert codes(box) == [NoticeCode.UPDATE_READY, NoticeCode.UPDATED]
        assert version(box, "keeper") == "9.0.0" and after.poll() is None
        until(lambda: "updated from 0.1.0 to 9.0.0, which records" in box.root.with_name("said").read_text())
    told = [
        event.notice.code
        for path in sorted(logs.glob("*.mcap"))
        for event in records_of(path, "/event", pb.Event)
    ]
    assert [code for code in told if code.startswith("update")] == ["update_ready", "updated"]  # each once

    shutil.rmtree(stick)
    broken = {"tilth/cli/run.py": b"raise SystemExit(3)\n"}
    KEY.sign(release_of(wheel, stick, "9.1.0", broken))
    monkeypatch.setattr(update, "TRIAL_S", 1.0)
    assert update.main(look) == 0
    assert codes(box)[-2:] == [NoticeCode.UPDATE_READY, NoticeCode.UPDATE_NOT_RECORDING]
    assert (version(box), version(box, "keeper"), version(box, "previous")) == ("9.0.0", "9.0.0", "")
    assert update.main(look) == 0 and len(codes(box)) == 4  # it is not tried again
    with Recorder(box, *run):
        until(
            lambda: "update to 9.1.0 was taken back, 9.0.0 runs" in box.root.with_name("said").read_text(),
        )

    shutil.rmtree(stick)
    KEY.sign(release_of(wheel, stick, "9.2.0"))
    machine = box.root / install.MACHINE
    machine.write_text(machine.read_text().replace("[tractor]", "[traktor]"))
    assert update.main(look) == 0 and version(box) == "9.0.0" and version(box, "next") == ""
    (told_last,) = json.loads((box.root / "opt/tilth" / STATE).read_text())["news"][-1:]
    assert told_last["code"] == NoticeCode.UPDATE_REFUSED and 'did you mean "tractor"' in told_last["text"]


class Recorder:
    """`tilth run` of the current release; what it says is in the file `said`."""

    def __init__(self, box: Box, *words: str) -> None:
        self._words = [str(box.root / "opt/tilth/current/bin/tilth"), *words]
        self._box = box

    def __enter__(self) -> "subprocess.Popen[bytes]":
        with self._box.root.with_name("said").open("wb") as out:
            self._process = subprocess.Popen(self._words, env=self._box.environment, stdout=out, stderr=out)
        return self._process

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGINT)
        self._process.wait()


@pytest.mark.cuts
def test_killed_at_any_instant_the_release_before_or_the_next_runs_and_another_look_goes_on(
    box: Box, wheel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stick = tmp_path / "stick"
    KEY.sign(release_of(wheel, stick, "9.0.0"))
    code = "import sys; from tilth.deploy import update; update.TRIAL_S = 0.0; sys.exit(update.main())"
    look: list[str | Path] = [sys.executable, "-c", code, "--root", box.root, stick]
    saved = tmp_path / "saved"
    subprocess.run(["cp", "-a", box.root, saved], check=True)
    took_s = time.monotonic()
    assert subprocess.run(look, capture_output=True, check=False).returncode == 0
    took_s = time.monotonic() - took_s
    assert codes(box) == [NoticeCode.UPDATE_READY, NoticeCode.UPDATE_NOT_RECORDING]  # whole: with a trial
    left = dict[str, int]()
    for cut in range(CUTS):
        shutil.rmtree(box.root)
        subprocess.run(["cp", "-a", saved, box.root], check=True)
        with subprocess.Popen(
            look, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        ) as one:
            try:
                one.wait(took_s * (cut + 0.5) / CUTS)
            except subprocess.TimeoutExpired:
                os.killpg(one.pid, signal.SIGKILL)
        state = f"{version(box)}, next {version(box, 'next')}, keeper {version(box, 'keeper')}"
        left[state] = left.get(state, 0) + 1
        assert version(box) in ("0.1.0", "9.0.0") and version(box, "keeper") in ("0.1.0", "9.0.0")
        for release in {(box.root / "opt/tilth" / link).resolve() for link in ("current", "keeper")}:
            python = release / "bin/python"
            words: list[str | Path] = [python, "-P", "-c", "import tilth.cli.run, tilth.deploy.update"]
            assert subprocess.run(words, env=box.environment, check=False).returncode == 0, state
        assert subprocess.run(look, capture_output=True, check=False).returncode == 0
        assert codes(box)[-1] == NoticeCode.UPDATE_NOT_RECORDING, state
        assert (version(box), version(box, "next")) == ("0.1.0", "")
        assert len(list(install.Box(box.root).releases.iterdir())) == 1
    with capsys.disabled():
        sys.stdout.write(f"\n{CUTS} kills within {took_s:.1f} s left: {left}\n")
