"""A virtual machine for what this computer's kernel may not have or must not suffer: CAN, a power cut.

    with boot(["bash", "-e", "scenario.sh"], out=folder) as guest:
        guest.finish()

QEMU runs Debian's stock kernel; its root is this computer's own, read-only, under a file system in memory:
the same Python, the same environment, the same checkout. `$OUT` in the guest is the folder `out` here, both
ways. There are can-utils, two CAN cards (can0, can1: SJA1000, on one emulated bus), the modules of MODULES;
every drive is a /dev/vd*. It has one processor, since two wait for each other, which costs twice the
computing. Nothing is paced like hardware, and Python takes half a minute to start: for correctness, never
speed. Times to wait are there so that one that hangs ends; others may want the processor.
"""

import contextlib
import gzip
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parents[1]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "tilth-vm"
MODULES = (
    "virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_blk", "ext4",
    "can", "can-raw", "can-gw", "vcan", "vxcan", "slcan", "kvaser_pci",
)  # fmt: skip
TOOLS = (
    "qemu-system-x86_64", "busybox", "cpio", "modprobe", "depmod", "dpkg-deb", "apt-get", "ip", "candump",
)  # fmt: skip
PACKAGES = "qemu-system-x86 busybox-static cpio kmod iproute2 can-utils"
MACHINE = (
    "-accel tcg -cpu max -m 1024 -nodefaults -no-reboot -display none "
    "-object can-bus,id=bus -device kvaser_pci,canbus=bus -device kvaser_pci,canbus=bus"
)
KERNEL = "console=ttyS0 quiet panic=-1 mitigations=off no_timer_check"


def missing() -> str:
    """Why no machine can be booted here; "" where one can."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    return f"no {', '.join(absent)}: apt-get install {PACKAGES}" if absent else ""


class Guest:
    """A machine that runs a command."""

    def __init__(self, process: subprocess.Popen[bytes], out: Path, console: Path) -> None:
        self.out = out
        self.console = console
        self._process = process

    def until(self, condition: Callable[[], bool], seconds: float = 1200.0) -> None:
        """Wait until something is so, seen from here; fails where the machine ends before."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert self._process.poll() is None, f"the machine has ended\n{self.last_words()}"
            assert time.monotonic() < deadline, f"waited in vain\n{self.last_words()}"
            time.sleep(0.02)

    def kill(self) -> None:
        """As when the power is cut: what it had not written to a drive is gone."""
        self._process.kill()
        self._process.wait()

    def finish(self, seconds: float = 1800.0) -> None:
        """Wait for the command's end; fails where that was not good."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f"not done after {seconds:.0f} s\n{self.last_words()}") from None
        status = self.out / ".status"
        assert status.exists(), f"the machine ended before its command\n{self.last_words()}"
        assert status.read_text() == "0\n", f"exit status {status.read_text()}{self.last_words()}"

    def last_words(self) -> str:
        lines = self.console.read_text(errors="replace").splitlines() if self.console.exists() else []
        return "\n".join(lines[-40:])


@contextmanager
def boot(
    command: Sequence[str],
    out: Path,
    *,
    drives: Sequence[Path] = (),
    options: Sequence[str] = (),
    upper: str = "",
    modules: Sequence[str] = (),
) -> Iterator[Guest]:
    """Start a machine that runs a command in the checkout and then ends.

    out: a folder, made where there is none. drives: raw images, /dev/vda and so on; what a drive has taken
    from the guest survives `kill`. options: further ones of QEMU. upper: the drive, an ext4, that has what
    the guest changes of its root, so that another start finds it; else it is in memory. modules: of the
    kernel, beside MODULES.
    """
    out.mkdir(parents=True, exist_ok=True)
    kernel, initial = _system((*MODULES, *modules))
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}:/usr/sbin:/sbin"
    (out / ".status").unlink(missing_ok=True)
    (out / ".run.sh").write_text(
        f"export PATH={shlex.quote(path)} HOME=/root OUT=/mnt/out LANG=C.UTF-8 PYTHONDONTWRITEBYTECODE=1\n"
        f"ip link set lo up; cd {shlex.quote(str(CHECKOUT))}\n"
        f"{shlex.join(command)} </dev/null; echo $? >$OUT/.status; sync\n"
        "echo o >/proc/sysrq-trigger; while :; do sleep 1; done\n"
    )
    console = out / "console.txt"
    arguments = [
        "qemu-system-x86_64",
        *shlex.split(MACHINE),
        *("-serial", f"file:{console}", "-kernel", str(kernel), "-initrd", str(initial)),
        *("-append", f"{KERNEL} upper={upper}" if upper else KERNEL),
        *("-virtfs", "local,path=/,mount_tag=root,security_model=none,readonly=on,multidevs=remap"),
        *("-virtfs", f"local,path={out},mount_tag=out,security_model=none"),
        *(word for path in drives for word in ("-drive", f"file={path},format=raw,if=virtio")),
        *options,
    ]
    with subprocess.Popen(arguments, stdin=subprocess.DEVNULL) as process:
        guest = Guest(process, out, console)
        try:
            yield guest
        finally:
            guest.kill()


def _system(modules: Sequence[str]) -> tuple[Path, Path]:
    """Kernel and initial file system, made once and kept in the cache."""
    script = (HERE / "init.sh").read_bytes()
    package = _newest_kernel()
    key = hashlib.sha256(b"\0".join((package.encode(), script, *(m.encode() for m in modules)))).hexdigest()
    folder = CACHE / key[:16]
    kernel, initial = folder / "kernel", folder / "initial.gz"
    if not initial.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=CACHE) as work:
            made = _make(package, script, modules, Path(work))
            with contextlib.suppress(OSError):  # another run was quicker
                made.rename(folder)
    return kernel, initial


def _newest_kernel() -> str:
    """The package of Debian's stock kernel, or of the one that is in the cache already."""
    known = CACHE / "package"
    if not known.exists():
        output = _said("apt-cache", "depends", "linux-image-amd64")
        CACHE.mkdir(parents=True, exist_ok=True)
        known.write_text(
            next(line.split()[1] for line in output.splitlines() if "Depends: linux-image" in line)
        )
    return known.read_text()


