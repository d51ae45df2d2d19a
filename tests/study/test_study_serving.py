"""Successive sessions of a study in the loop of the server."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.participants import enrol_participant, withdraw_participant
from avrgym.study.sessions import session_threads, study_sessions
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage import database, schema
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    ExperimenterCommand,
    InputProfileMessage,
    Language,
    ParticipantBody,
    ParticipantReady,
    PhaseDescription,
    Problem,
    Question,
    Scene,
    SentMessage,
    VrEntered,
    Welcome,
)
from helpers.studies.small_studies import enrol_with_consent, make_study, run_trial

NO_PROCESS = 2**22 + 1
"""No process of Linux has this number."""


class Loop:
    """Ticks the sessions while another thread sends requests; ``heard`` contains the sent messages."""

    def __init__(self, store: StudyStore) -> None:
        self.inbox: list[SentMessage] = []
        self.sessions = StudySessions(store, self.inbox.append)
        self.now_s = 0.0

    def tick(self) -> None:
        self.sessions.tick(self.now_s)
        self.now_s += TICK_S

    def ask(self, ask: Callable[..., None], *arguments: str) -> None:
        with ThreadPoolExecutor(1) as thread:
            asked = thread.submit(ask, *arguments)
            while not asked.done():
                self.tick()
            asked.result()


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with StudyStore(make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]')) as opened:
        yield opened


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    """A study with two items before each session and one after it."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]')
    with open(folder / "study.toml", "a") as file:
        for when, names in (("before_session", ("nausea", "strain")), ("after_session", ("effort",))):
            items = [
                f'{{ id = "{name}", text = "{name}?", points = 4, low = "no", high = "very" }}'
                for name in names
            ]
            file.write(
                f'[[questionnaires]]\nname = "{when}"\nwhen = "{when}"\nitems = [{", ".join(items)}]\n'
            )
    with StudyStore(folder) as opened:
        yield opened


@pytest.fixture
def loop(store: StudyStore) -> Iterator[Loop]:
    running = Loop(store)
    yield running
    running.sessions.close(running.now_s)


@pytest.mark.slow
def test_one_session_runs_at_a_time(store: StudyStore, loop: Loop) -> None:
    """The next session begins for spectators, and not for the earlier participant."""
    first, second = enrol_with_consent(store), enrol_with_consent(store)
    greeted: list[SentMessage] = []
    watched: list[SentMessage] = []
    loop.sessions.send_initial_state(greeted.append, "participant", 0.0)
    loop.sessions.send_initial_state(watched.append, "spectator", 0.0)
    loop.sessions.receive(VrEntered(), 0.0)
    loop.tick()
    assert (loop.sessions.running_participant, list(loop.sessions.scenes)) == (None, [])
    assert [type(message) for message in greeted] == [Welcome, Language, PhaseDescription]
    greeted.clear()
    watched.clear()
    loop.ask(loop.sessions.begin_session, first)
    assert [type(message) for message in greeted] == [
        Welcome,
        Language,
        ParticipantBody,
        InputProfileMessage,
        Scene,
        PhaseDescription,
    ]
    assert (loop.sessions.running_participant, len(loop.sessions.scenes)) == (first, 1)
    with pytest.raises(StudyError, match="the session of sub-001 is running; end it first"):
        loop.ask(loop.sessions.begin_session, second)
    loop.sessions.receive(ExperimenterCommand(name="end"), loop.now_s)
    loop.tick()
    assert (loop.sessions.running_participant, store.read_sessions(first)[0].state) == (None, "closed")
    loop.ask(loop.sessions.begin_session, second)
    assert loop.sessions.running_participant == second
    assert [type(message) for message in greeted] == [
        Welcome,
        Language,
        ParticipantBody,
        InputProfileMessage,
        Scene,
        PhaseDescription,
    ]
    assert [type(message) for message in watched] == 2 * [
        Welcome,
        Language,
        ParticipantBody,
        InputProfileMessage,
        Scene,
        PhaseDescription,
    ]


def test_sessions_use_the_latest_furniture(store: StudyStore, loop: Loop) -> None:
    """The furniture of the design applies until a session sets another, which later sessions keep."""
    assert loop.sessions.furniture == store.design.furniture
    lower = RealFurniture(seat_height_m=0.45)
    for furniture in (lower, None):
        loop.ask(
            lambda pseudonym, seat=furniture: loop.sessions.begin_session(pseudonym, seat),
            enrol_with_consent(store),
        )
        assert loop.sessions.furniture == lower
        loop.sessions.receive(ExperimenterCommand(name="end"), loop.now_s)
        loop.tick()


