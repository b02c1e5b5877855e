"""`tilth setup`: the live page behind a code, and pages on which the machine file is made."""

import argparse
import json
import signal
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import segno

from tilth.cli import WrongUse
from tilth.cli.discover import parse_buses
from tilth.cli.zenoh_options import add_address, add_daemon, check_address
from tilth.logger.child import words_of
from tilth.logger.log import whole_file
from tilth.monitor.addresses import EVERYWHERE, listening_socket, urls
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.entry_code import EntryCode, new_code
from tilth.monitor.server import Inside, serve
from tilth.monitor.view import View
from tilth.replay.bus_listening import BusListening, interfaces
from tilth.replay.discover import BusDevice, Findings
from tilth.replay.first_machine import machine_text, usable, which, who
from tilth.replay.machine_draft import DEERE, MOST_RECEIVERS, described
from tilth.replay.wheel_search import WheelCandidate
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Bus
from tilth.schemas.readable import reason_of
from tilth.schemas.wheel_angle import RUDDER

PORT = 8117
CHECK_S: Final = 2.0  # to hear the buses
LONGEST_CHECK_S: Final = 120.0
MOST_WHEELS: Final = 3
BEFORE: Final = ".before"
SETUP: Final = "setup"  # what the live page is told, so that it shows the way there


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "setup",
        help="make a machine file on a web page, from a phone or in a browser here",
        description="Serves the live page, and pages that make the machine file step by step from the "
        "messages on the buses and from your measurements. Nothing is shown until the code has been "
        "entered. Nothing is ever sent on a bus. Until Ctrl-C.",
    )
    parser.add_argument("file", type=Path, metavar="MACHINE.toml", help="file to make, or to make again")
    parser.add_argument(
        "--label", type=Path, metavar="FILE", help='file with code = "…"; otherwise a random code is printed'
    )
    parser.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="INTERFACE:CHANNEL[,key=value…]",
        help="bus to listen to; default: every CAN interface of this computer",
    )
    parser.add_argument(
        "--in-use",
        type=Path,
        metavar="FILE",
        help="the machine file that is in use, if it is another one",
    )
    add_daemon(parser)
    add_address(parser, PORT)


def run(args: argparse.Namespace) -> int:
    check_address(args)
    entry, code = _entry(args.label)
    buses = parse_buses(args.bus)
    try:
        listener = listening_socket(args.host, args.port)
    except OSError as error:
        where = f"cannot serve at {args.host} port {args.port}: {error.strerror or error}"
        raise WrongUse(f"{where}; give another --port or --host") from None
    with ExitStack() as stack:
        stack.callback(listener.close)
        try:
            heard = DaemonData(args.connect, args.config, args.prefix, args.machine, args.replay)
        except ValueError as error:
            raise WrongUse(str(error)) from None
        stack.callback(heard.close)
        view = View(heard, str(args.config or args.connect))
        view.tell(SETUP, {})
        first = MadeHere(args.file, args.in_use or args.file, buses, heard, view)
        stack.callback(first.close)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with suppress(KeyboardInterrupt):
            host, port = listener.getsockname()[:2]
            _say_where(host, port, "" if args.label else code)
            serve(heard, view, listener, inside=Inside(first, entry))
    return 0


def _entry(label: Path | None) -> tuple[EntryCode, str]:
    """Raises WrongUse: without a good code nothing is served."""
    code: object = new_code()
    if label is not None:
        try:
            code = tomllib.loads(label.read_text(encoding="utf-8-sig")).get("code")
        except OSError as error:
            raise WrongUse(f"--label {label}: {reason_of(error)}; nothing is served without a code") from None
        except ValueError as error:
            raise WrongUse(f'--label {label}: {error}; it has a line such as code = "{code}"') from None
    if not isinstance(code, str):
        raise WrongUse(f'--label {label}: it has no line such as code = "{new_code()}"')
    try:
        return EntryCode(code), code
    except ValueError as error:
        raise WrongUse(f"--label {label}: {error}, such as {new_code()}") from None


def _say_where(host: str, port: int, code: str) -> None:
    """code: that was drawn, if one was: one of a label stays there."""
    for url in urls("http", host, port):
        print(f"{url}/", flush=True)
    if host in EVERYWHERE and sys.stderr.isatty():
        segno.make(urls("http", host, port)[0], error="l").terminal(sys.stderr, border=2, compact=True)
    if code:
        print(f"code: {code}", flush=True)


