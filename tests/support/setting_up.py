"""`tilth setup` as a process, and a rig that drives on a bus of this computer."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from loopback import GROUP, PATIENCE_S, free_port
from paths import ROOT

CODE = "ABCD-2345"
SCENARIO = (
    "seconds = {seconds}\nspeed = [[{seconds}, 3.0]]\nsteering = ["
    + ", ".join(["[4.0, 0.0], [5.0, 12.0], [5.0, -12.0]"] * 40)
    + "]\n"
)


class SettingUp:
    """url: of the page. file: that is saved there."""

    def __init__(self, folder: Path, *words: str, code: str = CODE) -> None:
        self.file, self.port = folder / "machine.toml", free_port()
        label = folder / "label.toml"
        label.write_text(f'code = "{code}"\n')
        self._bus = f"udp_multicast:{GROUP},port={self.port},hop_limit=0"
        at = ["--label", str(label), "--bus", self._bus, "--port", "0", "--connect", "tcp/127.0.0.1:1"]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "tilth.cli", "setup", str(self.file), *at, *words],
            stdout=subprocess.PIPE, text=True, cwd=folder,
        )  # fmt: skip
        assert self._process.stdout is not None
        self.url = self._process.stdout.readline().strip()

    def close(self) -> None:
        self._process.terminate()
        self._process.communicate(timeout=PATIENCE_S)

    @contextmanager
    def driving(self, folder: Path, seconds: float) -> Iterator[None]:
        """All that a rig's devices say, in real time."""
        scenario = folder / "scenario.toml"
        scenario.write_text(SCENARIO.format(seconds=seconds))
        words = ["simulate", str(scenario), "--bus", self._bus]
        with subprocess.Popen(
            [sys.executable, "-P", "-m", "tilth.cli", *words], cwd=ROOT, stderr=subprocess.DEVNULL
        ) as process:
            try:
                yield
            finally:
                process.kill()
