"""Keys and certificates of one small authority (X.509, ECDSA on P-256)."""

import ipaddress
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

AUTHORITY_DAYS: Final = 25 * 365
# A computer without a battery-backed clock starts in 1970 and must be heard all the same.
_BEGIN: Final = datetime(1970, 1, 2, tzinfo=UTC)
_HOST: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9.-]{0,252}")


class HostError(Exception):
    """What was given is neither an address nor a name of a computer."""


def new_authority(name: str, now: datetime) -> tuple[bytes, bytes]:
    """Private key and certificate, PEM."""
    key = ec.generate_private_key(ec.SECP256R1())
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    until = now + timedelta(days=AUTHORITY_DAYS)
    certificate = (
        _certificate(_subject(name), _subject(name), key.public_key(), until)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .sign(key, hashes.SHA256())
    )
    return _pem(key), certificate.public_bytes(serialization.Encoding.PEM)


def issue(
    authority: tuple[bytes, bytes], name: str, hosts: Sequence[str], until: datetime | None
) -> tuple[bytes, bytes]:
    """Private key and certificate of one party, PEM. hosts: how a server is called; none for a client.

    A client's certificate never serves and a server's never asks: a reader cannot pose as the daemon.
    until: as long as the authority's where None, and never longer. Raises HostError.
    """
    signer = serialization.load_pem_private_key(authority[0], None)
    issuer = x509.load_pem_x509_certificate(authority[1])
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    key = ec.generate_private_key(ec.SECP256R1())
    last = issuer.not_valid_after_utc if until is None else min(until, issuer.not_valid_after_utc)
    use = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    signer_id = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    certificate = (
        _certificate(_subject(name), issuer.subject, key.public_key(), last)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
        .add_extension(signer_id, critical=False)
    )
    if hosts:
        names = x509.SubjectAlternativeName([_host(host) for host in hosts])
        certificate = certificate.add_extension(names, critical=False)
    signed = certificate.sign(signer, hashes.SHA256())
    return _pem(key), signed.public_bytes(serialization.Encoding.PEM)


def _certificate(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_BEGIN)
        .not_valid_after(until)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _subject(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not _HOST.fullmatch(host):
        raise HostError(f'"{host}": give an address such as 192.168.1.10, or a name such as tractor.local')
    return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    form = serialization.PrivateFormat.PKCS8
    return key.private_bytes(serialization.Encoding.PEM, form, serialization.NoEncryption())
