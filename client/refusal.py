"""Says why a key of `tilth keys` opens nothing, as far as that can be told from outside.

Zenoh itself only says that it has no connection; the daemon's computer does tell a plain TLS client more.
"""

import base64
import binascii
import contextlib
import json
import socket
import ssl
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tilth.client.link import open_session
from tilth.schemas.invocation import command
from tilth.schemas.readable import reason_of

WAIT_S: Final = 2.0
_ALERT_S: Final = 0.7  # a refusal comes after the handshake, and at once
_ALERTS: Final = (
    ("CERTIFICATE_REQUIRED", "it wants a certificate and this file has none; ask for a key of your own"),
    ("CERTIFICATE_EXPIRED", "this key has expired; ask for it to be renewed ({renew})"),
    ("UNKNOWN_CA", "this key is of another authority; ask for one of this machine's"),
    ("DECRYPT_ERROR", "this key is of another authority; ask for one of this machine's"),
    ("BAD_CERTIFICATE", "it does not take this certificate; ask for a new one"),
)


@dataclass(frozen=True, slots=True)
class Verdict:
    """`opens`: whether the daemon answers to this key; `text`: what may be done with it, or why nothing."""

    opens: bool
    text: str


@dataclass(frozen=True, slots=True)
class Holder:
    """Whom a key is for, and of which machine."""

    name: str
    role: str
    prefix: str
    machine: str


def holder_of(path: Path) -> Holder:
    """Raises ValueError where it is no key file."""
    metadata = _content(path)["metadata"]["tilth"]
    return Holder(metadata["name"], metadata["role"], metadata["prefix"], metadata["machine"])


def try_key(path: Path) -> Verdict:
    """Try a key file against its daemon. Raises ValueError where it is no key file."""
    content = _content(path)
    holder = holder_of(path)
    refusals = []
    for endpoint in content["connect"]["endpoints"]:
        refusal = _handshake(endpoint, content["transport"]["link"]["tls"])
        if not refusal:
            return _ask(path, f"{holder.prefix}/{holder.machine}", endpoint, holder.role)
        refusals.append(f"{endpoint}: {refusal}")
    return Verdict(False, "; ".join(refusals))


def _content(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        metadata, tls = content["metadata"]["tilth"], content["transport"]["link"]["tls"]
        complete = {
            "name",
            "prefix",
            "machine",
            "role",
        } <= metadata.keys() and "root_ca_certificate_base64" in tls
        if complete and content["connect"]["endpoints"]:
            return content
    except OSError as error:
        raise ValueError(f"{path}: {reason_of(error)}") from None
    except (ValueError, LookupError, TypeError, AttributeError):
        pass
    raise ValueError(f"{path}: no key of a person or program that `{command('keys')}` has made")


def _handshake(endpoint: str, tls: dict[str, str]) -> str:
    """Why it fails, "" where it does not."""
    host, _, port = endpoint.removeprefix("tls/").rpartition(":")
    host = host.strip("[]")
    try:
        context = _context(tls)
    except (ssl.SSLError, binascii.Error, ValueError):
        return "the certificates in this file are damaged; ask for a new one"
    try:
        with (
            socket.create_connection((host, int(port)), WAIT_S) as plain,
            context.wrap_socket(plain, server_hostname=host) as secured,
        ):
            secured.settimeout(_ALERT_S)
            with contextlib.suppress(TimeoutError):  # nothing to say: it waits for Zenoh's first word
                secured.recv(1)
    except ssl.SSLCertVerificationError as error:
        return f"who listens there has no certificate of this machine's authority ({error.verify_message})"
    except ssl.SSLError as error:
        reason = str(error.reason)
        return next(
            (text.format(renew=command("keys", "--renew")) for alert, text in _ALERTS if alert in reason),
            f"refused: {reason.lower()}",
        )
    except OSError as error:
        return f"not reached: {reason_of(error)}"
    return ""


def _context(tls: dict[str, str]) -> ssl.SSLContext:
    context = ssl.create_default_context(cadata=_pem(tls["root_ca_certificate_base64"]))
    if "connect_certificate_base64" in tls:
        with tempfile.TemporaryDirectory() as folder:  # it takes files only; nobody else may enter
            pair = Path(folder) / "pair.pem"
            pair.write_text(_pem(tls["connect_private_key_base64"]) + _pem(tls["connect_certificate_base64"]))
            context.load_cert_chain(pair)
    return context


def _pem(text: str) -> str:
    return base64.b64decode(text, validate=True).decode()


def _ask(path: Path, base: str, endpoint: str, role: str) -> Verdict:
    """Whether anything is answered: a name that is not on the daemon's list gets a session, nothing else."""
    with open_session(config=path) as session:
        for reply in session.get(f"{base}/status", timeout=WAIT_S):
            if reply.ok is not None:
                may = "hear everything and mark" if role == "operator" else "hear everything, and not mark"
                return Verdict(True, f"{endpoint}: {base} answers; this key may {may}")
    return Verdict(
        False,
        f"{endpoint}: it takes the certificate but tells nothing under {base}: the key was revoked, or its "
        "daemon.json is older than the key; copy the new one there and start it anew",
    )
