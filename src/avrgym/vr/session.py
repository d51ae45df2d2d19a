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

from avrgym.episodes import EPISODE_STEPS
from avrgym.models import human
from avrgym.models.human import Person, Sex
from avrgym.policies import Policy
from avrgym.study import records
from avrgym.study.questionnaire import LIKERT_ITEMS, Item, validate_answer
from avrgym.study.recording import RecordingError, RecordingWriter
from avrgym.vr import messages
from avrgym.vr.body import BodyPose, seated_head_centre, torso_height
from avrgym.vr.messages import PhaseName
from avrgym.vr.webxr import Registration, hand_pose, head_pose, is_valid, register
from avrgym.vr.world import ControlStep, LiveWorld

STALE_S = 0.2
"""A tracking frame older than this no longer moves the person."""
CALIBRATION_S = 0.5
CALIBRATION_FRAMES = 5
STEADY_M = 0.03
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


@dataclass(frozen=True)
class Disconnected:
    """The participant's connection is gone."""


@dataclass(frozen=True)
class _Frame:
    """A tracking frame and when it arrived; ``usable``: it may move the person."""

    tracking: messages.Tracking
    received_s: float
    usable: bool


@dataclass
class _Attempt:
    """The trial that is running: its recording, when it began, and what it gave so far."""

    recording: RecordingWriter
    began_s: float
    steps: int = 0
    reward: float = 0.0
    success: bool = False
    stalled: bool = False


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
        self._frames: list[_Frame] = []
        self._arrived: list[_Frame] = []
        self._newest: _Frame | None = None
        self._pose: BodyPose | None = None
        self._followed = -1
        self._holding = False
        self._attempt: _Attempt | None = None
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
        self._record_physics(now_s)
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
            recording = self._open_recording(plan)
        except OSError as error:
            self._pause_unrecorded(error, now_s)
            return
        self._world.begin(plan.seed)
        self._attempt = _Attempt(recording, now_s)
        self._arrived.clear()
        self._holding = False
        self.recordings.append(recording.path)
        self._record_physics(now_s)
        kind = "Practice" if plan.practice else f"Trial {self._trial + 1} of {len(self.plan.trials)}"
        text = f"{kind}: move your head and arms as you like. The robot holds still."
        self._enter("free_before", text, now_s, self.plan.free_movement_s)

    def _finish_step(self, step: ControlStep, now_s: float) -> None:
        attempt, outcome = self._attempt, step.outcome
        assert attempt is not None
        attempt.steps += 1
        attempt.reward += float(outcome.reward[0])
        attempt.success = self.succeeded = bool(outcome.success[0])
        control = records.Control(
            step=attempt.steps,
            observation=step.observation.tolist(),
            action=step.action.tolist(),
            reward=float(outcome.reward[0]),
            reward_terms={name: float(term[0]) for name, term in outcome.reward_terms.items()},
            success=attempt.success,
            distance_m=float(outcome.distance_m[0]),
            force_on_person_n=float(outcome.force_on_person_n[0]),
        )
        self._record("/control", control, now_s)
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
        self._record_physics(now_s)
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
        self._frames.clear()
        self._arrived.clear()
        self._newest, self._pose = None, None
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
        frame = _Frame(tracking, now_s, self._is_usable(tracking))
        self._arrived.append(frame)
        if not frame.usable:
            return
        self._newest = frame
        if self.phase == "calibration":
            self._frames = [f for f in self._frames if f.received_s > now_s - CALIBRATION_S] + [frame]
            if self.registration is None:
                self._place_scene(tracking)

    def _is_usable(self, frame: messages.Tracking) -> bool:
        """Whether a frame shows where a head is, is sound in every number, and comes after those before."""
        replayed = self._newest is not None and frame.sequence <= self._newest.tracking.sequence
        poses = [pose for pose in (frame.head, frame.left, frame.right) if pose is not None]
        return frame.head is not None and not replayed and all(is_valid(pose) for pose in poses)

    def _place_scene(self, frame: messages.Tracking) -> None:
        """Put the seat under the participant as they are now, so that they see where they sit."""
        assert frame.head is not None
        self.registration = register(frame.head, seated_head_centre(self.person))
        self._send_scene()

    def _calibrate(self, now_s: float) -> None:
        """Seat the participant: height, place and direction from the last half second of tracking."""
        recent = [f.tracking.head for f in self._frames if f.received_s > now_s - CALIBRATION_S]
        heads = [head for head in recent if head is not None]
        if len(heads) < CALIBRATION_FRAMES:
            self._problem(
                "the headset is not tracked: look around for a moment, then press the trigger again"
            )
            return
        spread = np.ptp([head.position for head in heads], axis=0).max()
        if spread > STEADY_M:
            self._problem(f"your head moved by {100 * spread:.0f} cm; keep it within {100 * STEADY_M:.0f} cm")
            return
        height = float(np.median([head_pose(register(h, np.zeros(3)), h).pos_w[2] for h in heads]))
        try:
            torso_height_m = torso_height(self.plan.sex, height)
        except ValueError as error:
            self._problem(str(error))
            return
        self._world = self._new_world(torso_height_m)
        self.registration = register(heads[-1], seated_head_centre(self.person))
        self._pose = None
        self._enter("loading", "One moment: your seat is being prepared.", now_s)
        self._send_scene()

    def _on_scene_loaded(self, message: messages.SceneLoaded, now_s: float) -> None:
        if self.phase == "loading" and message.url == self._scene_url:
            self._start_trial(now_s)

    @property
    def _scene_url(self) -> str:
        return f"/scenes/{len(self.scenes) - 1}.glb"

    def _follow(self, now_s: float) -> None:
        """Move the person to the newest tracking frame, or hold them when it is stale."""
        newest = self._newest
        stale = newest is not None and now_s - newest.received_s > STALE_S
        if stale != self._holding:
            self._holding = stale
            name, detail = _TRACKING_LOST if stale else _TRACKING_FOUND
            self._record_event(name, detail, now_s)
        self._record_arrived(None if stale else newest, stale=stale)
        if newest is None or stale or self.registration is None:
            return
        is_new = newest.tracking.sequence != self._followed
        if is_new or self._pose is None:
            self._followed = newest.tracking.sequence
            self._pose = self._body_pose(self.registration, newest.tracking)
        self._world.follow(self._pose)
        if is_new:
            targets = records.BodyTargets(self._world.joint_targets_rad.tolist())
            self._record("/body_targets", targets, now_s)

    @staticmethod
    def _body_pose(registration: Registration, frame: messages.Tracking) -> BodyPose:
        assert frame.head is not None
        return BodyPose(
            head_pose(registration, frame.head),
            None if frame.left is None else hand_pose(registration, frame.left),
            None if frame.right is None else hand_pose(registration, frame.right),
        )

    def _new_world(self, torso_height_m: float) -> LiveWorld:
        world = LiveWorld(self._current.environment, Person(self.plan.sex, torso_height_m))
        self.scenes.append((self._current.environment, world.person))
        return world

    # What goes out -----------------------------------------------------------------------------------------------

    def _send_scene(self) -> None:
        registration = self.registration or Registration(np.zeros(3), 0.0)
        head = human.PREFIX + "head"
        self._send(
            messages.Scene(
                url=self._scene_url,
                bodies=list(self._world.bodies),
                head_bodies=[head],
                xr_from_world=registration.xr_from_world(),
            )
        )

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

    def _open_recording(self, plan: TrialPlan) -> RecordingWriter:
        self._folder.mkdir(parents=True, exist_ok=True)
        attempt = 1
        while True:
            path = self._folder / f"trial-{self._trial + 1:02}_attempt-{attempt}.mcap"
            try:
                return RecordingWriter(path, self._configuration(plan, attempt))
            except FileExistsError:
                attempt += 1

    def _configuration(self, plan: TrialPlan, attempt: int) -> dict[str, Any]:
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
        attempt = self._attempt
        if attempt is None:
            return
        attempt.recording.write(topic, round((now_s - attempt.began_s) * 1e9), record)

    def _record_event(self, name: str, detail: str, now_s: float) -> None:
        self._record("/events", records.Event(name, detail), now_s)

    def _record_physics(self, now_s: float) -> None:
        if self._attempt is not None:
            state = self._world.state_vector().tolist()
            self._record("/physics", records.Physics(self._attempt.steps, self._world.time_s, state), now_s)

    def _watch_recording(self, now_s: float) -> None:
        """Go no further with a trial whose recording has failed."""
        error = None if self._attempt is None else self._attempt.recording.error
        if isinstance(error, TimeoutError):
            self._warn_of_stall(error, now_s)
        elif error is not None:
            self._pause_unrecorded(error, now_s)

    def _warn_of_stall(self, error: TimeoutError, now_s: float) -> None:
        """A disk that pauses loses nothing: the records wait. Say so once a trial, and go on."""
        attempt = self._attempt
        if attempt is not None and not attempt.stalled:
            attempt.stalled = True
            self._record_event("recording_stalled", str(error), now_s)
            self._problem(f"the recording is slow: {error}")

    def _record_arrived(self, followed: _Frame | None, *, stale: bool = False) -> None:
        """Record the frames that came since the last tick; the person moves to ``followed``."""
        for frame in self._arrived:
            held = stale or not frame.usable
            self._record_frame(frame, applied=frame is followed, held=held)
        self._arrived.clear()

    def _record_frame(self, frame: _Frame, *, applied: bool, held: bool) -> None:
        if self._attempt is None:
            return
        tracking = frame.tracking
        record = records.TrackingFrame(
            sequence=tracking.sequence,
            client_time_ms=tracking.client_time_ms,
            received_time_s=frame.received_s - self._attempt.began_s,
            applied=applied,
            held=held,
            head=_recorded_pose(tracking.head),
            left=_recorded_pose(tracking.left),
            right=_recorded_pose(tracking.right),
        )
        self._record("/tracking", record, frame.received_s)

    def _close_recording(self, result: str, now_s: float) -> RecordingError | None:
        """End the recording of a running trial; what keeps it from being complete, if anything does."""
        self._record_arrived(None)
        attempt, self._attempt = self._attempt, None
        if attempt is None:
            return None
        outcome = {
            "result": result,
            "steps": attempt.steps,
            "reward": attempt.reward,
            "success": attempt.success,
            "seconds": now_s - attempt.began_s,
        }
        try:
            attempt.recording.close(outcome)
        except RecordingError as error:
            return error
        return None


_TRACKING_LOST = "tracking_lost", f"no frame for {STALE_S} s: the person holds still"
_TRACKING_FOUND = "tracking_found", ""


def _recorded_pose(pose: messages.XRPose | None) -> records.Pose | None:
    return None if pose is None else records.Pose(list(pose.position), list(pose.orientation))
