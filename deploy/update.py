"""Updates with nobody present: `python -m tilth.deploy.update`, as root; its units are in system/.

A package (tilth_VERSION_ARCHITECTURE.deb) with its signature beside it (….deb.minisig) is found on a stick or
in a folder, checked, and prepared beside the release that records. It is applied when nothing is recorded, or
before the recorder starts; then it is on trial, and taken back where it does not record within a minute or
ends three times. The program is that of the release before until the new one is kept: /opt/tilth/keeper. What
has happened stands in /opt/tilth/updates.json, of which the recorder makes events.
"""

import argparse
import errno
import json
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from tilth.deploy import install
from tilth.deploy.install import Box, Failed, is_recording
from tilth.deploy.minisign import ForgedError, FormError, Keys, read_key, read_signature, verify
from tilth.logger.log import whole_file
from tilth.logger.update_news import STATE
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.sentences import notice_sentence

FOLDER: Final = "var/lib/tilth-updates"  # that rsync fills
KEYS: Final = "etc/tilth/update-keys"  # *.pub; `revoked`: ids, one a line
OWN_KEYS: Final = Path(__file__).with_name("update_keys")  # that this release was published with
INCOMING: Final = "opt/tilth/incoming"
TRIAL_S: Final = 60.0
ENDINGS: Final = 3
TIMES_ITS_SIZE: Final = 7  # the room that a package takes: its copy, what it holds, and that installed
RESERVE: Final = 300_000_000  # bytes that are left to the recorder
MOST_NEWS: Final = 20


class NotTaken(Exception):
    """A package that is not used, and why."""

    def __init__(self, why: Notice) -> None:
        super().__init__(notice_sentence(why))
        self.notice = why


@dataclass(slots=True)
class Updates:
    """What is known from one look to the next: opt/tilth/updates.json."""

    news: list[dict[str, Any]] = field(default_factory=list)
    newest: str = ""  # version that was ever prepared
    seen: list[Any] = field(default_factory=list)  # files that were looked at
    coming: list[Any] = field(default_factory=list)  # files that were there at the last look

    @classmethod
    def of(cls, box: Box) -> "Updates":
        """As kept; anew where it cannot be read."""
        try:
            return cls(**json.loads(whole_file.read(box.at("opt/tilth") / STATE)))
        except (OSError, ValueError, TypeError):
            return cls()

    def keep(self, box: Box) -> None:
        whole_file.write(box.at("opt/tilth") / STATE, json.dumps(asdict(self), indent=1).encode())

    def tell(self, told: Notice) -> None:
        text = notice_sentence(told)
        print(text, flush=True)
        entry = {"id": uuid.uuid4().hex, "code": told.code, "values": dict(told.values), "text": text}
        self.news = [*self.news, entry][-MOST_NEWS:]


def look(box: Box, updates: Updates, folder: Path, *, at_once: bool) -> None:
    """Prepare the package in a folder, or tell why not, once. at_once: else only what has not changed since
    the last look: it may be being copied."""
    packages = [
        path for path in sorted(folder.glob("tilth_*.deb")) if path.is_file() and not path.is_symlink()
    ]
    files = [path for package in packages for path in (package, _signature_of(package)) if path.exists()]
    there = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    if not packages or (not at_once and there == updates.seen):
        return
    if not at_once and there != updates.coming:
        updates.coming = there
        updates.keep(box)
        return
    try:
        take(box, updates, packages)
    except NotTaken as one:
        updates.tell(one.notice)
    finally:
        shutil.rmtree(box.at(INCOMING), ignore_errors=True)
    updates.seen = there
    updates.keep(box)


