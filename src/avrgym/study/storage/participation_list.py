"""The participation list: a signed file next to the database, with every change of a participant's state.

If the database is lost, ``participation.jsonl`` still contains withdrawals, exclusions and deletions. An entry is
written before its transaction is committed, so a crash loses no withdrawal. The digest of each entry covers the
previous entry (hash chain), and the user's key signs each digest. When a participant is deleted, the contents of the
participant's entries are erased, but not their checksums and digests.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from avrgym.recording.configuration import RecordedConsent
from avrgym.study.storage import signing
from avrgym.study.storage.hash_chain import compute_json_sha256
from avrgym.study.storage.schema import make_salt
from avrgym.system.files import PRIVATE_FILE_MODE, open_privately, write_atomically

PARTICIPATION_LIST_FILE = "participation.jsonl"
INVALID_COPY_PATTERN = re.compile(rf"{re.escape(PARTICIPATION_LIST_FILE)}\.(?:invalid|unsound)-([0-9]+)")
"""Pattern of the file names of renamed invalid lists. Earlier versions used the suffix ``unsound``."""
DELETED_STATE = "deleted"
"""State of a participant with deleted data. Only the list contains this state."""
FINAL_PARTICIPATION_STATES = ("withdrawn", "excluded", DELETED_STATE)
"""Final states of a participant. If the database lacks a final state, it is restored from the list."""
PARTICIPATION_LIST_STARTED_EVENT, PARTICIPATION_LIST_COMPARED_EVENT = (
    "list begun",
    "compared with the database",
)
DATABASE_REBUILT_EVENT = "database rebuilt"
"""Name of the event for the rebuild of a lost database from the recordings.

An entry without a participant contains one of the events ``PARTICIPATION_LIST_STARTED_EVENT``,
``PARTICIPATION_LIST_COMPARED_EVENT`` and ``DATABASE_REBUILT_EVENT``.
"""

EntryContent = Mapping[str, Any]
"""Content of a list entry: state or event, time, and further fields, by name."""


class ParticipationEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of the participation list: one line of the file.

    ``participant``: participant number; ``None`` for an entry about the list or the database. ``content``: ``None``
    after erasure. ``sha256``: checksum of the content. ``key``: public key. ``signature``: signature of the digest.
    """

    number: int
    participant: int | None
    content: dict[str, Any] | None
    sha256: str
    digest: str
    key: str
    signature: str


@dataclass(frozen=True)
class ParticipationEntries:
    """Entries of a participation list.

    ``error_message``: reason why the list is invalid, such as "is empty"; empty for a valid list.
    """

    entries: tuple[ParticipationEntry, ...]
    error_message: str = ""

    @cached_property
    def latest_content_by_participant(self) -> Mapping[int, EntryContent]:
        """Content of each participant's latest entry, by participant number."""
        return {each.participant: each.content for each in self.entries if each.participant and each.content}

    @cached_property
    def contents_without_participant(self) -> Sequence[EntryContent]:
        """Contents of the entries without a participant, in the order of the file."""
        return [each.content for each in self.entries if each.participant is None and each.content]

    @property
    def hash_chain_ids(self) -> set[str | None]:
        """Ids of all database hash chains that used the list. An id is the first digest of a chain."""
        return {each.get("ledger") for each in self.contents_without_participant}

    @property
    def hash_chain_id(self) -> str | None:
        """Id of the database hash chain to which the list belongs; ``None`` if unknown."""
        return next(
            (each["ledger"] for each in reversed(self.contents_without_participant) if "ledger" in each), None
        )

    @property
    def started_at(self) -> str:
        """Time of the list's first entry."""
        return self.contents_without_participant[0]["at"]

    @property
    def list_id(self) -> str:
        """Id of the list: the digest of its first entry."""
        return self.entries[0].digest

    def list_database_rebuild_contents(self) -> list[EntryContent]:
        """Returns the contents of the entries about rebuilds of the database."""
        return [each for each in self.contents_without_participant if each["event"] == DATABASE_REBUILT_EVENT]

    def list_consents(self, participant: int) -> list[RecordedConsent]:
        """Returns all consents of a participant. ``participant``: participant number."""
        own = [each.content for each in self.entries if each.participant == participant and each.content]
        return [
            RecordedConsent(
                each["consented_at"],
                each.get("consent_version"),
                each.get("language"),
                each.get("consent_sha256"),
            )
            for each in own
            if "consented_at" in each
        ]

    def is_signed_by_user(self) -> bool:
        """Returns whether this user's key signed the last entry. The digest of this entry covers all others."""
        own = signing.load_signing_key()
        return own is not None and self.entries[-1].key == signing.encode_public_key(own)

    def contains_digest(self, digest: str) -> bool:
        """Returns whether the list contains an entry with this digest."""
        return any(each.digest == digest for each in reversed(self.entries))


