"""Keep the participation list and the database consistent.

Each transaction appends its changes to the list. When a study is opened, missing entries are appended to the list.
Withdrawals, exclusions and deletions that the database lacks are restored from the list. They are missing if an older
copy replaced the database.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, signing
from avrgym.study.storage.participation_list import (
    DATABASE_REBUILT_EVENT,
    DELETED_STATE,
    FINAL_PARTICIPATION_STATES,
    PARTICIPATION_LIST_COMPARED_EVENT,
    PARTICIPATION_LIST_STARTED_EVENT,
    EntryContent,
    ParticipationEntries,
    ParticipationList,
    has_same_content,
    make_participant_content,
)
from avrgym.study.storage.schema import (
    EVENT_TABLE,
    LEDGER_TABLE,
    PARTICIPANT_TABLE,
    TOMBSTONE_TABLE,
    make_utc_timestamp,
)

PARTICIPATION_STATE_RESTORED_EVENT = "participation restored"
"""Name of the event for a final state that was restored from the participation list."""
OLDER_STUDY_COPY_EVENT = "participation list set back"
"""Name of the event for a study that is an older copy than the last one on this computer."""
_COLUMNS = (
    "simulated",
    "site",
    "site_number",
    "sex",
    "age_years",
    "language",
    "cell",
    "enrolled_at",
    "consented_at",
    "consent_version",
    "consent_sha256",
)
"""Fields of a participant in the list, in addition to the state."""

ContentByParticipant = Mapping[int, EntryContent]
"""Contents of list entries, by participant number."""


def make_participant_row_values(content: EntryContent) -> dict[str, Any]:
    """Returns the values of a participant's row from the content of a list entry, without the state."""
    return {name: content.get(name) for name in _COLUMNS}


# Changes of a transaction


def append_transaction_entries(
    known: ParticipationList, connection: sa.Connection, written: Collection[tuple[str, int]]
) -> None:
    """Append the changes of a transaction to the list, before the commit.

    ``written``: table and primary key of each row that the transaction wrote.
    """
    numbers = {key for name, key in written if name in (PARTICIPANT_TABLE.name, TOMBSTONE_TABLE.name)}
    events = {key for name, key in written if name == EVENT_TABLE.name}
    rebuilt = list(_rebuilds(connection, events)) if events else []
    if not numbers and not rebuilt:
        return
    before = known.read_entries()
    if before is not None and before.error_message:
        known.rename_invalid_file()
        _begin(known, connection, f"replaces a list that {before.error_message}")
    elif before is None:
        _begin(known, connection, "", numbers)
    else:
        _append(known, before, _contents(connection, numbers, numbers), rebuilt)


def _begin(
    known: ParticipationList, connection: sa.Connection, detail: str, enrolled: Collection[int] = ()
) -> None:
    """Start a list with all participants of the database. ``enrolled``: participants enrolled in this transaction."""
    everybody = _contents(connection)
    is_first = everybody.keys() <= {*enrolled}
    times = [str(each["enrolled_at"]) for each in everybody.values() if is_first and each.get("enrolled_at")]
    begun = _without_participant(
        connection, PARTICIPATION_LIST_STARTED_EVENT, min(times, default=make_utc_timestamp()), detail
    )
    rebuilt = [(None, each) for each in _rebuilds(connection)]
    if everybody or rebuilt:
        known.append_entries([(None, begun), *rebuilt, *sorted(everybody.items())])


def _append(
    known: ParticipationList,
    before: ParticipationEntries,
    contents: ContentByParticipant,
    rebuilt: Collection[EntryContent] = (),
) -> None:
    known_rebuilds = {(each["at"], each["detail"]) for each in before.list_database_rebuild_contents()}
    new = [(None, each) for each in rebuilt if (each["at"], each["detail"]) not in known_rebuilds]
    new += [(number, each) for number, each in sorted(contents.items()) if _is_news(before, number, each)]
    if new:
        known.append_entries(new)


