"""The signed participation list preserves withdrawals, exclusions and deletions after loss of the database."""

import json
import os
import shutil
import signal
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.study.checking import database_rebuild
from avrgym.study.checking.database_checks import check_database
from avrgym.study.checking.database_rebuild import RebuildSummary, rebuild_study_database
from avrgym.study.checking.participation_checks import check_participation
from avrgym.study.checking.study_checks import check_orphaned_files
from avrgym.study.export import export_study
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import (
    confirm_participation,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.storage import database, reconciliation, signing
from avrgym.study.storage.data_loss import describe_data_loss
from avrgym.study.storage.participation_list import PARTICIPATION_LIST_FILE, ParticipationList
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import eligible_answers, enrol_with_consent, run_participant, small_study

DATABASE_FILES = ("study.db", "study.db.sha256", "study.head")
STATES = {
    "sub-001": "completed",
    "sub-002": "withdrawn",
    "sub-004": "excluded",
    "sub-005": "allocated",
    "sub-006": "enrolled",
    "sub-007": "withdrawn",
}
"""Of the study of these tests. ``sub-003`` is deleted."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with all final states, and a copy of the recordings of a deleted participant."""
    folder = small_study(tmp_path_factory.mktemp("made") / "study")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        with StudyStore(folder) as store:
            for _ in range(3):
                run_participant(store, enrol_with_consent(store, simulated=False), simulated=False)
            withdraw_participant(store, "sub-002", "tired")
            shutil.copytree(folder / "recordings" / "sub-003", folder.parent / "sub-003")
            delete_participant(store, "sub-003")
            enrol_participant(store, "man", age_years=40)
            record_consent(store, "sub-004")
            answers = eligible_answers(store)
            assert not record_inclusion_answers(
                store, "sub-004", {each: not answers[each] for each in answers}
            )
            run_participant(store, enrol_with_consent(store, simulated=False), trials=4, simulated=False)
            enrol_participant(store, "man")
            withdraw_participant(store, enrol_with_consent(store, simulated=False))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    copy = Path(shutil.copytree(made, tmp_path / "study"))
    with StudyStore(copy):
        pass
    return copy


def lose(folder: Path, *files: str) -> RebuildSummary:
    for name in (*DATABASE_FILES, *files):
        (folder / name).unlink(missing_ok=True)
    return rebuild_study_database(folder)


def states(folder: Path) -> dict[str, str]:
    with StudyStore(folder) as store:
        return {each.pseudonym: each.state for each in store.read_participants()}


def wrong(folder: Path) -> dict[str, str]:
    with StudyStore(folder) as store:
        checks = (check_database, check_participation, check_orphaned_files)
        return {each.where: each.message for check in checks for each in check(store) if each.is_error}


def losses(folder: Path) -> str:
    with StudyStore(folder) as store:
        return " ".join(describe_data_loss(store))


def lines(folder: Path) -> list[str]:
    return (folder / PARTICIPATION_LIST_FILE).read_text().splitlines(keepends=True)


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)])


# With a sound list


def test_list_begun_late_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(small_study(tmp_path / "study")) as store:
        enrol_participant(store, "man")
        enrol_participant(store, "woman")
        assert not list(check_participation(store))
        (store.folder / PARTICIPATION_LIST_FILE).unlink()
    with StudyStore(tmp_path / "study") as store:
        enrol_participant(store, "man")
        assert any("was started at" in finding.message for finding in check_participation(store))


@pytest.mark.slow
def test_final_states_survive_loss_of_the_database(folder: Path) -> None:
    with StudyStore(folder) as store:
        before = {each.pseudonym: each for each in store.read_participants()}
    assert wrong(folder) == {}
    rebuilt = lose(folder)
    assert (rebuilt.participant_count, rebuilt.unknown_participation_count) == (6, 0)
    assert states(folder) == STATES
    with StudyStore(folder) as store:
        assert [each.number for each in store.read_deleted_participants()] == [3]
        for participant in store.read_participants():
            kept = before[participant.pseudonym]
            for name in (
                "age_years",
                "language",
                "cell",
                "consented_at",
                "consent_version",
                "consent_sha256",
            ):
                assert getattr(participant, name) == getattr(kept, name), name
        assert enrol_with_consent(store, simulated=False) == "sub-008"
    assert wrong(folder) == {}
    assert "was lost and rebuilt" in losses(folder)