class ParticipationList:
    """The participation list in a study's folder. Writers must hold the database's write lock."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: tuple[object, ParticipationEntries] | None = None

    @property
    def path(self) -> Path:
        """Path of the list's file."""
        return self._folder / PARTICIPATION_LIST_FILE

    def read_entries(self) -> ParticipationEntries | None:
        """Returns the entries of the list; ``None`` if the file does not exist."""
        try:
            version = self._version()
        except FileNotFoundError:
            return None
        if self._known is None or self._known[0] != version:
            self._known = version, _parsed(self.path.read_bytes())
        return self._known[1]

    def append_entries(self, contents: Sequence[tuple[int | None, EntryContent]]) -> None:
        """Append entries and flush them to disk. Raises ``OSError`` if the file cannot be written.

        ``contents``: participant number (or ``None``) and content of each entry.
        """
        before = self.read_entries() or ParticipationEntries(())
        entries = [*before.entries]
        for participant, content in contents:
            entries.append(_entry_after(entries[-1] if entries else None, participant, content))
        data = b"".join(map(_line, entries[len(before.entries) :]))
        self._remove_unfinished()
        self._cut_unfinished_line()
        try:
            with open(self.path, "ab", opener=open_privately) as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        after = ParticipationEntries(tuple(entries), before.error_message)
        self._known = self._version(), after
        signing.store_last_entry(self._folder, after.list_id, entries[-1].digest)

    def store_last_entry(self) -> None:
        """Store the list's last entry in the user's data folder, unless the folder already has one of this list."""
        known, end = self.read_entries(), signing.read_last_entry(self._folder)
        if known is None or known.error_message or not known.is_signed_by_user():
            return
        if end is None or end.list_id != known.list_id:
            signing.store_last_entry(self._folder, known.list_id, known.entries[-1].digest)

    def erase_participant(self, participant: int) -> None:
        """Erase the contents of a participant's entries, except the last entry. Also remove renamed invalid lists.

        Checksums and digests are not changed.
        """
        known = self.read_entries()
        self._remove_unfinished()
        for path in self.find_invalid_copies():
            path.unlink()
        if known is None or known.error_message:
            return
        own = [each for each in known.entries if each.participant == participant]
        erased = {each.number for each in own[:-1] if each.content is not None}
        if erased:
            entries = [
                msgspec.structs.replace(each, content=None) if each.number in erased else each
                for each in known.entries
            ]
            write_atomically(self.path, b"".join(map(_line, entries)), PRIVATE_FILE_MODE)

    def rename_invalid_file(self) -> None:
        """Rename the file of an invalid list. The next ``append_entries`` starts a new list."""
        numbers = [_copy_number(path) for path in self.find_invalid_copies()]
        os.replace(
            self.path, self.path.with_name(f"{PARTICIPATION_LIST_FILE}.invalid-{max(numbers, default=0) + 1}")
        )

    def find_invalid_copies(self) -> list[Path]:
        """Returns the paths of renamed invalid lists."""
        return sorted(
            path
            for path in self._folder.glob(f"{PARTICIPATION_LIST_FILE}.*")
            if INVALID_COPY_PATTERN.fullmatch(path.name)
        )

    def _version(self) -> object:
        found = self.path.stat()
        return found.st_size, found.st_mtime_ns, found.st_ino

    def _remove_unfinished(self) -> None:
        """Remove temporary copies of killed processes."""
        for path in self._folder.glob(f".{PARTICIPATION_LIST_FILE}.*.part"):
            path.unlink(missing_ok=True)

    def _cut_unfinished_line(self) -> None:
        """Remove an unfinished last line after a crash."""
        if self.path.exists():
            data = self.path.read_bytes()
            if not data.endswith(b"\n"):
                write_atomically(self.path, data[: data.rfind(b"\n") + 1], PRIVATE_FILE_MODE)


