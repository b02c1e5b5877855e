#!/usr/bin/python3
"""Puts Tilth on a Debian computer, whole or not at all: install, upgrade, roll back, uninstall.

    sudo python3 install.py install tilth-0.1.0-py3-none-linux_x86_64.whl --machine machine.toml

Only the standard library of Python 3.11. Each release has an environment of its own, /opt/tilth/releases/<n>;
/opt/tilth/current says which runs, /opt/tilth/previous where `rollback` goes. Logs, keys and machine file are
never touched by any of them. /opt/tilth/next is what update.py has prepared, /opt/tilth/keeper whose program
looks after updates: the release before, while the current one is on trial. See README.md beside this file.
"""

import argparse
import contextlib
import fcntl
import os
import platform
import pwd
import shutil
import stat
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

SERVICE = "tilth.service"
TIMER = "tilth-update.timer"
# File of deploy/system in the release → its place on the computer.
PLACES = (
    ("tilth.service", "etc/systemd/system/tilth.service"),
    ("tilth-can@.service", "etc/systemd/system/tilth-can@.service"),
    ("tilth-page.service", "etc/systemd/system/tilth-page.service"),
    ("tilth-take.path", "etc/systemd/system/tilth-take.path"),
    ("tilth-take.service", "etc/systemd/system/tilth-take.service"),
    ("tilth-hotspot.service", "etc/systemd/system/tilth-hotspot.service"),
    ("80-tilth-can.rules", "etc/udev/rules.d/80-tilth-can.rules"),
    ("tilth-update.service", "etc/systemd/system/tilth-update.service"),
    ("tilth-update.timer", "etc/systemd/system/tilth-update.timer"),
    ("tilth-update-boot.service", "etc/systemd/system/tilth-update-boot.service"),
    ("tilth-update@.service", "etc/systemd/system/tilth-update@.service"),
    ("81-tilth-update.rules", "etc/udev/rules.d/81-tilth-update.rules"),
    ("tilth.sysusers", "etc/sysusers.d/tilth.conf"),
    ("tilth.sysctl", "etc/sysctl.d/60-tilth.conf"),
    ("tilth.timesyncd", "etc/systemd/timesyncd.conf.d/tilth.conf"),
)
SETUP = "usr/local/sbin/tilth-setup"  # this program, for later
COMMAND = "usr/local/bin/tilth"
KEYS = "daemon.json"
KERNELS = "var/cache/tilth"  # what numba has compiled; NUMBA_CACHE_DIR and CacheDirectory of the unit
MACHINE = "etc/tilth/machine.toml"
SCALE_DBC, IMPLEMENT_FILES = "implement.load.weighing.dbc", "implements.files"  # keys of a machine file
NEXT = "`tilth discover` drafts a machine file, `sudo tilth-setup machine FILE` takes it"
WHEELS = Path(__file__).resolve().with_name("wheels")  # what the Debian package brings
PYTHON = Path(sys.base_prefix, "bin", f"python3.{sys.version_info.minor}")  # has pip; a release has none
FOR_PHONES = ("tilth-page.service", "tilth-take.path", "tilth-take.service", "tilth-hotspot.service")
HOTSPOT = "etc/NetworkManager/system-connections/tilth-hotspot.nmconnection"  # that `phone` has made
LOGS = "var/lib/tilth/logs"
LARGEST = 1 << 20  # bytes of a machine file that was saved on the page
RECORDING = 75  # exit status: try again later
NOT_REMOVED = ("etc/tilth", "var/lib/tilth")  # what `uninstall` leaves


class Failed(Exception):
    """What is wrong and what to do, in one sentence. Nothing has changed."""


class RunGoesOn(Failed):
    """A run is being recorded."""


