"""Sessions of a study one after another, as the server's loop runs them and an experimenter begins them."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from avrgym.study import database
from avrgym.study.participants import enrol
from avrgym.study.serving import StudySessions
from avrgym.study.states import StudyError
from avrgym.study.store import Store
from avrgym.vr.messages import Command, Entered, Phase, Scene, ServerMessage, Welcome
from avrgym.vr.world import TICK_S
from studies import make_study, take_in


class Loop:
    """Ticks the sessions as a loop would, while another thread asks; ``heard`` is what was sent."""

    def __init__(self, store: Store) -> None:
        self.heard: list[ServerMessage] = []
        self.sessions = StudySessions(store, self.heard.append)
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
    monkeypatch.delenv(database.URL_VARIABLE, raising=False)
    with Store(make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]')) as opened:
        yield opened


@pytest.fixture
def loop(store: Store) -> Iterator[Loop]:
    running = Loop(store)
    yield running
    running.sessions.close(running.now_s)


def test_clients_wait_until_a_session_begins_and_one_runs_at_a_time(store: Store, loop: Loop) -> None:
    first, second = take_in(store), take_in(store)
    greeted: list[ServerMessage] = []
    loop.sessions.greet(greeted.append, "participant", 0.0)
    loop.sessions.receive(Entered(), 0.0)
    loop.tick()
    assert (loop.sessions.participant, list(loop.sessions.scenes)) == (None, [])
    assert [type(message) for message in greeted] == [Welcome, Phase]
    greeted.clear()
    loop.ask(loop.sessions.begin, first)
    assert [type(message) for message in greeted] == [Welcome, Scene, Phase]
    assert (loop.sessions.participant, len(loop.sessions.scenes)) == (first, 1)
    with pytest.raises(StudyError, match="the session of sub-001 runs; end it before another begins"):
        loop.ask(loop.sessions.begin, second)
    loop.sessions.receive(Command(name="end"), loop.now_s)
    loop.tick()
    assert (loop.sessions.participant, store.sessions(first)[0].state) == (None, "closed")
    loop.ask(loop.sessions.begin, second)
    assert loop.sessions.participant == second
    assert [type(message) for message in greeted] == 2 * [Welcome, Scene, Phase]


def test_who_withdraws_is_withdrawn_after_their_session_has_ended(store: Store, loop: Loop) -> None:
    pseudonym = take_in(store)
    loop.ask(loop.sessions.begin, pseudonym)
    with pytest.raises(StudyError, match="no session of sub-002 runs here"):
        loop.ask(loop.sessions.withdraw, "sub-002", "")
    loop.ask(loop.sessions.withdraw, pseudonym, "felt sick")
    assert store.participant(pseudonym).state == "withdrawn"
    assert [session.state for session in store.sessions(pseudonym)] == ["closed"]
    assert loop.sessions.participant is None


def test_a_session_that_cannot_be_changes_nothing(store: Store, loop: Loop) -> None:
    pseudonym = enrol(store, "man")
    with pytest.raises(StudyError, match="is enrolled; only the allocated have sessions"):
        loop.ask(loop.sessions.begin, pseudonym)
    assert (loop.sessions.participant, store.sessions(pseudonym)) == (None, [])


def test_the_end_of_the_server_closes_the_session(store: Store) -> None:
    pseudonym = take_in(store)
    loop = Loop(store)
    loop.ask(loop.sessions.begin, pseudonym)
    loop.sessions.close(loop.now_s)
    assert [session.state for session in store.sessions(pseudonym)] == ["closed"]
    assert store.participant(pseudonym).state == "allocated"