def make_participant_content(state: str, at: str, **values: Any) -> EntryContent:
    """Returns the content of an entry about a participant. Values that are ``None`` are omitted."""
    return {"state": state, "at": at} | {name: value for name, value in values.items() if value is not None}


def has_same_content(content: EntryContent, other: EntryContent | None) -> bool:
    """Returns whether two contents are equal. Time and salt are ignored."""
    return other is not None and _without_time(content) == _without_time(other)


def _without_time(content: EntryContent) -> EntryContent:
    return {name: value for name, value in content.items() if name not in ("at", "salt")}


def _copy_number(path: Path) -> int:
    match = INVALID_COPY_PATTERN.fullmatch(path.name)
    return int(match[1]) if match else 0


# Entries


def _entry_after(
    before: ParticipationEntry | None, participant: int | None, content: EntryContent
) -> ParticipationEntry:
    number = before.number + 1 if before else 1
    salted = dict(content) | {"salt": make_salt()}
    sha256 = compute_json_sha256(salted)
    digest = _digest(before.digest if before else "", number, participant, sha256)
    own = signing.load_signing_key()
    key = signing.encode_public_key(own) if own else ""
    signature = own.sign(digest.encode()).hex() if own else ""
    return ParticipationEntry(number, participant, salted, sha256, digest, key, signature)


def _line(entry: ParticipationEntry) -> bytes:
    return msgspec.json.encode(entry) + b"\n"


def _parsed(data: bytes) -> ParticipationEntries:
    """Returns the entries up to the first damaged entry. An unfinished last line is ignored."""
    entries: list[ParticipationEntry] = []
    for number, line in enumerate(data.split(b"\n")[:-1], start=1):
        try:
            entries.append(msgspec.json.decode(line, type=ParticipationEntry))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            return ParticipationEntries(tuple(entries), f"is damaged in line {number}: {error}")
    if not entries:
        return ParticipationEntries((), "is empty")
    return ParticipationEntries(tuple(entries), next(_faults(entries), ""))


def _faults(entries: Sequence[ParticipationEntry]) -> Iterator[str]:
    before = ""
    for number, each in enumerate(entries, start=1):
        if each.digest != _digest(before, number, each.participant, each.sha256) or each.number != number:
            yield f"was changed: entry {number} does not match the previous entry"
        before = each.digest
    deleted = {
        each.participant for each in entries if each.content and each.content.get("state") == DELETED_STATE
    }
    for each in entries:
        if each.content is None and each.participant not in deleted:
            yield f"was changed: the content of entry {each.number} is missing"
        if each.content is not None and compute_json_sha256(each.content) != each.sha256:
            yield f"was changed: the content of entry {each.number} does not match its checksum"
    if entries[0].content is None or entries[0].content.get("event") != PARTICIPATION_LIST_STARTED_EVENT:
        yield "was changed: its first entry is missing"
    for each in {each.key: each for each in entries}.values():
        if each.key and not signing.is_signature_valid(each.key, each.signature, each.digest):
            yield f"was changed: the signature of entry {each.number} is invalid"


def _digest(before: str, number: int, participant: int | None, sha256: str) -> str:
    return compute_json_sha256([before, number, participant, sha256])
