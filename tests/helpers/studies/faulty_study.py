"""A study with random faults, and an oracle for the expected result of each attempt."""

import random
from collections import Counter
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from avrgym.models.scene import CONTROL_STEP_S
from avrgym.recording.reader import read_recording
from avrgym.study.checking.study_checks import check_study
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage.answers import find_attempts_with_open_questionnaire
from avrgym.study.storage.database_rows import TrialAttempt
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    ParticipantDisconnected,
    ParticipantReady,
    Question,
    Scene,
    SceneLoaded,
    SentMessage,
    TrackingFrameMessage,
    VisibilityChanged,
    VrEntered,
    VrLeft,
)
from helpers.studies.small_studies import enrol_with_consent
from helpers.vr.device_switch_examples import SIDES, measured_pose, random_error

RUNNING = ("free_before", "countdown", "trial")
AFTER_TRIAL = ("retreat", "free_after", "questionnaire", "confirm")
TRACKED_PARTS = ("head", "left", "right")
INTERRUPTIONS = ("menu", "network", "reload", "leave", "restart")
"""Faults that interrupt an attempt immediately while the robot is active."""
KINDS = ("none", "limb", "limb", "frames", "switch", *INTERRUPTIONS)
LOST_S, EDGE_S = 1.0, CONTROL_STEP_S
"""Duration of lost tracking that interrupts an attempt, and the tolerance within which both results are correct."""
MAX_CAMERA_ERROR_M, MAX_CAMERA_ERROR_DEG = 0.1, 60.0
"""Maximum difference between the hand poses of camera and controller."""
LIMIT_TICKS = 60_000


@dataclass
class Fault:
    """The fault of one attempt: its phase, the delay after the start of the phase, and its duration."""

    kind: str
    phase: str
    delay_s: float
    lasts_s: float
    part: str


@dataclass
class Expected:
    """The expected result of one attempt, from its fault and the time at which the robot finished."""

    fault: Fault
    needed: tuple[str, ...]
    happened_s: float | None = None
    happened_in: str = ""
    finished_s: float | None = None

    @property
    def counts(self) -> bool | None:
        """Return whether the attempt must be completed; ``None`` near a limit."""
        if self.happened_s is None or self.fault.kind in ("none", "switch"):
            return True
        if self.fault.kind in INTERRUPTIONS:
            return self.happened_in not in RUNNING
        if self.happened_in in AFTER_TRIAL or (
            self.fault.kind == "limb" and self.fault.part not in self.needed
        ):
            return True
        until_s = self.happened_s + self.fault.lasts_s
        seen_s = until_s if self.finished_s is None else min(until_s, self.finished_s)
        missing_s = seen_s - self.happened_s
        return None if abs(missing_s - LOST_S) < EDGE_S else missing_s < LOST_S


