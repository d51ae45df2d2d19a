"""A participant's session: calibration, free movement, trials, questionnaire, in explicit phases.

The session knows no clock and no network. Whoever runs it gives it messages and ticks, each with the time in seconds
since the session began, and sends what it hands out. So the same session runs live on a thread and, with a
simulated participant, faster than real time.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from avrgym.envs import ACTIONS
from avrgym.episodes import EPISODE_STEPS
from avrgym.models import human
from avrgym.models.human import Person, Sex
from avrgym.policies import Policy, load_policy
from avrgym.study import records
from avrgym.study.questionnaire import LIKERT_ITEMS, Item, validate_answer
from avrgym.study.recording import RecordingError
from avrgym.tasks import TASKS, find_environment
from avrgym.vr import messages
from avrgym.vr.attempt import Attempt
from avrgym.vr.body import BodyPose, seated_head_centre
from avrgym.vr.messages import PhaseName
from avrgym.vr.tracking import STALE_S, TrackingFeed, body_pose, measure_torso_height
from avrgym.vr.webxr import Registration, register
from avrgym.vr.world import ControlStep, LiveWorld, scene_url

COUNTDOWN_S = 3.0
STATE_EVERY_TICKS = 2
STOPPABLE: tuple[PhaseName, ...] = ("free_before", "countdown", "trial")
"""Where a stop ends the trial; later its robot is at rest, and what it gave is kept."""


@dataclass(frozen=True)
class TrialPlan:
    """One trial to run: an environment, a policy by name or path, a seed; a practice trial has no questionnaire."""

    environment: str
    policy: str
    seed: int
    practice: bool


@dataclass(frozen=True)
class SessionPlan:
    """A session: its trials in order, the body model, the time of free movement, and who takes part."""

    trials: Sequence[TrialPlan]
    sex: Sex
    free_movement_s: float
    simulated: bool
    items: Sequence[Item] = LIKERT_ITEMS


def load_policies(plan: SessionPlan) -> dict[str, Policy]:
    """Every policy that a plan names.

    Raises:
        ValueError: for an unknown environment or a policy that cannot be loaded.
    """
    policies = {}
    for trial in plan.trials:
        task, _ = find_environment(trial.environment)
        size = TASKS[task].observation_size
        policies[trial.policy] = load_policy(trial.policy, trial.environment, size, ACTIONS)
    return policies


@dataclass(frozen=True)
class Disconnected:
    """The participant's connection is gone."""


Handler = Callable[[Any, float], None]


