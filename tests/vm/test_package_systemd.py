"""The Debian package under a systemd of its own: installed, run, upgraded, rolled back, updated with nobody
present, taken back, removed.

Of Tilth's wheel alone, in namespaces on this computer's kernel (contained.py): a quarter of an hour where
the computer is busy. `pytest -m vm_systemd -n 0 tests/vm/test_package_systemd.py`.
"""

import json
import sysconfig
from pathlib import Path

import contained
import pytest
from guest import CHECKOUT
from loopback import records_of
from releases import SigningKey, release_of

from tilth.schemas.flow import EventKind
from tilth.schemas.notices import NoticeCode
from tilth.schemas.proto import tilth_pb2 as pb

HERE = Path(__file__).parent
KEY = SigningKey(0xA1)
CRASHES = b"import time\ntime.sleep(0.5)\nraise SystemExit(3)\n"
SILENT = b"""
import os, time
from tilth.logger.supervisor import of_environment
def add(subparsers): subparsers.add_parser("run").add_argument("rest", nargs="...")
def run(args):
    supervisor = of_environment(os.environ)
    while True:
        supervisor.turned(time.monotonic_ns())
        time.sleep(1)
"""
RELEASES = (
    ("second", "9.0.0", None),
    ("waits", "9.1.0", None),
    ("crashes", "9.2.0", CRASHES),
    ("silent", "9.3.0", SILENT),
)


def stage(out: Path, wheel: Path) -> None:
    """What the scenario finds."""
    text = (CHECKOUT / "deploy/machines/jd7930-parker500.toml").read_text()
    (out / "machine.toml").write_text(text)
    (out / "resting.toml").write_text(text.replace("[log]", "[log]\nignition_off_s = 10"))
    (out / "ours.pub").write_text(KEY.public())
    for folder, version, broken in (("first", wheel.name.split("-")[1], None), *RELEASES):
        KEY.sign(release_of(wheel, out / folder, version, {"tilth/cli/run.py": broken} if broken else None))


def judge(out: Path) -> None:
    news = json.loads((out / "updates.json").read_text())["news"]
    assert [entry["code"] for entry in news] == [
        NoticeCode.UPDATE_READY, NoticeCode.UPDATED, NoticeCode.UPDATE_READY, NoticeCode.UPDATE_CRASHED,
        NoticeCode.UPDATE_READY, NoticeCode.UPDATE_NOT_RECORDING,
    ]  # fmt: skip
    told = [
        event
        for path in sorted((out / "logs").glob("*.mcap"))
        for event in records_of(path, "/event", pb.Event)
    ]
    assert [e.text for e in told if e.kind == EventKind.UPDATE] == [entry["text"] for entry in news]


@pytest.mark.vm_systemd
@pytest.mark.skipif(contained.missing() != "", reason=contained.missing())
def test_the_package_from_installed_to_purged(tmp_path: Path, wheel: Path) -> None:
    stage(tmp_path, wheel)
    environment = ["env", f"NEEDED={sysconfig.get_path('purelib')}", "TRIAL_S=20.0"]
    contained.with_systemd([*environment, "bash", "-ex", str(HERE / "package.sh")], tmp_path)
    judge(tmp_path)