class FaultyStudy:
    """Runs a study with random faults. ``attempts`` contains the expected result of each attempt."""

    def __init__(self, store: StudyStore, seed: int) -> None:
        self.store, self.rng = store, random.Random(seed)
        self.devices = np.random.default_rng(seed)
        self.attempts: dict[str, list[Expected]] = {}
        self.inbox: list[SentMessage] = []
        self.ticks = 0

    @property
    def now_s(self) -> float:
        return self.ticks * TICK_S

    def run(self, participants: int) -> None:
        """Run the study for a number of participants."""
        for number in range(participants):
            self.pseudonym = enrol_with_consent(self.store)
            self.attempts[self.pseudonym] = []
            self.participant = SimulatedParticipant(sample_participant_traits("woman", number), number)
            self._open()
            ends = self.ticks + LIMIT_TICKS * len(self.store.read_trials(self.pseudonym))
            while self.sessions.running_participant is not None:
                assert self.ticks < ends, f"still in {self.phase}"
                self._tick()
            self.sessions.close(self.now_s)

    def _open(self) -> None:
        self.sessions = StudySessions(self.store, self.inbox.append, first=self.pseudonym)
        self._connected, self._visible, self._missing, self._switched = True, True, set[str](), False
        self._until_s: float | None = None
        self._seen, self._began_s, self._acted_s = "", self.now_s, self.now_s
        self._connect()

    @property
    def phase(self) -> str:
        session = self.sessions._session
        return session.phase_name if session is not None else "over"

    def _latest(self, kind: type) -> SentMessage | None:
        return next((message for message in reversed(self.inbox) if isinstance(message, kind)), None)

    def _send(self, *sent) -> None:
        for message in sent:
            self.sessions.receive(message, self.now_s)

    def _connect(self) -> None:
        self._connected, self._visible = True, True
        self.sessions.send_initial_state(self.inbox.append, "participant", self.now_s)

    def _tick(self) -> None:
        self._notice()
        self._fault()
        if self._connected:
            self._attend()
        self.sessions.tick(self.now_s)
        del self.inbox[:-400]
        self.ticks += 1

    def _notice(self) -> None:
        phase = self.phase
        if phase == self._seen:
            return
        if phase == "free_before":
            self._begin_attempt()
        elif phase in AFTER_TRIAL and self._running is not None and self._running.finished_s is None:
            self._running.finished_s = self.now_s
        self._seen, self._began_s = phase, self.now_s

    @property
    def _running(self) -> Expected | None:
        own = self.attempts[self.pseudonym]
        return own[-1] if own else None

    def _begin_attempt(self) -> None:
        rng, session = self.rng, self.sessions._session
        assert session is not None
        task = TASKS[find_environment(session.world.environment_id)[0]]
        fault = Fault(
            rng.choice(KINDS),
            rng.choice(
                ("free_before", "countdown", "trial", "trial", "retreat", "free_after", "questionnaire")
            ),
            rng.uniform(0.0, 0.8),
            rng.choice((0.1, 0.3, 0.6, 1.6, 2.5)),
            rng.choice(TRACKED_PARTS),
        )
        self.attempts[self.pseudonym].append(Expected(fault, task.tracked_body_parts))

    def _fault(self) -> None:
        """Start or end a fault."""
        expected = self._running
        if self._until_s is not None and self.now_s >= self._until_s:
            self._repair()
        if expected is None or expected.happened_s is not None or expected.fault.phase != self._seen:
            return
        if self.now_s - self._began_s >= expected.fault.delay_s:
            expected.happened_s, expected.happened_in = self.now_s, self.phase
            self._until_s = self.now_s + expected.fault.lasts_s
            self._break(expected.fault)

    def _break(self, fault: Fault) -> None:
        if fault.kind == "menu":
            self._visible = False
            self._send(VisibilityChanged(self.rng.choice(("visible-blurred", "hidden", "context-lost"))))
        elif fault.kind in ("network", "reload"):
            self._connected = False
            self._send(ParticipantDisconnected())
        elif fault.kind == "leave":
            self._send(VrLeft())
        elif fault.kind == "restart":
            self.sessions.close(self.now_s)
            self._open()
        elif fault.kind == "switch":
            self._switched = True
            self._errors = {
                side: random_error(
                    self.devices,
                    self.devices.uniform(0.0, MAX_CAMERA_ERROR_M),
                    self.devices.uniform(0.0, MAX_CAMERA_ERROR_DEG),
                )
                for side in SIDES
            }
        elif fault.kind != "none":
            self._missing = {fault.part} if fault.kind == "limb" else set(TRACKED_PARTS)

    def _repair(self) -> None:
        expected = self._running
        assert expected is not None
        self._until_s, self._missing, self._switched = None, set(), False
        if not self._visible:
            self._visible = True
            self._send(VisibilityChanged("visible"))
        if not self._connected:
            self._connect()
            if expected.fault.kind == "network":
                self._send(VrEntered())

    def _attend(self) -> None:
        """Send frames, and respond to the phase at intervals."""
        if self.ticks % 3 == 0 and self._visible and self._missing != set(TRACKED_PARTS):
            self._send(self._frame())
        if self.phase == "loading" and (scene := self._latest(Scene)) is not None:
            assert isinstance(scene, Scene)
            self._send(SceneLoaded(scene.url))
        if self._visible and self.now_s - self._acted_s > 0.45:
            self._acted_s = self.now_s
            self._act()

    def _act(self) -> None:
        session = self.sessions._session
        assert session is not None
        trials = session.plan.trials
        self.participant.adopt_posture(trials[min(session.trial_index, len(trials) - 1)].environment)
        if self.phase == "waiting":
            self._send(VrEntered())
        elif self.phase in ("calibration", "check", "ready", "paused", "confirm"):
            if self.now_s - self._began_s > 0.8:
                self._send(ParticipantReady())
        elif self.phase == "questionnaire":
            asked = self._latest(Question)
            assert isinstance(asked, Question)
            self._send(Answer(asked.item, self.rng.randint(1, asked.points), 0.4))

    def _frame(self) -> TrackingFrameMessage:
        frame = self.participant.make_tracking_frame(self.now_s, moving=self.phase != "calibration")
        changes: dict[str, Any] = dict.fromkeys(self._missing)
        for hand in {"left", "right"} & self._missing:
            changes[f"{hand}_modality"] = "none"
        if self._switched:
            for side in SIDES:
                grip = frame.left if side == "left" else frame.right
                assert grip is not None
                changes |= {
                    f"{side}_modality": "hand",
                    side: measured_pose(grip, side, "hand", self._errors[side]),
                }
        return msgspec.structs.replace(frame, **changes)

    def faults(self) -> list[str]:
        """Return the differences between study and oracle as text."""
        found: list[str] = []
        for pseudonym, expected in self.attempts.items():
            stored = self.store.read_attempts(pseudonym)
            if len(stored) != len(expected):
                found.append(f"{pseudonym}: {len(stored)} attempts, {len(expected)} began")
            for attempt, each in zip(stored, expected, strict=False):
                if each.fault.kind == "switch" and (held := self._held_after(attempt, each)):
                    found.append(f"{attempt}: {held} frames are held after a switch, {each}")
                if each.counts is not None and each.counts != (attempt.state == "completed"):
                    found.append(f"{attempt} is {attempt.state}, counts: {each.counts}, {each}")
            found += self._faults_of_trials(pseudonym)
        return found + [
            str(each) for each in check_study(self.store) if each.is_error and "policy" not in each.where
        ]

    def _held_after(self, attempt: TrialAttempt, switch: Expected) -> int:
        """Return how many frames were rejected after a switch of devices; 0 is expected."""
        if switch.happened_s is None:
            return 0
        recording = read_recording(self.store.resolve_path(attempt.recording))
        frames = [frame for _, frame in recording.messages_by_topic["/tracking"]]
        return sum(frame.rejected or bool(frame.rejected_parts) for frame in frames)

    def _faults_of_trials(self, pseudonym: str) -> list[str]:
        found: list[str] = []
        attempts, answers = self.store.read_attempts(pseudonym), self.store.read_answers(pseudonym)
        if find_attempts_with_open_questionnaire(self.store, attempts):
            found.append(f"{pseudonym}: a questionnaire is open")
        for trial in self.store.read_trials(pseudonym):
            own = [each for each in attempts if each.trial == trial.id and each.state == "completed"]
            if len(own) != 1:
                found.append(f"{trial} has {len(own)} completed attempts")
                continue
            given = {each.item: each.value for each in answers if each.attempt == own[0].id}
            recording = read_recording(self.store.resolve_path(own[0].recording))
            recorded = {answer.item: answer.value for _, answer in recording.messages_by_topic["/answers"]}
            asked = (
                []
                if trial.practice
                else [item.id for item in self.store.design.list_items_at_moment("after_trial")]
            )
            if sorted(given) != sorted(asked) or given != recorded:
                found.append(f"{trial}: {given} stored, {recorded} recorded of {asked}")
        return found

    def counts(self) -> Counter[str]:
        """Count faults by kind, by time (before or after the robot finished) and by expected result."""
        words = {True: "counts", False: "is repeated", None: "near a limit"}
        return Counter(
            f"{each.fault.kind if each.happened_s is not None else 'none'}"
            f"{' after the robot' if each.happened_in in AFTER_TRIAL else ''}: {words[each.counts]}"
            for own in self.attempts.values()
            for each in own
        )
