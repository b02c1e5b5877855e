"""A release: what it refuses, what is in it, that it is the same twice, and that others can check it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT
from releases import release_of

from tilth.deploy import release as releasing
from tilth.deploy.minisign import read_key, read_signature, verify
from tilth.deploy.release import SUMS, NotReady, bill_of_materials, notes_of

OLD = "## 0.9.0, 2026-01-02\n\n- old\n"


def test_the_notes_are_the_newest_section() -> None:
    changelog = f"# Changes\n\nWords.\n\n## 1.0.0, 2026-03-04\n\n- one\n- two\n\n### more\n\n- three\n\n{OLD}"
    assert notes_of(changelog, "1.0.0") == "- one\n- two\n\n### more\n\n- three\n"


@pytest.mark.parametrize(
    ("newest", "words"),
    [
        ("", "does not begin with 1.0.0"),
        ("## 1.0.1, 2026-03-04\n\n- one\n\n", "does not begin with 1.0.0"),
        ("## 1.0.0, not released yet\n\n- one\n\n", "write the date"),
        ("## 1.0.0, 2026-03-04\n\n", "says nothing of 1.0.0"),
    ],
)
def test_a_version_without_a_section_is_refused(newest: str, words: str) -> None:
    with pytest.raises(NotReady, match=words):
        notes_of(f"# Changes\n\n{newest}{OLD}", "1.0.0")


def test_what_is_not_released_yet_makes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "wheels").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/old").touch()
    status = releasing.main([str(tmp_path / "out"), "--wheels", str(tmp_path / "wheels")])
    assert status == 1 and capsys.readouterr().err.startswith("release: ")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["old"]


@pytest.mark.skipif(shutil.which("uv") is None, reason="no uv here")
def test_the_bill_names_all_that_is_installed_and_is_the_same_twice() -> None:
    text = bill_of_materials()
    assert text == bill_of_materials()
    bill = json.loads(text)
    assert bill["bomFormat"] == "CycloneDX" and bill["specVersion"] >= "1.5"
    named = {f"{one['name']}=={one['version']}" for one in bill["components"]}
    pins = (ROOT / "deploy/constraints.txt").read_text().splitlines()
    assert {pin.partition(" ;")[0] for pin in pins} <= named
    assert all(one["purl"].startswith("pkg:pypi/") for one in bill["components"])


@pytest.mark.long
@pytest.mark.skipif(
    not all(map(shutil.which, ("minisign", "dpkg-deb", "uv", "git"))),
    reason="no minisign, dpkg-deb, uv or git",
)
def test_a_release_is_signed_and_the_same_twice(tmp_path: Path, wheel: Path) -> None:
    """In a checkout whose newest section has a date: another copy of this one."""
    made = subprocess.run(
        ["minisign", "-G", "-W", "-p", "k.pub", "-s", "k.key"], cwd=tmp_path, capture_output=True, check=False
    )
    assert made.returncode == 0, made.stderr
    checkout = tmp_path / "checkout"
    subprocess.run(["git", "clone", "--quiet", "--shared", ROOT, checkout], check=True)
    shutil.copytree(ROOT / "deploy", checkout / "deploy", dirs_exist_ok=True)
    changes = (ROOT / "CHANGELOG.md").read_text()
    (checkout / "CHANGELOG.md").write_text(changes.replace(", not released yet", ", 2026-11-29", 1))
    package = release_of(wheel, tmp_path, wheel.name.split("-")[1])
    wheels = next(tmp_path.glob("wheels-*"))
    for_another = wheels.with_name("others")  # with the name of a wheel of the other kind of processor
    for_another.mkdir()
    another = "x86_64" if wheel.stem.endswith("_aarch64") else "aarch64"
    shutil.copy(wheel, for_another / f"{wheel.name.partition('-linux_')[0]}-linux_{another}.whl")
    code = (
        "import sys; from pathlib import Path; from tilth.deploy import package, release\n"
        "package.CHECKOUT = release.CHECKOUT = Path(sys.argv.pop(1))\nsys.exit(release.main())"
    )
    for name in ("once", "twice"):
        words: list[str | Path] = [sys.executable, "-c", code, checkout, tmp_path / name, "--wheels", wheels]
        words += ["--wheels", for_another, "--key", tmp_path / "k.key"]
        done = subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ})
        assert done.returncode == 0, done.stderr
    once, twice = ({p.name: p.read_bytes() for p in (tmp_path / n).iterdir()} for n in ("once", "twice"))
    assert once == twice
    debs = [f"{package.stem.rpartition('_')[0]}_{architecture}.deb" for architecture in ("amd64", "arm64")]
    assert {SUMS, "notes.md", wheel.name, next(for_another.iterdir()).name} < set(once)
    for signed in (*debs, SUMS):
        check: list[str | Path] = [
            "minisign",
            "-V",
            "-p",
            tmp_path / "k.pub",
            "-m",
            tmp_path / "once" / signed,
        ]
        assert subprocess.run(check, capture_output=True, check=False).returncode == 0
        _, key = read_key((tmp_path / "k.pub").read_text())
        verify(tmp_path / "once" / signed, read_signature(once[f"{signed}.minisig"].decode()), key)
    sums = ["sha256sum", "--check", "--strict", "--quiet", SUMS]
    assert subprocess.run(sums, cwd=tmp_path / "once", capture_output=True, check=False).returncode == 0
    assert len(once[SUMS].splitlines()) == len(once) - 4  # all but itself and the signatures
