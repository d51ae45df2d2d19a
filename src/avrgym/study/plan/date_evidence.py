"""Evidence for the date of a frozen plan: a time stamp (RFC 3161), or a registration that researchers claim.

A time stamp contains the SHA-256 of ``plan-frozen.json`` and a time, signed by an authority. Verification needs no
network. The authority is trusted if this computer has its root certificate.
"""

import ssl
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from cryptography import x509
from cryptography.utils import CryptographyDeprecationWarning

from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import PRIVATE_FILE_MODE, write_atomically

if TYPE_CHECKING:
    from rfc3161_client import TimeStampResponse


_PATH = (0, 1, 1, 0)
"""Indices of nested DER elements: the path from a response to its signed data."""
_CERTIFICATES = 0xA0
"""DER tag of the certificates in signed data."""


def sort_certificates(response: bytes) -> bytes:
    """Returns the response of a time stamping authority with sorted certificates, as DER requires.

    Raises:
        IndexError: if the bytes are not a response of an authority.
    """
    start, end = 0, len(response)
    for place in _PATH:
        _, _, start, end = list(_elements(response, start, end))[place]
    for tag, _, first, last in _elements(response, start, end):
        if tag == _CERTIFICATES:
            certificates = sorted(response[at:after] for _, at, _, after in _elements(response, first, last))
            return response[:first] + b"".join(certificates) + response[last:]
    return response


def _elements(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yields DER elements between two offsets: tag, and offsets of the element, of its content and of its end."""
    while start < end:
        length, content = data[start + 1], start + 2
        if length & 0x80:
            content += length & 0x7F
            length = int.from_bytes(data[start + 2 : content])
        yield data[start], start, content, content + length
        start = content + length


TIME_STAMP_FILE = "plan-frozen.tsr"
REGISTRATION_FILE = "plan-registration.json"


class Registration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """URL and day of a registration, as claimed by the researchers."""

    url: str
    registered_on: date = msgspec.field(name="on")


@dataclass(frozen=True)
class TimeStamp:
    """A verified time stamp. ``is_trusted``: this computer has the root certificate of the authority."""

    issued_at: datetime
    authority: str
    is_trusted: bool


def store_time_stamp(folder: Path, data: bytes, record: bytes) -> TimeStamp:
    """Verify the time stamp of a frozen plan, and store it next to the plan. Returns the time stamp.

    Args:
        folder: the study's folder.
        data: the authority's response.
        record: contents of ``plan-frozen.json``.

    Raises:
        StudyError: if the time stamp is not valid for this record, or if another one is stored. Nothing is stored then.
    """
    stamp = verify_time_stamp(data, record)
    _refuse_other(folder / TIME_STAMP_FILE, data)
    write_atomically(folder / TIME_STAMP_FILE, data, PRIVATE_FILE_MODE)
    return stamp


def store_registration(folder: Path, url: str, on: date) -> None:
    """Store URL and date of the plan's registration. They are not verified.

    Raises ``StudyError`` for an invalid URL, or if another registration is stored.
    """
    if not url.startswith(("https://", "http://")) or not url.isprintable() or len(url) > 500:
        raise StudyError(
            f"{url[:100]!r} is not a valid URL; allowed: http://… or https://…, at most 500 characters"
        )
    data = msgspec.json.format(msgspec.json.encode(Registration(url, on))) + b"\n"
    _refuse_other(folder / REGISTRATION_FILE, data)
    write_atomically(folder / REGISTRATION_FILE, data, PRIVATE_FILE_MODE)


def _refuse_other(path: Path, data: bytes) -> None:
    if path.exists() and path.read_bytes() != data:
        raise StudyError(f"{path} exists already and was not changed; remove it to store another one")


def read_time_stamp(folder: Path, record: bytes) -> TimeStamp | None:
    """Returns the stored time stamp; ``None`` if there is none.

    Raises ``StudyError`` if the time stamp belongs to another record.
    """
    path = folder / TIME_STAMP_FILE
    return verify_time_stamp(path.read_bytes(), record) if path.exists() else None


def read_registration(folder: Path) -> Registration | None:
    """Returns the stored registration; ``None`` if there is none. Raises ``StudyError`` if the file is damaged."""
    path = folder / REGISTRATION_FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=Registration) if path.exists() else None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{REGISTRATION_FILE} is damaged: {error}; restore a backup") from None


def verify_time_stamp(data: bytes, record: bytes) -> TimeStamp:
    """Returns the time stamp in an authority's response (``data``).

    Raises ``StudyError`` if it is not a valid time stamp of ``record``.
    """
    from rfc3161_client import VerificationError, VerifierBuilder, decode_timestamp_response

    try:
        response = decode_timestamp_response(sort_certificates(data))
        embedded = [x509.load_der_x509_certificate(each) for each in response.signed_data.certificates]
    except (ValueError, IndexError) as error:
        raise StudyError(f"not a time stamp: {error}; allowed: a .tsr file (RFC 3161)") from None
    known = [each for each in _system_roots() if _may_sign(each, embedded)]
    own = [each for each in embedded if each.issuer == each.subject]
    fault = "no root certificate is in the file or on this computer"
    for roots, is_trusted in ((known, True), (own, False)):
        if roots:
            try:
                VerifierBuilder(roots=roots).build().verify_message(response, record)
            except VerificationError as error:
                fault = str(error)
            else:
                return TimeStamp(
                    response.tst_info.gen_time.astimezone(UTC), _signer(response, embedded), is_trusted
                )
    raise StudyError(
        f"not a valid time stamp of this plan: {fault}; request a time stamp for plan-frozen.json"
    )


def _may_sign(root: x509.Certificate, certificates: Sequence[x509.Certificate]) -> bool:
    return any(root.subject in (each.issuer, each.subject) for each in certificates)


def _signer(response: "TimeStampResponse", certificates: Sequence[x509.Certificate]) -> str:
    (signer,) = response.signed_data.signer_infos
    leaf = next(each for each in certificates if each.serial_number == signer.serial_number)
    return leaf.subject.rfc4514_string()


def _system_roots() -> list[x509.Certificate]:
    """Returns all valid root certificates that this computer trusts."""
    found: list[x509.Certificate] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error", CryptographyDeprecationWarning)
        for data in ssl.create_default_context().get_ca_certs(binary_form=True):
            with suppress(ValueError, CryptographyDeprecationWarning):
                found.append(x509.load_der_x509_certificate(data))
    return found
