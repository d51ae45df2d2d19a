"""Encrypt the identity file, and detect duplicate enrolments by name or contact."""

import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from pathlib import Path

from avrgym.study.storage import identity_file, identity_keys
from avrgym.study.storage.identity_file import Identity, read_identities
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore


class PossibleDuplicateError(StudyError):
    """Error: the person may already be enrolled. The message contains pseudonyms and no names."""


def check_duplicate_enrolment(
    folder: Path, identity: Identity, *, confirmed: bool, pseudonym: str = ""
) -> str:
    """Check that no other participant has the same name or contact.

    Args:
        folder: the study's folder.
        identity: the new name and contact.
        confirmed: the experimenter confirms that this is another person.
        pseudonym: the participant's pseudonym, if enrolled; their own entry is not compared.

    Returns:
        The text for the event about a confirmed duplicate; empty without duplicates.

    Raises:
        PossibleDuplicateError: if another participant has the same name or contact, unless ``confirmed``.
        KeyUnavailableError: if the identity file cannot be decrypted without its key.
    """
    if not identity.name and not identity.contact:
        return ""
    duplicates = " and ".join(
        other
        for other, known in read_identities(folder).items()
        if other != pseudonym and may_be_same_person(known, identity)
    )
    if duplicates and not confirmed:
        raise PossibleDuplicateError(
            f"{duplicates} has the same name or contact. Nothing was stored, because each person may enrol only once. "
            "If this is another person, use --confirm-duplicate or confirm it on the dashboard"
        )
    return duplicates and f"confirmed as another person than {duplicates}"


def find_possible_duplicate_pairs(
    key: Mapping[str, Identity], pseudonyms: Iterable[str]
) -> Iterator[tuple[str, str]]:
    """Yields the pairs of pseudonyms that may belong to the same person."""
    for first, second in combinations(sorted(set(pseudonyms) & set(key)), 2):
        if may_be_same_person(key[first], key[second]):
            yield first, second


def may_be_same_person(first: Identity, second: Identity) -> bool:
    """Returns whether names and contacts of two identities are equal. Empty values are ignored.

    Returns false if no value is comparable.
    """
    pairs = (
        (_plain_name(first.name), _plain_name(second.name)),
        (_plain_contact(first.contact), _plain_contact(second.contact)),
    )
    given = [(one, other) for one, other in pairs if one and other]
    return bool(given) and all(one == other for one, other in given)


def _plain_name(name: str) -> str:
    return " ".join(_folded(name).split())


def _plain_contact(contact: str) -> str:
    """Returns the contact without spaces, for comparison."""
    return "".join(_folded(contact).split())


def _folded(text: str) -> str:
    """Returns the text for comparison: Unicode NFKC, case-folded, without format characters."""
    folded = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).casefold())
    return "".join(character for character in folded if unicodedata.category(character) != "Cf")


def encrypt_participant_names(store: StudyStore, new_passphrase: Callable[[], str] | None = None) -> bool:
    """Encrypt all names with a new key. Returns whether an unencrypted file was removed.

    ``new_passphrase``: returns the new passphrase; default: a new key file is used.

    Raises:
        KeyUnavailableError: if the current key of encrypted names is missing.
        StudyError: if the passphrase is too short, or if verification fails. Nothing is changed then.
    """
    identity_file.read_identities(store.folder)
    passphrase = new_passphrase() if new_passphrase is not None else None
    if passphrase is not None:
        identity_keys.check_passphrase(passphrase)
    with store.write_transaction():  # the lock also protects the identity file
        present = identity_file.read_identities(store.folder)
        was_plain = identity_file.find_unencrypted_identity_file(store.folder) is not None
        if passphrase is not None:
            identity_keys.set_passphrase(store.folder, passphrase)
        lock = identity_keys.make_key_source(passphrase=passphrase is not None)
        identity_file.encrypt_identity_file(store.folder, lock, present)
    return was_plain