class Box:
    """A computer, or a folder that stands for one: there, nothing is started and no user is made."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.real = root == Path("/")

    def at(self, place: str) -> Path:
        return self.root / place

    @property
    def releases(self) -> Path:
        return self.at("opt/tilth/releases")

    def release(self, link: str) -> Path | None:
        """Where opt/tilth/current or previous points, None where it is not there."""
        path = self.at(f"opt/tilth/{link}")
        target = self.releases / path.readlink().name if path.is_symlink() else None
        return target if target is not None and target.is_dir() else None

    def point(self, link: str, release: Path | None) -> None:
        """At once: a power cut leaves the old or the new. None: nowhere."""
        if release is None:
            self.at(f"opt/tilth/{link}").unlink(missing_ok=True)
            return
        new_link = self.at(f"opt/tilth/.{link}")
        new_link.unlink(missing_ok=True)
        new_link.symlink_to(Path("releases") / release.name)
        new_link.replace(self.at(f"opt/tilth/{link}"))

    def run(self, *words: str, fail: bool = True) -> bool:
        """Something that only a real computer has."""
        if not self.real:
            return True
        if shutil.which(words[0]) is None:  # a container has no systemd
            if fail:
                raise Failed(f"there is no {words[0]} here; this takes a computer with systemd")
            return False
        done = subprocess.run(words, check=False)
        if fail and done.returncode:
            raise Failed(f"{' '.join(words)}: exit status {done.returncode}")
        return done.returncode == 0


@contextlib.contextmanager
def alone(box: Box, *, wait: bool = False) -> Iterator[None]:
    """While no other installer or updater works. Raises Failed where one does, unless told to wait."""
    folder = box.at("opt/tilth")
    if not folder.is_dir():  # nothing is installed
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        yield
    except BlockingIOError:
        raise Failed("another installation or update is under way; try again in a minute") from None
    finally:
        os.close(descriptor)


def install(box: Box, args: argparse.Namespace) -> None:
    """Install a release from a wheel, and start the service where there is a machine file. Raises Failed."""
    machine = box.at(MACHINE)
    beside = [] if args.machine is None else _files_beside(args.machine)
    release = _new_release(box, args.source, args.wheels)
    told = args.machine or (machine if machine.exists() else None)
    try:
        if told is not None:
            _check_machine(release, told)
    except Failed:
        shutil.rmtree(release)
        raise
    if told is None:
        _activate(box, release)
        print(f"tilth {version_of(release)} is installed. The recorder starts once it knows the rig: {NEXT}")
        return
    _take(box, args, beside)
    _switch(box, release)


def machine(box: Box, args: argparse.Namespace) -> None:
    """Let what is installed record this rig. Raises Failed."""
    release = box.release("current")
    if release is None:
        raise Failed("nothing is installed yet; say install, with --machine")
    beside = _files_beside(args.machine)
    _check_machine(release, args.machine)
    place = box.at(MACHINE)
    before = place.with_name(f".{place.name}.before")
    if place.exists():
        _put(place, before)
    _take(box, args, beside)
    try:
        _switch(box, release)
    except Failed:
        if before.exists():
            before.replace(place)
            _start(box)
        raise
    before.unlink(missing_ok=True)


def phone(box: Box, args: argparse.Namespace) -> None:
    """Let a phone in that has the code. Raises Failed."""
    release = box.release("current")
    if release is None:
        raise Failed("nothing is installed yet; say install")
    words = [] if args.label is None else [str(args.label)]
    words += ["--root", str(box.root), *(["--hotspot"] if args.hotspot else [])]
    if subprocess.run(
        [str(release / "bin/python"), "-P", "-m", "tilth.deploy.phone", *words], check=False
    ).returncode:
        raise Failed("no phone is let in, see above")
    box.run("systemctl", "daemon-reload")
    box.run("nmcli", "connection", "reload", fail=False)
    box.run("systemctl", "enable", "--quiet", *FOR_PHONES)
    box.run("udevadm", "trigger", "--action=add", "--subsystem-match=net", fail=False)
    box.run("systemctl", "restart", "tilth-page.service", "tilth-take.path")
    box.run("systemctl", "start", "--no-block", "tilth-hotspot.service", fail=False)


def take(box: Box, args: argparse.Namespace) -> None:
    """Let the recorder use a machine file that the page has saved, once it records no run. Raises Failed.

    Who serves the page may have put anything there: it is read once, and checked as the recorder's user.
    """
    release, place = box.release("current"), box.at(MACHINE)
    if release is None:
        raise Failed("nothing is installed yet; say install")
    content = _plain(args.machine)
    if place.exists() and place.read_bytes() == content:
        print("it is in use already")
        return
    if is_recording(box):
        raise RunGoesOn("a run is being recorded; the machine file is taken when that has ended")
    box.run("systemd-sysusers", "/etc/sysusers.d/tilth.conf")
    with tempfile.TemporaryDirectory(prefix="tilth-take-") as folder:
        copy = Path(folder) / Path(MACHINE).name
        copy.write_bytes(content)
        for path, mode in ((Path(folder), 0o755), (copy, 0o644)):
            path.chmod(mode)
        _check_machine(release, copy, **_as_recorder(box))
        if place.exists():
            _put(place, place.with_name(f"{place.name}.before"))
        args.machine, args.keys = copy, None
        machine(box, args)


def _plain(path: Path) -> bytes:
    """Of a plain file, through no link. Raises Failed."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise Failed(f"{path}: {(error.strerror or str(error)).lower()}") from None
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_size > LARGEST:
            raise Failed(f"{path}: is no machine file")
        return stream.read(LARGEST)


