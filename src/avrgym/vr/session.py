"""A participant's session: calibration, free movement, trials, questionnaire, in explicit phases.

The session knows no clock and no network. Whoever runs it gives it messages and ticks, each with the time in seconds
since the session began, and sends what it hands out. So the same session runs live on a thread and, with a
simulated participant, faster than real time.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.models import human
from avrgym.models.human import Person
from avrgym.study import records
from avrgym.study.recording import RecordingError
from avrgym.vr import messages, transitions
from avrgym.vr.asking import Asking
from avrgym.vr.attempt import Attempt, Experience, configuration
from avrgym.vr.calibration import measure_torso_height
from avrgym.vr.experimenter import COMMANDS, correct_torso_height
from avrgym.vr.messages import PhaseName
from avrgym.vr.plan import Policies, SessionPlan, TrialPlan, load_policies
from avrgym.vr.preparation import AtOnce
from avrgym.vr.presence import Presence
from avrgym.vr.reporting import Reporter, status
from avrgym.vr.scenery import Scenery
from avrgym.vr.tracking import STALE_S
from avrgym.vr.webxr import Registration
from avrgym.vr.world import ControlStep, LiveWorld

__all__ = ["Disconnected", "Session", "SessionPlan", "TrialPlan", "load_policies"]

STOPPABLE: tuple[PhaseName, ...] = ("free_before", "countdown", "trial")
"""Where a stop ends the trial; later its robot is at rest, and what it gave is kept."""


@dataclass(frozen=True)
class Disconnected:
    """The participant's connection is gone."""


Send = Callable[[messages.ServerMessage], None]
Handler = Callable[[Any, float], None]
Then = Callable[[float], None]


