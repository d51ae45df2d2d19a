"""The key that encrypts a study's names: from a passphrase, or from a key file outside the study.

By default the key file is in the user's data folder. A server reads the passphrase or the key file's path from an
environment variable. Without the key the names are lost, but no other data.
"""

import os
from functools import cache
from pathlib import Path
from typing import Literal
from unicodedata import normalize

import msgspec
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from avrgym.study.storage.states import StudyError
from avrgym.system.files import make_private_folder, user_data_folder, write_new

PASSPHRASE, KEY_FILE = "AVRGYM_STUDY_PASSPHRASE", "AVRGYM_STUDY_KEY_FILE"
"""Variables of the environment."""
MIN_PASSPHRASE_LENGTH = 8
"""Of a passphrase."""
SCRYPT_COST = 1 << 17
"""Scrypt's n for new passphrases: 128 MB and about half a second for each guess."""
_MOST_COST = 1 << 20
_KEY_BYTES = 32
_given: dict[Path, str] = {}


class KeyUnavailable(StudyError):
    """The key of the names is not available; nothing was changed."""


class KeySource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the key of an identity file comes from. ``salt``, hexadecimal, also names a key file."""

    kind: Literal["passphrase", "file"]
    salt: str
    cost: int = 0


def new_key_source(*, passphrase: bool) -> KeySource:
    """A lock with a new salt."""
    return KeySource(
        "passphrase" if passphrase else "file", os.urandom(16).hex(), SCRYPT_COST if passphrase else 0
    )


def set_passphrase(folder: Path, passphrase: str) -> None:
    """Use a passphrase for the study in a folder as long as this process runs."""
    _given[folder.resolve()] = passphrase


def known_passphrase(folder: Path) -> str | None:
    """The passphrase that was given to this process for the study in a folder, if any."""
    return _given.get(folder.resolve()) or os.environ.get(PASSPHRASE) or None


def check_passphrase(passphrase: str) -> None:
    """Raise ``StudyError`` for a passphrase that is too short."""
    if len(passphrase) < MIN_PASSPHRASE_LENGTH:
        raise StudyError(f"a passphrase has at least {MIN_PASSPHRASE_LENGTH} characters; nothing was changed")


def load_key(folder: Path, lock: KeySource, *, make: bool = False) -> bytes:
    """The key of a lock; ``make`` makes a key file that is missing.

    Raises:
        Locked: when passphrase or key file are not at hand.
    """
    if lock.kind == "file":
        return _from_file(folder, key_path(lock), make=make)
    passphrase = known_passphrase(folder)
    if passphrase is None:
        raise KeyUnavailable(
            f"the names are locked with a passphrase: set {PASSPHRASE}, or use `avrgym study` on a terminal, which "
            "asks for it; nothing was changed"
        )
    if make:
        check_passphrase(passphrase)
    if not 1 < lock.cost <= _MOST_COST:
        raise StudyError(f"the identity file asks for a cost of {lock.cost}; allowed: up to {_MOST_COST}")
    try:
        return _from_passphrase(passphrase, lock.salt, lock.cost)
    except ValueError as error:
        raise StudyError(f"the lock of the identity file is damaged: {error}; nothing was changed") from None


def key_path(lock: KeySource) -> Path:
    """Where the key file of a lock is."""
    named = os.environ.get(KEY_FILE)
    return Path(named) if named else user_data_folder() / "keys" / f"{lock.salt}.key"


def _from_file(folder: Path, path: Path, *, make: bool) -> bytes:
    if path.resolve().is_relative_to(folder.resolve()):
        raise StudyError(f"{path} is in the study's folder; choose a key file elsewhere; nothing was changed")
    if make and not path.exists():
        make_private_folder(path.parent)
        write_new(path, os.urandom(_KEY_BYTES).hex() + "\n")
    try:
        key = bytes.fromhex(path.read_text("ascii"))
    except OSError as error:
        raise KeyUnavailable(
            f"the key file of the names, {path}, cannot be read ({error.strerror}): restore a copy, or name it in "
            f"{KEY_FILE}; nothing was changed. Without it the names are lost, but no other data"
        ) from None
    except ValueError:
        key = b""
    if len(key) != _KEY_BYTES:
        raise KeyUnavailable(f"{path} is no key file: it has {_KEY_BYTES} bytes in hexadecimal digits")
    return key


@cache
def _from_passphrase(passphrase: str, salt: str, cost: int) -> bytes:
    return Scrypt(salt=bytes.fromhex(salt), length=_KEY_BYTES, n=cost, r=8, p=1).derive(
        normalize("NFC", passphrase).encode("utf-8", "surrogateescape")
    )
