"""A questionnaire that was left open is answered in the next session; database, recording and checks agree."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from avrgym.recording.files import read_recording
from avrgym.study.checking.checks import check_study
from avrgym.study.checking.rebuilding import rebuild_study
from avrgym.study.checking.summary import summarise_study
from avrgym.study.dashboard.views import participant_view
from avrgym.study.people.participants import withdraw
from avrgym.study.sessions.serving import StudySessions
from avrgym.study.storage import database
from avrgym.study.storage.answers import open_attempts
from avrgym.study.storage.store import Store
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, draw_traits
from avrgym.vr.protocol.messages import (
    Answer,
    Back,
    Command,
    Entered,
    Question,
    Ready,
    Scene,
    SceneLoaded,
    Send,
    Sent,
)
from avrgym.vr.protocol.received import Disconnected
from avrgym.vr.tracking.world import TICK_S
from studies import make_study, take_in

GIVEN = {"L1": 1, "L2": 2, "L3": 3, "L4": 4}


class Day:
    """A server's day: the sessions of a study, and a participant who answers ``most`` questions at most."""

    def __init__(self, store: Store, pseudonym: str) -> None:
        self.heard: list[Sent] = []
        send: Send = self.heard.append
        self.sessions = StudySessions(store, send, first=pseudonym)
        self.sessions.greet(send, "participant", 0.0)
        self.participant = SimulatedParticipant(draw_traits("woman", 1), 1)
        self.ticks = 0

    @property
    def phase(self) -> str:
        session = self.sessions._session
        return "over" if session is None or self.sessions.participant is None else session.phase

    def tell(self, *told) -> None:
        for message in told:
            self.sessions.receive(message, self.ticks * TICK_S)

    def tick(self) -> None:
        if self.ticks % 4 == 0:
            frame = self.participant.frame(self.ticks * TICK_S, moving=self.phase != "calibration")
            self.tell(frame)
        if self.phase == "loading":
            self.tell(SceneLoaded([each for each in self.heard if isinstance(each, Scene)][-1].url))
        if self.phase in ("calibration", "check", "ready", "paused") and self.ticks % 40 == 39:
            self.tell(Ready())
        self.sessions.tick(self.ticks * TICK_S)
        self.ticks += 1

    def until(self, *phases: str) -> None:
        ends = self.ticks + 20_000
        while self.phase not in phases:
            assert self.ticks < ends, f"still in {self.phase}"
            self.tick()

    def question(self) -> Question:
        return [each for each in self.heard if isinstance(each, Question)][-1]

    def answer(self, count: int) -> None:
        for _ in range(count):
            item = self.question().item
            self.tell(Answer(item, GIVEN[item], 1.0))
            self.tick()

    def end(self) -> None:
        self.sessions.close(self.ticks * TICK_S)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(database.URL_VARIABLE, raising=False)
    protocol = {"practice_policy": '""', "free_movement_s": "0.1", "trial_steps": "3"}
    return make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', **protocol)


@pytest.fixture
def left(folder: Path) -> Iterator[Callable[[], tuple[Store, str]]]:
    """A study in which somebody has answered two of four questions after their first trial when the server stops."""
    stores: list[Store] = []

    def leave() -> tuple[Store, str]:
        store = Store(folder)
        stores.append(store)
        pseudonym = take_in(store)
        day = Day(store, pseudonym)
        day.tell(Entered())
        day.until("questionnaire")
        day.answer(2)
        day.end()
        return store, pseudonym

    yield leave
    for store in stores:
        store.close()


def values(store: Store, pseudonym: str) -> dict[str, int]:
    return {each.item: each.value for each in store.answers(pseudonym)}


def words(store: Store) -> list[str]:
    return [finding.what for finding in check_study(store) if "policy" not in finding.where]


