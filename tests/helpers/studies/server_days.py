"""Study sessions of a participant in simulated time, in server processes that can be killed."""

import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from avrgym.recording.reader import read_recording
from avrgym.study.sessions import study_visit
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    MessageSender,
    ParticipantReady,
    Question,
    Scene,
    SceneLoaded,
    SentMessage,
    VrEntered,
)

ANSWERS = {"L1": 1, "L2": 2, "L3": 3, "L4": 4}


class ServerDay:
    """The sessions of one server process with a simulated participant."""

    def __init__(self, store: StudyStore, pseudonym: str) -> None:
        self.inbox: list[SentMessage] = []
        send: MessageSender = self.inbox.append
        self.sessions = StudySessions(store, send, first=pseudonym)
        self.sessions.send_initial_state(send, "participant", 0.0)
        self.participant = SimulatedParticipant(sample_participant_traits("woman", 1), 1)
        self.ticks = 0

    @property
    def phase(self) -> str:
        session = self.sessions._session
        return "over" if session is None or self.sessions.running_participant is None else session.phase_name

    def send(self, *sent) -> None:
        for message in sent:
            self.sessions.receive(message, self.ticks * TICK_S)

    def tick(self) -> None:
        if self.ticks % 4 == 0:
            frame = self.participant.make_tracking_frame(
                self.ticks * TICK_S, moving=self.phase != "calibration"
            )
            self.send(frame)
        if self.phase == "loading":
            self.send(SceneLoaded([each for each in self.inbox if isinstance(each, Scene)][-1].url))
        if self.phase in ("calibration", "check", "ready", "paused") and self.ticks % 40 == 39:
            self.send(ParticipantReady())
        self.sessions.tick(self.ticks * TICK_S)
        self.ticks += 1

    def run_until(self, *phases: str) -> None:
        ends = self.ticks + 20_000
        while self.phase not in phases:
            assert self.ticks < ends, f"still in {self.phase}"
            self.tick()

    def question(self) -> Question:
        return [each for each in self.inbox if isinstance(each, Question)][-1]

    def answer(self, count: int) -> None:
        for _ in range(count):
            item = self.question().item
            self.send(Answer(item, ANSWERS[item], 1.0))
            self.tick()

    def end(self) -> None:
        self.sessions.close(self.ticks * TICK_S)


def kill_server_in(folder: Path, pseudonym: str, phase: str, answers: int, stored: int) -> None:
    """Kill the server (SIGKILL) in a phase after ``answers`` answers, of which ``stored`` are in the database."""
    here, there = get_context("spawn").Pipe()
    process = get_context("spawn").Process(
        target=_attend, args=(folder, pseudonym, phase, answers, stored, there)
    )
    process.start()
    try:
        assert here.poll(120.0)
    finally:
        process.kill()
        process.join()


def _attend(folder: Path, pseudonym: str, phase: str, answers: int, stored: int, reports: Connection) -> None:
    """Advance to a phase, report it, and wait."""
    with StudyStore(folder) as store:
        day = ServerDay(store, pseudonym)
        day.send(VrEntered())
        day.run_until("questionnaire" if answers else phase)
        day.answer(min(stored, answers))
        if stored < answers:
            study_visit.record_trial_answer = lambda *_: None
            day.answer(answers - stored)
        day.tick()
        (attempt,) = store.read_attempts(pseudonym)
        recording = store.resolve_path(attempt.recording)
        while phase != "trial" and read_recording(recording).robot_outcome is None:
            time.sleep(0.01)
        while stored < answers > len(read_recording(recording).messages_by_topic["/answers"]):
            time.sleep(0.01)
        reports.send(day.phase)
        time.sleep(600.0)