class MadeHere:
    """A machine file that is made of what is heard here. From several threads."""

    def __init__(self, path: Path, in_use: Path, buses: Sequence[Bus], heard: DaemonData, view: View) -> None:
        """buses: empty for every CAN interface of this computer."""
        self._path, self._in_use, self._given, self._heard, self._view = path, in_use, buses, heard, view
        self._listening: BusListening | None = None
        self._found = Findings(0, 0.0, (), (), ())

    @property
    def is_first(self) -> bool:
        return not (self._path.exists() or self._in_use.exists())

    def close(self) -> None:
        if self._listening is not None:
            self._listening.stop()

    def listen(self) -> None:
        """To what is there now: an adapter may just have been plugged in."""
        self.close()
        self._listening = BusListening(self._given or _found_here())
        self._listening.start()

    def heard(self) -> dict[str, Any]:
        """What the page shows of the buses."""
        if self._listening is None:
            self.listen()
        listening = self._listening
        assert listening is not None
        self._found = found = listening.findings()
        devices = usable(found)
        mounts = dict(zip(found.front_to_rear, Mount, strict=False))
        known = mounts if len(found.front_to_rear) == len(devices) == MOST_RECEIVERS else {}
        return {
            "listens": listening.listens,
            "seconds": round(found.seconds),
            "frames": found.frames,
            "buses": [
                {"name": bus.name, "channel": str(bus.channel), "bitrate": bus.bitrate,
                 "heard": bus.name in found.buses}
                for bus in listening.buses
            ],
            "problems": listening.problems(),
            "receivers": [_receiver(device, known.get((device.bus, device.source))) for device in devices],
            "without": [who(device) for device in found.receivers if not device.positions],
            "devices": len(found.sources),
            "wheels": [_wheel(candidate) for candidate in found.wheel_angles[:MOST_WHEELS]],
        }  # fmt: skip

    def check(self, answers: dict[str, str]) -> dict[str, Any]:
        """What is wrong with the answers; of a whole machine file also what `tilth check` says."""
        text, told = self._drafted(answers)
        if not text:
            return told
        with TemporaryDirectory(prefix="tilth-setup-") as folder:
            draft = Path(folder) / "machine.toml"
            draft.write_text(text, encoding="utf-8")
            return told | _checked(draft, self._path.absolute().parent)

    def save(self, answers: dict[str, str]) -> dict[str, Any]:
        """Where nothing is refused. The file before stays beside it. Whatever runs goes on."""
        text, told = self._drafted(answers)
        if not text:
            return told
        kept = self._path.with_name(self._path.name + BEFORE)
        try:
            had = self._path.exists()
            if had:
                whole_file.write(kept, whole_file.read(self._path))
            whole_file.write(self._path, text.encode())
        except OSError as error:
            return told | {"wrong": [["", f"{error.filename or self._path}: {reason_of(error)}"]]}
        return told | {
            "saved": str(self._path),
            "kept": str(kept) if had else "",
            "recording": self._records(),
        }

    def _drafted(self, answers: dict[str, str]) -> tuple[str, dict[str, Any]]:
        """The text, "" where something is refused."""
        buses = [] if self._listening is None else self._listening.buses
        text, judged = machine_text(answers, self._found, buses)
        wrong = [[one.field, one.text] for one in judged if one.refused]
        rare = [[one.field, one.text] for one in judged if not one.refused]
        return "" if wrong else text, {"wrong": wrong, "rare": rare, "text": text}

    def _records(self) -> bool:
        """Whether a recorder lives that does not say it rests."""
        status = self._view.last("status") or {}
        return self._heard.alive()[0] and not status.get("resting") and status.get("recording") is not False


def _found_here() -> list[Bus]:
    return parse_buses([
        f"socketcan:{name}" + (f",bitrate={bitrate}" if bitrate else "") for name, bitrate in interfaces()
    ])  # fmt: skip


def _receiver(device: BusDevice, mount: Mount | None) -> dict[str, Any]:
    often = max((m.per_s for m in device.messages), default=0.0)
    return {
        "who": who(device),
        "bus": device.bus,
        "source": device.source,
        "name": None if device.name is None else f"{device.name:016X}",
        "maker": device.manufacturer_name,
        "function": device.function_name,
        "per_s": round(often, 1),
        "corrected": device.manufacturer == DEERE,
        "mount": mount or "",
    }


def _wheel(candidate: WheelCandidate) -> dict[str, Any]:
    return {
        "which": which(candidate),
        "words": described(candidate),
        "likely": candidate.likely,
        "rudder": candidate.pgn == RUDDER,
        "lowest": candidate.lowest,
        "highest": candidate.highest,
    }


def _checked(draft: Path, folder: Path) -> dict[str, Any]:
    """By the command itself, in a process of its own: no driver of a bus can hang this one."""
    words = ("check", str(draft), "--json", "--seconds", f"{CHECK_S:g}", "--log", str(folder))
    try:
        done = subprocess.run(
            words_of("tilth.cli", *words),
            capture_output=True, text=True, check=False, timeout=LONGEST_CHECK_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"ok": False, "checks": [_problem(f"no answer within {LONGEST_CHECK_S:g} s")]}
    try:
        found: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        last = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
        return {"ok": False, "checks": [_problem(last[0].replace(str(draft), "machine.toml"))]}
    return {"ok": found["ok"], "checks": found["checks"]}


def _problem(text: str) -> dict[str, str]:
    return {"what": "tilth check", "state": "problem", "text": text}
