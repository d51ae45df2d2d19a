"""What all exports go through: every completed trial with whom, where and what it was."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from avrgym.study.recording import Recording, read_recording
from avrgym.study.records import Control
from avrgym.study.rows import GivenAnswer, Participant, StudySession, Trial, TrialAttempt
from avrgym.study.store import Store
from avrgym.tasks import find_environment


@dataclass(frozen=True)
class ExportedAttempt:
    """One attempt with all it belongs to."""

    store: Store
    participant: Participant
    session: StudySession
    trial: Trial
    attempt: TrialAttempt
    answers: tuple[GivenAnswer, ...]

    @property
    def task(self) -> str:
        return find_environment(self.trial.environment)[0]

    @property
    def robot(self) -> str:
        return find_environment(self.trial.environment)[1]

    @property
    def scene(self) -> str:
        """Task and robot in one word."""
        return self.task + self.robot

    def read(self) -> Recording:
        """Read the recording; it is large, and nothing keeps it."""
        return read_recording(self.store.path(self.attempt.recording))

    def control_steps(self) -> list[tuple[float, Control]]:
        """The control steps with their times in seconds."""
        return [(time_ns / 1e9, control) for time_ns, control in self.read().topics["/control"]]

    def labels(self) -> dict[str, Any]:
        """What tells this attempt from all others, for the rows of tables."""
        return {
            "participant": self.participant.pseudonym,
            "simulated": self.participant.simulated,
            "session": self.session.number,
            "position": self.trial.position,
            "practice": self.trial.practice,
            "task": self.task,
            "robot": self.robot,
            "policy": self.trial.policy,
            "attempt": self.attempt.number,
        }


def all_attempts(store: Store) -> Iterator[ExportedAttempt]:
    """Every attempt of every participant, in the order they began."""
    for participant in store.participants():
        sessions = {session.id: session for session in store.sessions(participant.pseudonym)}
        trials = {trial.id: trial for trial in store.trials(participant.pseudonym)}
        answers = store.answers(participant.pseudonym)
        for attempt in store.attempts(participant.pseudonym):
            own = tuple(answer for answer in answers if answer.attempt == attempt.id)
            session, trial = sessions[attempt.session], trials[attempt.trial]
            yield ExportedAttempt(store, participant, session, trial, attempt, own)


def completed_attempts(store: Store) -> Iterator[ExportedAttempt]:
    """The attempts that completed their trials."""
    return (exported for exported in all_attempts(store) if exported.attempt.state == "completed")


def scenes(store: Store) -> dict[str, list[ExportedAttempt]]:
    """The completed attempts by task and robot, for formats that need equal observations."""
    found: dict[str, list[ExportedAttempt]] = {}
    for exported in completed_attempts(store):
        found.setdefault(exported.scene, []).append(exported)
    return found
