"""The identity file: the only file with names and contacts of participants. Each entry is encrypted separately.

It is ``private/identities.json``; only the folder's owner can open the folder. The key is stored elsewhere, see
``identity_keys``. The cipher is AES-256-GCM with a new nonce for each entry. Each entry is bound to its pseudonym.
Pseudonyms are not encrypted, so an entry can be removed without the key. Writers must hold the database lock.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import msgspec
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from avrgym.study.storage.identity_keys import (
    KEY_FILE_VARIABLE,
    KeySource,
    KeyUnavailableError,
    find_key_file_path,
    find_passphrase,
    load_key,
    make_key_source,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import PRIVATE_FILE_MODE, PRIVATE_FOLDER_MODE, make_private_folder, write_atomically

IDENTITY_FORMAT = "avrgym identities 1"
"""Name and version of the file format."""
_NONCE_BYTES = 12


class Identity(msgspec.Struct, frozen=True):
    """Name and contact of a participant."""

    name: str
    contact: str


class IdentityFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contents of the identity file.

    ``key_source``: source of the key. ``key_check``: encrypted ``format``; only the correct key can decrypt it.
    ``entries``: encrypted identities, by pseudonym.
    """

    format: str
    key_source: KeySource = msgspec.field(name="lock")
    key_check: str = msgspec.field(name="check")
    entries: dict[str, str]


def read_identity_file(path: Path) -> IdentityFile:
    """Returns the contents of an identity file without decryption. Raises ``StudyError`` if the file is damaged."""
    try:
        file = msgspec.json.decode(path.read_bytes(), type=IdentityFile)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path} is not an identity file: {error}; restore a backup") from None
    if file.format != IDENTITY_FORMAT:
        raise StudyError(f"{path} has format {file.format!r}; allowed: {IDENTITY_FORMAT!r}")
    return file


def encode_identity_file(file: IdentityFile) -> bytes:
    """Returns the contents of an identity file as JSON."""
    return msgspec.json.format(msgspec.json.encode(file))


def encrypt_identities(
    folder: Path, key_source: KeySource, identities: Mapping[str, Identity]
) -> IdentityFile:
    """Returns the contents of a new identity file with encrypted identities. A missing key file is created."""
    key = load_key(folder, key_source, create=True)
    entries = {pseudonym: _encrypt(key, pseudonym, each) for pseudonym, each in identities.items()}
    file = IdentityFile(
        IDENTITY_FORMAT, key_source, _encrypt_bytes(key, IDENTITY_FORMAT, IDENTITY_FORMAT.encode()), entries
    )
    _checked(folder, file)
    return file


def decrypt_identities(folder: Path, file: IdentityFile) -> dict[str, Identity]:
    """Returns the decrypted identities, by pseudonym.

    Raises:
        KeyUnavailableError: if the key is missing or wrong.
        StudyError: if an entry was changed.
    """
    key = _checked(folder, file)
    return {pseudonym: _decrypt(key, pseudonym, data) for pseudonym, data in file.entries.items()}


def set_encrypted_identity(
    folder: Path, file: IdentityFile, pseudonym: str, identity: Identity
) -> IdentityFile:
    """Returns the file's contents with an added or replaced entry. Raises the errors of ``decrypt_identities``."""
    key = _checked(folder, file)
    return msgspec.structs.replace(
        file, entries=file.entries | {pseudonym: _encrypt(key, pseudonym, identity)}
    )


def remove_encrypted_identity(file: IdentityFile, pseudonym: str) -> IdentityFile:
    """Returns the file's contents without an entry. No key is needed."""
    entries = {name: data for name, data in file.entries.items() if name != pseudonym}
    return msgspec.structs.replace(file, entries=entries)


def _checked(folder: Path, file: IdentityFile) -> bytes:
    """Returns the key. Raises ``KeyUnavailableError`` if it is missing or wrong."""
    key = load_key(folder, file.key_source)
    try:
        _decrypt_bytes(key, IDENTITY_FORMAT, file.key_check)
    except InvalidTag:
        which = (
            "the passphrase of the identity file"
            if file.key_source.kind == "passphrase"
            else f"the key file of the identity file, {find_key_file_path(file.key_source)},"
        )
        raise KeyUnavailableError(f"{which} is wrong. Nothing was changed") from None
    return key


