"""Updates with nobody present: what is refused, in words, while the release that records stays as it is."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from paths import ROOT
from releases import HERE, SigningKey, package_of
from setup_box import has_pip
from small_disk import on_a_small_disk

from tilth.deploy import install, update
from tilth.schemas.notices import NoticeCode

pytestmark = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb: not on Debian")
TRUSTED, STRANGER, REVOKED = SigningKey(0xA1), SigningKey(0xB2), SigningKey(0xC3)
OTHER = "arm64" if HERE != "arm64" else "amd64"


def installed(root: Path, version: str = "0.2.0") -> Path:
    """A folder for a computer on which this version is current; it is only asked for its version."""
    release = root / "opt/tilth/releases/1"
    (release / f"lib/python3.11/site-packages/tilth-{version}.dist-info").mkdir(parents=True)
    for link in ("current", "keeper"):
        (root / "opt/tilth" / link).symlink_to("releases/1")
    keys = root / update.KEYS
    keys.mkdir(parents=True)
    for key in (TRUSTED, REVOKED):
        (keys / f"{key.name}.pub").write_text(key.public())
    (keys / "revoked").write_text(f"# of last year\n{REVOKED.name.lower()}  # was on a lost computer\n")
    return root


def news(root: Path) -> list[dict[str, object]]:
    path = root / "opt/tilth/updates.json"
    return list(json.loads(path.read_text())["news"]) if path.exists() else []


def of_anything(stick: Path) -> None:
    TRUSTED.sign(package_of(stick, "0.3.0"))


def for_another_processor(stick: Path) -> None:
    TRUSTED.sign(package_of(stick, "0.3.0", OTHER))


def for_another_processor_inside(stick: Path) -> None:
    TRUSTED.sign(package_of(stick, "0.3.0", OTHER, said=HERE))


def by_nobody(stick: Path) -> None:
    package_of(stick, "0.3.0")


def by_a_stranger(stick: Path) -> None:
    STRANGER.sign(package_of(stick, "0.3.0"))


def by_a_revoked_key(stick: Path) -> None:
    REVOKED.sign(package_of(stick, "0.3.0"))


def by_a_stranger_in_its_name(stick: Path) -> None:
    package = package_of(stick, "0.3.0")
    signed = STRANGER.sign(package)
    other = TRUSTED.sign(package).read_text().splitlines()
    lines = STRANGER.sign(package).read_text().splitlines()
    signed.write_text("\n".join([lines[0], other[1], *lines[2:]]))


def tampered(stick: Path) -> None:
    package = package_of(stick, "0.3.0")
    TRUSTED.sign(package)
    with package.open("r+b") as file:
        file.seek(200)
        byte = file.read(1)
        file.seek(200)
        file.write(bytes([byte[0] ^ 1]))


def cut_off(stick: Path) -> None:
    package = package_of(stick, "0.3.0")
    TRUSTED.sign(package)
    os.truncate(package, package.stat().st_size - 1)


def two(stick: Path) -> None:
    for version in ("0.3.0", "0.4.0"):
        TRUSTED.sign(package_of(stick, version))


def older(stick: Path) -> None:
    TRUSTED.sign(package_of(stick, "0.1.9"))


def half_a_signature(stick: Path) -> None:
    signed = TRUSTED.sign(package_of(stick, "0.3.0"))
    signed.write_bytes(signed.read_bytes()[:100])


BAD: tuple[tuple[Callable[[Path], None], NoticeCode, str], ...] = (
    (of_anything, NoticeCode.UPDATE_REFUSED, "could not be installed"),  # it holds no wheel
    (for_another_processor, NoticeCode.UPDATE_OTHER_PROCESSOR, f"this computer takes {HERE}"),
    (for_another_processor_inside, NoticeCode.UPDATE_OTHER_PROCESSOR, "another kind of processor"),
    (by_nobody, NoticeCode.UPDATE_UNSIGNED, "has no signature beside it"),
    (half_a_signature, NoticeCode.UPDATE_UNSIGNED, "has no signature beside it that can be read"),
    (by_a_stranger, NoticeCode.UPDATE_UNKNOWN_KEY, "00000000000000B2, which this computer does not know"),
    (by_a_revoked_key, NoticeCode.UPDATE_REVOKED_KEY, "00000000000000C3, which was revoked"),
    (by_a_stranger_in_its_name, NoticeCode.UPDATE_FORGED, "is not what 00000000000000A1 has signed"),
    (tampered, NoticeCode.UPDATE_FORGED, "is not what 00000000000000A1 has signed"),
    (cut_off, NoticeCode.UPDATE_FORGED, "copy package and signature anew"),
    (two, NoticeCode.UPDATE_SEVERAL, "there are several packages, tilth_0.3.0"),
    (older, NoticeCode.UPDATE_OLDER, "is older than 0.2.0, which this computer has had"),
)


@pytest.mark.parametrize(("make", "code", "words"), BAD, ids=[make.__name__ for make, _, _ in BAD])
def test_a_bad_stick_is_a_sentence_and_changes_nothing(
    make: Callable[[Path], None],
    code: NoticeCode,
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    root, stick = installed(tmp_path / "root"), tmp_path / "stick"
    stick.mkdir()
    make(stick)
    before = set(root.rglob("*"))
    assert update.main(["--root", str(root), str(stick)]) == 0
    assert words in capsys.readouterr().out
    (entry,) = news(root)
    assert entry["code"] == code and words in str(entry["text"])
    assert set(root.rglob("*")) - before == {root / "opt/tilth/updates.json"}
    assert (root / "opt/tilth/current").readlink() == Path("releases/1")


def test_a_folder_is_looked_at_when_it_has_settled_and_told_of_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = installed(tmp_path / "root")
    folder = root / update.FOLDER
    look = ["--root", str(root)]
    assert update.main(look) == 0 and news(root) == []  # there is no such folder
    folder.mkdir(parents=True)
    package = package_of(folder, "0.3.0")
    assert update.main(look) == 0 and news(root) == []  # the signature may be on its way
    STRANGER.sign(package)
    assert update.main(look) == 0 and news(root) == []
    for _ in range(3):
        assert update.main(look) == 0
        assert [entry["code"] for entry in news(root)] == [NoticeCode.UPDATE_UNKNOWN_KEY]
    TRUSTED.sign(package)  # signed anew: another one
    for _ in range(3):
        assert update.main(look) == 0
    assert [entry["code"] for entry in news(root)][1:] == [NoticeCode.UPDATE_REFUSED]
    capsys.readouterr()


def test_what_is_here_already_and_what_is_no_package_are_left_alone(tmp_path: Path) -> None:
    root, stick = installed(tmp_path / "root"), tmp_path / "stick"
    stick.mkdir()
    (stick / "tilth_notes.txt").write_text("")
    (stick / "tilth_9.9.9-1_amd64.deb").symlink_to("/etc/shadow")
    TRUSTED.sign(package_of(stick, "0.2.0"))
    assert update.main(["--root", str(root), str(stick)]) == 0
    assert news(root) == [] and (root / "opt/tilth/releases").exists()


def test_a_version_that_was_had_is_not_tried_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root, stick = installed(tmp_path / "root"), tmp_path / "stick"
    stick.mkdir()
    (root / "opt/tilth/updates.json").write_text(json.dumps({"newest": "0.10.0"}))
    TRUSTED.sign(package_of(stick, "0.9.0"))
    assert update.main(["--root", str(root), str(stick)]) == 0
    assert "is older than 0.10.0" in capsys.readouterr().out  # by numbers, not by letters


def test_a_stick_that_is_pulled_while_it_is_copied(tmp_path: Path) -> None:
    """Reading it fails for real: the package is this process's memory at 0, which nobody can read."""
    root, stick = installed(tmp_path / "root"), tmp_path / "stick"
    stick.mkdir()
    package = package_of(stick, "0.3.0")
    TRUSTED.sign(package)
    script = 'mount --bind /proc/$$/mem "$1" && shift && exec "$@"'
    look: list[str | Path] = [sys.executable, "-m", "tilth.deploy.update", "--root", root, stick]
    unshare: list[str | Path] = [
        "unshare",
        "--user",
        "--map-root-user",
        "--mount",
        "sh",
        "-c",
        script,
        "sh",
        package,
        *look,
    ]
    done = subprocess.run(unshare, capture_output=True, text=True, check=False)
    if "mount:" in done.stderr or "unshare:" in done.stderr:
        pytest.skip(f"nobody may mount here: {done.stderr}")
    assert done.returncode == 0 and "could not be read: input/output error" in done.stdout, done.stderr
    assert not (root / update.INCOMING).exists()


