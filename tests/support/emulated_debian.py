"""A Debian of ARMv8 on this computer: its package manager works, its root owns its files, it has no network.

`run` changes nothing in it for good.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from tilth.deploy import emulated

NEEDED = "python3,python3-pip,iproute2,debconf"  # what the package depends on
PACKAGES = [
    "--variant=apt", "--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr", f"--include=usr-is-merged,{NEEDED}",
    "--aptopt=Apt::Install-Recommends false",
]  # fmt: skip
SPACES = ["unshare", "--user", "--mount", "--pid", "--fork", "--kill-child"]
ALL_IDS = "0 0 65536"
INSIDE = """
mount -t tmpfs memory "$2"
mkdir "$2/files" "$2/work" "$2/root"
mount -t overlay -o "userxattr,lowerdir=$1,upperdir=$2/files,workdir=$2/work" overlay "$2/root"
mount --rbind /dev "$2/root/dev"
mount -t proc none "$2/root/proc"
mkdir "$2/root/out"
mount --bind "$3" "$2/root/out"
ip link set lo up
exec chroot "$2/root" sh -ex /out/script
"""


def make(root: Path) -> None:
    """As far as it is not there. Raises CalledProcessError."""
    if (root / "made").exists():
        return
    shutil.rmtree(root, ignore_errors=True)  # left by one that was ended
    as_root(["mmdebstrap", "--quiet", "--arch=arm64", *PACKAGES, emulated.DEBIAN, root])
    (root / "made").touch()


def run(root: Path, script: str, out: Path) -> str:
    """A shell's script in it, where `out` is /out. Returns what it said. Raises CalledProcessError."""
    (out / "script").write_text(script, encoding="utf-8")
    (out / "mnt").mkdir()
    return as_root(["sh", "-e", "-c", INSIDE, "sh", root, out / "mnt", out], "--net")


def as_root(words: list[str | Path], *spaces: str) -> str:
    """Run a program as root of namespaces of its own, which has the ids of all users, and in which Linux
    knows the emulator. It takes root. Returns what it said. Raises CalledProcessError."""
    begin = ["sh", "-c", 'echo; read -r _ && exec "$@" </dev/null', "sh"]
    command = [*SPACES, *spaces, *begin, "sh", "-c", emulated.KNOWN, "sh", *words]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdout.readline()  # it is in its namespaces
        for ids in ("uid_map", "gid_map"):
            Path(f"/proc/{process.pid}/{ids}").write_text(ALL_IDS, encoding="ascii")
        said, _ = process.communicate("\n")
    if process.returncode:
        sys.stderr.write(said)
        raise subprocess.CalledProcessError(process.returncode, command, said)
    return said