def is_recording(box: Box) -> bool:
    """Whether a log is being written: the recorder locks it, from its start, or the first frame, to ignition
    off."""
    for path in box.at(LOGS).glob("*.mcap"):
        with path.open("rb") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
    return False


def _take(box: Box, args: argparse.Namespace, beside: Sequence[Path]) -> None:
    """Put the machine file, what goes with it, and keys in their places."""
    machine = box.at(MACHINE)
    if args.machine is not None:
        for file in beside:
            _put(file, machine.with_name(file.name))
        _put(args.machine, machine)
    if args.keys is not None:
        _put(args.keys, machine.with_name(KEYS), 0o640)
        if tomllib.loads(machine.read_text(encoding="utf-8-sig")).get("zenoh", {}).get("config") != KEYS:
            print(f'the keys are not used until {machine} says: [zenoh] config = "{KEYS}"')


def _files_beside(
    machine: Path, keys: Sequence[str] = ("wheel_angle.dbc", SCALE_DBC, IMPLEMENT_FILES)
) -> list[Path]:
    """What a machine file names and goes with it: DBC files, and files of implements with theirs. Not what
    it names by an absolute path, which stays where it is. Raises Failed: what root copies is told by a file
    that may be anybody's."""
    try:
        plain = tomllib.loads(machine.read_text(encoding="utf-8-sig"))
    except ValueError as error:
        raise Failed(f"{machine}: {error}") from None
    named: list[tuple[str, object]] = []
    for key in keys:
        told: object = plain
        for part in key.split("."):
            told = told.get(part) if isinstance(told, dict) else None
        named += [(key, name) for name in (told if isinstance(told, list) else [told])]
    files = []
    for key, name in named:
        if not isinstance(name, str) or Path(name).is_absolute():
            continue  # the service's user reads it there, if that user may
        taken = ("", Path(MACHINE).name, KEYS)
        if name != Path(name).name or name.startswith(".") or "\0" in name or name in taken:
            raise Failed(f"{machine}: {key} = {name!r}: give the name of a file beside the machine file")
        file = machine.parent / name
        if file.is_symlink() or not file.is_file():
            raise Failed(f"{file}: is no plain file; put the file itself beside the machine file")
        files += [file, *(_files_beside(file, [SCALE_DBC]) if key == IMPLEMENT_FILES else [])]
    return files


def upgrade(box: Box, args: argparse.Namespace) -> None:
    """Install the next release; the one before stays for a rollback. Raises Failed."""
    if box.release("current") is None:
        raise Failed("nothing is installed yet; say install, with --machine")
    args.machine = args.keys = None
    install(box, args)


def rollback(box: Box, args: argparse.Namespace) -> None:
    """Make the previous release the current one. Raises Failed."""
    previous = box.release("previous")
    if previous is None:
        raise Failed("there is no earlier release to go back to")
    _check_machine(previous, box.at(MACHINE))
    _switch(box, previous)