@pytest.mark.parametrize(
    ("before", "words"),
    [
        pytest.param("", "4 MB are free; make room", marks=pytest.mark.long),
        ("t.update.TIMES_ITS_SIZE = t.update.RESERVE = 0", "0 MB are free"),
    ],
    ids=["seen in advance", "while it is copied"],
)
def test_a_full_disk_is_a_sentence(before: str, words: str, tmp_path: Path) -> None:
    root, stick = tmp_path / "root", tmp_path / "stick"
    stick.mkdir()
    noise = np.random.default_rng(1).bytes(6_000_000)  # which cannot be packed smaller
    TRUSTED.sign(package_of(stick, "0.3.0", holds=noise))
    script = (
        "import sys; sys.path[:0] = sys.argv[1].split(':'); from pathlib import Path\n"
        "import test_update as t\n"
        f"{before}\n"
        "t.installed(Path(sys.argv[2])); sys.exit(t.update.main(['--root', sys.argv[2], sys.argv[3]]))"
    )
    places = ":".join([str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")])
    root.mkdir()
    done = on_a_small_disk(root, "4m", sys.executable, "-c", script, places, root, stick)
    assert done.status == 0 and words in done.out, done.err
    assert not [path for path in done.left if "incoming" in path]


@pytest.mark.long
@pytest.mark.skipif(not has_pip(), reason="no pip: apt-get install python3-pip")
def test_an_upgrade_by_hand_on_a_full_disk_is_a_sentence(wheel: Path, tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    script = (
        "import os, sys; sys.path[:0] = sys.argv[1].split(':'); from pathlib import Path\n"
        "import test_update as t\n"
        "os.environ['PIP_NO_DEPS'] = '1'\n"
        "t.installed(Path(sys.argv[2]))\n"
        "status = t.install.main(['--root', sys.argv[2], 'upgrade', sys.argv[3]])\n"
        "print('runs:', os.readlink(sys.argv[2] + '/opt/tilth/current')); sys.exit(status)"
    )
    places = ":".join([str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")])
    done = on_a_small_disk(root, "2m", sys.executable, "-c", script, places, root, wheel)
    assert done.status == 1 and "No space left on device" in done.err.splitlines()[-1], done.err
    assert "runs: releases/1" in done.out and not [path for path in done.left if "releases/2" in path]


def test_keys_come_from_the_computer_and_from_the_release_and_what_is_none_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root, own = installed(tmp_path / "root"), tmp_path / "own"
    own.mkdir()
    (own / "next.pub").write_text(STRANGER.public())
    (own / "revoked").write_text(f"{TRUSTED.name}\n")
    (root / update.KEYS / "notes.pub").write_text("no key")
    monkeypatch.setattr(update, "OWN_KEYS", own)
    trusted, revoked = update.keys(install.Box(root))
    assert set(trusted) == {TRUSTED.name, REVOKED.name, STRANGER.name}
    assert revoked == {TRUSTED.name, REVOKED.name}
    assert "notes.pub is no public key" in capsys.readouterr().err


def test_an_upgrade_by_hand_is_on_trial_until_it_has_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = installed(tmp_path / "root")
    box, before = install.Box(root), root / "opt/tilth/releases/1"
    release = box.releases / "2"
    packages = release / "lib/python3.11/site-packages"
    (packages / "tilth").mkdir(parents=True)
    (packages / "tilth-0.3.0.dist-info").mkdir()
    (packages / "tilth/deploy").symlink_to(ROOT / "deploy")

    def cut(box: install.Box) -> bool:
        raise SystemExit("the power is cut")

    monkeypatch.setattr(install, "_start", cut)
    with pytest.raises(SystemExit):
        install._switch(box, release)
    install.remove_unused(box)
    assert (box.release("current"), box.release("keeper")) == (release, before) and update.on_trial(box)
    monkeypatch.setattr(install, "_start", lambda box: True)
    install._switch(box, release)
    assert box.release("keeper") == release and not update.on_trial(box)