def _make(package: str, script: bytes, modules: Sequence[str], work: Path) -> Path:
    """A folder with the kernel and the initial file system."""
    _said("apt-get", "download", package, folder=work)
    root, made, tree = work / "root", work / "made", work / "tree"
    _said("dpkg-deb", "-x", str(next(work.glob("*.deb"))), str(root))
    (version,) = (path.name for path in (root / "lib/modules").iterdir())
    _said("depmod", "-b", str(root), version)
    files: list[str] = []
    for module in modules:
        output = _said("modprobe", "-d", str(root), "-S", version, "--show-depends", module)
        rows = [line.split() for line in output.splitlines()]
        files += [row[1] for row in rows if row[0] == "insmod" and row[1] not in files]
    for name in ("bin", "modules", "proc", "sys", "dev", "lower", "upper", "root"):
        (tree / name).mkdir(parents=True)
    for file in files:
        shutil.copy(file, tree / "modules")
    (tree / "modules/order").write_text("".join(f"{Path(file).name}\n" for file in files))
    shutil.copy(shutil.which("busybox") or "", tree / "bin/busybox")
    (tree / "init").write_bytes(script)
    (tree / "init").chmod(0o755)
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    pack = ["cpio", "-o", "-H", "newc", "--quiet"]
    packed = subprocess.run(pack, input=names.encode(), capture_output=True, check=True, cwd=tree).stdout
    made.mkdir()
    (made / "initial.gz").write_bytes(gzip.compress(packed, 1))
    shutil.copy(root / f"boot/vmlinuz-{version}", made / "kernel")
    return made


def unpacked(packages: Sequence[str]) -> Path:
    """A folder with what is in packages of Debian's, made once and kept in the cache."""
    folder = CACHE / hashlib.sha256(" ".join(packages).encode()).hexdigest()[:16]
    if not folder.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=CACHE) as work:
            brought, root = Path(work, "packages"), Path(work, "root")
            brought.mkdir()
            (root / "usr").mkdir(parents=True)
            for name in ("bin", "sbin", "lib"):  # as Debian's root has them
                (root / "usr" / name).mkdir()
                (root / name).symlink_to(f"usr/{name}")
            _said("apt-get", "download", *packages, folder=brought)
            for package in sorted(brought.iterdir()):
                files = subprocess.run(
                    ["dpkg-deb", "--fsys-tarfile", package], capture_output=True, check=True
                ).stdout
                into = ["tar", "--extract", "--keep-directory-symlink", "--directory", str(root)]
                subprocess.run(into, input=files, check=True)
            with contextlib.suppress(OSError):  # another run was quicker
                root.rename(folder)
    return folder


def _said(*command: str, folder: Path | None = None) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, f"{shlex.join(command)}: {done.stderr}"
    return done.stdout
