"""Brings up a CAN interface with its bit rate: `python -m tilth.deploy.can_up can0 /etc/tilth/machine.toml`.

Only the standard library: it runs at each ignition, before anything else has been loaded.
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

RESTART_MS = 100  # after bus-off the controller takes part again, and the recorder has seen it
QUEUE = 1000  # frames


def main(words: list[str]) -> int:
    """1 where it cannot be done, 2 for wrong use; one line says why."""
    if len(words) != 2:
        print("usage: can_up INTERFACE MACHINE.toml", file=sys.stderr)
        return 2
    interface, path = words[0], Path(words[1])
    try:
        bitrate = bitrate_of(interface, tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except OSError as error:
        print(f"{path}: {(error.strerror or str(error)).lower()}", file=sys.stderr)
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
    if up and data.get("bittiming", {}).get("bitrate") == bitrate and data.get("restart_ms"):
        return f"{interface} is up already at {bitrate} bit/s"
    if up:
        _ip("link", "set", interface, "down")
    _ip("link", "set", interface, "type", "can", "bitrate", str(bitrate), "restart-ms", str(RESTART_MS))
    _ip("link", "set", interface, "txqueuelen", str(QUEUE), "up")
    return f"{interface} is up at {bitrate} bit/s, restarted {RESTART_MS} ms after bus-off"


def _ip(*words: str) -> str:
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=True).stdout


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
