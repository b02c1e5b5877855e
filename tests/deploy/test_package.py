"""The Debian package, of Tilth's own wheel: what it holds, and that it is made the same twice."""

import gzip
import shutil
import subprocess
from pathlib import Path

import pytest

from tilth.deploy.package import HERE, SCRIPTS, debian_package

needs_dpkg = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb: not on Debian")


def said(*words: str | Path) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Path:
    folder = tmp_path_factory.mktemp("package")
    wheels = folder / "wheels"
    wheels.mkdir()
    shutil.copy(wheel, wheels)
    made = []
    for name in ("once", "twice"):
        (folder / f"{name}-out").mkdir()
        made.append(debian_package(wheels, folder / name, folder / f"{name}-out"))
    assert made[0].read_bytes() == made[1].read_bytes()
    return made[0]


@pytest.mark.long
@needs_dpkg
def test_it_carries_the_wheel_the_installer_and_scripts_that_a_shell_can_read(
    package: Path, wheel: Path, tmp_path: Path
) -> None:
    said("dpkg-deb", "--raw-extract", package, tmp_path)
    home = tmp_path / "usr/lib/tilth"
    assert (home / "wheels" / wheel.name).read_bytes() == wheel.read_bytes()
    assert (home / "install.py").read_bytes() == (HERE / "install.py").read_bytes()
    assert (home / "install.py").stat().st_mode & 0o777 == 0o755
    for name in SCRIPTS:
        said("sh", "-n", tmp_path / "DEBIAN" / name)
    changes = gzip.decompress((tmp_path / "usr/share/doc/tilth/changelog.gz").read_bytes())
    assert b"# Changes" in changes
    fields = dict(line.split(": ", 1) for line in said("dpkg-deb", "--field", package).splitlines()[:8])
    assert fields["Package"] == "tilth" and fields["Version"].endswith("-1")
    assert "python3 (>= 3." in fields["Depends"] and "python3 (<< 3." in fields["Depends"]
    owners = {line.split()[1] for line in said("dpkg-deb", "--contents", package).splitlines()}
    assert owners == {"root/root"}


@needs_dpkg
@pytest.mark.parametrize(("processor", "architecture"), [("x86_64", "amd64"), ("aarch64", "arm64")])
def test_it_is_for_the_processor_of_the_wheel(processor: str, architecture: str, tmp_path: Path) -> None:
    (tmp_path / "wheels").mkdir()
    (tmp_path / f"wheels/tilth-0.1.0-py3-none-linux_{processor}.whl").touch()
    made = debian_package(tmp_path / "wheels", tmp_path / "tree", tmp_path)
    assert made.name == f"tilth_0.1.0-1_{architecture}.deb"
    assert said("dpkg-deb", "--field", made, "Architecture").strip() == architecture


@pytest.mark.long
@needs_dpkg
@pytest.mark.skipif(shutil.which("lintian") is None, reason="no lintian here")
def test_lintian_finds_nothing(package: Path) -> None:
    done = subprocess.run(
        ["lintian", "--no-tag-display-limit", package], capture_output=True, text=True, check=False
    )
    assert done.stdout == ""