def test_recordings_of_deleted_participants_are_ignored(folder: Path, made: Path) -> None:
    shutil.copytree(made.parent / "sub-003", folder / "recordings" / "sub-003")
    assert "there are recordings of them" in wrong(folder)["sub-003"]
    rebuilt = lose(folder)
    assert "sub-003" not in states(folder)
    assert any(each.startswith("sub-003: was deleted at") for each in rebuilt.omission_messages)
    assert list(wrong(folder)) == ["sub-003"]
    with StudyStore(folder) as store:
        delete_participant(store, "sub-003")
    assert wrong(folder) == {}


def test_list_contains_only_numbers_of_deleted_participants(folder: Path) -> None:
    with StudyStore(folder) as store:
        listed = store.read_participation_list()
    assert listed is not None
    own = [each.content for each in listed.entries if each.participant == 3]
    assert len(own) > 1
    assert own[:-1] == [None] * (len(own) - 1)
    assert own[-1] is not None
    assert set(own[-1]) == {"state", "at", "simulated", "salt"}
    assert listed.error_message == ""


def test_database_is_updated_from_the_list(folder: Path, tmp_path: Path) -> None:
    """After a restore of an older database, later withdrawals and deletions still apply."""
    older = {name: (folder / name).read_bytes() for name in DATABASE_FILES}
    with StudyStore(folder) as store:
        withdraw_participant(store, "sub-005")
        delete_participant(store, "sub-001")
    for name, data in older.items():
        (folder / name).write_bytes(data)
    assert states(folder)["sub-005"] == "withdrawn"
    assert states(folder)["sub-001"] == "withdrawn"
    assert "is in the database again" in wrong(folder)["sub-001"]


# With a list that proves nothing


def edit(folder: Path) -> None:
    """Change the state of the withdrawn participant to completed."""
    changed = [line.replace('"withdrawn"', '"completed"') for line in lines(folder)]
    (folder / PARTICIPATION_LIST_FILE).write_text("".join(changed))


def resign(folder: Path) -> None:
    """Change the state, and sign a recomputed chain with another key."""
    contents = [
        (each["participant"], each["content"] or {"state": "enrolled", "at": ""})
        for each in map(json.loads, lines(folder))
    ]
    (folder / PARTICIPATION_LIST_FILE).unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(signing, "get_user_data_folder", lambda: folder / "another")
        edited = [
            (who, {name: "completed" if value == "withdrawn" else value for name, value in content.items()})
            for who, content in contents
        ]
        ParticipationList(folder).append_entries(edited)
    shutil.rmtree(folder / "another")


def cut(folder: Path) -> None:
    """Truncate the list before the withdrawal."""
    (folder / PARTICIPATION_LIST_FILE).write_text("".join(lines(folder)[:-1]))


def another(folder: Path) -> None:
    """Replace the list by that of another study."""
    other = small_study(folder.parent / "other")
    with StudyStore(other) as store:
        for _ in range(7):
            run_participant(store, enrol_with_consent(store, simulated=False), trials=1, simulated=False)
    shutil.copy(other / PARTICIPATION_LIST_FILE, folder / PARTICIPATION_LIST_FILE)


def remove(folder: Path) -> None:
    (folder / PARTICIPATION_LIST_FILE).unlink()


FORGERIES: dict[str, tuple[Callable[[Path], None], str]] = {
    "removed": (remove, "is missing"),
    "edited": (edit, "does not match its checksum"),
    "signed with another key": (resign, "is not signed with this user's key"),
    "set back": (cut, "was replaced by an older copy"),
    "of another study": (another, "belongs to another study"),
}


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("forgery", FORGERIES)
def test_participants_without_a_valid_list_need_confirmation(folder: Path, forgery: str) -> None:
    forge, words = FORGERIES[forgery]
    forge(folder)
    rebuilt = lose(folder)
    assert words in rebuilt.lost_data
    found = states(folder)
    assert {found[name] for name in ("sub-001", "sub-002", "sub-005")} == {"unknown"}
    assert set(found.values()) == {"unknown"}
    assert rebuilt.unknown_participation_count == len(found)
    assert {"sub-001", "sub-002"} <= set(wrong(folder))
    assert words in losses(folder)
    assert "sub-001" in losses(folder)
    assert [path.name for path in folder.glob(f"{PARTICIPATION_LIST_FILE}.invalid-*")] == (
        [] if forgery == "removed" else [f"{PARTICIPATION_LIST_FILE}.invalid-1"]
    )
    assert rebuild_again(folder)
    assert words in losses(folder)


