"""An open questionnaire is answered in the next session; database, recording and checks agree."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from avrgym.recording import answers_file
from avrgym.recording.reader import read_recording
from avrgym.recording.schema import Answer
from avrgym.study.checking.database_rebuild import rebuild_study_database
from avrgym.study.checking.study_checks import check_study
from avrgym.study.checking.study_summary import summarise_study
from avrgym.study.dashboard.displayed_data import make_displayed_participant
from avrgym.study.people.participants import withdraw_participant
from avrgym.study.storage import database
from avrgym.study.storage.answers import (
    change_trial_answer,
    find_attempts_with_open_questionnaire,
    reconcile_answers,
)
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ParticipantDisconnected,
    ParticipantReady,
    PreviousQuestionRequest,
    VrEntered,
)
from helpers.studies.server_days import ANSWERS, ServerDay, kill_server_in
from helpers.studies.small_studies import enrol_with_consent, make_study


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    protocol = {"practice_policy": '""', "free_movement_s": "0.1", "trial_steps": "3"}
    return make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', **protocol)


@pytest.fixture
def left(folder: Path) -> Iterator[Callable[[], tuple[StudyStore, str]]]:
    """A study with two of four questions answered after the first trial when the server stops."""
    stores: list[StudyStore] = []

    def leave() -> tuple[StudyStore, str]:
        store = StudyStore(folder)
        stores.append(store)
        pseudonym = enrol_with_consent(store)
        day = ServerDay(store, pseudonym)
        day.send(VrEntered())
        day.run_until("questionnaire")
        day.answer(2)
        day.end()
        return store, pseudonym

    yield leave
    for store in stores:
        store.close()


@pytest.fixture
def killed(folder: Path) -> Iterator[Callable[..., tuple[StudyStore, str]]]:
    """A study after a kill of the server in a phase of the first trial."""
    with ExitStack() as opened:

        def kill(phase: str, answers: int = 0, stored: int = 4) -> tuple[StudyStore, str]:
            with StudyStore(folder) as store:
                pseudonym = enrol_with_consent(store, simulated=False)
            kill_server_in(folder, pseudonym, phase, answers, stored)
            return opened.enter_context(StudyStore(folder)), pseudonym

        yield kill


def values(store: StudyStore, pseudonym: str) -> dict[str, int]:
    return {each.item: each.value for each in store.read_answers(pseudonym)}


def words(store: StudyStore) -> list[str]:
    return [finding.message for finding in check_study(store) if "policy" not in finding.where]


@pytest.mark.slow
def test_open_questionnaire_is_answered_the_next_day(left: Callable[[], tuple[StudyStore, str]]) -> None:
    store, pseudonym = left()
    (attempt,) = store.read_attempts(pseudonym)
    assert attempt.state == "completed"
    assert store.read_trials(pseudonym)[0].state == "completed"
    assert [each.id for each in find_attempts_with_open_questionnaire(store, [attempt])] == [attempt.id]
    assert any("questionnaire is open: no answer to L3, L4" in each for each in words(store))
    assert not any(finding.is_error for finding in check_study(store) if "L3" in finding.message)
    assert summarise_study(store).participants[0].questionnaires_open == 1
    assert make_displayed_participant(store, pseudonym).trials[0].questionnaire_open

    day = ServerDay(store, pseudonym)
    assert (day.phase, day.question().item) == ("questionnaire", "L3")
    day.send(PreviousQuestionRequest())
    assert day.question().previous_answer == 2
    day.answer(3)
    day.send(ParticipantReady())
    day.run_until("waiting")
    day.send(VrEntered())
    day.run_until("free_before")
    assert len(store.read_attempts(pseudonym)) == 2
    assert store.read_attempts(pseudonym)[1].trial != attempt.trial
    assert values(store, pseudonym) == ANSWERS
    recording = read_recording(store.resolve_path(attempt.recording))
    assert {answer.item: answer.value for _, answer in recording.messages_by_topic["/answers"]} == ANSWERS
    day.end()
    assert not any(attempt.recording == each.where for each in check_study(store))
    assert summarise_study(store).participants[0].questionnaires_open == 0


@pytest.mark.slow
def test_rebuild_contains_late_answers(left: Callable[[], tuple[StudyStore, str]]) -> None:
    store, pseudonym = left()
    day = ServerDay(store, pseudonym)
    day.answer(2)
    day.send(ParticipantReady())
    day.end()
    folder = store.folder
    (attempt,) = store.read_attempts(pseudonym)
    late = answers_file.read_answer_timestamps(folder / attempt.recording)
    store.close()
    for path in folder.glob(f"{database.DATABASE_FILE}*"):
        path.unlink()
    rebuilt = rebuild_study_database(folder)
    assert (rebuilt.attempt_count, rebuilt.answer_count) == (1, 4)
    with StudyStore(folder) as again:
        assert values(again, pseudonym) == ANSWERS
        assert late.keys() < ANSWERS.keys()
        assert late.items() <= {each.item: each.answered_at for each in again.read_answers(pseudonym)}.items()
        assert again.read_trials(pseudonym)[0].state == "completed"
        assert find_attempts_with_open_questionnaire(again, again.read_attempts(pseudonym)) == []


def test_rebuild_keeps_a_questionnaire_open(left: Callable[[], tuple[StudyStore, str]]) -> None:
    store, pseudonym = left()
    folder = store.folder
    store.close()
    for path in folder.glob(f"{database.DATABASE_FILE}*"):
        path.unlink()
    rebuild_study_database(folder)
    with StudyStore(folder) as again:
        assert len(find_attempts_with_open_questionnaire(again, again.read_attempts(pseudonym))) == 1


@pytest.mark.slow
def test_skipped_items_are_missing(left: Callable[[], tuple[StudyStore, str]]) -> None:
    store, pseudonym = left()
    day = ServerDay(store, pseudonym)
    day.send(ExperimenterCommand("skip"))
    day.tick()
    day.end()
    (attempt,) = store.read_attempts(pseudonym)
    assert find_attempts_with_open_questionnaire(store, [attempt]) == []
    assert attempt.state == "completed"
    assert any("questionnaire was skipped: no answer to L3, L4" in each for each in words(store))


def test_withdrawal_leaves_the_questionnaire_unanswered(left: Callable[[], tuple[StudyStore, str]]) -> None:
    store, pseudonym = left()
    withdraw_participant(store, pseudonym, "")
    assert [each.state for each in store.read_attempts(pseudonym)] == ["completed"]
    assert values(store, pseudonym) == {"L1": 1, "L2": 2}
    assert not any(finding.is_error for finding in check_study(store) if "L3" in finding.message)


@pytest.mark.slow
def test_completion_waits_for_the_last_answers(folder: Path) -> None:
    """The participant is completed only after the last answer."""
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
        day = ServerDay(store, pseudonym)
        day.send(VrEntered())
        for _ in store.read_trials(pseudonym)[1:]:
            day.run_until("questionnaire")
            day.answer(4)
            day.send(ParticipantReady())
            day.tick()
        day.run_until("questionnaire")
        day.answer(1)
        day.send(ParticipantDisconnected())
        day.tick()
        day.end()
        assert store.read_remaining_trials(pseudonym) == []
        assert store.read_participant(pseudonym).state == "allocated"
        last = ServerDay(store, pseudonym)
        for _ in range(30):
            last.tick()  # the status is sent, too
        last.answer(3)
        last.send(ParticipantReady())
        last.run_until("over")
        last.end()
        assert store.read_participant(pseudonym).state == "completed"
        assert len(store.read_answers(pseudonym)) == 4 * len(store.read_trials(pseudonym))


# After kill -9 -----------------------------------------------------------------------------------------------


def assert_completed_with(store: StudyStore, pseudonym: str, answers: dict[str, int]) -> None:
    """Assert that the first trial is completed with these answers in database and recording."""
    (attempt,) = store.read_attempts(pseudonym)
    assert (attempt.state, store.read_trials(pseudonym)[0].state) == ("completed", "completed")
    assert (attempt.metrics.steps, values(store, pseudonym)) == (3, answers)
    recording = read_recording(store.resolve_path(attempt.recording))
    assert (recording.is_complete, recording.result) == (True, "completed")
    assert {answer.item: answer.value for _, answer in recording.messages_by_topic["/answers"]} == answers
    assert [each.message for each in check_study(store) if each.is_error and "policy" not in each.where] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "answers", "stored"),
    [
        ("retreat", 0, 0),
        ("free_after", 0, 0),
        ("questionnaire", 2, 2),
        ("questionnaire", 2, 1),
        ("confirm", 4, 4),
    ],
)
def test_trial_killed_after_the_robot_finished_counts(
    killed: Callable[..., tuple[StudyStore, str]], phase: str, answers: int, stored: int
) -> None:
    """It counts even if the last answer was not yet in the database."""
    store, pseudonym = killed(phase, answers, stored)
    day = ServerDay(store, pseudonym)
    given = dict(list(ANSWERS.items())[:answers])
    if answers < len(ANSWERS):
        assert (day.phase, day.question().item) == ("questionnaire", list(ANSWERS)[answers])
    assert_completed_with(store, pseudonym, given)
    if answers < len(ANSWERS):
        day.answer(len(ANSWERS) - answers)
        day.send(ParticipantReady())
    day.run_until("waiting")
    assert_completed_with(store, pseudonym, ANSWERS)
    day.end()


@pytest.mark.slow
def test_trial_killed_before_the_robot_finished_is_repeated(
    killed: Callable[..., tuple[StudyStore, str]],
) -> None:
    store, pseudonym = killed("trial")
    day = ServerDay(store, pseudonym)
    assert day.phase == "waiting"
    assert [each.state for each in store.read_attempts(pseudonym)] == ["interrupted"]
    assert store.read_trials(pseudonym)[0].state == "planned"
    day.end()


@pytest.mark.slow
def test_rebuild_from_a_truncated_recording(killed: Callable[..., tuple[StudyStore, str]]) -> None:
    store, pseudonym = killed("questionnaire", 2, 1)
    folder = store.folder
    store.close()
    for path in folder.glob(f"{database.DATABASE_FILE}*"):
        path.unlink()
    rebuild_study_database(folder)
    with StudyStore(folder) as again:
        assert again.read_trials(pseudonym)[0].state == "completed"
        assert len(find_attempts_with_open_questionnaire(again, again.read_attempts(pseudonym))) == 1


@pytest.mark.slow
def test_answers_agree_after_a_kill(left: Callable[[], tuple[StudyStore, str]]) -> None:
    """Recording or database lacks the last change of an answer."""
    store, pseudonym = left()
    (attempt,) = store.read_attempts(pseudonym)
    change_trial_answer(store, attempt.id, Answer("L2", 4, 1.0))
    recorded = [
        Answer("L1", 1, 1.0),
        Answer("L2", 2, 1.0),
        *(Answer("L1", value, 1.0) for value in (5, 1, 3)),
    ]
    with store.database.write_transaction() as connection:
        lacking = reconcile_answers(store, connection, attempt, recorded)
    assert lacking == [Answer("L2", 4, 1.0)]
    assert values(store, pseudonym) == {"L1": 3, "L2": 4}
    with store.database.write_transaction() as connection:
        assert reconcile_answers(store, connection, attempt, [*recorded, *lacking]) == []