def _is_news(before: ParticipationEntries, number: int, content: EntryContent) -> bool:
    """Returns whether a participant's content is new and may be appended. A final state is never replaced."""
    latest = before.latest_content_by_participant.get(number)
    if (
        latest is not None
        and latest["state"] in FINAL_PARTICIPATION_STATES
        and content["state"] not in FINAL_PARTICIPATION_STATES
    ):
        return False
    if latest is not None and latest["state"] == DELETED_STATE:
        return False
    return not has_same_content(content, latest)


def _contents(
    connection: sa.Connection,
    participants: Collection[int] | None = None,
    tombstones: Collection[int] | None = None,
) -> dict[int, EntryContent]:
    """Returns the contents of list entries about participants and deleted participants, by participant number.

    ``participants`` and ``tombstones``: only these numbers; default: all.
    """
    columns = [PARTICIPANT_TABLE.c[name] for name in ("number", "state", *_COLUMNS)]
    rows = _all(connection, columns, PARTICIPANT_TABLE.c.number, participants)
    found = {
        row["number"]: make_participant_content(
            at=make_utc_timestamp(), **{name: value for name, value in row.items() if name != "number"}
        )
        for row in rows
    }
    for row in _all(connection, list(TOMBSTONE_TABLE.c), TOMBSTONE_TABLE.c.number, tombstones):
        found[row["number"]] = make_participant_content(
            DELETED_STATE, row["deleted_at"], simulated=row["simulated"]
        )
    return found


def _rebuilds(connection: sa.Connection, keys: Collection[int] | None = None) -> Iterator[EntryContent]:
    """Yields the contents of entries about rebuilds of the database, from its events."""
    for row in _all(connection, list(EVENT_TABLE.c), EVENT_TABLE.c.id, keys):
        if row["name"] == DATABASE_REBUILT_EVENT:
            yield _without_participant(connection, DATABASE_REBUILT_EVENT, row["at"], row["detail"])


def _without_participant(connection: sa.Connection, event: str, at: str, detail: str) -> EntryContent:
    return {"event": event, "at": at, "detail": detail, "ledger": read_hash_chain_id(connection)}


def read_hash_chain_id(connection: sa.Connection) -> str | None:
    """Returns the id of the database's hash chain, which is its first digest; ``None`` for an empty chain."""
    return connection.execute(sa.select(LEDGER_TABLE.c.digest).where(LEDGER_TABLE.c.number == 1)).scalar()


def _all(
    connection: sa.Connection, columns: list[Any], key: sa.Column[Any], keys: Collection[int] | None
) -> list[sa.RowMapping]:
    query = sa.select(*columns).order_by(key)
    if keys is not None:
        query = query.where(key.in_(keys))
    return list(connection.execute(query).mappings())


# Opening a study


@dataclass(frozen=True)
class ParticipationListDifferences:
    """Differences between participation list and database when a study is opened.

    ``new_list_reason``: reason to start a new list; ``None`` if the list is valid. ``restored_states``: final states
    that only the list contains, by participant number. ``missing_states``: states that only the database contains, by
    participant number. ``is_older_copy``: the list is an older copy and lacks the last entry that this computer stored.
    ``is_unsigned_by_user``: the list matches the database, but this user has not signed it.
    """

    new_list_reason: str | None = None
    restored_states: ContentByParticipant = field(default_factory=dict[int, EntryContent])
    missing_states: ContentByParticipant = field(default_factory=dict[int, EntryContent])
    is_older_copy: bool = False
    is_unsigned_by_user: bool = False

    def __bool__(self) -> bool:
        return self.new_list_reason is not None or any(
            (self.restored_states, self.missing_states, self.is_older_copy, self.is_unsigned_by_user)
        )