def take(box: Box, updates: Updates, packages: Sequence[Path]) -> None:
    """Check and prepare one; one that is here already is left alone. Raises NotTaken."""
    here = _said("dpkg", "--print-architecture")
    fitting = [path for path in packages if path.stem.endswith(f"_{here}")]
    if not fitting:
        raise NotTaken(notice(NoticeCode.UPDATE_OTHER_PROCESSOR, file=packages[0].name, here=here))
    if len(fitting) > 1:
        names = ", ".join(path.name for path in fitting)
        raise NotTaken(notice(NoticeCode.UPDATE_SEVERAL, files=names))
    (package,) = fitting
    checked = copied(box, package)
    architecture, version = (
        _said("dpkg-deb", "--field", str(checked), key) for key in ("Architecture", "Version")
    )
    if architecture != here:
        raise NotTaken(notice(NoticeCode.UPDATE_OTHER_PROCESSOR, file=package.name, here=here))
    version = version.partition("-")[0]
    newest = newest_of(box, updates)
    if version == newest:
        return
    if not is_newer(version, newest):
        raise NotTaken(notice(NoticeCode.UPDATE_OLDER, file=package.name, newest=newest))
    tree = checked.with_name("tree")
    try:
        subprocess.run(["dpkg-deb", "--extract", checked, tree], check=True)
        checked.unlink()
        install.prepare(box, tree / "usr/lib/tilth/wheels")
    except (OSError, Failed, subprocess.CalledProcessError) as error:
        raise NotTaken(notice(NoticeCode.UPDATE_REFUSED, file=package.name, why=str(error))) from None
    updates.newest = version
    updates.tell(notice(NoticeCode.UPDATE_READY, file=package.name, version=version))