def _encrypt(key: bytes, pseudonym: str, identity: Identity) -> str:
    return _encrypt_bytes(key, pseudonym, msgspec.json.encode(identity))


def _decrypt(key: bytes, pseudonym: str, data: str) -> Identity:
    try:
        return msgspec.json.decode(_decrypt_bytes(key, pseudonym, data), type=Identity)
    except (InvalidTag, msgspec.DecodeError, UnicodeDecodeError):
        raise StudyError(f"the identity of {pseudonym} is damaged or was changed; restore a backup") from None


def _encrypt_bytes(key: bytes, bound_to: str, data: bytes) -> str:
    nonce = os.urandom(_NONCE_BYTES)
    return (nonce + AESGCM(key).encrypt(nonce, data, bound_to.encode())).hex()


def _decrypt_bytes(key: bytes, bound_to: str, data: str) -> bytes:
    try:
        raw = bytes.fromhex(data)
        return AESGCM(key).decrypt(raw[:_NONCE_BYTES], raw[_NONCE_BYTES:], bound_to.encode())
    except ValueError:
        raise InvalidTag from None


IDENTITY_FOLDER = "private"
UNENCRYPTED_IDENTITY_FILE, ENCRYPTED_IDENTITY_FILE = "key.json", "identities.json"
"""File names of the unencrypted and of the encrypted identity file."""
_NEW = f"{ENCRYPTED_IDENTITY_FILE}.new"


def find_identity_file_path(folder: Path) -> Path:
    """Returns the path of the encrypted identity file, or of the unencrypted file if only this file exists."""
    plain, path = (
        folder / IDENTITY_FOLDER / UNENCRYPTED_IDENTITY_FILE,
        folder / IDENTITY_FOLDER / ENCRYPTED_IDENTITY_FILE,
    )
    return plain if plain.exists() and not path.exists() else path


def find_unencrypted_identity_file(folder: Path) -> Path | None:
    """Returns the path of the unencrypted identity file; ``None`` if it does not exist."""
    path = folder / IDENTITY_FOLDER / UNENCRYPTED_IDENTITY_FILE
    return path if path.exists() else None


def read_key_source(folder: Path) -> KeySource | None:
    """Returns the key source of the encrypted identity file; ``None`` if the file does not exist."""
    path = folder / IDENTITY_FOLDER / ENCRYPTED_IDENTITY_FILE
    return read_identity_file(path).key_source if path.exists() else None


def read_pseudonyms_with_identity(folder: Path) -> set[str]:
    """Returns the pseudonyms in the identity file. No key is needed. Raises ``StudyError`` if the file is damaged."""
    path = find_identity_file_path(folder)
    if not path.exists():
        return set()
    return set(
        _read_plain(path) if path.name == UNENCRYPTED_IDENTITY_FILE else read_identity_file(path).entries
    )


def read_identities(folder: Path) -> dict[str, Identity]:
    """Returns all identities, by pseudonym.

    Raises:
        KeyUnavailableError: if the key is missing or wrong.
        StudyError: if the file is damaged.
    """
    path = find_identity_file_path(folder)
    if not path.exists():
        return {}
    return (
        _read_plain(path)
        if path.name == UNENCRYPTED_IDENTITY_FILE
        else decrypt_identities(folder, read_identity_file(path))
    )


def store_identity(folder: Path, pseudonym: str, identity: Identity) -> None:
    """Add or replace a participant's entry. An unencrypted file stays unencrypted.

    Raises the errors of ``read_identities``.
    """
    create_identity_file(folder)
    path = find_identity_file_path(folder)
    if path.name == UNENCRYPTED_IDENTITY_FILE:
        _write(folder, UNENCRYPTED_IDENTITY_FILE, _encoded_plain(_read_plain(path) | {pseudonym: identity}))
    else:
        _write(
            folder,
            ENCRYPTED_IDENTITY_FILE,
            encode_identity_file(
                set_encrypted_identity(folder, read_identity_file(path), pseudonym, identity)
            ),
        )


