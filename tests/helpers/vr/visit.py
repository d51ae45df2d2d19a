"""Runs a session and a simulated client on one simulated clock, without a network."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.human import Sex
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.recording.reader import Recording, read_recording
from avrgym.tasks.registry import get_observation_and_action_size
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    MessageSender,
    ParticipantReady,
    PhaseDescription,
    Problem,
    Question,
    Scene,
    SceneLoaded,
    Stop,
    VrEntered,
)
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.plan import SessionPlan, SessionPolicies, TrialPlan
from avrgym.vr.session.session import Session

ENVIRONMENT = "avrgym/FeedingJaco-v1"
FRAME_EVERY_TICKS = 4
CALIBRATION_TICKS = 20


def constant_policy(environment: str) -> Policy:
    """Return a policy that moves every joint at 0.6 of its maximum speed."""
    size, joints = get_observation_and_action_size(environment)
    return Policy(
        weights=(np.zeros((size, joints)),),
        biases=(np.resize([0.6, -0.6], joints),),
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
    """Plan one short trial for each seed with the policy ``drive``.

    Trials alternate between the environments. With ``practice`` the first one is a practice trial.
    """
    trials = [
        TrialPlan(environments[i % len(environments)], "drive", seed, practice and i == 0)
        for i, seed in enumerate(seeds)
    ]
    return SessionPlan(
        trials, sex, free_movement_s, is_simulated=True, trial_steps=trial_steps, countdown_s=0.1
    )


def constant_policies(plan: SessionPlan) -> SessionPolicies:
    """Return the constant policy for every environment of a plan."""
    return {(trial.environment, trial.policy): constant_policy(trial.environment) for trial in plan.trials}


def result(recording: Recording) -> str:
    """Return the result of a recorded attempt."""
    assert recording.outcome is not None
    return recording.outcome.result


def events(recording: Recording) -> list[str]:
    """Return the names of a recording's events in order."""
    return [event.name for _, event in recording.messages_by_topic["/events"]]


class Visit:
    """A session with a simulated client. ``inbox`` contains the received messages, ``observed`` the events.

    - ``tracking``: the client sends frames.
    - ``pose_rad`` (20,): a constant pose that replaces the participant's movement.
    - ``loads_scenes``: the client loads every scene immediately.
    - ``confirms``: the participant confirms the body check, the start of each trial and the answers.
    """

    def __init__(
        self,
        folder: Path,
        plan: SessionPlan,
        policies: SessionPolicies | None = None,
        participant: SimulatedParticipant | None = None,
        make: Callable[[MessageSender], Session] | None = None,
    ) -> None:
        """Start a session from a plan, or the session that ``make`` returns."""
        self.inbox: list[messages.ServerMessage | messages.WorldState] = []
        self.participant = participant or SimulatedParticipant(sample_participant_traits(plan.sex, 1), 1)
        self.tracking = self.loads_scenes = self.confirms = True
        self.pose_rad: FloatArray | None = None
        self.observed: list[read_session_events.SessionEvent] = []
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

    def receive(self, message: messages.ServerMessage | messages.WorldState) -> None:
        """Store a message, after a check that it can be encoded."""
        messages.encode_message(message)
        self.inbox.append(message)

    @property
    def now_s(self) -> float:
        """Seconds since the start of the session."""
        return self._ticks * TICK_S

    @property
    def phase(self) -> str:
        return self.session.phase_name

    def received(self, kind: type) -> list[Any]:
        """Return the received messages of a type in order."""
        return [message for message in self.inbox if isinstance(message, kind)]

    @property
    def problems(self) -> list[str]:
        """Texts of all problems, without the warning about a slow disk."""
        return [problem.message for problem in self.received(Problem) if "slow" not in problem.message]

    @property
    def phases(self) -> list[str]:
        """Names of the phases so far."""
        return [phase.name for phase in self.received(PhaseDescription)]

    def recordings(self) -> list[Recording]:
        """Read the recordings of all attempts so far."""
        return [read_recording(path) for path in self.session.recordings]

    def send(self, *sent: messages.ReceivedMessage) -> None:
        """Send messages to the session."""
        for message in sent:
            self.session.receive(message, self.now_s)

    def frame(self) -> messages.TrackingFrameMessage:
        """Return the participant's next tracking frame."""
        if self.pose_rad is not None:
            return self.participant.make_tracking_frame_from_angles(self.pose_rad, self.now_s)
        return self.participant.make_tracking_frame(self.now_s, moving=self.phase != "calibration")

    def tick(self, count: int = 1) -> None:
        """Advance the clock."""
        for _ in range(count):
            if self.tracking and self._ticks % FRAME_EVERY_TICKS == 0:
                self.send(self.frame())
            if self.loads_scenes and self.phase in ("loading", "headset") and self.received(Scene):
                self.send(SceneLoaded(url=self.received(Scene)[-1].url))
            if self.confirms and self.phase in ("check", "ready"):
                self.send(ParticipantReady())
            self.session.tick(self.now_s)
            self._ticks += 1

    def run_until(self, phase: str, limit_s: float = 60.0) -> None:
        """Advance the clock until the session enters a phase."""
        ends_s = self.now_s + limit_s
        while self.phase != phase:
            assert self.now_s < ends_s, f"still in {self.phase} after {limit_s} s; problems: {self.problems}"
            self.tick()

    def calibrate(self) -> None:
        """Enter VR and complete the calibration."""
        self.send(VrEntered())
        self.tick(CALIBRATION_TICKS)
        self.send(ParticipantReady())

    def go_to(self, phase: str) -> None:
        """Advance from the start to a phase of the first trial."""
        if phase == "waiting":
            return
        if phase == "calibration":
            self.send(VrEntered())
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
        """Answer the next questions."""
        for value in values:
            item = self.received(Question)[-1].item
            self.send(Answer(item=item, value=value, response_time_s=1.5))
        if self.confirms and self.phase == "confirm":
            self.send(ParticipantReady())

    def leave(self) -> None:
        """End the session."""
        self.session.close(self.now_s)