def rebuild_again(folder: Path) -> bool:
    """Rebuild the database again; returns whether all participants are still unknown."""
    lose(folder)
    return set(states(folder).values()) == {"unknown"}


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("forgery", FORGERIES)
def test_invalid_list_is_replaced_from_the_database(folder: Path, forgery: str) -> None:
    forge, _ = FORGERIES[forgery]
    forge(folder)
    assert states(folder) == STATES
    kept = [path.name for path in folder.glob(f"{PARTICIPATION_LIST_FILE}.invalid-*")]
    assert kept == ([] if forgery in ("removed", "set back") else [f"{PARTICIPATION_LIST_FILE}.invalid-1"])
    assert list(wrong(folder)) == kept
    lose(folder)
    assert states(folder) == STATES


def test_loss_of_the_list_remains_recorded(folder: Path, tmp_path: Path) -> None:
    lose(folder, PARTICIPATION_LIST_FILE)
    with StudyStore(folder) as store:
        assert confirm_participation(store, "sub-001", "form in folder 2") == "completed"
        run_participant(store, enrol_with_consent(store, simulated=False), simulated=False)
    lose(folder)
    assert states(folder)["sub-001"] == "completed"
    assert states(folder)["sub-002"] == "unknown"
    assert losses(folder).count("was lost and rebuilt") == 2
    assert "the participation list is missing" in losses(folder)
    merge_studies([folder, small_study(tmp_path / "berlin")], tmp_path / "all")
    assert losses(tmp_path / "all").count("database of the site study was lost and rebuilt") == 2
    assert "sub-1002" in losses(tmp_path / "all")
    with StudyStore(tmp_path / "all") as store:
        export_study(store, "csv", tmp_path / "csv")
    notice = (tmp_path / "csv" / "README.txt").read_text()
    assert "the participation list is missing" in notice
    assert "sub-1002" in notice


def test_only_unknown_participants_can_be_confirmed(folder: Path) -> None:
    with (
        StudyStore(folder) as store,
        pytest.raises(StudyError, match="is withdrawn; allowed: a participant with unknown state"),
    ):
        confirm_participation(store, "sub-002", "form")
    lose(folder, PARTICIPATION_LIST_FILE)
    assert avrgym("confirm-participation", folder, "sub-001", "--evidence", " ").exit_code == 1
    said = avrgym("confirm-participation", folder, "sub-001", "--evidence", "form in folder 2")
    assert "sub-001 is completed" in said.stdout
    assert "sub-001" not in wrong(folder)
    assert "confirmed from other records that they consented and did not withdraw: sub-001" in losses(folder)
    assert "form in folder 2" in avrgym("check", folder).stdout
    assert "consent or withdrawal of 2 is unknown" in avrgym("status", folder).stdout.replace("\n", " ")


def test_unsigned_list_proves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    (tmp_path / "file").touch()
    monkeypatch.setattr(signing, "get_user_data_folder", lambda: tmp_path / "file")
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
    assert "is not signed" in lose(folder).lost_data
    assert states(folder) == {"sub-001": "unknown"}


# Kills


def _withdraw_and_die(folder: Path) -> None:
    """Withdraw a participant, and end the process between list and database."""
    following = reconciliation.append_transaction_entries

    def follow_and_die(*arguments: object) -> None:
        following(*arguments)  # pyright: ignore[reportArgumentType]
        os.kill(os.getpid(), signal.SIGKILL)

    with StudyStore(folder) as store:
        database.append_transaction_entries = follow_and_die
        withdraw_participant(store, "sub-005")


