"""A real daemon on a real bus: `tilth run` in a process of its own hears a simulated tractor over TCP, from
which a receiver can be unplugged, and whose log cannot be written any more."""

import os
import re
import resource
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from loopback import PATIENCE_S, machine_text, udp_bus

from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.demo import on_loopback
from tilth.simulator.drive import drive
from tilth.simulator.scenario import Scenario
from tilth.simulator.socketcand_server import open_server, play
from tilth.simulator.traffic import traffic

ADDRESS_CLAIM = 0xEE00
PLAIN = Scenario(clock_offset_s=0.0)


class FieldRig:
    """`start` and `kill` the daemon as often as you like; the tractor drives on."""

    def __init__(
        self, folder: Path, seconds: float, scenario: Scenario = PLAIN, key: Path | None = None
    ) -> None:
        """key: the daemon's, of `tilth keys`."""
        self.folder = folder
        self._server = open_server()
        text = on_loopback(machine_text(folder, udp_bus("can0", 0)), self._server.port)
        if key is not None:
            text = re.sub("(?m)^listen = .*$", f'config = "{key}"', text)
        self.machine = parse_machine(text)
        self.endpoint = self.machine.zenoh.listen[0]
        self.text = text
        self.file = folder / "machine.toml"
        self.file.write_text(text)
        self._unplugged: set[str] = set()
        self._process: subprocess.Popen[bytes] | None = None
        orders, self._orders = os.pipe()
        self._thread = threading.Thread(target=self._play, args=(orders, seconds, scenario), daemon=True)
        self._thread.start()

    def start(self) -> None:
        start = "import sys; from tilth.cli import main; sys.exit(main())"
        self._process = subprocess.Popen(
            [sys.executable, "-c", start, "run", str(self.file), "--plain"], stdout=subprocess.DEVNULL
        )

    def kill(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait(PATIENCE_S)

    def stop(self) -> None:
        """As a person does: the log is finished."""
        assert self._process is not None
        self._process.terminate()
        self._process.wait(PATIENCE_S)

    def unplug(self, *mounts: str) -> None:
        self._unplugged = set(mounts)

    def let_it_write(self, may: bool) -> None:
        """No file of the daemon's can grow where it may not."""
        assert self._process is not None
        size = resource.RLIM_INFINITY if may else 1
        resource.prlimit(self._process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    def close(self) -> None:
        if self._process is not None:
            self.kill()
        with suppress(BrokenPipeError):  # the drive is over
            os.write(self._orders, b"\n")
        self._thread.join(PATIENCE_S)
        os.close(self._orders)

    def _play(self, orders: int, seconds: float, scenario: Scenario) -> None:
        mount_of = {f"{receiver.name:016X}": receiver.mount.value for receiver in self.machine.receiver}
        truth = drive(self.machine, 1, seconds, scenario)
        mounts: dict[int, str] = {}  # by source address, as it is claimed

        def plugged() -> Iterator[Frame]:
            for frame in traffic(self.machine, begun):
                source = frame.can_id & 0xFF
                if frame.can_id >> 8 & 0xFF00 == ADDRESS_CLAIM:
                    mounts[source] = mount_of.get(frame.data[::-1].hex().upper(), "")
                if mounts.get(source) not in self._unplugged:
                    yield frame

        with open(orders, "rb", buffering=0) as result:
            while not self._server.listening():
                if self._server.serve(0.02, result):
                    return
            clock = Clock()
            begun = replace(truth, scenario=replace(truth.scenario, utc_start_ns=clock.t_ns() + 300_000_000))
            play(self._server, plugged(), clock, result)
            self._server.close()