def create_identity_file(folder: Path) -> None:
    """Create an empty identity file if none exists. Its key source is the known passphrase, or a new key file.

    Raises:
        StudyError: if the key cannot be created.
    """
    if not find_identity_file_path(folder).exists():
        key_source = make_key_source(
            passphrase=find_passphrase(folder) is not None and KEY_FILE_VARIABLE not in os.environ
        )
        _write(
            folder, ENCRYPTED_IDENTITY_FILE, encode_identity_file(encrypt_identities(folder, key_source, {}))
        )


def remove_identity(folder: Path, pseudonym: str) -> None:
    """Remove a participant's entry, and all temporary files that may contain it. No key is needed."""
    remove_leftover_identity_files(folder)
    plain, path = (
        folder / IDENTITY_FOLDER / UNENCRYPTED_IDENTITY_FILE,
        folder / IDENTITY_FOLDER / ENCRYPTED_IDENTITY_FILE,
    )
    if plain.exists() and pseudonym in (entries := _read_plain(plain)):
        del entries[pseudonym]
        _write(folder, UNENCRYPTED_IDENTITY_FILE, _encoded_plain(entries))
    if path.exists() and pseudonym in (file := read_identity_file(path)).entries:
        _write(
            folder, ENCRYPTED_IDENTITY_FILE, encode_identity_file(remove_encrypted_identity(file, pseudonym))
        )


def encrypt_identity_file(folder: Path, key_source: KeySource, present: Mapping[str, Identity]) -> None:
    """Encrypt the identity file with a new key. An unencrypted file is removed after verification.

    Args:
        folder: the study's folder.
        key_source: source of the new key.
        present: the current entries, as ``read_identities`` returns them.

    Raises:
        StudyError: if only the unencrypted file contains an entry, or if verification fails.
    """
    plain = find_unencrypted_identity_file(folder)
    lacking = sorted(set(_read_plain(plain)) - set(present)) if plain else []
    if lacking:
        raise StudyError(
            f"{plain} contains {', '.join(lacking)}, but {ENCRYPTED_IDENTITY_FILE} does not; restore a backup of "
            f"both files. "
            "Nothing was changed"
        )
    _write(folder, _NEW, encode_identity_file(encrypt_identities(folder, key_source, present)))
    new = folder / IDENTITY_FOLDER / _NEW
    if decrypt_identities(folder, read_identity_file(new)) != present:
        raise StudyError(f"{new} could not be verified. Nothing was changed; run the command again")
    os.replace(new, folder / IDENTITY_FOLDER / ENCRYPTED_IDENTITY_FILE)
    if plain:
        remove_leftover_identity_files(folder)
        plain.unlink()


def _read_plain(path: Path) -> dict[str, Identity]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Identity])
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path} is not an identity file: {error}; restore a backup") from None


def _encoded_plain(entries: Mapping[str, Identity]) -> bytes:
    return msgspec.json.format(msgspec.json.encode(entries))


def _write(folder: Path, name: str, data: bytes) -> None:
    private = folder / IDENTITY_FOLDER
    make_private_folder(private)
    private.chmod(PRIVATE_FOLDER_MODE)
    remove_leftover_identity_files(folder)
    write_atomically(private / name, data, mode=PRIVATE_FILE_MODE)


def find_leftover_identity_files(folder: Path) -> list[Path]:
    """Returns the temporary identity files of killed processes. The caller must hold the database lock."""
    names = (UNENCRYPTED_IDENTITY_FILE, ENCRYPTED_IDENTITY_FILE, _NEW)
    parts = (path for name in names for path in (folder / IDENTITY_FOLDER).glob(f".{name}.*.part"))
    return sorted([*parts, *(folder / IDENTITY_FOLDER).glob(_NEW)])


def remove_leftover_identity_files(folder: Path) -> None:
    """Remove temporary identity files of killed processes."""
    for path in find_leftover_identity_files(folder):
        path.unlink(missing_ok=True)
