"""The key that encrypts participants' names. Its source is a passphrase, or a key file outside the study.

By default, the key file is in the user's data folder. For servers, an environment variable contains the passphrase or
the path of the key file. If the key is lost, the names are lost, but no other data.
"""

import os
from functools import cache
from pathlib import Path
from typing import Literal
from unicodedata import normalize

import msgspec
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import get_user_data_folder, make_private_folder, write_private_file

PASSPHRASE_VARIABLE, KEY_FILE_VARIABLE = "AVRGYM_STUDY_PASSPHRASE", "AVRGYM_STUDY_KEY_FILE"
"""Environment variables with the passphrase, and with the path of the key file."""
MIN_PASSPHRASE_LENGTH = 8
"""Minimum number of characters of a passphrase."""
SCRYPT_COST = 1 << 17
"""Cost parameter n of scrypt for new passphrases: 128 MB of memory and about 0.5 s for each attempt."""
_MAX_COST = 1 << 20
_KEY_BYTES = 32
_given: dict[Path, str] = {}


class KeyUnavailableError(StudyError):
    """Raised if the key of the identity file is missing or wrong. Nothing was changed."""


class KeySource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Source of an identity file's key.

    ``salt``: hexadecimal; it is also the name of a key file. ``cost``: parameter n of scrypt; 0 for a key file.
    """

    kind: Literal["passphrase", "file"]
    salt: str
    cost: int = 0


def make_key_source(*, passphrase: bool) -> KeySource:
    """Returns a new key source with a random salt."""
    return KeySource(
        "passphrase" if passphrase else "file", os.urandom(16).hex(), SCRYPT_COST if passphrase else 0
    )


def set_passphrase(folder: Path, passphrase: str) -> None:
    """Set the passphrase of the study in a folder for this process."""
    _given[folder.resolve()] = passphrase


def find_passphrase(folder: Path) -> str | None:
    """Returns the passphrase of the study in a folder; ``None`` if neither this process nor the environment has it."""
    return _given.get(folder.resolve()) or os.environ.get(PASSPHRASE_VARIABLE) or None


def check_passphrase(passphrase: str) -> None:
    """Raises ``StudyError`` if the passphrase is too short."""
    if len(passphrase) < MIN_PASSPHRASE_LENGTH:
        raise StudyError(f"the passphrase is too short; allowed: at least {MIN_PASSPHRASE_LENGTH} characters")


def load_key(folder: Path, source: KeySource, *, create: bool = False) -> bytes:
    """Returns the key (32 bytes). With ``create``, a missing key file is created.

    Raises:
        KeyUnavailableError: if the passphrase or the key file is missing.
    """
    if source.kind == "file":
        return _from_file(folder, find_key_file_path(source), create=create)
    passphrase = find_passphrase(folder)
    if passphrase is None:
        raise KeyUnavailableError(
            f"the names are encrypted with a passphrase: set {PASSPHRASE_VARIABLE}, or run `avrgym study` in a "
            f"terminal and "
            "enter it. Nothing was changed"
        )
    if create:
        check_passphrase(passphrase)
    if not 1 < source.cost <= _MAX_COST:
        raise StudyError(
            f"the key derivation cost (n) in the identity file is {source.cost}; allowed: up to {_MAX_COST}"
        )
    try:
        return _from_passphrase(passphrase, source.salt, source.cost)
    except ValueError as error:
        raise StudyError(
            f"the key source in the identity file is damaged: {error}; restore a backup. Nothing was changed"
        ) from None


def find_key_file_path(source: KeySource) -> Path:
    """Returns the path of the key file: the environment variable, or a file in the user's data folder."""
    named = os.environ.get(KEY_FILE_VARIABLE)
    return Path(named) if named else get_user_data_folder() / "keys" / f"{source.salt}.key"


def _from_file(folder: Path, path: Path, *, create: bool) -> bytes:
    if path.resolve().is_relative_to(folder.resolve()):
        raise StudyError(
            f"{path} is in the study's folder; choose a key file in another folder. Nothing was changed"
        )
    if create and not path.exists():
        make_private_folder(path.parent)
        write_private_file(path, os.urandom(_KEY_BYTES).hex() + "\n")
    try:
        key = bytes.fromhex(path.read_text("ascii"))
    except OSError as error:
        raise KeyUnavailableError(
            f"the key file of the identity file, {path}, cannot be read ({error.strerror}). Restore a backup, or set "
            f"{KEY_FILE_VARIABLE} to its path. Nothing was changed. Without the key file, the names are lost, but no "
            "other data"
        ) from None
    except ValueError:
        key = b""
    if len(key) != _KEY_BYTES:
        raise KeyUnavailableError(
            f"{path} is not a key file; allowed: {_KEY_BYTES} bytes in hexadecimal digits"
        )
    return key


@cache
def _from_passphrase(passphrase: str, salt: str, cost: int) -> bytes:
    return Scrypt(salt=bytes.fromhex(salt), length=_KEY_BYTES, n=cost, r=8, p=1).derive(
        normalize("NFC", passphrase).encode("utf-8", "surrogateescape")
    )
