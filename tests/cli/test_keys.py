"""tilth keys: made, listed, renewed and revoked."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from loopback import TEXT

from tilth.cli import main
from tilth.deploy import keys
from tilth.logger.clock import Clock

NOW = datetime.fromtimestamp(Clock().t_ns() // 1_000_000_000, UTC)


def test_keys_are_made_listed_renewed_and_revoked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = tmp_path / "machine.toml"
    machine.write_text(TEXT)
    folder = tmp_path / "keys"
    command = ["keys", str(folder)]
    assert main([*command, "--machine", str(machine), "--host", "10.0.0.2", "--host", "fe80::1"]) == 0
    assert "nobody may hear it yet" in capsys.readouterr().out
    assert main([*command, "--operator", "olga", "--reader", "rita", "--reader", "cab.page"]) == 0
    assert folder.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o600}
    endpoints = json.loads((folder / "rita.json").read_text())["connect"]["endpoints"]
    assert endpoints == ["tls/127.0.0.1:7447", "tls/10.0.0.2:7447", "tls/[fe80::1]:7447"]
    before = (folder / "rita.json").read_bytes()
    assert main([*command, "--renew", "rita", "--days", "9", "--revoke", "olga"]) == 0
    out = capsys.readouterr().out
    assert "olga                 revoked" in out and (folder / "rita.json").read_bytes() != before
    (rita, _) = keys.read_register(folder).parties
    until_day = datetime.fromisoformat(rita.until).replace(tzinfo=UTC)
    assert timedelta(days=7) < until_day - NOW and rita.name == "rita"
    assert not (folder / "olga.json").exists()
