"""Successive sessions of a study in the loop of the server."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.study.checking.checks import check_study
from avrgym.study.people.participants import enrol_participant, withdraw
from avrgym.study.sessions import serving, threads
from avrgym.study.sessions.serving import StudySessions
from avrgym.study.storage import database, schema
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    Body,
    Command,
    Entered,
    Input,
    Language,
    Phase,
    Problem,
    Question,
    Ready,
    Scene,
    SentMessage,
    Welcome,
)
from helpers.studies.small_studies import enrol_with_consent, make_study, run_trial

NO_PROCESS = 2**22 + 1
"""No process of Linux has this number."""


class Loop:
    """Ticks the sessions while another thread sends requests; ``heard`` contains the sent messages."""

    def __init__(self, store: Store) -> None:
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
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    with Store(make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]')) as opened:
        yield opened


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Store]:
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
    with Store(folder) as opened:
        yield opened


@pytest.fixture
def loop(store: Store) -> Iterator[Loop]:
    running = Loop(store)
    yield running
    running.sessions.close(running.now_s)


@pytest.mark.slow
def test_one_session_runs_at_a_time(store: Store, loop: Loop) -> None:
    """The next session begins for spectators, and not for the earlier participant."""
    first, second = enrol_with_consent(store), enrol_with_consent(store)
    greeted: list[SentMessage] = []
    watched: list[SentMessage] = []
    loop.sessions.send_initial_state(greeted.append, "participant", 0.0)
    loop.sessions.send_initial_state(watched.append, "spectator", 0.0)
    loop.sessions.receive(Entered(), 0.0)
    loop.tick()
    assert (loop.sessions.participant, list(loop.sessions.scenes)) == (None, [])
    assert [type(message) for message in greeted] == [Welcome, Language, Phase]
    greeted.clear()
    watched.clear()
    loop.ask(loop.sessions.begin, first)
    assert [type(message) for message in greeted] == [Welcome, Language, Body, Input, Scene, Phase]
    assert (loop.sessions.participant, len(loop.sessions.scenes)) == (first, 1)
    with pytest.raises(StudyError, match="the session of sub-001 is running; end it first"):
        loop.ask(loop.sessions.begin, second)
    loop.sessions.receive(Command(name="end"), loop.now_s)
    loop.tick()
    assert (loop.sessions.participant, store.sessions(first)[0].state) == (None, "closed")
    loop.ask(loop.sessions.begin, second)
    assert loop.sessions.participant == second
    assert [type(message) for message in greeted] == [Welcome, Language, Body, Input, Scene, Phase]
    assert [type(message) for message in watched] == 2 * [Welcome, Language, Body, Input, Scene, Phase]


def test_sessions_use_the_latest_furniture(store: Store, loop: Loop) -> None:
    """The furniture of the design applies until a session sets another, which later sessions keep."""
    assert loop.sessions.furniture == store.design.furniture
    lower = RealFurniture(seat_height_m=0.45)
    for furniture in (lower, None):
        loop.ask(
            lambda pseudonym, seat=furniture: loop.sessions.begin(pseudonym, seat), enrol_with_consent(store)
        )
        assert loop.sessions.furniture == lower
        loop.sessions.receive(Command(name="end"), loop.now_s)
        loop.tick()


def test_withdrawal_is_stored_after_the_session(store: Store, loop: Loop) -> None:
    pseudonym = enrol_with_consent(store)
    loop.ask(loop.sessions.begin, pseudonym)
    with pytest.raises(StudyError, match="no session of sub-002 is running"):
        loop.ask(loop.sessions.withdraw, "sub-002", "")
    loop.ask(loop.sessions.withdraw, pseudonym, "felt sick")
    assert store.participant(pseudonym).state == "withdrawn"
    assert [session.state for session in store.sessions(pseudonym)] == ["closed"]
    assert loop.sessions.participant is None


def test_impossible_session_changes_nothing(store: Store, loop: Loop) -> None:
    pseudonym = enrol_participant(store, "man")
    with pytest.raises(StudyError, match="is enrolled; only allocated participants"):
        loop.ask(loop.sessions.begin, pseudonym)
    assert (loop.sessions.participant, store.sessions(pseudonym)) == (None, [])


def test_server_end_closes_the_session(store: Store) -> None:
    pseudonym = enrol_with_consent(store)
    loop = Loop(store)
    loop.ask(loop.sessions.begin, pseudonym)
    loop.sessions.close(loop.now_s)
    assert [session.state for session in store.sessions(pseudonym)] == ["closed"]
    assert store.participant(pseudonym).state == "allocated"


# Questions about the session


def asked(heard: list[SentMessage]) -> list[str]:
    return [message.item for message in heard if isinstance(message, Question)]


def answer(loop: Loop, item: str, value: int) -> None:
    """Answer all questions, then confirm the answers."""
    loop.sessions.receive(Answer(item=item, value=value, response_time_s=2.5), loop.now_s)
    loop.sessions.receive(Ready(), loop.now_s)
    loop.tick()


def test_questions_before_and_after_the_trials_are_stored(asking: Store) -> None:
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    loop.sessions.send_initial_state(loop.inbox.append, "participant", 0.0)
    loop.ask(loop.sessions.begin, pseudonym)
    assert [type(message) for message in loop.inbox[-5:]] == [Welcome, Language, Input, Phase, Question]
    loop.sessions.receive(Entered(), loop.now_s)
    for item, value, problem in (
        ("strain", 2, "the answer is to 'strain'; expected: nausea"),
        ("nausea", 5, "allowed: integers from 1 to 4"),
    ):
        answer(loop, item, value)
        assert problem in [message for message in loop.inbox if isinstance(message, Problem)][-1].message
    assert asking.answers(pseudonym) == []
    answer(loop, "nausea", 3)
    assert [(given.item, given.value) for given in asking.answers(pseudonym)] == [("nausea", 3)]
    for _ in range(3):  # a press that bounces
        loop.sessions.receive(Answer(item="strain", value=4, response_time_s=2.5), loop.now_s)
    loop.sessions.receive(Command(name="skip"), loop.now_s)
    loop.tick()
    assert [type(message) for message in loop.inbox[-6:]] == [Welcome, Language, Body, Input, Scene, Phase]
    loop.sessions.receive(Command(name="end"), loop.now_s)
    loop.tick()
    assert asked(loop.inbox)[-1] == "effort"
    assert loop.sessions.participant == pseudonym
    late: list[SentMessage] = []
    loop.sessions.send_initial_state(late.append, "participant", loop.now_s)
    assert asked(late) == ["effort"]
    answer(loop, "effort", 1)
    loop.tick()
    assert (loop.sessions.participant, asking.sessions(pseudonym)[0].state) == (None, "closed")
    given = [
        (each.item, each.value, each.response_time_s, each.attempt) for each in asking.answers(pseudonym)
    ]
    assert given == [("nausea", 3, 2.5, None), ("strain", 4, 2.5, None), ("effort", 1, 2.5, None)]
    loop.sessions.close(loop.now_s)


@pytest.mark.slow
def test_experimenter_skips_questions_or_ends_the_session(asking: Store) -> None:
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    loop.ask(loop.sessions.begin, pseudonym)
    answer(loop, "nausea", 1)
    loop.sessions.receive(Command(name="end"), loop.now_s)
    loop.tick()
    assert (loop.sessions.participant, asking.sessions(pseudonym)[0].state) == (None, "closed")
    loop.ask(loop.sessions.begin, pseudonym)
    for command in ("skip", "end"):
        loop.sessions.receive(Command(name=command), loop.now_s)
        loop.tick()
    assert "questions before_session left" in [event.name for event in asking.events()]
    assert loop.sessions.participant == pseudonym
    loop.ask(loop.sessions.withdraw, pseudonym, "")
    assert asking.participant(pseudonym).state == "withdrawn"
    notes = [finding.message for finding in check_study(asking) if finding.where.startswith("ses-")]
    assert notes == ["has unanswered items: strain, effort", "has unanswered items: nausea, strain, effort"]
    assert not any(finding.is_error for finding in check_study(asking))
    loop.sessions.close(loop.now_s)


def test_session_with_only_the_last_questions(asking: Store) -> None:
    """The session ended by a crash between the last trial and the last questions."""
    loop, pseudonym = Loop(asking), enrol_with_consent(asking)
    session = open_session(asking, pseudonym)
    for trial in asking.remaining_trials(pseudonym):
        run_trial(asking, session, trial)
    with asking.database.write_transaction() as connection:
        connection.execute(sa.update(schema.SESSION_TABLE).values(process_id=NO_PROCESS))
    loop.ask(loop.sessions.begin, pseudonym)
    assert asked(loop.inbox) == []
    loop.sessions.send_initial_state(loop.inbox.append, "participant", loop.now_s)
    assert asked(loop.inbox) == ["effort"]
    answer(loop, "effort", 2)
    loop.tick()
    assert asking.participant(pseudonym).state == "completed"


def test_session_does_not_begin_without_a_link(
    store: Store, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the link cannot be stored, the session does not begin for spectators."""

    def fail(*_: object, **__: object) -> str:
        raise StudyError("the study's database: disk full")

    pseudonym = enrol_with_consent(store)
    with monkeypatch.context() as patch:
        patch.setattr(serving, "make_session_link", fail)
        with pytest.raises(StudyError, match="disk full"):
            loop.ask(loop.sessions.begin, pseudonym)
    assert (loop.sessions.participant, loop.sessions.at_rest) == (None, True)
    watched: list[SentMessage] = []
    loop.sessions.send_initial_state(watched.append, "experimenter", loop.now_s)
    assert [each.session for each in watched if isinstance(each, Welcome)] == [""]
    loop.ask(loop.sessions.begin, pseudonym)
    assert loop.sessions.participant == pseudonym


def test_loop_does_not_wait_for_a_new_link(store: Store, loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """The database may be locked for a minute while the robot moves."""
    loop.ask(loop.sessions.begin, enrol_with_consent(store))
    before, made_by = loop.sessions.links.link, list[threading.Thread]()
    make_link = serving.make_session_link

    def noted(*arguments: Any) -> str:
        made_by.append(threading.current_thread())
        return make_link(*arguments)

    monkeypatch.setattr(serving, "make_session_link", noted)
    loop.ask(loop.sessions.renew_link, "sub-001")
    assert made_by != [threading.current_thread()]
    assert len(made_by) == 1
    assert loop.sessions.links.link not in (None, before)
    with pytest.raises(StudyError, match="no session of sub-002 is running"):
        loop.ask(loop.sessions.renew_link, "sub-002")


def test_link_ends_when_another_process_ends_the_session(
    store: Store, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threads, "SESSION_POLL_INTERVAL_S", 0.01)
    loop.ask(loop.sessions.begin, enrol_with_consent(store))
    withdraw(store, "sub-001", "at another station")
    while loop.sessions.participant is not None:
        loop.tick()
    assert loop.sessions.links.link is None
    assert loop.sessions.links.current_code() is None
