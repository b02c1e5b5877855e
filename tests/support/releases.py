"""Packages as a release has them: signed in minisign's form, of a version of its own, sound or broken."""

import base64
import hashlib
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tilth.deploy.package import debian_package


def _here() -> str:
    if shutil.which("dpkg") is None:  # no Debian: who asks for packages is skipped
        return ""
    asked = ["dpkg", "--print-architecture"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


HERE = _here()


@dataclass(frozen=True, slots=True)
class SigningKey:
    """Of a seed, so that it is the same each time; signs as minisign does, without the program."""

    seed: int

    @property
    def number(self) -> bytes:
        return self.seed.to_bytes(8, "little")

    @property
    def key(self) -> Ed25519PrivateKey:
        return Ed25519PrivateKey.from_private_bytes(self.seed.to_bytes(32, "little"))

    @property
    def name(self) -> str:
        return f"{self.seed:016X}"

    def public(self) -> str:
        content = b"Ed" + self.number + self.key.public_key().public_bytes_raw()
        return f"untrusted comment: minisign public key {self.name}\n{base64.b64encode(content).decode()}\n"

    def sign(self, file: Path, comment: str = "tilth") -> Path:
        signature = self.key.sign(hashlib.blake2b(file.read_bytes()).digest())
        over_comment = self.key.sign(signature + comment.encode())
        lines = (
            "untrusted comment: signature",
            base64.b64encode(b"ED" + self.number + signature).decode(),
            f"trusted comment: {comment}",
            base64.b64encode(over_comment).decode(),
        )
        signed = file.with_name(f"{file.name}.minisig")
        signed.write_text("".join(f"{line}\n" for line in lines))
        return signed


def release_of(wheel: Path, folder: Path, version: str, broken: Mapping[str, bytes] | None = None) -> Path:
    """The package of Tilth's wheel alone, as of that version; broken: modules with other content."""
    _, own, tags = wheel.name.split("-", 2)
    wheels = folder / f"wheels-{version}"
    wheels.mkdir(parents=True)
    with (
        zipfile.ZipFile(wheel) as old,
        zipfile.ZipFile(wheels / f"tilth-{version}-{tags}", "w", zipfile.ZIP_STORED) as new,
    ):
        for name in old.namelist():
            content = (broken or {}).get(name, old.read(name))
            if name.endswith("/METADATA"):
                content = content.replace(f"\nVersion: {own}\n".encode(), f"\nVersion: {version}\n".encode())
            if not name.endswith("/RECORD"):
                new.writestr(name.replace(f"tilth-{own}.dist-info", f"tilth-{version}.dist-info"), content)
            else:
                new.writestr(f"tilth-{version}.dist-info/RECORD", "")
    package = debian_package(wheels, folder / f"tree-{version}", folder)
    shutil.rmtree(folder / f"tree-{version}")
    return package


def package_of(
    folder: Path, version: str, architecture: str = HERE, *, said: str = "", holds: bytes = b""
) -> Path:
    """A small one, of one file. said: the architecture in its name, where it is another one."""
    tree = folder / "tree"
    (tree / "DEBIAN").mkdir(parents=True)
    fields = (
        f"Package: tilth\nVersion: {version}-1\nArchitecture: {architecture}\nMaintainer: T <t@example.org>\n"
    )
    (tree / "DEBIAN/control").write_text(f"{fields}Description: none\n")
    (tree / "file").write_bytes(holds)
    package = folder / f"tilth_{version}-1_{said or architecture}.deb"
    subprocess.run(["dpkg-deb", "--build", tree, package], check=True, stdout=subprocess.DEVNULL)
    shutil.rmtree(tree)
    return package
