"""The user's signing key (Ed25519), and the last entry that the user wrote in each participation list.

Both are in the user's data folder, outside all studies. They reveal an edited list, an older copy of a list, and the
list of another study.
"""

import hashlib
import os
from contextlib import suppress
from functools import cache
from pathlib import Path

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from avrgym.system.files import (
    PRIVATE_FILE_MODE,
    get_user_data_folder,
    make_private_folder,
    open_privately,
    write_atomically,
)

SIGNING_KEY_FILE = "signing-key.pem"
"""File name of the signing key, in the user's data folder."""
_STUDIES = "studies"


class LastParticipationEntry(msgspec.Struct, frozen=True, rename={"list_id": "list_digest"}):
    """The last entry that this user wrote in a participation list.

    ``folder``: folder of the study. ``list_id``: id of the list. ``digest``: digest of the entry.
    """

    folder: str
    list_id: str
    digest: str


def load_signing_key() -> Ed25519PrivateKey | None:
    """Returns the user's signing key; ``None`` if it cannot be read or written. A missing key is created."""
    try:
        return _key_in(get_user_data_folder())
    except (OSError, ValueError):
        return None


@cache
def _key_in(folder: Path) -> Ed25519PrivateKey:
    path = folder / SIGNING_KEY_FILE
    if not path.exists():
        _make_key(path)
    key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    if not isinstance(key, Ed25519PrivateKey):
        raise ValueError(f"{path} does not contain an Ed25519 key; restore a backup of the file")
    return key


def _make_key(path: Path) -> None:
    """Write a new key atomically. A key that another process has written is not replaced."""
    make_private_folder(path.parent)
    pem = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    with open(temporary, "xb", opener=open_privately) as file:
        file.write(pem)
        file.flush()
        os.fsync(file.fileno())
    with suppress(FileExistsError):
        os.link(temporary, path)
    temporary.unlink()


def encode_public_key(key: Ed25519PrivateKey) -> str:
    """Returns the public key as hexadecimal digits."""
    return key.public_key().public_bytes_raw().hex()


def is_signature_valid(public: str, signature: str, text: str) -> bool:
    """Returns whether the signature of a text is valid for a public key."""
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(public))
        key.verify(bytes.fromhex(signature), text.encode())
    except (InvalidSignature, ValueError):
        return False
    return True


def store_last_entry(folder: Path, list_id: str, digest: str) -> None:
    """Store the last entry of a study's participation list in the user's data folder. Errors are ignored."""
    known = LastParticipationEntry(str(folder.resolve()), list_id, digest)
    with suppress(OSError, ValueError):
        path = _path_of(folder)
        make_private_folder(path.parent)
        write_atomically(path, msgspec.json.encode(known), PRIVATE_FILE_MODE)


def read_last_entry(folder: Path) -> LastParticipationEntry | None:
    """Returns the stored last entry of the study in a folder; ``None`` if none is stored."""
    with suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
        return _read(_path_of(folder))
    return None


def find_last_entry_of_moved_study(list_id: str) -> LastParticipationEntry | None:
    """Returns the stored last entry of a list if its study's folder no longer exists; otherwise ``None``."""
    for path in sorted((get_user_data_folder() / _STUDIES).glob("*.json")):
        with suppress(OSError, msgspec.DecodeError, UnicodeDecodeError):
            known = _read(path)
            if known.list_id == list_id and not Path(known.folder).exists():
                return known
    return None


def _read(path: Path) -> LastParticipationEntry:
    return msgspec.json.decode(path.read_bytes(), type=LastParticipationEntry)


def _path_of(folder: Path) -> Path:
    name = hashlib.sha256(str(folder.resolve()).encode("utf-8", "surrogateescape")).hexdigest()[:32]
    return get_user_data_folder() / _STUDIES / f"{name}.json"