def copied(box: Box, package: Path) -> Path:
    """A copy on this computer's disk that one of its keys has signed. Raises NotTaken."""
    name, signed = package.name, _signature_of(package)
    trusted, revoked = keys(box)
    try:
        signature = read_signature(signed.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise NotTaken(notice(NoticeCode.UPDATE_UNSIGNED, file=name, signature=signed.name)) from None
    if signature.key in revoked:
        raise NotTaken(notice(NoticeCode.UPDATE_REVOKED_KEY, file=name, key=signature.key))
    if signature.key not in trusted:
        told = notice(NoticeCode.UPDATE_UNKNOWN_KEY, file=name, key=signature.key, folder=str(box.at(KEYS)))
        raise NotTaken(told)
    incoming = box.at(INCOMING)
    shutil.rmtree(incoming, ignore_errors=True)
    incoming.mkdir(mode=0o700)
    try:
        needed = package.stat().st_size * TIMES_ITS_SIZE + RESERVE
        free = shutil.disk_usage(incoming).free
        if needed > free:
            told = notice(NoticeCode.UPDATE_NO_ROOM, file=name, needed_mb=needed / 1e6, free_mb=free / 1e6)
            raise NotTaken(told)
        copy = Path(shutil.copyfile(package, incoming / "package.deb"))
        verify(copy, signature, trusted[signature.key])
    except ForgedError:
        raise NotTaken(notice(NoticeCode.UPDATE_FORGED, file=name, key=signature.key)) from None
    except OSError as error:
        if error.errno == errno.ENOSPC:
            told = notice(NoticeCode.UPDATE_NO_ROOM, file=name, needed_mb=needed / 1e6, free_mb=0.0)
            raise NotTaken(told) from None
        why = (error.strerror or str(error)).lower()
        raise NotTaken(notice(NoticeCode.UPDATE_UNREADABLE, file=name, why=why)) from None
    return copy


def keys(box: Box) -> tuple[Keys, set[str]]:
    """Those that may sign, and ids of those that may no longer: the computer's own, and this release's."""
    trusted, revoked = {}, set[str]()
    for folder in (box.at(KEYS), OWN_KEYS):
        for path in sorted(folder.glob("*.pub")):
            try:
                name, key = read_key(path.read_text(encoding="utf-8"))
            except (OSError, FormError, UnicodeDecodeError) as error:
                print(f"{path} is no public key of minisign's and is left out: {error}", file=sys.stderr)
                continue
            trusted[name] = key
        if (folder / "revoked").exists():
            lines = (folder / "revoked").read_text(encoding="utf-8").splitlines()
            revoked |= {line.partition("#")[0].strip().upper() for line in lines}
    return trusted, revoked - {""}


def newest_of(box: Box, updates: Updates) -> str:
    """The newest version that this computer has had: what was taken or rolled back is not tried again."""
    current = box.release("current")
    version = "0" if current is None else install.version_of(current)
    return updates.newest if is_newer(updates.newest, version) else version


def is_newer(version: str, other: str) -> bool:
    """By Debian's order."""
    return subprocess.run(["dpkg", "--compare-versions", version, "gt", other], check=False).returncode == 0


def apply(box: Box, updates: Updates, *, start: bool = True) -> None:
    """Let what is prepared run, on trial."""
    release = box.release("next")
    if release is None:
        return
    try:
        install.apply(box, start=start)
    except Failed as error:  # the machine file is another one than when it was prepared
        box.point("next", None)
        told = notice(NoticeCode.UPDATE_REFUSED, file=install.version_of(release), why=str(error))
        updates.tell(told)
        updates.keep(box)


def on_trial(box: Box) -> bool:
    return box.release("keeper") not in (None, box.release("current"))


def watch(box: Box, updates: Updates) -> None:
    """Keep the release on trial where it records and does not end; else take it back."""
    _, before = service(box)
    deadline, recorded, endings = time.monotonic() + TRIAL_S, False, before
    while endings < ENDINGS:
        recorded = recorded or is_recording(box)
        if time.monotonic() >= deadline:
            if not recorded:
                return _take_back(box, updates, NoticeCode.UPDATE_NOT_RECORDING)
            if endings == before:
                return _kept(box, updates)
            deadline, recorded, before = time.monotonic() + TRIAL_S, False, endings
        time.sleep(0.5)
        _, endings = service(box)
    return _take_back(box, updates, NoticeCode.UPDATE_CRASHED)


def service(box: Box) -> tuple[str, int]:
    """How the recorder is, in systemd's words, and how often it had to be started again; ENDINGS where
    systemd has given up."""
    if not box.real:
        return "active", 0
    asked = ["systemctl", "show", install.SERVICE, "--property=ActiveState,NRestarts"]
    told = dict(line.split("=", 1) for line in _said(*asked).splitlines())
    return told["ActiveState"], ENDINGS if told["ActiveState"] == "failed" else int(told["NRestarts"])


def _versions(box: Box) -> tuple[str, str]:
    """Of the release on trial, and of the one before."""
    current, keeper = box.release("current"), box.release("keeper")
    assert current is not None and keeper is not None
    return install.version_of(current), install.version_of(keeper)


def _kept(box: Box, updates: Updates) -> None:
    version, before = _versions(box)
    updates.tell(notice(NoticeCode.UPDATED, before=before, version=version))
    updates.keep(box)
    box.point("keeper", box.release("current"))


def _take_back(box: Box, updates: Updates, why: NoticeCode) -> None:
    version, before = _versions(box)
    if why is NoticeCode.UPDATE_CRASHED:
        told = notice(NoticeCode.UPDATE_CRASHED, before=before, version=version, times=float(ENDINGS))
    else:
        told = notice(NoticeCode.UPDATE_NOT_RECORDING, before=before, version=version, within_s=TRIAL_S)
    updates.tell(told)
    updates.keep(box)  # first: the one before tells it when it starts
    install.take_back(box)


def _signature_of(package: Path) -> Path:
    return package.with_name(f"{package.name}.minisig")


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def main(words: Sequence[str] | None = None) -> int:
    """0, 1 where the installer is at work already or cannot do it: another look comes in a minute."""
    parser = argparse.ArgumentParser(prog="python -m tilth.deploy.update", description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help=f"with a package; /{FOLDER} if not said")
    parser.add_argument("--root", type=Path, default=Path("/"), help="a folder instead of this computer")
    parser.add_argument("--stick", type=Path, metavar="DEVICE", help="look there and prepare, at once")
    parser.add_argument("--boot", action="store_true", help="the recorder has not started yet: apply")
    args = parser.parse_args(words)
    box = Box(args.root.absolute())
    try:
        with ExitStack() as stack:
            stack.enter_context(install.alone(box, wait=args.stick is not None))
            updates = Updates.of(box)
            if args.boot:
                apply(box, updates, start=False)
                return 0
            install.remove_unused(box)  # what a power cut has left
            if on_trial(box):
                watch(box, updates)
            if args.stick is not None:
                look(box, updates, _mounted(args.stick, stack), at_once=True)
                return 0
            look(box, updates, args.folder or box.at(FOLDER), at_once=args.folder is not None)
            if box.release("next") is not None and not is_recording(box) and service(box)[0] != "inactive":
                apply(box, updates)
                if on_trial(box):
                    watch(box, updates)
    except (Failed, OSError, subprocess.CalledProcessError) as error:
        print(f"update: {error}", file=sys.stderr)
        return 1
    return 0


def _mounted(device: Path, stack: ExitStack) -> Path:
    """Read-only; seen by this unit alone, and gone with it (PrivateMounts=)."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    options = "ro,nosuid,nodev,noexec"
    subprocess.run(["mount", "--options", options, device, folder], check=True)
    stack.callback(lambda: subprocess.run(["umount", "--lazy", folder], check=False))
    return folder


if __name__ == "__main__":
    sys.exit(main())