def prepare(box: Box, source: Path) -> Path:
    """Make the release of a folder of wheels ready, opt/tilth/next; another records. Raises Failed."""
    release = _new_release(box, source, None)
    try:
        if box.at(MACHINE).exists():
            _check_machine(release, box.at(MACHINE))
            _compile(box, release)
    except BaseException:
        shutil.rmtree(release)
        raise
    os.sync()
    box.point("next", release)
    remove_unused(box)  # one that was prepared before
    return release


def apply(box: Box, *, start: bool = True) -> None:
    """Let what was prepared run, on trial: the release before looks after it. A power cut in the middle
    leaves opt/tilth/next, and this is done again. start: else the recorder begins by itself.
    Raises Failed."""
    release, before = box.release("next"), box.release("current")
    if release is None or before is None:
        raise Failed("nothing is prepared")
    records = box.at(MACHINE).exists()
    if release != before:
        if records:  # the file may be another one by now
            _check_machine(release, box.at(MACHINE))
        box.point("previous", before)
        _activate(box, release, keeper=before if records else None)
    box.point("next", None)
    if start and records:
        _start(box)
    else:
        box.run("systemctl", "daemon-reload")


def take_back(box: Box) -> None:
    """Let the release before run again, and remove the one on trial. Raises Failed."""
    release, before = box.release("current"), box.release("keeper")
    if before is None or release is None or before == release:
        raise Failed("nothing is on trial")
    _activate(box, before)
    box.point("previous", None)
    _start(box)
    remove_unused(box)


def uninstall(box: Box, args: argparse.Namespace) -> None:
    """Remove all but configuration and logs."""
    for unit in (TIMER, "tilth-update-boot.service", *FOR_PHONES, SERVICE):
        box.run("systemctl", "disable", "--now", unit, fail=False)
    for _, place in PLACES:
        box.at(place).unlink(missing_ok=True)
    for place in (SETUP, COMMAND, HOTSPOT):
        box.at(place).unlink(missing_ok=True)
    for place in ("opt/tilth", KERNELS):
        shutil.rmtree(box.at(place), ignore_errors=True)
    box.run("nmcli", "connection", "reload", fail=False)
    box.run("systemctl", "daemon-reload", fail=False)
    box.run("udevadm", "control", "--reload", fail=False)
    print(f"removed; kept: {', '.join(str(box.at(place)) for place in NOT_REMOVED)}")


def status(box: Box, args: argparse.Namespace) -> None:
    for link in ("current", "previous"):
        release = box.release(link)
        print(f"{link:9} {'none' if release is None else f'{release.name}: tilth {version_of(release)}'}")
    box.run("systemctl", "--no-pager", "status", SERVICE, fail=False)


