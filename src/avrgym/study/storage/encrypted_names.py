"""The encrypted identity file. Each entry is encrypted separately and can be removed without the key.

AES-256 in Galois/Counter Mode, with a new nonce for each entry; an entry is bound to its pseudonym. Pseudonyms are not
encrypted.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import msgspec
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from avrgym.study.storage.identity_keys import Lock, Locked, key_of, key_path
from avrgym.study.storage.states import StudyError

FORMAT = "avrgym identities 1"
_NONCE_BYTES = 12


class Identity(msgspec.Struct, frozen=True):
    """Name and contact of a participant."""

    name: str
    contact: str


class IdentityFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The contents of the file. ``check`` is the encrypted format: a wrong key cannot decrypt it."""

    format: str
    lock: Lock
    check: str
    entries: dict[str, str]


def decoded(path: Path) -> IdentityFile:
    """The file as it is, without a key; ``StudyError`` for one that is damaged."""
    try:
        file = msgspec.json.decode(path.read_bytes(), type=IdentityFile)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path}: not an identity file: {error}") from None
    if file.format != FORMAT:
        raise StudyError(f"{path}: its format is {file.format!r}; this AVR Gym reads {FORMAT!r}")
    return file


def encoded(file: IdentityFile) -> bytes:
    """The file's bytes."""
    return msgspec.json.format(msgspec.json.encode(file))


def encrypted(folder: Path, lock: Lock, identities: Mapping[str, Identity]) -> IdentityFile:
    """A new identity file with a lock, whose key file is made when it is missing."""
    key = key_of(folder, lock, make=True)
    entries = {pseudonym: _encrypt(key, pseudonym, each) for pseudonym, each in identities.items()}
    file = IdentityFile(FORMAT, lock, _encrypt_bytes(key, FORMAT, FORMAT.encode()), entries)
    _checked(folder, file)
    return file


def decrypted(folder: Path, file: IdentityFile) -> dict[str, Identity]:
    """All entries by pseudonym.

    Raises:
        Locked: without the key, or with a wrong one.
        StudyError: for an entry that was changed.
    """
    key = _checked(folder, file)
    return {pseudonym: _decrypt(key, pseudonym, data) for pseudonym, data in file.entries.items()}


def with_entry(folder: Path, file: IdentityFile, pseudonym: str, identity: Identity) -> IdentityFile:
    """The file with an entry more, or another one; raises as ``decrypted`` does."""
    key = _checked(folder, file)
    return msgspec.structs.replace(
        file, entries=file.entries | {pseudonym: _encrypt(key, pseudonym, identity)}
    )


def without_entry(file: IdentityFile, pseudonym: str) -> IdentityFile:
    """The file without an entry; this needs no key."""
    entries = {name: data for name, data in file.entries.items() if name != pseudonym}
    return msgspec.structs.replace(file, entries=entries)


def _checked(folder: Path, file: IdentityFile) -> bytes:
    """The key, which is the one that the file was encrypted with."""
    key = key_of(folder, file.lock)
    try:
        _decrypt_bytes(key, FORMAT, file.check)
    except InvalidTag:
        which = (
            "the passphrase of the names"
            if file.lock.kind == "passphrase"
            else f"the key file of the names, {key_path(file.lock)},"
        )
        raise Locked(f"{which} is wrong; nothing was changed") from None
    return key


def _encrypt(key: bytes, pseudonym: str, identity: Identity) -> str:
    return _encrypt_bytes(key, pseudonym, msgspec.json.encode(identity))


def _decrypt(key: bytes, pseudonym: str, data: str) -> Identity:
    try:
        return msgspec.json.decode(_decrypt_bytes(key, pseudonym, data), type=Identity)
    except (InvalidTag, msgspec.DecodeError, UnicodeDecodeError):
        raise StudyError(f"the identity of {pseudonym} is damaged or was changed") from None


def _encrypt_bytes(key: bytes, bound_to: str, data: bytes) -> str:
    nonce = os.urandom(_NONCE_BYTES)
    return (nonce + AESGCM(key).encrypt(nonce, data, bound_to.encode())).hex()


def _decrypt_bytes(key: bytes, bound_to: str, data: str) -> bytes:
    try:
        raw = bytes.fromhex(data)
        return AESGCM(key).decrypt(raw[:_NONCE_BYTES], raw[_NONCE_BYTES:], bound_to.encode())
    except ValueError:
        raise InvalidTag from None
