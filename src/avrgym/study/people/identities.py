"""Names of participants: encryption of the identity file, and detection of duplicate enrolments."""

import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from pathlib import Path

from avrgym.study.storage import identity_file, identity_keys
from avrgym.study.storage.identity_file import Identity, read_identities
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store


class PossibleDuplicate(StudyError):
    """Someone who may take part already; the message contains pseudonyms and no names."""


def check_duplicate(folder: Path, identity: Identity, *, confirmed: bool, pseudonym: str = "") -> str:
    """The detail of an enrolment event: the participants who look like the same person, or an empty text.

    Args:
        folder: the study's folder.
        identity: the name and contact to be stored.
        confirmed: the experimenter confirms that this is another person.
        pseudonym: the participant of this identity, if there is one; their own entry is not compared.

    Raises:
        PossibleDouble: when the identity file has an entry of the same person, and nobody confirmed the difference.
        Locked: when the names cannot be read without their key.
    """
    if not identity.name and not identity.contact:
        return ""
    doubles = " and ".join(
        other
        for other, known in read_identities(folder).items()
        if other != pseudonym and may_be_same_person(known, identity)
    )
    if doubles and not confirmed:
        raise PossibleDuplicate(
            f"this may be {doubles}, with the same name or contact; nothing was stored. Each person is enrolled once; "
            "if this is another person, confirm that by --confirm-double or on the dashboard"
        )
    return doubles and f"confirmed as another person than {doubles}"


def possible_duplicates(key: Mapping[str, Identity], pseudonyms: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Pairs of these participants that may be one person."""
    for first, second in combinations(sorted(set(pseudonyms) & set(key)), 2):
        if may_be_same_person(key[first], key[second]):
            yield first, second


def may_be_same_person(first: Identity, second: Identity) -> bool:
    """Whether two entries agree in name or contact and differ in neither; one that is empty differs from nothing."""
    pairs = (
        (_plain_name(first.name), _plain_name(second.name)),
        (_plain_contact(first.contact), _plain_contact(second.contact)),
    )
    given = [(one, other) for one, other in pairs if one and other]
    return bool(given) and all(one == other for one, other in given)


def _plain_name(name: str) -> str:
    return " ".join(_folded(name).split())


def _plain_contact(contact: str) -> str:
    """Without any spaces, which mean nothing in addresses and telephone numbers."""
    return "".join(_folded(contact).split())


def _folded(text: str) -> str:
    """Unicode's NFKC form without case and without invisible format characters."""
    folded = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).casefold())
    return "".join(character for character in folded if unicodedata.category(character) != "Cf")


def encrypt_names(store: Store, new_passphrase: Callable[[], str] | None = None) -> bool:
    """Encrypt all names with a new key file, or with a new passphrase; whether a plain file was removed.

    Raises:
        Locked: when the names are encrypted, and their present key is not at hand.
        StudyError: for a passphrase that is too short, or when reading back fails. Nothing is changed then.
    """
    identity_file.read_identities(store.folder)
    passphrase = new_passphrase() if new_passphrase is not None else None
    if passphrase is not None:
        identity_keys.check_passphrase(passphrase)
    with store.write():  # one writer at a time, for the identity file as well
        present = identity_file.read_identities(store.folder)
        was_plain = identity_file.plain_path(store.folder) is not None
        if passphrase is not None:
            identity_keys.set_passphrase(store.folder, passphrase)
        lock = identity_keys.new_key_source(passphrase=passphrase is not None)
        identity_file.encrypt_names(store.folder, lock, present)
    return was_plain