class Session:
    """One participant's session.

    ``scenes`` holds environment and person of each scene that the client was told of, by the number in its
    address; ``recordings`` the files of all attempts; ``succeeded`` whether the latest trial is a success so far;
    ``registration`` where the participant's floor lies in the world, once that is known.
    """

    def __init__(
        self,
        plan: SessionPlan,
        policies: Mapping[str, Policy],
        folder: Path,
        send: Callable[[messages.ServerMessage], None],
        identifier: str,
    ) -> None:
        """Start in phase ``waiting`` with a person of reference height.

        Args:
            plan: what to run.
            policies: every policy that the plan names.
            folder: where recordings go; none is ever overwritten.
            send: takes every message for the client.
            identifier: the name of the session for the client and the recordings.
        """
        self.plan, self.identifier = plan, identifier
        self.recordings: list[Path] = []
        self.scenes: list[tuple[str, Person]] = []
        self.phase: PhaseName = "waiting"
        self.succeeded = False
        self._policies, self._folder, self._send = policies, folder, send
        self._trial = 0
        self._phase_message: messages.Phase | None = None
        self._ends_at: float | None = None
        self.registration: Registration | None = None
        self._feed = TrackingFeed()
        self._pose: BodyPose | None = None
        self._followed = -1
        self._holding = False
        self._attempt: Attempt | None = None
        self._item = 0
        self._state_number = 0
        self._world = self._new_world(human.PROPORTIONS[plan.sex].torso_height)
        self._handlers: dict[type, Handler] = {
            messages.Tracking: self._on_tracking,
            messages.Entered: self._on_entered,
            messages.Left: self._on_left,
            messages.Ready: self._on_ready,
            messages.SceneLoaded: self._on_scene_loaded,
            messages.Stop: self._on_stop,
            messages.OriginReset: self._on_origin_reset,
            messages.Answer: self._on_answer,
            Disconnected: self._on_disconnected,
        }
        self._enter("waiting", "Put on the headset and choose Enter VR.")

    @property
    def person(self) -> Person:
        """Whose body the participant has."""
        return self._world.person

    @property
    def bodies(self) -> tuple[str, ...]:
        """The order of the poses in every state."""
        return self._world.bodies

    def greet(self) -> None:
        """Tell a client that has just connected where things stand."""
        self._send(messages.Welcome(protocol=messages.PROTOCOL, session=self.identifier))
        self._send_scene()
        if self._phase_message is not None:
            self._send(self._phase_message)
        if self.phase == "questionnaire":
            self._ask()

    def receive(self, message: messages.ClientMessage | Disconnected, now_s: float) -> None:
        """Take a message of the participant's client."""
        handler = self._handlers.get(type(message))
        if handler is None:
            self._problem(f"a message of type {type(message).__name__} has no place in a running session")
            return
        handler(message, now_s)

    def tick(self, now_s: float) -> None:
        """Advance the world by 10 ms of simulated time and the session to ``now_s``."""
        self._follow(now_s)
        driving = self.phase == "trial"
        policy = self._policies[self._current.policy] if driving else None
        step = self._world.tick(policy)
        if self._attempt is not None:
            self._attempt.record_physics(self._world, now_s)
        if step is not None:
            self._finish_step(step, now_s)
        self._watch_recording(now_s)
        if self._world.ticks % STATE_EVERY_TICKS == 0:
            self._send_state()
        if self._ends_at is not None and now_s >= self._ends_at:
            self._advance(now_s)

    def close(self, now_s: float) -> None:
        """End the session; a trial that is running is kept as interrupted."""
        self._abandon("interrupted", now_s)

    # Phases ------------------------------------------------------------------------------------------------------

    @property
    def _current(self) -> TrialPlan:
        return self.plan.trials[min(self._trial, len(self.plan.trials) - 1)]

    def _enter(self, phase: PhaseName, text: str, now_s: float = 0.0, seconds: float | None = None) -> None:
        self.phase = phase
        self._ends_at = None if seconds is None else now_s + seconds
        self._phase_message = messages.Phase(
            name=phase,
            text=text,
            trial=min(self._trial + 1, len(self.plan.trials)),
            trials=len(self.plan.trials),
            practice=self._current.practice,
            seconds=seconds,
        )
        self._record_event("phase", phase, now_s)
        self._send(self._phase_message)

    def _advance(self, now_s: float) -> None:
        """Go on from a phase whose time is over."""
        if self.phase == "free_before":
            self._enter("countdown", "The robot starts in", now_s, COUNTDOWN_S)
        elif self.phase == "countdown":
            self._enter("trial", "The robot is helping you. Press a menu button to stop it.", now_s)
        elif self.phase == "free_after":
            self._after_trial(now_s)

    def _start_trial(self, now_s: float) -> None:
        plan = self._current
        try:
            attempt = Attempt(self._folder, self._trial + 1, self._configuration, now_s)
        except OSError as error:
            self._pause_unrecorded(error, now_s)
            return
        self._world.begin(plan.seed)
        self._attempt = attempt
        self._feed.take_arrived()
        self._holding = False
        self.recordings.append(attempt.path)
        attempt.record_physics(self._world, now_s)
        kind = "Practice" if plan.practice else f"Trial {self._trial + 1} of {len(self.plan.trials)}"
        text = f"{kind}: move your head and arms as you like. The robot holds still."
        self._enter("free_before", text, now_s, self.plan.free_movement_s)

    def _finish_step(self, step: ControlStep, now_s: float) -> None:
        attempt = self._attempt
        assert attempt is not None
        attempt.record_step(step, now_s)
        self.succeeded = attempt.success
        if attempt.steps == EPISODE_STEPS:
            self._world.hold()
            text = "The robot has finished and holds still. Move as you like."
            self._enter("free_after", text, now_s, self.plan.free_movement_s)

    def _after_trial(self, now_s: float) -> None:
        if self._current.practice or not self.plan.items:
            self._complete_trial(now_s)
            return
        self._item = 0
        self._enter("questionnaire", "Point at your answer and press the trigger.", now_s)
        self._ask()

    def _complete_trial(self, now_s: float) -> None:
        failure = self._close_recording("completed", now_s)
        if failure is not None:
            self._pause_unrecorded(failure, now_s)
            return
        self._trial += 1
        if self._trial < len(self.plan.trials):
            self._start_trial(now_s)
        else:
            self._enter("finished", "That was all. Thank you! You may take off the headset.", now_s)

    def _abandon(self, result: str, now_s: float) -> bool:
        """Hold the robot and end a running trial without completing it; whether one was running."""
        self._world.hold()
        if self._attempt is None:
            return False
        self._record_event("robot_holds", result, now_s)
        self._attempt.record_physics(self._world, now_s)
        failure = self._close_recording(result, now_s)
        if failure is not None:
            self._problem(f"the trial is not recorded completely: {failure}")
        return True

    def _pause_unrecorded(self, error: Exception, now_s: float) -> None:
        """Hold the robot and let the participant try again, because a trial without a recording is none."""
        self._world.hold()
        self._close_recording("failed", now_s)
        self._problem(f"the trial cannot be recorded: {error}")
        text = "The recording failed: the robot holds still. Press the trigger to try again."
        self._enter("paused", text, now_s)

    # What the participant does -----------------------------------------------------------------------------------

    def _on_entered(self, _message: messages.Entered, now_s: float) -> None:
        if self.phase == "finished":
            return
        self._abandon("interrupted", now_s)
        self._begin_calibration(now_s)

    def _begin_calibration(self, now_s: float) -> None:
        self.registration = None
        self._feed, self._pose = TrackingFeed(), None
        self._followed, self._holding = -1, False
        text = "Sit upright, look straight ahead and rest your arms. Then press the trigger."
        self._enter("calibration", text, now_s)

    def _on_left(self, _message: messages.Left, now_s: float) -> None:
        if self.phase != "finished":
            self._abandon("interrupted", now_s)
            self._enter("waiting", "You left VR. Choose Enter VR to go on.", now_s)

    def _on_disconnected(self, _message: Disconnected, now_s: float) -> None:
        if self.phase != "finished":
            self._abandon("interrupted", now_s)
            self._enter("waiting", "The connection was lost. Choose Enter VR to go on.", now_s)

    def _on_stop(self, _message: messages.Stop, now_s: float) -> None:
        if self.phase not in STOPPABLE:
            self._problem(f"the robot holds still; it can be stopped in the phases {', '.join(STOPPABLE)}")
        else:
            self._abandon("stopped", now_s)
            self._enter(
                "paused", "Stopped: the robot holds still. Press the trigger to repeat the trial.", now_s
            )

    def _on_origin_reset(self, _message: messages.OriginReset, now_s: float) -> None:
        if self.phase not in ("waiting", "finished"):
            self._abandon("interrupted", now_s)
            self._begin_calibration(now_s)

    def _on_ready(self, _message: messages.Ready, now_s: float) -> None:
        if self.phase == "calibration":
            self._calibrate(now_s)
        elif self.phase == "paused":
            self._start_trial(now_s)
        else:
            self._problem("a trigger counts as ready only in the phases calibration and paused")

    def _on_answer(self, answer: messages.Answer, now_s: float) -> None:
        if self.phase != "questionnaire":
            self._problem("an answer counts only while the questionnaire is open")
            return
        item = self.plan.items[self._item]
        try:
            validate_answer([item], answer.item, answer.value)
        except ValueError as error:
            self._problem(str(error))
            self._ask()
            return
        self._record("/answers", records.Answer(answer.item, answer.value, answer.response_time_s), now_s)
        self._item += 1
        if self._item < len(self.plan.items):
            self._ask()
        else:
            self._complete_trial(now_s)

    def _ask(self) -> None:
        item = self.plan.items[self._item]
        self._send(
            messages.Question(
                item=item.id,
                text=item.text,
                points=item.points,
                low=item.low,
                high=item.high,
                number=self._item + 1,
                count=len(self.plan.items),
            )
        )

    # Calibration and tracking ------------------------------------------------------------------------------------

    def _on_tracking(self, tracking: messages.Tracking, now_s: float) -> None:
        frame = self._feed.add(tracking, now_s)
        if frame.usable and self.phase == "calibration" and self.registration is None:
            self._place_scene(tracking)

    def _place_scene(self, frame: messages.Tracking) -> None:
        """Put the seat under the participant as they are now, so that they see where they sit."""
        assert frame.head is not None
        self.registration = register(frame.head, seated_head_centre(self.person))
        self._send_scene()

    def _calibrate(self, now_s: float) -> None:
        """Seat the participant: height, place and direction from the last half second of tracking."""
        try:
            heads = self._feed.steady_heads(now_s)
            torso_height_m = measure_torso_height(self.plan.sex, heads)
        except ValueError as error:
            self._problem(str(error))
            return
        self._world = self._new_world(torso_height_m)
        self.registration = register(heads[-1], seated_head_centre(self.person))
        self._pose = None
        self._enter("loading", "One moment: your seat is being prepared.", now_s)
        self._send_scene()

    def _on_scene_loaded(self, message: messages.SceneLoaded, now_s: float) -> None:
        if self.phase == "loading" and message.url == scene_url(len(self.scenes) - 1):
            self._start_trial(now_s)

    def _follow(self, now_s: float) -> None:
        """Move the person to the newest tracking frame, or hold them when it is stale."""
        newest, stale = self._feed.newest, self._feed.is_stale(now_s)
        if stale != self._holding:
            self._holding = stale
            name, detail = _TRACKING_LOST if stale else _TRACKING_FOUND
            self._record_event(name, detail, now_s)
        arrived = self._feed.take_arrived()
        if self._attempt is not None:
            self._attempt.record_frames(arrived, None if stale else newest, stale=stale)
        if newest is None or stale or self.registration is None:
            return
        is_new = newest.tracking.sequence != self._followed
        if is_new or self._pose is None:
            self._followed = newest.tracking.sequence
            self._pose = body_pose(self.registration, newest.tracking)
        self._world.follow(self._pose)
        if is_new:
            targets = records.BodyTargets(self._world.joint_targets_rad.tolist())
            self._record("/body_targets", targets, now_s)

    def _new_world(self, torso_height_m: float) -> LiveWorld:
        world = LiveWorld(self._current.environment, Person(self.plan.sex, torso_height_m))
        self.scenes.append((self._current.environment, world.person))
        return world

    # What goes out -----------------------------------------------------------------------------------------------

    def _send_scene(self) -> None:
        registration = self.registration or Registration(np.zeros(3), 0.0)
        self._send(self._world.scene(len(self.scenes) - 1, registration))

    def _send_state(self) -> None:
        self._state_number += 1
        self._send(
            messages.State(
                sequence=self._state_number,
                simulation_time_s=self._world.time_s,
                tracking_sequence=self._followed,
                poses=self._world.body_poses(),
            )
        )

    def _problem(self, text: str) -> None:
        self._send(messages.Problem(message=text))

    # Recording ---------------------------------------------------------------------------------------------------

    def _configuration(self, attempt: int) -> dict[str, Any]:
        plan = self._current
        assert self.registration is not None
        xr_from_world = self.registration.xr_from_world()
        return {
            "session": self.identifier,
            "environment": plan.environment,
            "policy": plan.policy,
            "seed": plan.seed,
            "practice": plan.practice,
            "trial": self._trial + 1,
            "attempt": attempt,
            "simulated": self.plan.simulated,
            "person": {"sex": self.person.sex, "torso_height_m": self.person.torso_height_m},
            "joints": list(human.JOINTS),
            "bodies": list(self._world.bodies),
            "xr_from_world": {"position": xr_from_world.position, "orientation": xr_from_world.orientation},
            "reward_weights": dict(self._world.task.weights),
            "items": [{"id": item.id, "text": item.text, "points": item.points} for item in self.plan.items],
            "versions": {"avrgym": version("avrgym"), "mujoco": mujoco.__version__},
        }

    def _record(self, topic: str, record: records.Record, now_s: float) -> None:
        if self._attempt is not None:
            self._attempt.record(topic, record, now_s)

    def _record_event(self, name: str, detail: str, now_s: float) -> None:
        self._record("/events", records.Event(name, detail), now_s)

    def _watch_recording(self, now_s: float) -> None:
        """Tell of a disk that pauses; go no further with a trial whose recording has failed."""
        if self._attempt is None:
            return
        stall = self._attempt.stall()
        if stall is not None:
            self._record_event("recording_stalled", str(stall), now_s)
            self._problem(f"the recording is slow: {stall}")
        if self._attempt.failure is not None:
            self._pause_unrecorded(self._attempt.failure, now_s)

    def _close_recording(self, result: str, now_s: float) -> RecordingError | None:
        """End the recording of a running trial; what keeps it from being complete, if anything does."""
        attempt, self._attempt = self._attempt, None
        if attempt is None:
            return None
        attempt.record_frames(self._feed.take_arrived(), None, stale=False)
        return attempt.close(result, now_s)


_TRACKING_LOST = "tracking_lost", f"no frame for {STALE_S} s: the person holds still"
_TRACKING_FOUND = "tracking_found", ""
