"""Encrypting the names of a study's participants."""

from collections.abc import Callable

from avrgym.study.storage import identity_keys, keyfile
from avrgym.study.storage.store import Store


def encrypt_names(store: Store, new_passphrase: Callable[[], str] | None = None) -> bool:
    """Encrypt all names with a new key file, or with a new passphrase; whether a plain file was removed.

    Raises:
        Locked: when the names are encrypted, and their present key is not at hand.
        StudyError: for a passphrase that is too short, or when reading back fails. Nothing is changed then.
    """
    keyfile.read_key(store.folder)
    passphrase = new_passphrase() if new_passphrase is not None else None
    if passphrase is not None:
        identity_keys.check_passphrase(passphrase)
    with store.write():  # one writer at a time, for the identity file as well
        present = keyfile.read_key(store.folder)
        was_plain = keyfile.plain_path(store.folder) is not None
        if passphrase is not None:
            identity_keys.give_passphrase(store.folder, passphrase)
        lock = identity_keys.new_lock(passphrase=passphrase is not None)
        keyfile.encrypt_names(store.folder, lock, present)
    return was_plain
