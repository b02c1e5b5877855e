"""Brings up a CAN interface with its bit rate: `python -m tilth.deploy.can_up can0 /etc/tilth/machine.toml`.

Where there is no machine file yet, but a label by which somebody may make one, it tries bit rates until it
hears a frame. It does so in listen-only mode: the controller sends nothing then, no acknowledgement either.

Only the standard library: it runs at each ignition, before anything else has been loaded.
"""

import json
import socket
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

RESTART_MS = 100  # after bus-off the controller takes part again, and the recorder has seen it
QUEUE = 1000  # frames
LABEL = "label.toml"  # beside the machine file
BITRATES = (250_000, 500_000, 125_000, 1_000_000)  # ISO 11783 and NMEA 2000 have the first
TRY_S = 1.5  # of each


def main(words: list[str]) -> int:
    """1 where it cannot be done, 2 for wrong use; one line says why."""
    if len(words) != 2:
        print("usage: can_up INTERFACE MACHINE.toml", file=sys.stderr)
        return 2
    interface, path = words[0], Path(words[1])
    try:
        if not path.exists() and path.with_name(LABEL).exists():
            found = search(interface, path)
            if found:
                print(f"{interface}: frames are heard at {found} bit/s; listen-only until there is {path}")
                return 0
        bitrate = bitrate_of(interface, tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except OSError as error:
        print(f"{path}: {(error.strerror or str(error)).lower()}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(
            f"{interface}: cannot listen only ({error.stderr.strip()}); no bit rate is tried", file=sys.stderr
        )
        return 1
    except ValueError as error:
        print(f"{path}: {error}", file=sys.stderr)
        return 1
    if bitrate is None:
        print(f"{interface} is no socketcan [[bus]] of {path}; left alone")
        return 0
    try:
        print(bring_up(interface, bitrate))
    except (OSError, subprocess.CalledProcessError) as error:
        reason = error.stderr.strip() if isinstance(error, subprocess.CalledProcessError) else str(error)
        print(f"{interface}: {reason}", file=sys.stderr)
        return 1
    return 0


def bitrate_of(interface: str, machine: dict[str, Any]) -> int | None:
    """Of the machine file's bus on that interface, None where there is none. Raises ValueError."""
    buses = machine.get("bus", [])
    for bus in buses if isinstance(buses, list) else []:
        if bus.get("interface") == "socketcan" and bus.get("channel") == interface:
            bitrate = bus.get("bitrate", 250_000)
            if isinstance(bitrate, int) and bitrate > 0:
                return bitrate
            raise ValueError(f"bus {interface}: bitrate = {bitrate!r}: give bits per second, such as 250000")
    return None


def search(interface: str, machine: Path) -> int:
    """The bit rate at which a frame is heard, at which it is up then; 0 as soon as there is a machine file.

    Raises CalledProcessError where the controller has no listen-only mode: then it stays down.
    """
    while True:
        for bitrate in BITRATES:
            if machine.exists():
                return 0
            _ip("link", "set", interface, "down")
            _ip("link", "set", interface, "type", "can", "bitrate", str(bitrate), "listen-only", "on")
            _ip("link", "set", interface, "up")
            if _hears(interface):
                return bitrate


def _hears(interface: str) -> bool:
    """A frame within TRY_S; such a socket is given no error frames."""
    end = time.monotonic() + TRY_S
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as listening:
        listening.bind((interface,))
        listening.settimeout(TRY_S)
        try:
            return bool(listening.recv(72))
        except OSError:  # none in time, or it was unplugged
            time.sleep(max(0.0, end - time.monotonic()))
            return False


def bring_up(interface: str, bitrate: int) -> str:
    """What was done; nothing where it is up already as it should be: a restart costs no frame.

    Raises CalledProcessError, OSError.
    """
    link = json.loads(_ip("-details", "-json", "link", "show", "dev", interface))[0]
    up = "UP" in link.get("flags", [])
    info = link.get("linkinfo", {})
    if info.get("info_kind") != "can":  # vcan, vxcan: no bit rate
        if not up:
            _ip("link", "set", interface, "up")
        return f"{interface} is up, a {info.get('info_kind', 'bus')} without a bit rate"
    data = info.get("info_data", {})
    only_listens = "LISTEN-ONLY" in data.get("ctrlmode", [])
    right = data.get("bittiming", {}).get("bitrate") == bitrate and not only_listens
    if up and right and data.get("restart_ms"):
        return f"{interface} is up already at {bitrate} bit/s"
    if up:
        _ip("link", "set", interface, "down")
    mode = ["listen-only", "off"] if only_listens else []
    _ip(
        "link", "set", interface, "type", "can", "bitrate", str(bitrate), "restart-ms", str(RESTART_MS), *mode
    )
    _ip("link", "set", interface, "txqueuelen", str(QUEUE), "up")
    return f"{interface} is up at {bitrate} bit/s, restarted {RESTART_MS} ms after bus-off"


def _ip(*words: str) -> str:
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
