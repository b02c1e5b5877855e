"""Verifies signatures in the form of minisign(1): Ed25519 over the BLAKE2b of a file.

A public key file has a comment and a line of base64: "Ed", the key's id (8 bytes), the key (32). A signature
file has a comment; "ED", the id, the signature (64); "trusted comment: …"; a signature over signature and
comment. Form: https://jedisct1.github.io/minisign/. Signing is minisign's own business, see release.py.
"""

import base64
import binascii
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

ID, SIGNATURE = 8, 64  # bytes
_TRUSTED: Final = "trusted comment: "
Keys = Mapping[str, Ed25519PublicKey]
"""By id, as minisign prints it: 16 hexadecimal digits."""


class FormError(ValueError):
    """This is no file in minisign's form."""


class ForgedError(ValueError):
    """The signature is of other bytes than these."""


@dataclass(frozen=True, slots=True)
class Signature:
    """What a signature file holds."""

    key: str  # its id
    signature: bytes
    comment: str  # signed too
    over_comment: bytes  # signature over both


def read_key(text: str) -> tuple[str, Ed25519PublicKey]:
    """A public key and its id. Raises FormError."""
    lines = text.strip().splitlines()
    name, key = _tagged(lines[-1] if lines else "", b"Ed", 32)
    return name, Ed25519PublicKey.from_public_bytes(key)


def read_signature(text: str) -> Signature:
    """Raises FormError; for a signature of the older kind too, over the file itself instead of its hash."""
    lines = text.strip().splitlines()
    if len(lines) != 4 or not lines[2].startswith(_TRUSTED):
        raise FormError("a signature has four lines")
    name, signature = _tagged(lines[1], b"ED", SIGNATURE)
    return Signature(name, signature, lines[2].removeprefix(_TRUSTED), _bytes(lines[3], SIGNATURE))


def verify(file: Path, signature: Signature, key: Ed25519PublicKey) -> None:
    """Raises ForgedError where this key has not signed exactly this file and comment; OSError."""
    with file.open("rb") as stream:
        digest = hashlib.file_digest(stream, hashlib.blake2b).digest()
    try:
        key.verify(signature.signature, digest)
        key.verify(signature.over_comment, signature.signature + signature.comment.encode())
    except InvalidSignature:
        raise ForgedError(f"{file.name} is not what {signature.key} has signed") from None


def _tagged(line: str, tag: bytes, size: int) -> tuple[str, bytes]:
    """Id and what follows it."""
    content = _bytes(line, len(tag) + ID + size)
    if not content.startswith(tag):
        raise FormError(f"another kind than {tag.decode()}")
    number = int.from_bytes(content[len(tag) : len(tag) + ID], "little")
    return f"{number:016X}", content[len(tag) + ID :]


def _bytes(line: str, size: int) -> bytes:
    try:
        content = base64.b64decode(line, validate=True)
    except (binascii.Error, ValueError):
        raise FormError("no base64") from None
    if len(content) != size:
        raise FormError(f"{len(content)} bytes instead of {size}")
    return content