def test_it_is_answered_the_next_day(left: Callable[[], tuple[Store, str]]) -> None:
    store, pseudonym = left()
    (attempt,) = store.attempts(pseudonym)
    assert attempt.state == "completed"
    assert store.trials(pseudonym)[0].state == "completed"
    assert [each.id for each in open_attempts(store, [attempt])] == [attempt.id]
    assert any("questionnaire is open: no answer to L3, L4" in each for each in words(store))
    assert not any(finding.wrong for finding in check_study(store) if "L3" in finding.what)
    assert summarise_study(store).participants[0].questionnaires_open == 1
    assert participant_view(store, pseudonym).trials[0].questionnaire_open

    day = Day(store, pseudonym)
    assert (day.phase, day.question().item) == ("questionnaire", "L3")
    day.tell(Back())
    assert day.question().given == 2
    day.answer(3)
    day.tell(Ready())
    day.until("waiting")
    day.tell(Entered())
    day.until("free_before")
    assert len(store.attempts(pseudonym)) == 2
    assert store.attempts(pseudonym)[1].trial != attempt.trial
    assert values(store, pseudonym) == GIVEN
    recording = read_recording(store.path(attempt.recording))
    assert {answer.item: answer.value for _, answer in recording.topics["/answers"]} == GIVEN
    day.end()
    assert not any(attempt.recording == each.where for each in check_study(store))
    assert summarise_study(store).participants[0].questionnaires_open == 0


def test_a_lost_database_is_rebuilt_with_late_answers(left: Callable[[], tuple[Store, str]]) -> None:
    store, pseudonym = left()
    day = Day(store, pseudonym)
    day.answer(2)
    day.tell(Ready())
    day.end()
    folder = store.folder
    store.close()
    for path in folder.glob(f"{database.FILE}*"):
        path.unlink()
    rebuilt = rebuild_study(folder)
    assert (rebuilt.attempts, rebuilt.answers) == (1, 4)
    with Store(folder) as again:
        assert values(again, pseudonym) == GIVEN
        assert again.trials(pseudonym)[0].state == "completed"
        assert open_attempts(again, again.attempts(pseudonym)) == []


def test_an_open_questionnaire_is_rebuilt_open(left: Callable[[], tuple[Store, str]]) -> None:
    store, pseudonym = left()
    folder = store.folder
    store.close()
    for path in folder.glob(f"{database.FILE}*"):
        path.unlink()
    rebuild_study(folder)
    with Store(folder) as again:
        assert len(open_attempts(again, again.attempts(pseudonym))) == 1


def test_what_the_experimenter_skips_is_missing(left: Callable[[], tuple[Store, str]]) -> None:
    store, pseudonym = left()
    day = Day(store, pseudonym)
    day.tell(Command("skip"))
    day.tick()
    day.end()
    (attempt,) = store.attempts(pseudonym)
    assert open_attempts(store, [attempt]) == []
    assert attempt.state == "completed"
    assert any("questionnaire was left: no answer to L3, L4" in each for each in words(store))


def test_who_withdraws_leaves_it_unanswered(left: Callable[[], tuple[Store, str]]) -> None:
    store, pseudonym = left()
    withdraw(store, pseudonym, "")
    assert [each.state for each in store.attempts(pseudonym)] == ["completed"]
    assert values(store, pseudonym) == {"L1": 1, "L2": 2}
    assert not any(finding.wrong for finding in check_study(store) if "L3" in finding.what)


def test_the_last_trial_waits_for_its_answers(folder: Path) -> None:
    """Nobody has completed the study before."""
    with Store(folder) as store:
        pseudonym = take_in(store)
        day = Day(store, pseudonym)
        day.tell(Entered())
        for _ in store.trials(pseudonym)[1:]:
            day.until("questionnaire")
            day.answer(4)
            day.tell(Ready())
            day.tick()
        day.until("questionnaire")
        day.answer(1)
        day.tell(Disconnected())
        day.tick()
        day.end()
        assert store.remaining_trials(pseudonym) == []
        assert store.participant(pseudonym).state == "allocated"
        last = Day(store, pseudonym)
        for _ in range(30):
            last.tick()  # the status is sent, too
        last.answer(3)
        last.tell(Ready())
        last.until("over")
        last.end()
        assert store.participant(pseudonym).state == "completed"
        assert len(store.answers(pseudonym)) == 4 * len(store.trials(pseudonym))