def compare_database_with_list(
    known: ParticipationList, connection: sa.Connection
) -> ParticipationListDifferences:
    """Returns the differences between list and database. Rows that another program changed are ignored."""
    everybody = _contents(connection)
    unchanged_keys = hash_chain.find_unchanged_row_keys(connection, PARTICIPANT_TABLE)
    edited = {number for number, each in everybody.items() if each["state"] != DELETED_STATE} - unchanged_keys
    contents = {number: each for number, each in everybody.items() if number not in edited}
    before = known.read_entries()
    if before is None:
        return ParticipationListDifferences(new_list_reason="" if contents else None)
    if before.error_message:
        return ParticipationListDifferences(new_list_reason=f"replaces a list that {before.error_message}")
    if read_hash_chain_id(connection) not in before.hash_chain_ids:
        return ParticipationListDifferences(new_list_reason="replaces a list of another study")
    restored = {
        number: content
        for number, content in before.latest_content_by_participant.items()
        if number not in edited
        and content["state"] in FINAL_PARTICIPATION_STATES
        and _lacks(contents.get(number), content)
    }
    missing = {number: each for number, each in contents.items() if _is_news(before, number, each)}
    if before.is_signed_by_user():
        end = signing.read_last_entry(known.path.parent)
        set_back = (
            end is not None and end.list_id == before.list_id and not before.contains_digest(end.digest)
        )
        return ParticipationListDifferences(
            restored_states=restored, missing_states=missing, is_older_copy=set_back
        )
    if restored or missing:
        return ParticipationListDifferences(
            new_list_reason="replaces a different list that another user's key signed"
        )
    return ParticipationListDifferences(is_unsigned_by_user=signing.load_signing_key() is not None)


def _lacks(found: EntryContent | None, final: EntryContent) -> bool:
    """Returns whether the database lacks a final state. ``found``: the participant's content in the database."""
    if found is None:
        return final["state"] == DELETED_STATE
    return found["state"] not in FINAL_PARTICIPATION_STATES


def reconcile_list_and_database(known: ParticipationList, connection: sa.Connection) -> None:
    """Make list and database consistent, within a write transaction."""
    found = compare_database_with_list(known, connection)
    if found.new_list_reason is not None:
        if known.path.exists():
            known.rename_invalid_file()
        _begin(known, connection, found.new_list_reason)
    for number, content in found.restored_states.items():
        _restore(connection, number, content)
    before = known.read_entries()
    if before is not None:
        _append(known, before, found.missing_states)
    if found.is_older_copy:
        detail = "this copy of the study is older than the last one on this computer"
        hash_chain.insert_row(
            connection,
            EVENT_TABLE,
            recorded_at=make_utc_timestamp(),
            name=OLDER_STUDY_COPY_EVENT,
            detail=detail,
        )
    if found.is_older_copy or found.is_unsigned_by_user:
        known.append_entries(
            [
                (
                    None,
                    _without_participant(
                        connection, PARTICIPATION_LIST_COMPARED_EVENT, make_utc_timestamp(), ""
                    ),
                )
            ]
        )


def _restore(connection: sa.Connection, number: int, content: EntryContent) -> None:
    """Store a final state that only the list contains.

    If the database still contains a deleted participant, the participant becomes withdrawn until the next deletion.
    """
    rows = _all(connection, [PARTICIPANT_TABLE.c.number], PARTICIPANT_TABLE.c.number, [number])
    if rows:
        state = "withdrawn" if content["state"] == DELETED_STATE else content["state"]
        hash_chain.update_row(connection, PARTICIPANT_TABLE, number, state=state)
        detail = f"{content['state']} at {content['at']} by the participation list"
        hash_chain.insert_row(
            connection,
            EVENT_TABLE,
            recorded_at=make_utc_timestamp(),
            participant=number,
            name=PARTICIPATION_STATE_RESTORED_EVENT,
            detail=detail,
        )
    else:
        row = {"number": number, "simulated": content.get("simulated", False), "deleted_at": content["at"]}
        hash_chain.insert_row(connection, TOMBSTONE_TABLE, **row)
