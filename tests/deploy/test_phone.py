"""The label of a computer, and the networks that NetworkManager is told of."""

import configparser
import shutil
import tomllib
from pathlib import Path

import pytest

from tilth.deploy.install import HOTSPOT
from tilth.deploy.phone import JOINED, LABEL, PROFILES, label_of, label_text, main
from tilth.monitor.entry_code import EntryCode

with_nmcli = pytest.mark.skipif(
    shutil.which("nmcli") is None, reason="no nmcli: apt-get install network-manager"
)


def test_a_label_is_drawn_once_and_written_on_the_stick(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stick, root = tmp_path / "tilth-label.toml", tmp_path / "root"
    words = [str(stick), "--root", str(root)]
    assert main(words) == 0
    first = tomllib.loads(stick.read_text())
    EntryCode(first["code"])
    assert len(first["passphrase"]) >= 16 and not first["hotspot"]
    assert (root / LABEL).read_text() == stick.read_text() and (root / LABEL).stat().st_mode & 0o777 == 0o600
    assert not (root / PROFILES).exists()  # no network without having been asked for
    assert first["code"] in capsys.readouterr().out
    assert main(words) == main(words[1:]) == 0  # from the stick, or what is there
    assert tomllib.loads((root / LABEL).read_text()) == first


def test_every_text_of_a_label_comes_back(tmp_path: Path) -> None:
    label = {"code": "ABCD-2345", "network": 'a "b" \\ c', "passphrase": '"\\"\\#=[] x', "hotspot": True,
             "join": {"network": "Höfe", "passphrase": "x" * 63}}  # fmt: skip
    path = tmp_path / "label.toml"
    path.write_text(label_text(label))
    assert label_of(path) == label


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("code", "label.toml: "),
        ('code = "1234"', "8 letters"),
        ("code = 12345678", "8 letters"),
        ('passphrase = "short"', "8 to 63"),
        (f'passphrase = "{"x" * 64}"', "8 to 63"),
        ('passphrase = "schlüssel-wort"', "8 to 63"),
        ('passphrase = "two\\nlines"', "8 to 63"),
        (f'network = "{"ä" * 17}"', "32 bytes"),
        ('network = ""', "32 bytes"),
        ('network = "a\\nb"', "32 bytes"),
        ('hotspot = "yes"', "true or false"),
        ('join = "Farm"', "network and passphrase"),
        ('[join]\nnetwork = "Farm"', "8 to 63"),
    ],
)
def test_a_bad_label_changes_nothing(
    text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, root = tmp_path / "label.toml", tmp_path / "root"
    path.write_text(text)
    assert main([str(path), "--root", str(root)]) == 1
    assert says in capsys.readouterr().err and not root.exists()


@with_nmcli
def test_networkmanager_takes_both_networks(tmp_path: Path) -> None:
    path, root = tmp_path / "label.toml", tmp_path / "root"
    path.write_text(
        'network = "Tilth-7K2M"\npassphrase = "ABCD-2345-EFGH"\n'
        '[join]\nnetwork = "Farm"\npassphrase = "12345678"\n'
    )
    assert main([str(path), "--hotspot", "--root", str(root)]) == 0
    found = {}
    for name in (Path(HOTSPOT).stem, JOINED):
        profile = root / PROFILES / f"{name}.nmconnection"
        assert profile.stat().st_mode & 0o777 == 0o600
        found[name] = configparser.ConfigParser()
        found[name].read(profile)
    own, joined = found[Path(HOTSPOT).stem], found[JOINED]
    assert own["wifi"]["mode"] == "ap" and own["ipv4"]["method"] == "shared"
    assert (own["wifi"]["band"], own["wifi"]["channel"]) == ("bg", "6")
    assert own["connection"]["autoconnect"] == "false"  # the unit opens it, nothing else
    assert own["wifi-security"]["key-mgmt"] == "wpa-psk" and own["wifi-security"]["psk"] == "ABCD-2345-EFGH"
    assert joined["wifi"]["mode"] == "infrastructure" and joined["wifi"]["ssid"] == "Farm"
    assert main([str(path), "--root", str(root)]) == 0
    assert not (root / HOTSPOT).exists()  # it is no longer allowed


def test_without_networkmanager_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["--hotspot", "--root", str(tmp_path / "root")]) == 1
    assert "apt-get install network-manager" in capsys.readouterr().err and not (tmp_path / "root").exists()