@pytest.mark.parametrize("database_is_lost", [False, True])
def test_kill_between_list_and_database_keeps_the_withdrawal(folder: Path, database_is_lost: bool) -> None:
    process = get_context("fork").Process(target=_withdraw_and_die, args=(folder,))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    if database_is_lost:
        for path in folder.glob("study.db-*"):
            path.unlink()
        lose(folder)
    assert states(folder) == STATES | {"sub-005": "withdrawn"}


def test_unfinished_line_is_ignored(folder: Path) -> None:
    with open(folder / PARTICIPATION_LIST_FILE, "a") as file:
        file.write('{"number":99,"partic')
    with StudyStore(folder) as store:
        withdraw_participant(store, "sub-005")
    assert wrong(folder) == {}
    lose(folder)
    assert states(folder) == STATES | {"sub-005": "withdrawn"}


def _rebuild_and_die(folder: Path) -> None:
    def die(*_: object) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(database_rebuild._Rebuilding, "rebuild", die)
        lose(folder)


def test_list_survives_a_killed_rebuild(folder: Path) -> None:
    """The study does not open with an incomplete database, which would replace the list."""
    process = get_context("fork").Process(target=_rebuild_and_die, args=(folder,))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert (folder / "study.db").exists()
    with pytest.raises(StudyError, match=r"is missing or empty, but there are .* `avrgym study rebuild"):
        StudyStore(folder)
    assert not list(folder.glob("*.invalid-*"))
    rebuild_study_database(folder)
    assert states(folder) == STATES | {"sub-005": "allocated"}


@pytest.mark.parametrize("written", [False, True])
def test_study_opens_after_a_kill_in_the_first_enrolment(tmp_path: Path, written: bool) -> None:
    folder = small_study(tmp_path / "new")
    with StudyStore(folder) as store, pytest.MonkeyPatch.context() as patch:
        follow = reconciliation.append_transaction_entries

        def fail(*arguments: object) -> None:
            follow(*arguments)  # pyright: ignore[reportArgumentType]
            raise StudyError("as a kill before the commit")

        patch.setattr(database, "append_transaction_entries", fail)
        with pytest.raises(StudyError, match="as a kill"):
            enrol_participant(store, "man")
    if not written:
        (folder / PARTICIPATION_LIST_FILE).write_bytes(b'{"number":1,"partic')
    with StudyStore(folder) as store:
        assert store.read_participants() == []
        assert enrol_participant(store, "man") == ("sub-002" if written else "sub-001")


def test_list_with_invalid_bytes_is_invalid(folder: Path) -> None:
    data = (folder / PARTICIPATION_LIST_FILE).read_bytes()
    (folder / PARTICIPATION_LIST_FILE).write_bytes(data.replace(b"sha256", b"sha25\xff", 1))
    with StudyStore(folder) as store:
        withdraw_participant(store, "sub-005")
        assert [path.name for path in folder.glob("*.invalid-*")] == [f"{PARTICIPATION_LIST_FILE}.invalid-1"]
    (folder / PARTICIPATION_LIST_FILE).write_bytes(data.replace(b"sha256", b"sha25\xff", 1))
    assert "is damaged in line 1" in lose(folder).lost_data


def test_deletion_removes_temporary_copies(folder: Path) -> None:
    left = folder / f".{PARTICIPATION_LIST_FILE}.{2**22 + 1}.part"
    left.write_bytes((folder / PARTICIPATION_LIST_FILE).read_bytes())
    with StudyStore(folder) as store:
        delete_participant(store, "sub-006")
    assert not left.exists()


def test_unwritable_list_prevents_changes(folder: Path) -> None:
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with StudyStore(folder) as store:
        resource.setrlimit(
            resource.RLIMIT_FSIZE, ((folder / PARTICIPATION_LIST_FILE).stat().st_size + 100, limits[1])
        )
        try:
            with pytest.raises(OSError, match="large") as refused:
                withdraw_participant(store, "sub-005")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert refused.value.filename == str(folder / PARTICIPATION_LIST_FILE)
    assert states(folder) == STATES
    assert wrong(folder) == {}
    with StudyStore(folder) as store:
        withdraw_participant(store, "sub-005")
    assert wrong(folder) == {}


def test_rebuild_lists_lost_data(folder: Path) -> None:
    lost = lose(folder).lost_data
    for what in ("about functioning", "adverse events", "refusals to re-consent", "the log", "links of"):
        assert what in lost
