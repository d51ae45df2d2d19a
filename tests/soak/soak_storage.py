"""Many kills, flipped bits and edits of studies: `make soak`."""

import os
import random
from collections import Counter
from contextlib import suppress
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from avrgym.study.checking.study_checks import check_study
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.storage import database, hash_chain
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.store import StudyStore
from helpers.studies.flipped_bits import flip_bit, is_detected
from helpers.studies.sites import check_errors, files_in, kill_merge, make_site, study_contents
from helpers.studies.small_studies import (
    eligible_answers,
    enrol_with_consent,
    new_postgresql_database,
    run_participant,
    run_trial,
    small_study,
)

KILLS, FLIPS, MERGE_KILLS = 200, 500, 20
SURNAME = "Unverwechselbar"
Fact = tuple[str, int]
"""An enrolled participant (0), or the position of a completed trial."""


@pytest.fixture(params=["sqlite", "postgresql"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The database of the test's studies."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    if request.param == "postgresql":
        server = request.getfixturevalue("postgresql")
        monkeypatch.setenv(database.DATABASE_URL_VARIABLE, new_postgresql_database(server))
    return request.param


@pytest.fixture
def on_sqlite(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A study with a completed participant."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(small_study(tmp_path / "study")) as store:
        run_participant(store, enrol_with_consent(store))
    return tmp_path / "study"


# Kills


def run_study(folder: Path, url: str, acknowledged: Connection) -> None:
    """Enrol participants with names and run their trials until killed. Reports each acknowledged fact."""
    os.environ[database.DATABASE_URL_VARIABLE] = url
    with StudyStore(folder) as store:
        for number in count():
            pseudonym = enrol_participant(
                store, "woman", name=f"{SURNAME} {os.getpid()} {number}", contact="a@example.org"
            )
            acknowledged.send((pseudonym, 0))
            record_consent(store, pseudonym)
            assert record_inclusion_answers(store, pseudonym, eligible_answers(store))
            session = open_session(store, pseudonym)
            for trial in store.read_remaining_trials(pseudonym)[:2]:
                run_trial(store, session, trial, simulated=False)
                acknowledged.send((pseudonym, trial.position))


def stored_facts(folder: Path) -> set[Fact]:
    """Return the facts that a study contains."""
    with StudyStore(folder) as store:
        people = [person.pseudonym for person in store.read_participants()]
        completed = {
            (person, trial.position)
            for person in people
            for trial in store.read_trials(person)
            if trial.state == "completed"
        }
    return completed | {(person, 0) for person in people}


def kill(folder: Path, after_s: float) -> list[Fact]:
    """Kill a process during its work. Returns the acknowledged facts."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["helpers.studies.small_studies"])
    here, there = context.Pipe(duplex=False)
    process = context.Process(
        target=run_study, args=(folder, os.environ.get(database.DATABASE_URL_VARIABLE, ""), there)
    )
    process.start()
    there.close()
    facts = []
    with suppress(EOFError):
        facts.append(here.recv())
        process.join(after_s)
        process.kill()
        while True:
            facts.append(here.recv())
    process.join()
    return facts


def test_kills_lose_no_facts_cause_no_findings_and_leave_no_names(kind: str, tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    rng, acknowledged, left = random.Random(3), 0, 0
    for done in range(1, KILLS + 1):
        facts = kill(folder, rng.uniform(0.0, 0.3))
        acknowledged += len(facts)
        left += len(list((folder / "private").glob(".*")))
        assert set(facts) <= stored_facts(folder)
        if done % 10 == 0:
            end_study(folder)
    print(
        f"\n{kind}: {KILLS} kills, {acknowledged} acknowledged facts all kept, {left} unfinished files, no name left"
    )


def end_study(folder: Path) -> None:
    """Check a study, delete all participants and search for their names."""
    with StudyStore(folder) as store:
        assert [f"{each.where}: {each.message}" for each in check_study(store) if each.is_error] == []
        for person in store.read_participants():
            for session in store.read_sessions(person.pseudonym):
                assert session.state in ("open", "interrupted", "closed")
            delete_participant(store, person.pseudonym)
        assert [f"{each.where}: {each.message}" for each in check_study(store) if each.is_error] == []
    for path in folder.rglob("*"):
        assert path.is_dir() or SURNAME.encode() not in path.read_bytes(), path


def test_killed_merges_lose_nothing_and_can_be_completed(tmp_path: Path) -> None:
    """A merge is killed at random steps, then completed, then extended by a site."""
    sites = [make_site(tmp_path / name, trials=(None, 2)) for name in ("atlanta", "berlin", "cairo")]
    before = [files_in(site) for site in sites]
    merge_studies(sites, tmp_path / "whole")
    whole = study_contents(tmp_path / "whole")
    rng, done, rounds = random.Random(5), 0, 0
    while done < MERGE_KILLS:
        out, rounds = tmp_path / f"all-{rounds}", rounds + 1
        while done < MERGE_KILLS and kill_merge(sites[: rng.randint(1, 3)], out, rng.randrange(600)):
            done += 1
            if out.exists():
                assert all(found == whole[person] for person, found in study_contents(out).items())
        merge_studies(sites, out)
        assert study_contents(out) == whole
        assert check_errors(out) == []
    assert [files_in(site) for site in sites] == before
    print(f"\n{done} kills of merges in {rounds} merged studies: each completed, nothing lost, nothing twice")


# Flipped bits


def test_each_bit_flipped_in_a_database_s_file_is_detected(on_sqlite: Path, tmp_path: Path) -> None:
    copy, rng = tmp_path / "copy", random.Random(11)
    assert not is_detected(on_sqlite)
    found = 0
    for _ in range(FLIPS):
        flip_bit(on_sqlite, copy, rng, "study.db")
        found += is_detected(copy)
    print(f"\n{found} of {FLIPS} bits flipped in study.db noticed")
    assert found == FLIPS


def test_each_bit_flipped_in_a_file_without_checksum_is_detected_or_changes_nothing(
    on_sqlite: Path, tmp_path: Path
) -> None:
    """A killed process writes no checksum of the file: the checks of rows and pages must detect the change."""
    (on_sqlite / "study.db.sha256").unlink()
    copy, rng, outcomes = tmp_path / "copy", random.Random(12), Counter[str]()
    before = rows(on_sqlite)
    for _ in range(FLIPS):
        bit = flip_bit(on_sqlite, copy, rng, "study.db")
        seen = is_detected(copy)
        outcomes["noticed" if seen else "without effect"] += 1
        assert seen or rows(copy) == before, bit
    print(f"\n{FLIPS} bits flipped in study.db after a kill: {dict(outcomes)}")


def test_each_bit_flipped_in_recordings_is_detected(on_sqlite: Path, tmp_path: Path) -> None:
    copy, rng = tmp_path / "copy", random.Random(13)
    recordings = [str(path.relative_to(on_sqlite)) for path in sorted(on_sqlite.rglob("*.mcap"))]
    found = 0
    for _ in range(FLIPS):
        flip_bit(on_sqlite, copy, rng, rng.choice(recordings))
        found += is_detected(copy)
    print(f"\n{found} of {FLIPS} bits flipped in recordings noticed")
    assert found == FLIPS


def rows(folder: Path) -> dict[str, list]:
    """Return the rows of every table."""
    with StudyStore(folder) as store, store.database.read_transaction() as connection:
        return {
            name: [tuple(row) for row in connection.execute(sa.select(table))]
            for name, table in hash_chain.CHAINED_TABLES.items()
        }


def test_each_bit_flipped_in_a_value_is_detected(kind: str, tmp_path: Path) -> None:
    """Flips a bit in any column of any row by SQL."""
    rng, found = random.Random(17), 0
    with StudyStore(small_study(tmp_path / "study")) as store:
        run_participant(store, enrol_with_consent(store))
        assert store.database.find_integrity_errors() == []
        while found < FLIPS:
            with store.database._engine.connect() as connection, connection.begin() as transaction:
                if not flip_value(connection, rng):
                    continue
                faults = list(hash_chain.find_hash_chain_errors(connection))
                transaction.rollback()
            assert faults
            found += 1
    print(f"\n{kind}: {found} of {FLIPS} bits flipped in values noticed")


def flip_value(connection: sa.Connection, rng: random.Random) -> bool:
    """Flip a bit of a value. Returns whether the database stored it."""
    table = rng.choice(list(hash_chain.CHAINED_TABLES.values()))
    found = connection.execute(sa.select(table)).all()
    if not found:
        return False
    row = rng.choice(found)._mapping
    column = rng.choice([each for each in table.columns if row[each.name] is not None])
    own = hash_chain.find_primary_key_column(table) == row[hash_chain.find_primary_key_column(table).name]
    with suppress(SQLAlchemyError, UnicodeError), connection.begin_nested():
        value = _flipped(row[column.name], rng)
        return connection.execute(sa.update(table).where(own).values({column.name: value})).rowcount == 1
    return False


def _flipped(value: object, rng: random.Random) -> object:
    match value:
        case bool():
            return not value
        case int():
            return value ^ 1 << rng.randrange(31)
        case float():
            return value * (1 + 2.0 ** -rng.randrange(1, 52))
        case dict():
            return value | {rng.choice(["steps", "reward", "tasks"]): rng.random()}
        case _:
            data = bytearray(str(value).encode() or b" ")
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(7)
            return data.decode()
