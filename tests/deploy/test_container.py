"""The container: podman-compose reads its compose file; by hand it is built, and all of it runs."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pytest
from loopback import GROUP, TEXT
from paths import ROOT

from tilth.cli import main

CONTAINER = ROOT / "deploy/container"
SCRIPTS = Path(sysconfig.get_path("scripts"))
TOOLS = ("podman", "buildah", "mmdebstrap", "uv")
ABSENT = [tool for tool in TOOLS if shutil.which(tool) is None]
BUS = re.compile(r"\[\[bus\]\].*?(?=\n\[)", re.S)
YAML: Any = importlib.import_module("yaml")  # podman-compose's, without types
DRIVE = "purpose = 'twenty seconds'\nseconds = 20.0\nspeed = [[20.0, 3.0]]\nsteering = [[20.0, 2.0]]\n"
# For a podman that may neither make control groups nor raise limits, as within another container.
CONFINED = '[containers]\ncgroups = "disabled"\ndefault_ulimits = ["nofile=1000:1000", "nproc=1000:1000"]\n'


@pytest.mark.skipif(
    shutil.which("podman") is None, reason="podman-compose asks podman: apt-get install podman"
)
def test_podman_reads_the_compose_file_and_every_service_is_confined() -> None:
    words: list[str | Path] = [SCRIPTS / "podman-compose", "--file", CONTAINER / "compose.yaml", "config"]
    said = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    services = YAML.safe_load(said)["services"]
    assert services.keys() == {"recorder", "router", "page"}
    for service in services.values():
        assert service["read_only"] is True and service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"] and "privileged" not in service


@pytest.mark.containers
@pytest.mark.skipif(bool(ABSENT) or os.geteuid() != 0, reason=f"takes root and {', '.join(TOOLS)}")
def test_recorder_router_and_page_come_up_and_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chroot = {**os.environ, "BUILDAH_ISOLATION": "chroot"}
    subprocess.run(["sh", CONTAINER / "build", tmp_path / "image"], check=True, env=chroot)
    folder = tmp_path / "tractor"
    folder.mkdir()
    shutil.copy(CONTAINER / "compose.yaml", folder)
    bus = f'[[bus]]\nname = "can0"\ninterface = "udp_multicast"\nchannel = "{GROUP}"\noptions.hop_limit = 0\n'
    (folder / "machine.toml").write_text(BUS.sub(bus, TEXT))
    (folder / "drive.toml").write_text(DRIVE)
    (tmp_path / "containers.conf").write_text(CONFINED)
    environment = {
        **os.environ,
        "PATH": f"{SCRIPTS}:{os.environ['PATH']}",
        "CONTAINERS_CONF": str(tmp_path / "containers.conf"),
        "PYTHON": sys.executable,
    }
    script = Path(__file__).with_name("compose.sh")
    spaces = ["unshare", "--mount", "--net", "bash", "-ex", str(script)]
    subprocess.run(spaces, check=True, cwd=folder, env=environment, timeout=1200)
    (log,) = folder.glob("*.mcap")
    assert main(["verify", "--json", str(log)]) == 0
    (run,) = json.loads(capsys.readouterr().out)
    sent = re.search(r"(\d+) frames sent", (folder / "sent.txt").read_text())
    assert sent is not None and int(sent[1]) > 10_000
    assert run["heard"]["/can/can0"]["count"] == int(sent[1])