def test_withdrawal_is_stored_after_the_session(store: StudyStore, loop: Loop) -> None:
    pseudonym = enrol_with_consent(store)
    loop.ask(loop.sessions.begin_session, pseudonym)
    with pytest.raises(StudyError, match="no session of sub-002 is running"):
        loop.ask(loop.sessions.withdraw_participant, "sub-002", "")
    loop.ask(loop.sessions.withdraw_participant, pseudonym, "felt sick")
    assert store.read_participant(pseudonym).state == "withdrawn"
    assert [session.state for session in store.read_sessions(pseudonym)] == ["closed"]
    assert loop.sessions.running_participant is None


def test_impossible_session_changes_nothing(store: StudyStore, loop: Loop) -> None:
    pseudonym = enrol_participant(store, "man")
    with pytest.raises(StudyError, match="is enrolled; only allocated participants"):
        loop.ask(loop.sessions.begin_session, pseudonym)
    assert (loop.sessions.running_participant, store.read_sessions(pseudonym)) == (None, [])


def test_server_end_closes_the_session(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    loop = Loop(store)
    loop.ask(loop.sessions.begin_session, pseudonym)
    loop.sessions.close(loop.now_s)
    assert [session.state for session in store.read_sessions(pseudonym)] == ["closed"]
    assert store.read_participant(pseudonym).state == "allocated"


# Questions about the session


def asked(heard: list[SentMessage]) -> list[str]:
    return [message.item for message in heard if isinstance(message, Question)]


def answer(loop: Loop, item: str, value: int) -> None:
    """Answer all questions, then confirm the answers."""
    loop.sessions.receive(Answer(item=item, value=value, response_time_s=2.5), loop.now_s)
    loop.sessions.receive(ParticipantReady(), loop.now_s)
    loop.tick()


def test_questions_before_and_after_the_trials_are_stored(asking: StudyStore) -> None:
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    loop.sessions.send_initial_state(loop.inbox.append, "participant", 0.0)
    loop.ask(loop.sessions.begin_session, pseudonym)
    assert [type(message) for message in loop.inbox[-5:]] == [
        Welcome,
        Language,
        InputProfileMessage,
        PhaseDescription,
        Question,
    ]
    loop.sessions.receive(VrEntered(), loop.now_s)
    for item, value, problem in (
        ("strain", 2, "the answer is to 'strain'; expected: nausea"),
        ("nausea", 5, "allowed: integers from 1 to 4"),
    ):
        answer(loop, item, value)
        assert problem in [message for message in loop.inbox if isinstance(message, Problem)][-1].message
    assert asking.read_answers(pseudonym) == []
    answer(loop, "nausea", 3)
    assert [(given.item, given.value) for given in asking.read_answers(pseudonym)] == [("nausea", 3)]
    for _ in range(3):  # a press that bounces
        loop.sessions.receive(Answer(item="strain", value=4, response_time_s=2.5), loop.now_s)
    loop.sessions.receive(ExperimenterCommand(name="skip"), loop.now_s)
    loop.tick()
    assert [type(message) for message in loop.inbox[-6:]] == [
        Welcome,
        Language,
        ParticipantBody,
        InputProfileMessage,
        Scene,
        PhaseDescription,
    ]
    loop.sessions.receive(ExperimenterCommand(name="end"), loop.now_s)
    loop.tick()
    assert asked(loop.inbox)[-1] == "effort"
    assert loop.sessions.running_participant == pseudonym
    late: list[SentMessage] = []
    loop.sessions.send_initial_state(late.append, "participant", loop.now_s)
    assert asked(late) == ["effort"]
    answer(loop, "effort", 1)
    loop.tick()
    assert (loop.sessions.running_participant, asking.read_sessions(pseudonym)[0].state) == (None, "closed")
    given = [
        (each.item, each.value, each.response_time_s, each.attempt) for each in asking.read_answers(pseudonym)
    ]
    assert given == [("nausea", 3, 2.5, None), ("strain", 4, 2.5, None), ("effort", 1, 2.5, None)]
    loop.sessions.close(loop.now_s)


@pytest.mark.slow
def test_experimenter_skips_questions_or_ends_the_session(asking: StudyStore) -> None:
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    loop.ask(loop.sessions.begin_session, pseudonym)
    answer(loop, "nausea", 1)
    loop.sessions.receive(ExperimenterCommand(name="end"), loop.now_s)
    loop.tick()
    assert (loop.sessions.running_participant, asking.read_sessions(pseudonym)[0].state) == (None, "closed")
    loop.ask(loop.sessions.begin_session, pseudonym)
    for command in ("skip", "end"):
        loop.sessions.receive(ExperimenterCommand(name=command), loop.now_s)
        loop.tick()
    assert "questions before_session left" in [event.name for event in asking.read_events()]
    assert loop.sessions.running_participant == pseudonym
    loop.ask(loop.sessions.withdraw_participant, pseudonym, "")
    assert asking.read_participant(pseudonym).state == "withdrawn"
    notes = [finding.message for finding in check_study(asking) if finding.where.startswith("ses-")]
    assert notes == ["has unanswered items: strain, effort", "has unanswered items: nausea, strain, effort"]
    assert not any(finding.is_error for finding in check_study(asking))
    loop.sessions.close(loop.now_s)


def test_session_with_only_the_last_questions(asking: StudyStore) -> None:
    """The session ended by a crash between the last trial and the last questions."""
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    session = open_session(asking, pseudonym)
    for trial in asking.read_remaining_trials(pseudonym):
        run_trial(asking, session, trial)
    with asking.database.write_transaction() as connection:
        connection.execute(sa.update(schema.SESSION_TABLE).values(process_id=NO_PROCESS))
    loop.ask(loop.sessions.begin_session, pseudonym)
    assert asked(loop.inbox) == []
    loop.sessions.send_initial_state(loop.inbox.append, "participant", loop.now_s)
    assert asked(loop.inbox) == ["effort"]
    answer(loop, "effort", 2)
    loop.tick()
    assert asking.read_participant(pseudonym).state == "completed"


def test_session_does_not_begin_without_a_link(
    store: StudyStore, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the link cannot be stored, the session does not begin for spectators."""

    def fail(*_: object, **__: object) -> str:
        raise StudyError("the study's database: disk full")

    pseudonym = enrol_with_consent(store)
    with monkeypatch.context() as patch:
        patch.setattr(study_sessions, "make_session_link", fail)
        with pytest.raises(StudyError, match="disk full"):
            loop.ask(loop.sessions.begin_session, pseudonym)
    assert (loop.sessions.running_participant, loop.sessions.is_at_rest) == (None, True)
    watched: list[SentMessage] = []
    loop.sessions.send_initial_state(watched.append, "experimenter", loop.now_s)
    assert [each.session for each in watched if isinstance(each, Welcome)] == [""]
    loop.ask(loop.sessions.begin_session, pseudonym)
    assert loop.sessions.running_participant == pseudonym


def test_loop_does_not_wait_for_a_new_link(
    store: StudyStore, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The database may be locked for a minute while the robot moves."""
    loop.ask(loop.sessions.begin_session, enrol_with_consent(store))
    before, made_by = loop.sessions.participant_links.current_link_token, list[threading.Thread]()
    make_link = study_sessions.make_session_link

    def noted(*arguments: Any) -> str:
        made_by.append(threading.current_thread())
        return make_link(*arguments)

    monkeypatch.setattr(study_sessions, "make_session_link", noted)
    loop.ask(loop.sessions.renew_session_link, "sub-001")
    assert made_by != [threading.current_thread()]
    assert len(made_by) == 1
    assert loop.sessions.participant_links.current_link_token not in (None, before)
    with pytest.raises(StudyError, match="no session of sub-002 is running"):
        loop.ask(loop.sessions.renew_session_link, "sub-002")


def test_link_ends_when_another_process_ends_the_session(
    store: StudyStore, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_threads, "SESSION_POLL_INTERVAL_S", 0.01)
    loop.ask(loop.sessions.begin_session, enrol_with_consent(store))
    withdraw_participant(store, "sub-001", "at another station")
    while loop.sessions.running_participant is not None:
        loop.tick()
    assert loop.sessions.participant_links.current_link_token is None
    assert loop.sessions.participant_links.get_or_create_code() is None
