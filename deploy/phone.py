"""Lets a phone in: the label with code and network, `python -m tilth.deploy.phone [LABEL.toml] [--hotspot]`.

`tilth-setup phone` runs it. LABEL.toml, on a stick say, is read where it is there, and else written:

    code = "7K2M-9XQ4"          # for the page
    network = "Tilth-7K2M"      # of the computer's own network
    passphrase = "…"            # 8 to 63 characters
    hotspot = true              # whether it may open that network
    [join]                      # a network of others that it is to join
    network = "Farm"
    passphrase = "…"
"""

import argparse
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from tilth.deploy.install import HOTSPOT
from tilth.logger.log import whole_file
from tilth.monitor.entry_code import EntryCode, new_code

LABEL: Final = "etc/tilth/label.toml"
PROFILES: Final = Path(HOTSPOT).parent
JOINED: Final = "tilth-network"
CHANNEL: Final = "6"  # allowed in every country, 12 to 14 are not
PAGE: Final = "http://10.42.0.1:8117"  # the address that NetworkManager gives a network of its own


class NoLabel(Exception):
    """What is wrong with a label or its network, and what to do; one sentence."""


def label_of(path: Path | None) -> dict[str, Any]:
    """What is on the stick, or drawn. Raises NoLabel."""
    told: dict[str, Any] = {}
    if path is not None and path.exists():
        try:
            told = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError) as error:
            raise NoLabel(f"{path}: {error}") from None
    code = told.get("code", new_code())
    passphrase = told.get("passphrase", f"{new_code()}-{new_code()}")
    network = told.get("network", f"Tilth-{new_code()[:4]}")
    try:
        EntryCode(code if isinstance(code, str) else "")
    except ValueError as error:
        raise NoLabel(f"{path}: code: {error}, such as {new_code()}") from None
    label = {
        "code": code,
        "network": network,
        "passphrase": passphrase,
        "hotspot": told.get("hotspot", False),
    }
    if type(label["hotspot"]) is not bool:
        raise NoLabel(f"{path}: hotspot: true or false")
    _check_network(path, label)
    if (join := told.get("join")) is not None:
        if not isinstance(join, dict):
            raise NoLabel(f"{path}: [join] has network and passphrase")
        _check_network(path, join)
        label["join"] = join
    return label


def _check_network(path: Path | None, told: Mapping[str, Any]) -> None:
    """By WPA2 (IEEE 802.11: 8 to 63 printable characters, up to 32 bytes of name). Raises NoLabel."""
    network, passphrase = told.get("network"), told.get("passphrase")
    if not isinstance(network, str) or not 1 <= len(network.encode()) <= 32 or not network.isprintable():
        raise NoLabel(f"{path}: network: give a name of up to 32 bytes, such as Tilth-7K2M")
    good = isinstance(passphrase, str) and 8 <= len(passphrase) <= 63
    if not good or not str(passphrase).isascii() or not str(passphrase).isprintable():
        raise NoLabel(f"{path}: passphrase: give 8 to 63 letters, digits and signs")


def label_text(label: Mapping[str, Any]) -> str:
    """As TOML; the texts in it have been checked, and hold at most quotes and backslashes to be escaped."""

    def line(name: str, value: object) -> str:
        if isinstance(value, bool):
            return f"{name} = {str(value).lower()}\n"
        escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
        return f'{name} = "{escaped}"\n'

    text = "".join(line(name, value) for name, value in label.items() if name != "join")
    if join := label.get("join"):
        text += "[join]\n" + "".join(line(name, join[name]) for name in ("network", "passphrase"))
    return text


def profile_words(name: str, network: str, passphrase: str, *, own: bool) -> list[str]:
    """Of nmcli, to make the profile. own: of a network that this computer opens, by order only."""
    mode = ["wifi.mode", "infrastructure"]
    if own:
        # Else NetworkManager draws a channel by the network's name, and not all may be opened everywhere.
        mode = ["wifi.mode", "ap", "wifi.band", "bg", "wifi.channel", CHANNEL, "ipv4.method", "shared"]
    return [
        "nmcli", "--offline", "connection", "add", "type", "wifi", "con-name", name, "ifname", "*",
        "ssid", network, "autoconnect", "no" if own else "yes", *mode,
        "ipv6.method", "disabled" if own else "auto",
        "wifi-sec.key-mgmt", "wpa-psk", "wifi-sec.proto", "rsn", "wifi-sec.psk", passphrase,
    ]  # fmt: skip


def write_profile(root: Path, words: Sequence[str]) -> None:
    """For NetworkManager, whose own tool makes it. Raises NoLabel."""
    if shutil.which(words[0]) is None:
        raise NoLabel("there is no NetworkManager here: apt-get install network-manager")
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoLabel(f"NetworkManager does not take the network: {done.stderr.strip()}")
    name = words[words.index("con-name") + 1]
    _write(root / PROFILES / f"{name}.nmconnection", done.stdout)


def _write(path: Path, text: str) -> None:
    """For root alone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    whole_file.write(path, text.encode(), mode=0o600)


def main(words: Sequence[str] | None = None) -> int:
    """1 where nothing was changed; one line says why."""
    parser = argparse.ArgumentParser(prog="tilth-setup phone")
    parser.add_argument("label", nargs="?", type=Path)
    parser.add_argument("--hotspot", action="store_true")
    parser.add_argument("--root", type=Path, default=Path("/"))
    args = parser.parse_args(words)
    place = args.root / LABEL
    try:
        label = label_of(args.label or place)
        label["hotspot"] = label["hotspot"] or args.hotspot
        if label["hotspot"]:
            own = profile_words(Path(HOTSPOT).stem, label["network"], label["passphrase"], own=True)
            write_profile(args.root, own)
        else:
            (args.root / HOTSPOT).unlink(missing_ok=True)
        if join := label.get("join"):
            write_profile(args.root, profile_words(JOINED, join["network"], join["passphrase"], own=False))
        _write(place, label_text(label))
        if args.label is not None and not args.label.exists():
            args.label.write_text(label_text(label), encoding="utf-8")
    except NoLabel as error:
        print(f"tilth-setup: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"tilth-setup: {error.filename}: {(error.strerror or str(error)).lower()}", file=sys.stderr)
        return 1
    shown = {"page": f"port 8117, code {label['code']}"}
    if label["hotspot"]:
        shown |= {"network": label["network"], "passphrase": label["passphrase"], "open there": PAGE}
    print("for the label of this computer:\n")
    for what, told in shown.items():
        print(f"    {what:11} {told}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