def adapter(box: Box, args: argparse.Namespace) -> None:
    """A name that a USB adapter keeps, whatever the order in which they are found."""
    if not args.name.replace("_", "").isalnum() or len(args.name) > 15:
        raise Failed(f'"{args.name}": give up to 15 letters, digits and underscores, such as can_tractor')
    if args.name.removeprefix("can").isdigit():
        raise Failed(f'"{args.name}": the kernel gives such names itself; give one such as can_tractor')
    device = Path("/sys/class/net") / args.interface
    if not device.exists():
        raise Failed(f"{args.interface}: no such interface; plug it in and see `ip link`")
    properties_text = subprocess.run(
        ["udevadm", "info", "--query=property", f"--path={device}"],
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    properties = dict(line.split("=", 1) for line in properties_text.splitlines() if "=" in line)
    port = (device / "dev_port").read_text().strip()
    path = box.at(f"etc/udev/rules.d/76-tilth-{args.name}.rules")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(adapter_rule(properties, port, args.name))
    box.run("udevadm", "control", "--reload")
    print(f"wrote {path}; plug the adapter in anew, it is {args.name} from then on")


def adapter_rule(properties: dict[str, str], port: str, name: str) -> str:
    """By its serial number where it has one, else by the socket it is plugged into. Raises Failed."""
    for key in ("ID_SERIAL_SHORT", "ID_PATH"):
        if value := properties.get(key):
            return (
                f"# The adapter that `tilth-setup adapter` was told of. {key}: {value}\n"
                f'ACTION=="add", SUBSYSTEM=="net", ENV{{{key}}}=="{value}", ATTR{{dev_port}}=="{port}", '
                f'NAME="{name}"\n'
            )
    raise Failed("udev knows neither serial number nor path of this interface; it keeps its own name")


def _new_release(box: Box, source: Path, wheels: Path | None) -> Path:
    """An environment with the software of a wheel, a folder of wheels or a checkout. Raises Failed."""
    wheel, offline = _wheel_of(source, wheels)
    remove_unused(box)
    used = [int(path.name) for path in box.releases.glob("*") if path.name.isdigit()]
    release = box.releases / str(max(used, default=0) + 1)
    release.mkdir(parents=True)
    pip = [
        str(PYTHON),
        "-m",
        "pip",
        "--python",
        str(release / "bin/python"),
        "--disable-pip-version-check",
    ]
    try:
        _do([str(PYTHON), "-m", "venv", "--without-pip", str(release)], "apt-get install python3")
        constraints = _constraints(wheel, release / "constraints.txt")
        flags = [] if offline is None else ["--no-index", "--find-links", str(offline)]
        pip += ["install", "--quiet", "--constraint", str(constraints), *flags, str(wheel)]
        _do(pip, "see above; it takes python3-pip, and a network or --wheels FOLDER")
    except BaseException:
        shutil.rmtree(release)
        raise
    os.sync()  # before anything points there
    return release


def remove_unused(box: Box) -> None:
    """Releases that nothing points to: of before, or left by a power cut."""
    used = [box.release(link) for link in ("current", "previous", "next", "keeper")]
    for path in box.releases.glob("*"):
        if path not in used:
            shutil.rmtree(path)


def _wheel_of(source: Path, wheels: Path | None) -> tuple[Path, Path | None]:
    """What pip installs, and the folder with all else where there is no network."""
    if source.is_file() and source.suffix == ".whl":
        return _for_here(source), wheels
    if (source / "pyproject.toml").is_file():
        return source.resolve(), wheels
    found = sorted(source.glob("tilth-*.whl")) if source.is_dir() else []
    if len(found) != 1:
        raise Failed(
            f"{source}: give a wheel of Tilth, a folder with exactly one and what it needs, or a checkout"
        )
    return _for_here(found[0]), source


def _for_here(wheel: Path) -> Path:
    """The wheel. Raises Failed where it is for another kind of processor."""
    processor = wheel.stem.rpartition("-linux_")[2]
    if processor not in (wheel.stem, platform.machine()):
        raise Failed(
            f"{wheel.name} is for {processor} and this computer is {platform.machine()}; "
            f"take the release's wheel or package for {platform.machine()}"
        )
    return wheel


def _constraints(wheel: Path, path: Path) -> Path:
    """The versions that were tested together, out of the wheel or the checkout."""
    if wheel.is_dir():
        path.write_bytes((wheel / "deploy/constraints.txt").read_bytes())
        return path
    try:
        with zipfile.ZipFile(wheel) as content:
            path.write_bytes(content.read("tilth/deploy/constraints.txt"))
    except (zipfile.BadZipFile, KeyError):
        raise Failed(f"{wheel}: no wheel of Tilth, or a damaged one; copy it anew") from None
    return path


_READ = """
import sys
try:
    from tilth.logger.machine_file import read_rigs
except ImportError:  # a release of before: of one implement
    from tilth.logger.machine_file import read_machine as read_rigs
from tilth.schemas.machine import MachineError
try:
    read_rigs(sys.argv[1])
except MachineError as error:
    sys.exit(str(error))
"""


def _check_machine(release: Path, machine: Path, **user: Any) -> None:
    """Whether this release understands the machine file. user: of subprocess.run. Raises Failed."""
    done = subprocess.run(
        [str(release / "bin/python"), "-P", "-c", _READ, str(machine)],
        capture_output=True,
        text=True,
        check=False,
        **user,
    )
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
        raise Failed(f"tilth {version_of(release)} does not take the machine file: {last[0]}")


def _switch(box: Box, release: Path) -> None:
    """Let this release run; where it does not, the one before goes on. Raises Failed.

    Until it has started it is on trial: after a power cut update.py looks after it.
    """
    before, older = box.release("current"), box.release("previous")
    _activate(box, release, keeper=before)
    if before is not None and before != release:
        box.point("previous", before)
    if not _start(box):
        if before in (None, release):
            raise Failed(f"it does not start; see journalctl -u {SERVICE}. Nothing was removed")
        _activate(box, before)
        box.point("previous", older or before)
        _start(box)
        raise Failed(f"{release.name} does not start, {before.name} runs again; see journalctl -u {SERVICE}")
    box.point("keeper", release)
    remove_unused(box)
    print(f"tilth {version_of(release)} (release {release.name}) is current")


def _activate(box: Box, release: Path, keeper: Path | None = None) -> None:
    """keeper: whose program looks after updates, where it is another one."""
    box.point("keeper", keeper or release)
    system = next(release.glob("lib/python3*/site-packages/tilth/deploy"))
    for name, place in PLACES:
        if (system / "system" / name).exists():  # a release of before has less
            _put(system / "system" / name, box.at(place))
    _put(system / "install.py", box.at(SETUP), 0o755)
    command, target = box.at(COMMAND), Path("/opt/tilth/current/bin/tilth")
    command.parent.mkdir(parents=True, exist_ok=True)
    if not command.is_symlink() or command.readlink() != target:  # a power cut finds it there
        command.unlink(missing_ok=True)
        command.symlink_to(target)
    box.point("current", release)
    os.sync()  # before the recorder of the release before is stopped


def _start(box: Box) -> bool:
    """Have systemd run what is current; it is up when the recorder itself says so."""
    box.run("systemd-sysusers", "/etc/sysusers.d/tilth.conf")
    keys = box.at("etc/tilth") / KEYS
    if box.real and keys.exists():
        shutil.chown(keys, "root", pwd.getpwnam("tilth").pw_gid)
    box.run("sysctl", "--quiet", "--load", "/etc/sysctl.d/60-tilth.conf", fail=False)
    box.run("systemctl", "daemon-reload")
    box.run("udevadm", "control", "--reload", fail=False)
    box.run("udevadm", "trigger", "--action=add", "--subsystem-match=net", fail=False)
    box.run("systemctl", "restart", "tilth-can@*.service", fail=False)  # a bit rate may be another one
    box.run("systemctl", "enable", "--quiet", SERVICE, "tilth-update-boot.service")
    box.run("systemctl", "enable", "--quiet", "--now", TIMER)
    _compile(box, box.release("current"))
    # systemd counts on where a release that ended again and again is stopped between two starts.
    box.run("systemctl", "reset-failed", SERVICE, fail=False)
    return box.run("systemctl", "restart", SERVICE, fail=False)


def _compile(box: Box, release: Path | None) -> None:
    """What a release calls, as the recorder's user, while the release before it still records.

    Nothing fails with it: the recorder compiles what it does not find, and estimates later.
    """
    kernels = box.at(KERNELS)
    assert release is not None
    kernels.mkdir(parents=True, exist_ok=True)
    user = _as_recorder(box)
    if box.real:
        shutil.chown(kernels, "tilth", "tilth")
    done = subprocess.run(
        [str(release / "bin/python"), "-P", "-m", "tilth.logger.compiling", str(box.at(MACHINE))],
        check=False,
        cwd="/",
        env={**os.environ, "NUMBA_CACHE_DIR": str(kernels), "HOME": str(kernels)},
        **user,
    )
    if done.returncode:
        print("compiling in advance failed, see above; the first estimates will come later")


def _as_recorder(box: Box) -> dict[str, Any]:
    """For subprocess.run: its user, where there is one."""
    return {"user": "tilth", "group": "tilth", "extra_groups": []} if box.real else {}


def _put(source: Path, target: Path, mode: int = 0o644) -> None:
    """Whole or not at all, and on the disk."""
    target.parent.mkdir(parents=True, exist_ok=True)
    new_file = target.with_name(f".{target.name}.new")
    new_file.unlink(missing_ok=True)
    content = source.read_bytes()
    with os.fdopen(os.open(new_file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as stream:
        stream.write(content)
        os.fsync(stream.fileno())
    new_file.chmod(mode)
    new_file.replace(target)


def _do(words: Sequence[str], remedy: str) -> None:
    done = subprocess.run(words, check=False, stderr=subprocess.PIPE, text=True)
    sys.stderr.write(done.stderr)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
        raise Failed(f"{' '.join(words[:3])} … failed: {last[0]}; {remedy}")


def version_of(release: Path) -> str:
    """From the name that pip gave its record."""
    found = next(release.glob("lib/python3*/site-packages/tilth-*.dist-info"), None)
    return "?" if found is None else found.name.removeprefix("tilth-").removesuffix(".dist-info")


COMMANDS: tuple[tuple[str, Callable[[Box, argparse.Namespace], None], str], ...] = (
    ("install", install, "put it on this computer and start it, now and at each ignition"),
    ("machine", machine, "record another rig, or this one by a corrected machine file"),
    ("phone", phone, "let a phone in that has the code of a label, also to make the machine file"),
    ("take", take, "record by the machine file that the page has saved, once no run is recorded"),
    ("upgrade", upgrade, "run another release; the one before stays for rollback"),
    ("rollback", rollback, "run the release before this one"),
    ("uninstall", uninstall, "remove it; logs, keys and machine file stay"),
    ("status", status, "say what is installed and whether it runs"),
    ("adapter", adapter, "give a CAN adapter a name that it keeps"),
)


def main(words: Sequence[str] | None = None) -> int:
    """0 done, 1 failed with nothing changed, 2 wrong use, 75 a run is recorded: later."""
    parser = argparse.ArgumentParser(prog="tilth-setup", description="Tilth on this computer.")
    parser.add_argument("--root", type=Path, default=Path("/"), help="a folder instead of this computer")
    subparsers = parser.add_subparsers(dest="command", required=True)
    for name, _, text in COMMANDS:
        one = subparsers.add_parser(name, help=text)
        if name in ("install", "upgrade"):
            brought: dict[str, Any] = {"nargs": "?", "default": WHEELS} if WHEELS.is_dir() else {}
            help_text = "a wheel, a folder of wheels, or a checkout"
            one.add_argument("source", type=Path, help=help_text, **brought)
            one.add_argument("--wheels", type=Path, help="folder with all that it needs: no network then")
        if name == "install":
            one.add_argument("--machine", type=Path, help="the machine file, in place of one that is there")
        if name == "phone":
            label_help = "file with code and network, on a stick say; written where it is not there"
            one.add_argument("label", nargs="?", type=Path, metavar="LABEL.toml", help=label_help)
            one.add_argument(
                "--hotspot", action="store_true", help="it may open a network until there is a machine file"
            )
        if name in ("machine", "take"):
            one.add_argument("machine", type=Path, help="the machine file, in place of one that is there")
        if name in ("install", "machine"):
            one.add_argument("--keys", type=Path, help="daemon.json of `tilth keys`, for a shared network")
        if name == "adapter":
            one.add_argument("interface", help="as it is called now, such as can0")
            one.add_argument("name", help="as it is to be called, such as can_tractor")
    args = parser.parse_args(words)
    box = Box(args.root.absolute())
    if box.real and os.geteuid() != 0:
        print("tilth-setup: this takes root: sudo", file=sys.stderr)
        return 2
    try:
        with alone(box):
            next(run for name, run, _ in COMMANDS if name == args.command)(box, args)
    except Failed as error:
        print(f"tilth-setup: {error}", file=sys.stderr)
        return RECORDING if isinstance(error, RunGoesOn) else 1
    except OSError as error:
        print(f"tilth-setup: {error.filename}: {(error.strerror or str(error)).lower()}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
