"""A participant's client and a session that share one simulated clock: no network, no waiting."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.human import Sex
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.recording.reader import Recording, read_recording
from avrgym.tasks.registry import sizes
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, draw_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    Disconnected,
    Entered,
    Phase,
    Problem,
    Question,
    Ready,
    Scene,
    SceneLoaded,
    Send,
    Stop,
)
from avrgym.vr.session import events as session_events
from avrgym.vr.session.plan import Policies, SessionPlan, TrialPlan
from avrgym.vr.session.session import Session

ENVIRONMENT = "avrgym/FeedingJaco-v1"
FRAME_EVERY_TICKS = 4
CALIBRATION_TICKS = 20


def constant_policy(environment: str) -> Policy:
    """Turns every joint at 0.6 of its speed, whatever it sees."""
    size = sizes(environment)[0]
    return Policy(
        weights=(np.zeros((size, 7)),),
        biases=(np.array([0.6, -0.6, 0.6, -0.6, 0.6, -0.6, 0.6]),),
        observation_mean=np.zeros(size),
        observation_variance=np.ones(size),
        observation_clip=5.0,
        observation_epsilon=1e-8,
        action_std=0.0,
        metadata=PolicyMetadata(environment=environment, people="original", steps=0, seed=0),
    )


def plan(
    *,
    sex: Sex = "woman",
    free_movement_s: float = 0.1,
    seeds: Sequence[int] = (3,),
    practice: bool = False,
    trial_steps: int = 3,
    environments: Sequence[str] = (ENVIRONMENT,),
) -> SessionPlan:
    """Short trials with the policy ``drive``, the first of them a practice trial if wanted.

    There is one for each seed; their environments take turns.
    """
    trials = [
        TrialPlan(environments[i % len(environments)], "drive", seed, practice and i == 0)
        for i, seed in enumerate(seeds)
    ]
    return SessionPlan(trials, sex, free_movement_s, simulated=True, trial_steps=trial_steps, countdown_s=0.1)


def constant_policies(plan: SessionPlan) -> Policies:
    """The policy ``drive`` for every environment of a plan."""
    return {(trial.environment, trial.policy): constant_policy(trial.environment) for trial in plan.trials}


def result(recording: Recording) -> str:
    """How an attempt ended, by its recording."""
    assert recording.outcome is not None
    return recording.outcome.result


def events(recording: Recording) -> list[str]:
    """The names of all events of a recording, in order."""
    return [event.name for _, event in recording.topics["/events"]]


class Visit:
    """A session and whoever attends it. ``heard`` holds all that the session said, ``observed`` what happened.

    While ``tracking`` is true the participant's frames flow; ``pose_rad`` (20,) is a pose to keep instead of
    their own movement. While ``loads`` is true the client shows every scene at once, and while ``content`` is true
    the participant finds that body and seat fit, is ready for every trial and confirms their answers.
    """

    def __init__(
        self,
        folder: Path,
        plan: SessionPlan,
        policies: Policies | None = None,
        participant: SimulatedParticipant | None = None,
        make: Callable[[Send], Session] | None = None,
    ) -> None:
        """Begin a session with a plan in a folder, or one that ``make`` makes."""
        self.inbox: list[messages.ServerMessage | messages.State] = []
        self.participant = participant or SimulatedParticipant(draw_traits(plan.sex, 1), 1)
        self.tracking = self.loads_scenes = self.confirms = True
        self.pose_rad: FloatArray | None = None
        self.observed: list[session_events.SessionEvent] = []
        self.session = (
            make(self.receive)
            if make
            else Session(
                plan,
                policies or constant_policies(plan),
                folder,
                self.receive,
                "visit",
                observe=self.observed.append,
            )
        )
        self._ticks = 0

    def receive(self, message: messages.ServerMessage | messages.State) -> None:
        """Take a message of the session, which a connection could send."""
        messages.encode(message)
        self.inbox.append(message)

    @property
    def now_s(self) -> float:
        """Seconds since the session began."""
        return self._ticks * TICK_S

    @property
    def phase(self) -> str:
        """The session's phase."""
        return self.session.phase

    def received(self, kind: type) -> list[Any]:
        """All messages of a kind, in order."""
        return [message for message in self.inbox if isinstance(message, kind)]

    @property
    def problems(self) -> list[str]:
        """The words of all problems, but for the warning of a busy machine that its disk is slow."""
        return [problem.message for problem in self.received(Problem) if "slow" not in problem.message]

    @property
    def phases(self) -> list[str]:
        """The names of all phases that were entered."""
        return [phase.name for phase in self.received(Phase)]

    def recordings(self) -> list[Recording]:
        """All attempts so far."""
        return [read_recording(path) for path in self.session.recordings]

    def send(self, *told: messages.ClientMessage | messages.ExperimenterMessage | Disconnected) -> None:
        """Send messages to the session, now."""
        for message in told:
            self.session.receive(message, self.now_s)

    def frame(self) -> messages.Tracking:
        """The participant's next frame."""
        if self.pose_rad is not None:
            return self.participant.frame_of(self.pose_rad, self.now_s)
        return self.participant.frame(self.now_s, moving=self.phase != "calibration")

    def tick(self, count: int = 1) -> None:
        """Let time pass."""
        for _ in range(count):
            if self.tracking and self._ticks % FRAME_EVERY_TICKS == 0:
                self.send(self.frame())
            if self.loads_scenes and self.phase in ("loading", "headset") and self.received(Scene):
                self.send(SceneLoaded(url=self.received(Scene)[-1].url))
            if self.confirms and self.phase in ("check", "ready"):
                self.send(Ready())
            self.session.tick(self.now_s)
            self._ticks += 1

    def run_until(self, phase: str, limit_s: float = 60.0) -> None:
        """Let time pass until the session enters a phase."""
        ends_s = self.now_s + limit_s
        while self.phase != phase:
            assert self.now_s < ends_s, f"still in {self.phase} after {limit_s} s; problems: {self.problems}"
            self.tick()

    def calibrate(self) -> None:
        """Enter VR and be measured."""
        self.send(Entered())
        self.tick(CALIBRATION_TICKS)
        self.send(Ready())

    def go_to(self, phase: str) -> None:
        """From the beginning to a phase of the first trial."""
        if phase == "waiting":
            return
        if phase == "calibration":
            self.send(Entered())
            self.tick(CALIBRATION_TICKS)
            return
        self.loads_scenes, self.confirms = phase != "loading", phase != "check"
        self.calibrate()
        self.run_until({"paused": "trial", "finished": "questionnaire"}.get(phase, phase))
        self.tick(3)
        if phase == "paused":
            self.send(Stop())
        if phase == "finished":
            self.answer(1, 2, 3, 4)

    def answer(self, *values: int) -> None:
        """Answer the questions that are asked, one after another."""
        for value in values:
            item = self.received(Question)[-1].item
            self.send(Answer(item=item, value=value, response_time_s=1.5))
        if self.confirms and self.phase == "confirm":
            self.send(Ready())

    def leave(self) -> None:
        """End the session."""
        self.session.close(self.now_s)