class Session:
    """One participant's session.

    ``recordings`` holds the files of all attempts; ``experience`` how the latest trial has been so far;
    ``person`` whose body the participant has; ``paused`` whether the experimenter lets no trial begin.
    """

    def __init__(
        self,
        plan: SessionPlan,
        policies: Policies,
        folder: Path,
        send: Send,
        identifier: str,
        *,
        observe: transitions.Observer = lambda transition: None,
        called_off: Callable[[], bool] = lambda: False,
        workers: Executor | None = None,
        scenes: list[tuple[str, Person]] | None = None,
    ) -> None:
        """Start in phase ``waiting`` with a person of reference height.

        Args:
            plan: what to run.
            policies: every policy that the plan names.
            folder: where recordings go; none is ever overwritten.
            send: takes every message for the clients.
            identifier: the name of the session for clients and recordings.
            observe: told of every transition before the session goes on. When it raises, the session pauses.
            called_off: whether somebody elsewhere has ended the session; asked at every tick.
            workers: makes the worlds of trials to come; without one they are made in the thread that ticks.
            scenes: those of sessions before this one, which keep their addresses; the session adds its own.
        """
        self.plan, self.identifier = plan, identifier
        self.recordings: list[Path] = []
        self.phase: PhaseName = "waiting"
        self.paused = False
        self.experience = Experience()
        self.presence = Presence()
        self.trial = plan.first_trial - 1
        self.person = Person(plan.sex, human.PROPORTIONS[plan.sex].torso_height)
        self.height_known = False
        self._policies, self._folder, self._send, self._observe = policies, folder, send, observe
        self._called_off = called_off
        self._observer_failure: Exception | None = None
        known = [] if scenes is None else scenes
        self._scenery = Scenery(plan, self.trial, self.person, workers or AtOnce(), known)
        self._reporter = Reporter(send)
        self._calibrated_for: human.Posture | None = None
        self._then: Then | None = None
        self._attempt: Attempt | None = None
        self._asking = Asking(())
        self._ends_at: float | None = None
        self._told_scene = self._scene_message()
        self._handlers: dict[type, Handler] = {
            messages.Tracking: self._on_tracking,
            messages.Entered: self._on_entered,
            messages.Left: self._on_left,
            messages.Ready: self._on_ready,
            messages.SceneLoaded: self._on_scene_loaded,
            messages.Stop: lambda _, now_s: self.stop("participant", now_s),
            messages.Recalibrate: self._on_recalibrate,
            messages.OriginReset: self._on_origin_reset,
            messages.Answer: self._on_answer,
            messages.Command: lambda command, now_s: COMMANDS[command.name](self, now_s),
            messages.CorrectTorsoHeight: lambda m, now_s: correct_torso_height(self, m.torso_height_m, now_s),
            Disconnected: self._on_disconnected,
        }
        self.enter("waiting", "Put on the headset and choose Enter VR.", 0.0)

    @property
    def scenes(self) -> list[tuple[str, Person]]:
        """Environment and person of each scene that clients may be told of, by the number in its address."""
        return self._scenery.scenes

    @property
    def registration(self) -> Registration | None:
        """Where the participant's floor lies in the world, once that is known."""
        return self.presence.registration

    @property
    def _world(self) -> LiveWorld:
        return self._scenery.world

    @property
    def bodies(self) -> tuple[str, ...]:
        """The order of the poses in every state."""
        return self._world.bodies

    def greet(self, send: Send, role: messages.Role, now_s: float) -> None:
        """Tell a client that has just connected where things stand."""
        if role == "participant":
            self._scenery.forget_client()
            self.tell(transitions.ConnectionFound(now_s))
        plan = self.plan
        send(
            messages.Welcome(
                messages.PROTOCOL, self.identifier, role, haptics=plan.haptics, sounds=plan.sounds
            )
        )
        send(self._scene_message())
        send(self._phase_message)
        if self.phase == "questionnaire":
            send(self._asking.question())

    def receive(
        self, message: messages.ClientMessage | messages.ExperimenterMessage | Disconnected, now_s: float
    ) -> None:
        """Take a message of the participant's client or of the experimenter's."""
        handler = self._handlers.get(type(message))
        if handler is None:
            self.problem(f"a message of type {type(message).__name__} has no place in a running session")
            return
        handler(message, now_s)

    def tick(self, now_s: float) -> None:
        """Advance the world by 10 ms of simulated time and the session to ``now_s``."""
        if self.phase != "finished" and self._called_off():
            COMMANDS["end"](self, now_s)
        self._follow(now_s)
        plan = self._current
        policy = self._policies[plan.environment, plan.policy] if self.phase == "trial" else None
        step = self._world.tick(policy)
        if self._attempt is not None:
            self._attempt.record_physics(self._world, now_s)
        if step is not None:
            self._finish_step(step, now_s)
        self._watch_keepers(now_s)
        self._watch_loading(now_s)
        self._report(step, now_s)
        if self._ends_at is not None and now_s >= self._ends_at:
            self._advance(now_s)

    def catch_up(self) -> None:
        """Wait for the disk, where ticks follow each other faster than in real time."""
        if self._attempt is not None:
            self._attempt.catch_up()

    def close(self, now_s: float) -> None:
        """End the session; a trial that is running is kept as interrupted."""
        self.abandon("interrupted", now_s)

    # Phases ------------------------------------------------------------------------------------------------------

    @property
    def _current(self) -> TrialPlan:
        return self.plan.trials[min(self.trial, len(self.plan.trials) - 1)]

    def enter(self, phase: PhaseName, text: str, now_s: float, seconds: float | None = None) -> None:
        """Enter a phase with the words to show; it ends by itself after ``seconds``, if they are given."""
        self.phase = phase
        self._ends_at = None if seconds is None else now_s + seconds
        trials = len(self.plan.trials)
        trial = min(self.trial + 1, trials)
        self._phase_message = messages.Phase(phase, text, trial, trials, self._current.practice, seconds)
        self.record_event("phase", phase, now_s)
        self.tell(transitions.PhaseEntered(now_s, phase, trial))
        self._send(self._phase_message)

    def _advance(self, now_s: float) -> None:
        """Go on from a phase whose time is over."""
        if self.phase == "free_before":
            self.enter("countdown", "The robot starts in", now_s, self.plan.countdown_s)
        elif self.phase == "countdown":
            self._scenery.use_up()
            self.enter("trial", "The robot is helping you. Press a menu button to stop it.", now_s)
        elif self.phase == "free_after":
            self._after_trial(now_s)

    def begin_trial(self, now_s: float) -> None:
        """Begin the next attempt, once its world is made, the participant is in place and nobody pauses."""
        if not self._scenery.is_fresh(self.trial, self.person):
            self.load(self.begin_trial, now_s)
        elif self._calibrated_for is not self._world.stage.posture:
            self._enter_calibration(now_s)
        elif self.paused:
            self.enter("paused", "The experimenter has paused the session. The robot holds still.", now_s)
        else:
            self._begin_attempt(now_s)

    def _begin_attempt(self, now_s: float) -> None:
        try:
            attempt = Attempt(
                self._folder,
                self.trial + 1,
                self._configuration,
                now_s,
                first_number=self._current.earlier_attempts + 1,
            )
        except OSError as error:
            self._pause_unrecorded(error, now_s)
            return
        self._attempt = attempt
        self.experience = attempt.experience
        self.presence.take_arrived()
        self.recordings.append(attempt.path)
        self.tell(transitions.TrialBegun(now_s, attempt.trial, attempt.number, attempt.path))
        attempt.record_physics(self._world, now_s)
        kind = f"Trial {self.trial + 1} of {len(self.plan.trials)}"
        text = f"{'Practice' if self._current.practice else kind}: move your head and arms as you like. "
        self.enter("free_before", text + "The robot holds still.", now_s, self.plan.free_movement_s)

    def _finish_step(self, step: ControlStep, now_s: float) -> None:
        attempt = self._attempt
        assert attempt is not None
        attempt.record_step(step, now_s)
        self.experience = attempt.experience
        if attempt.steps == self.plan.trial_steps:
            self._world.hold()
            text = "The robot has finished and holds still. Move as you like."
            self.enter("free_after", text, now_s, self.plan.free_movement_s)
            self._prepare_next()

    def _after_trial(self, now_s: float) -> None:
        items = self.plan.items_after(self._current)
        if not items:
            self._complete_trial(now_s)
            return
        self._asking = Asking(items)
        self.enter("questionnaire", "Point at your answer and press the trigger.", now_s)
        self._send(self._asking.question())

    def _complete_trial(self, now_s: float) -> None:
        failure = self._end_attempt("completed", now_s) or self._observer_failure
        if failure is not None:
            self._pause_unrecorded(failure, now_s)
        else:
            self.next_trial(now_s)

    def next_trial(self, now_s: float) -> None:
        """Go on to the next trial, or finish after the last."""
        self.trial += 1
        if self.trial < len(self.plan.trials):
            self.begin_trial(now_s)
        else:
            self.finish("That was all. Thank you! You may take off the headset.", now_s)

    def finish(self, text: str, now_s: float) -> None:
        """End the session with these words."""
        self.trial = len(self.plan.trials)
        self.enter("finished", text, now_s)

    def abandon(self, result: transitions.Result, now_s: float) -> None:
        """Hold the robot, and end a running trial without completing it."""
        self._world.hold()
        if self._attempt is None:
            return
        self.record_event("robot_holds", result, now_s)
        self._attempt.record_physics(self._world, now_s)
        failure = self._end_attempt(result, now_s)
        if failure is not None:
            self.problem(f"the trial is not recorded completely: {failure}")

    def _pause_unrecorded(self, error: Exception, now_s: float) -> None:
        """Hold the robot and let the participant try again, because a trial that is not kept is none."""
        self._world.hold()
        self._end_attempt("failed", now_s)
        self.problem(f"the trial cannot be recorded: {error}")
        text = "The recording failed: the robot holds still. Press the trigger to try again."
        self.enter("paused", text, now_s)
        self._observer_failure = None  # whoever cannot keep this pause either is asked again with the trial

    # What the participant does -----------------------------------------------------------------------------------

    def _on_entered(self, _message: messages.Entered, now_s: float) -> None:
        if self.phase != "finished":
            self.abandon("interrupted", now_s)
            self.calibrate_again(now_s)

    def _on_left(self, _message: messages.Left, now_s: float) -> None:
        if self.phase != "finished":
            self.abandon("interrupted", now_s)
            self.enter("waiting", "You left VR. Choose Enter VR to go on.", now_s)

    def _on_disconnected(self, _message: Disconnected, now_s: float) -> None:
        self.tell(transitions.ConnectionLost(now_s))
        if self.phase != "finished":
            self.abandon("interrupted", now_s)
            self.enter("waiting", "The connection was lost. Choose Enter VR to go on.", now_s)

    def stop(self, by: transitions.Who, now_s: float) -> None:
        """Hold the robot at once; the trial that runs may be repeated."""
        if self.phase not in STOPPABLE:
            self.problem(f"the robot holds still; it can be stopped in the phases {', '.join(STOPPABLE)}")
            return
        self.abandon("stopped", now_s)
        self.tell(transitions.Stopped(now_s, by))
        self.enter("paused", "Stopped: the robot holds still. Press the trigger to repeat the trial.", now_s)
        self._scenery.prepare(self.trial, self.person)

    def _on_recalibrate(self, _message: messages.Recalibrate, now_s: float) -> None:
        if self.phase not in ("check", "paused"):
            self.problem("you can be measured again in the phases check and paused")
            return
        self.height_known = False
        self.calibrate_again(now_s)

    def _on_origin_reset(self, _message: messages.OriginReset, now_s: float) -> None:
        if self.phase not in ("waiting", "finished"):
            self.abandon("interrupted", now_s)
            self.calibrate_again(now_s)

    def _on_ready(self, _message: messages.Ready, now_s: float) -> None:
        if self.phase == "calibration":
            self._calibrate(now_s)
        elif self.phase == "check" or (self.phase == "paused" and not self.paused):
            self.begin_trial(now_s)
        elif self.phase == "paused":
            self.problem("the experimenter has paused the session and will continue it")
        else:
            self.problem("a trigger counts as ready only in the phases calibration, check and paused")

    def _on_answer(self, answer: messages.Answer, now_s: float) -> None:
        if self.phase != "questionnaire" or self._attempt is None:
            self.problem("an answer counts only while the questionnaire is open")
            return
        try:
            self._asking.take(answer)
        except ValueError as error:
            self.problem(str(error))
            self._send(self._asking.question())
            return
        self._keep_answer(self._attempt, answer, now_s)
        if self._asking.done:
            self._complete_trial(now_s)
        else:
            self._send(self._asking.question())

    def _keep_answer(self, attempt: Attempt, answer: messages.Answer, now_s: float) -> None:
        given = answer.item, answer.value, answer.response_time_s
        attempt.record("/answers", records.Answer(*given), now_s)
        self.tell(transitions.Answered(now_s, attempt.trial, attempt.number, *given))

    # Calibration and tracking ------------------------------------------------------------------------------------

    def calibrate_again(self, now_s: float) -> None:
        """Let the participant be seated anew, in the current trial's seat or bed."""
        self.presence = Presence()
        self._calibrated_for = None
        if self._world.environment == self._current.environment:
            self._enter_calibration(now_s)
        else:
            self.load(self._enter_calibration, now_s)

    def _enter_calibration(self, now_s: float) -> None:
        self.presence.forget_place()
        how = "Sit upright, look" if self._world.stage.posture is human.SEATED else "Lie back, look"
        text = f"{how} straight ahead and rest your arms. Then press the trigger."
        self.enter("calibration", text, now_s)

    def _on_tracking(self, tracking: messages.Tracking, now_s: float) -> None:
        frame = self.presence.take(tracking, now_s)
        if frame.usable and self.phase == "calibration" and self.registration is None:
            assert tracking.head is not None
            self.presence.place(tracking.head, self.person, self._world.stage.posture)
            self._tell_scene()

    def _calibrate(self, now_s: float) -> None:
        """Seat the participant: height, place and direction from the last half second of tracking."""
        measured, posture = not self.height_known, self._world.stage.posture
        try:
            head = self.presence.steady_head(now_s)
            if measured:
                self._give_torso_height(
                    measure_torso_height(self.plan.sex, posture, head, self.plan.furniture)
                )
        except ValueError as error:
            self.problem(str(error))
            return
        self._calibrated_for = posture
        self.presence.place(head, self.person, posture)
        self.tell(transitions.Calibrated(now_s, self.person.torso_height_m, measured))
        self.load(self.enter_check, now_s)

    def give_torso_height(self, torso_height_m: float) -> None:
        """Change the body's size, in its place.

        Raises:
            ValueError: for a height that no adult has, naming what is allowed.
        """
        self._give_torso_height(torso_height_m)
        self.presence.place_again(self.person)

    def _give_torso_height(self, torso_height_m: float) -> None:
        self.person = Person(self.plan.sex, torso_height_m)
        self.height_known = True

    def enter_check(self, now_s: float) -> None:
        """Let the participant look whether body and seat fit."""
        text = "Look down: do body and seat fit you? Trigger: go on. Menu button: measure again."
        self.enter("check", text, now_s)

    def _follow(self, now_s: float) -> None:
        """Move the person to the newest tracking frame, or hold them when it is stale."""
        followed = self.presence.follow(self._world, now_s)
        if followed.turned:
            name, detail = _TRACKING_LOST if followed.lost else _TRACKING_FOUND
            self.record_event(name, detail, now_s)
            kind = transitions.TrackingLost if followed.lost else transitions.TrackingFound
            self.tell(kind(now_s))
        if self._attempt is None:
            return
        self._attempt.record_frames(followed.arrived, followed.newest, stale=followed.lost)
        self._attempt.record_targets(self._world.joint_targets_rad, now_s)

    # The world ----------------------------------------------------------------------------------------------------

    def load(self, then: Then, now_s: float) -> None:
        """Have the current trial's world made and shown, then go on with ``then``."""
        self._then = then
        self._scenery.prepare(self.trial, self.person)
        self.enter("loading", "One moment: the scene is being prepared.", now_s)

    def _prepare_next(self) -> None:
        """Have the next trial's world made, and its scene fetched, while the participant moves and answers."""
        if self.trial + 1 == len(self.plan.trials):
            return
        self._scenery.prepare(self.trial + 1, self.person)
        url = self._scenery.upcoming(self.trial + 1, self.person)
        if url is not None:
            self._send(messages.Upcoming(url=url))

    def _watch_loading(self, now_s: float) -> None:
        """Put up the world that was waited for; go on when the client shows it."""
        then = self._then
        if self.phase != "loading" or then is None:
            return
        if not self._scenery.is_fresh(self.trial, self.person) and not self._change_world(now_s):
            return
        self._tell_scene()
        if self._scenery.is_shown:
            self._then = None
            then(now_s)

    def _change_world(self, now_s: float) -> bool:
        """Whether the prepared world stands now."""
        if not self._scenery.ready:
            return False
        try:
            self._scenery.change()
        except Exception as error:  # whatever a compiler or a file may raise
            self.problem(f"the scene cannot be made: {error}")
            self.enter("paused", "The scene cannot be made. Press the trigger to try again.", now_s)
            return False
        return True

    def _on_scene_loaded(self, message: messages.SceneLoaded, now_s: float) -> None:
        self._scenery.show(message.url)

    # What goes out -----------------------------------------------------------------------------------------------

    def _scene_message(self) -> messages.Scene:
        registration = self.registration or Registration(np.zeros(3), 0.0)
        return self._world.scene(self._scenery.number, registration)

    def _tell_scene(self) -> None:
        """Send the scene, unless that is what was sent last."""
        scene = self._scene_message()
        if scene != self._told_scene:
            self._told_scene = scene
            self._send(scene)

    def _report(self, step: ControlStep | None, now_s: float) -> None:
        self._reporter.tick(self._world, self.presence.followed, step)
        if self._reporter.status_is_due:
            standing = self._phase_message, self._attempt, self._world, self.presence, now_s
            self._send(status(*standing, steps=self.plan.trial_steps, paused=self.paused))

    def problem(self, text: str) -> None:
        """Tell participant and experimenter what is wrong."""
        self._send(messages.Problem(message=text))

    def tell(self, transition: transitions.Transition) -> None:
        """Tell the observer; should it fail, the session pauses at the next tick."""
        try:
            self._observe(transition)
        except Exception as error:  # whatever keeps a database from keeping it
            self._observer_failure = error

    # Recording ---------------------------------------------------------------------------------------------------

    def _configuration(self, attempt: int) -> dict[str, Any]:
        assert self.registration is not None
        return configuration(
            self.plan, self.trial, attempt, self._world, self.registration.xr_from_world(), self.identifier
        )

    def record_event(self, name: str, detail: str, now_s: float) -> None:
        """Record anything that happened at one instant of a running trial."""
        if self._attempt is not None:
            self._attempt.record("/events", records.Event(name, detail), now_s)

    def _watch_keepers(self, now_s: float) -> None:
        """Tell of a disk that pauses; go no further with a trial that recording or observer cannot keep."""
        if self._observer_failure is not None:
            self._pause_unrecorded(self._observer_failure, now_s)
        if self._attempt is None:
            return
        stall = self._attempt.stall()
        if stall is not None:
            self.record_event("recording_stalled", str(stall), now_s)
            self.problem(f"the recording is slow: {stall}")
        if self._attempt.failure is not None:
            self._pause_unrecorded(self._attempt.failure, now_s)

    def _end_attempt(self, result: transitions.Result, now_s: float) -> RecordingError | None:
        """End the recording of a running trial; what keeps it from being complete, if anything does."""
        attempt, self._attempt = self._attempt, None
        if attempt is None:
            return None
        attempt.record_frames(self.presence.take_arrived(), None, stale=False)
        failure = attempt.close(result, now_s)
        sums = attempt.steps, attempt.reward, attempt.success
        whose = attempt.trial, attempt.number, attempt.path
        kept = "failed" if result == "completed" and failure is not None else result
        self.tell(transitions.TrialEnded(now_s, *whose, kept, failure is None, *sums))
        return failure


_TRACKING_LOST = "tracking_lost", f"no frame for {STALE_S} s: the person holds still"
_TRACKING_FOUND = "tracking_found", ""
