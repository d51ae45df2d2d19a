"""A self-signed certificate for headsets in the local network.

Browsers allow WebXR only on secure pages. The browser of a headset asks once whether to trust the certificate.
"""

import datetime
import ipaddress
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from avrgym.system.files import write_atomically

CERTIFICATE_VALIDITY_DAYS = 90
MIN_REMAINING_VALIDITY_DAYS = 14
TEST_NET_ADDRESS = "192.0.2.1"
"""An address that no host has (RFC 5737). The route to this address starts at this computer's own address. No packet is
sent."""


@dataclass(frozen=True)
class Certificate:
    """A certificate: its two files in PEM format, and the host names and addresses for which it is valid."""

    certificate_file: Path
    key_file: Path
    host_names: tuple[str, ...]


def find_lan_host_names() -> tuple[str, ...]:
    """Returns this computer's address and host names in the local network."""
    host = socket.gethostname().partition(".")[0].lower()
    return (*_lan_addresses(), host, f"{host}.local")


def _lan_addresses() -> tuple[str, ...]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((TEST_NET_ADDRESS, 9))
        except OSError:
            return ()
        address = probe.getsockname()[0]
    return () if ipaddress.ip_address(address).is_loopback else (address,)


def load_or_create_certificate(names: Sequence[str], folder: Path) -> Certificate:
    """Returns the certificate in a folder.

    Creates a new certificate if it is missing, expires soon, or is not valid for one of ``names``.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = locate_certificate(folder, names)
    if find_renewal_reason(found) is not None:
        _make(found)
    return found


def locate_certificate(folder: Path, names: Sequence[str]) -> Certificate:
    """Returns a certificate with these names and with paths in this folder. The files need not exist."""
    return Certificate(folder / "certificate.pem", folder / "key.pem", tuple(names))


def find_renewal_reason(wanted: Certificate) -> str | None:
    """Returns the reason why a new certificate is needed; ``None`` if the current one is valid."""
    try:
        certificate = x509.load_pem_x509_certificate(wanted.certificate_file.read_bytes())
        key = serialization.load_pem_private_key(wanted.key_file.read_bytes(), None)
    except (OSError, ValueError):
        return "it or its key cannot be read"
    if certificate.public_key() != key.public_key():
        return "its key does not match"
    ends = certificate.not_valid_after_utc
    if ends <= datetime.timedelta(days=MIN_REMAINING_VALIDITY_DAYS) + datetime.datetime.now(datetime.UTC):
        return f"it expires on {ends:%Y-%m-%d}"
    known = set(certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    if not set(_alternative_names(wanted.host_names)) <= known:
        return "it lacks a current name or address of this computer"
    return None


def _make(wanted: Certificate) -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    write_atomically(
        wanted.key_file,
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        ),
        mode=0o600,
    )
    certificate = _signed(key, wanted.host_names)
    write_atomically(
        wanted.certificate_file, certificate.public_bytes(serialization.Encoding.PEM), mode=0o600
    )


def _signed(key: ec.EllipticCurvePrivateKey, names: Sequence[str]) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "AVR Gym")])
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=CERTIFICATE_VALIDITY_DAYS))
        .add_extension(x509.SubjectAlternativeName(_alternative_names(names)), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )


def _alternative_names(names: Sequence[str]) -> list[x509.GeneralName]:
    return [_alternative_name(name) for name in ("localhost", "127.0.0.1", *names)]


def _alternative_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)
