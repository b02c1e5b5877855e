"""What is no key, and a key whose daemon is not there."""

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from tilth.client.refusal import holder_of, try_key


def key_file(path: Path, **changes: Any) -> Path:
    holder = {"name": "anna", "role": "operator", "prefix": "tilth", "machine": "rig"}
    tls = {"root_ca_certificate_base64": "bm90IGEgY2VydGlmaWNhdGU="}
    with socket.socket() as free:  # nobody listens there
        free.bind(("127.0.0.1", 0))
        endpoint = f"tls/127.0.0.1:{free.getsockname()[1]}"
    content = {
        "metadata": {"tilth": holder}, "connect": {"endpoints": [endpoint]},
        "transport": {"link": {"tls": tls}},
    }  # fmt: skip
    path.write_text(json.dumps({**content, **changes}))
    return path


def test_whom_a_key_is_for(tmp_path: Path) -> None:
    holder = holder_of(key_file(tmp_path / "anna.json5"))
    assert (holder.name, holder.role, holder.prefix, holder.machine) == ("anna", "operator", "tilth", "rig")


def test_damaged_certificates_are_told(tmp_path: Path) -> None:
    found = try_key(key_file(tmp_path / "anna.json5"))
    assert not found.opens and "damaged; ask for a new one" in found.text


@pytest.mark.parametrize(
    "changes",
    [{"metadata": {}}, {"connect": {"endpoints": []}}, {"transport": []}, {"metadata": {"tilth": {}}}],
)
def test_what_is_no_key(changes: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no key of a person or program"):
        holder_of(key_file(tmp_path / "a.json5", **changes))


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file"):
        holder_of(tmp_path / "a.json5")
