"""Names are private, and deletion of a participant leaves no trace."""

import hashlib
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from avrgym.study.people import participant_deletion
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import add_note, enrol_participant, set_identity
from avrgym.study.storage import database, identity_file, schema, sqlite
from avrgym.study.storage.database import StudyDatabase
from avrgym.study.storage.sessions import close_session, open_session, record_session_event
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import find_exposed_paths
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study

NAME, CONTACT = "Grace Unverwechselbar", "grace.unverwechselbar@example.org"
TRACES = (
    NAME.encode(),
    CONTACT.encode(),
    b"Unverwechselbar",
    b"she-laughed-at-the-spoon",
    b"sub-002",
    b"ses-01-trace",
)

NAMES = {NAME.encode(), CONTACT.encode(), b"Unverwechselbar"}
"""Traces that are encrypted."""


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    """Three people with some trials; the second has traces in all kinds of data."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(small_study(tmp_path / "study")) as opened:
        for number in (1, 2, 3):
            second = number == 2
            pseudonym = enrol_with_consent(
                opened,
                simulated=False,
                name=NAME if second else f"Person {number}",
                contact=CONTACT if second else "",
            )
            run_participant(opened, pseudonym, trials=2, simulated=False)
        add_note(opened, "sub-002", "she-laughed-at-the-spoon")
        session = open_session(opened, "sub-002")
        record_session_event(opened, session.id, "reconnected", "ses-01-trace")
        close_session(opened, session.id)
        yield opened


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def found(folder: Path) -> set[bytes]:
    """The traces in contents and names of all files."""
    held = files(folder)
    everything = [*held.values(), *(name.encode() for name in held)]
    return {trace for trace in TRACES if any(trace in data for data in everything)}


def others(store: StudyStore) -> tuple:
    """Rows and checksums of recordings of the other participants."""
    rows = tuple(
        (
            store.read_participant(p),
            store.read_trials(p),
            store.read_sessions(p),
            store.read_attempts(p),
            store.read_answers(p),
        )
        for p in ("sub-001", "sub-003")
    )
    recordings = {
        name: hashlib.sha256(data).hexdigest() for name, data in files(store.folder / "recordings").items()
    }
    return rows, {name: digest for name, digest in recordings.items() if not name.startswith("sub-002")}


# The identity file


def test_names_are_only_in_a_private_encrypted_file(store: StudyStore) -> None:
    private = store.folder / "private"
    holders = [name for name, data in files(store.folder).items() if b"Unverwechselbar" in data]
    assert holders == []
    assert identity_file.read_identities(store.folder)["sub-002"] == identity_file.Identity(NAME, CONTACT)
    assert stat.S_IMODE(private.stat().st_mode) == 0o700
    assert stat.S_IMODE((private / "identities.json").stat().st_mode) == 0o600
    assert list(find_exposed_paths(private)) == []


def test_identity_file_is_private_for_any_umask(store: StudyStore) -> None:
    before = os.umask(0)
    try:
        set_identity(store, "sub-001", "Another Name", "")
    finally:
        os.umask(before)
    assert stat.S_IMODE((store.folder / "private" / "identities.json").stat().st_mode) == 0o600


def test_damaged_identity_file_is_rejected_and_kept(store: StudyStore) -> None:
    path = store.folder / "private" / "identities.json"
    path.write_text("{ damaged")
    with pytest.raises(StudyError, match="not an identity file"):
        set_identity(store, "sub-001", "Another Name", "")
    assert path.read_text() == "{ damaged"


def test_simulated_participant_has_no_name(store: StudyStore) -> None:
    with pytest.raises(StudyError, match="cannot have a name or contact"):
        enrol_participant(store, "man", name="Robo", simulated=True)
    assert len(store.read_participants()) == 3


# Deletion


def test_deletion_leaves_no_trace(store: StudyStore) -> None:
    before = others(store)
    assert found(store.folder) == set(TRACES) - NAMES
    delete_participant(store, "sub-002")
    assert found(store.folder) == set()
    assert others(store) == before
    (tombstone,) = store.read_deleted_participants()
    assert (tombstone.number, tombstone.simulated) == (2, False)
    assert [participant.number for participant in store.read_participants()] == [1, 3]
    store.close()
    assert found(store.folder) == set()


def test_deleted_number_is_not_reused_and_its_order_is(store: StudyStore) -> None:
    cell = store.read_participant("sub-003").cell
    delete_participant(store, "sub-003")
    pseudonym = enrol_with_consent(store, simulated=False)
    assert pseudonym == "sub-004"
    assert store.read_participant(pseudonym).cell == cell


def test_deletion_removes_backups_of_the_database(store: StudyStore) -> None:
    backups = store.folder / "backups"
    backups.mkdir()
    shutil.copy(store.folder / "study.db", backups / "0001_first-copy.db")
    delete_participant(store, "sub-002")
    assert not backups.exists()
    assert found(store.folder) == set()


@pytest.mark.parametrize("step", ["remove_identity", "_delete_rows", "erase_deleted_data"])
def test_repeated_deletion_completes_an_interrupted_one(
    store: StudyStore, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    before = others(store)
    owner = {
        "remove_identity": identity_file,
        "_delete_rows": participant_deletion,
        "erase_deleted_data": StudyDatabase,
    }[step]
    with monkeypatch.context() as crash:
        crash.setattr(owner, step, lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            delete_participant(store, "sub-002")
    delete_participant(store, "sub-002")
    delete_participant(store, "sub-002")
    assert found(store.folder) == set()
    assert others(store) == before


def test_running_session_prevents_deletion(store: StudyStore) -> None:
    session = open_session(store, "sub-002")
    before = files(store.folder / "recordings")
    with pytest.raises(StudyError, match=r"is open at .*; close it before the deletion"):
        delete_participant(store, "sub-002")
    assert files(store.folder / "recordings") == before
    assert store.read_participant("sub-002").state == "allocated"
    close_session(store, session.id)
    delete_participant(store, "sub-002")


def test_other_readers_prevent_erasure_of_traces(store: StudyStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite, "LOCK_TIMEOUT_S", 0.1)
    with StudyStore(store.folder) as reader, reader.database.read_transaction() as connection:
        connection.execute(schema.PARTICIPANT_TABLE.select()).all()
        with pytest.raises(
            StudyError, match="another program uses the study, so deleted data can still be recovered"
        ):
            delete_participant(store, "sub-002")
    delete_participant(store, "sub-002")
    assert found(store.folder) == set()


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("pseudonym", ["sub-009", "../recordings", "sub-002/../sub-001", "*", "sub-2"])
def test_unknown_participants_cannot_be_deleted(store: StudyStore, pseudonym: str) -> None:
    before = {name: data for name, data in files(store.folder).items() if "study.db" not in name}
    with pytest.raises(StudyError, match=r"not a pseudonym|there is no sub-009"):
        delete_participant(store, pseudonym)
    assert {name: data for name, data in files(store.folder).items() if "study.db" not in name} == before


def test_deletion_does_not_follow_links(store: StudyStore, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    shutil.move(store.folder / "recordings" / "sub-002", elsewhere)
    (store.folder / "recordings" / "sub-002").symlink_to(elsewhere)
    kept = files(elsewhere)
    delete_participant(store, "sub-002")
    assert files(elsewhere) == kept
    assert not os.path.lexists(store.folder / "recordings" / "sub-002")
