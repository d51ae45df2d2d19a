"""A participant's session: its trials in explicit phases, from free movement to the questionnaire.

How a participant takes place stands in ``seating``, how worlds come in ``loading``, how attempts are kept in
``keeping``, what participant and experimenter may ask in ``participant`` and ``experimenter``.

The session knows no clock and no network. Whoever runs it gives it messages and ticks, each with the time in seconds
since the session began, and sends what it hands out. So the same session runs live on a thread and, with a simulated
participant, faster than real time.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.models import human
from avrgym.models.human import Person
from avrgym.recording import records
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import PhaseName
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.session import continuity, experimenter, keeping, loading, participant, seating, transitions
from avrgym.vr.session.asking import Asking
from avrgym.vr.session.attempt import Attempt, Experience
from avrgym.vr.session.plan import Policies, SessionPlan, TrialPlan
from avrgym.vr.session.preparation import AtOnce
from avrgym.vr.session.reporting import Reporter, status
from avrgym.vr.session.scenery import Scenery
from avrgym.vr.tracking.jumps import PARTS
from avrgym.vr.tracking.presence import Presence
from avrgym.vr.tracking.tracking import STALE_S
from avrgym.vr.tracking.world import ControlStep, LiveWorld

MOVING: tuple[PhaseName, ...] = ("free_before", "countdown", "trial", "free_after")
"""Where the participant or the robot moves and looks at it."""


@dataclass(frozen=True)
class Disconnected:
    """The participant's connection is gone."""


Send = Callable[[messages.ServerMessage], None]
Handler = Callable[["Session", Any, float], None]
Then = Callable[[float], None]


class Session:
    """One participant's session.

    ``trial`` counts the plan's trials from 0. ``recordings`` holds the files of all attempts; ``attempt`` is the one
    that runs, ``experience`` how the latest has been so far. ``person`` is whose body the participant has;
    ``height_known``: its torso height is theirs, ``calibrated_for``: the posture that they have taken place in.
    ``completing`` is a trial whose completion is not kept yet, ``failing`` whether the last attempt could not be kept.
    ``paused`` is whether the experimenter lets no trial begin, ``then`` what follows when the scene is loaded.
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
        kept: Callable[[], bool] = lambda: True,
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
            observe: told of every transition. When it raises, the session pauses.
            kept: whether all that the observer was told is kept; before that no phase ends by itself, and no trial
                follows a completed one. When it raises, the session pauses.
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
        self.send = send
        self.folder = folder
        self._policies, self._observe, self._kept = policies, observe, kept
        self._called_off = called_off
        self.observer_failure: Exception | None = None
        known = [] if scenes is None else scenes
        self.scenery = Scenery(plan, self.trial, self.person, workers or AtOnce(), known)
        self._reporter = Reporter(send)
        self.calibrated_for: human.Posture | None = None
        self.then: Then | None = None
        self.attempt: Attempt | None = None
        self.completing: int | None = None
        self.failing = False
        self.asking = Asking(())
        self._ends_at: float | None = None
        self._ticked_s: float | None = None
        self._told_scene = self._scene_message()
        self.enter("waiting", "Put on the headset and choose Enter VR.", 0.0)

    @property
    def scenes(self) -> list[tuple[str, Person]]:
        """Environment and person of each scene that clients may be told of, by the number in its address."""
        return self.scenery.scenes

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves, so that some milliseconds more or less harm nobody."""
        return self.phase not in MOVING

    @property
    def registration(self) -> Registration | None:
        """Where the participant's floor lies in the world, once that is known."""
        return self.presence.registration

    @property
    def world(self) -> LiveWorld:
        """The world that stands."""
        return self.scenery.world

    @property
    def bodies(self) -> tuple[str, ...]:
        """The order of the poses in every state."""
        return self.world.bodies

    def greet(self, send: Send, role: messages.Role, now_s: float) -> None:
        """Tell a client that has just connected where things stand."""
        if role == "participant":
            self.scenery.forget_client()
            self.tell(transitions.ConnectionFound(now_s))
        plan = self.plan
        send(
            messages.Welcome(
                messages.PROTOCOL, self.identifier, role, haptics=plan.haptics, sounds=plan.sounds
            )
        )
        send(seating.body_message(self.person))
        send(self._scene_message())
        send(self._phase_message)
        if self.phase == "questionnaire":
            send(self.asking.question())

    def receive(
        self, message: messages.ClientMessage | messages.ExperimenterMessage | Disconnected, now_s: float
    ) -> None:
        """Take a message of the participant's client or of the experimenter's."""
        handler = HANDLERS.get(type(message))
        if handler is None:
            self.problem(f"a message of type {type(message).__name__} has no place in a running session")
            return
        handler(self, message, now_s)

    def tick(self, now_s: float) -> None:
        """Advance the world by 10 ms of simulated time and the session to ``now_s``."""
        if self.phase != "finished" and self._called_off():
            experimenter.end(self, now_s)
        continuity.watch(self, self._since_last_tick(now_s), now_s)
        self._follow(now_s)
        plan = self.current
        policy = self._policies[plan.environment, plan.policy] if self.phase == "trial" else None
        step = self.world.tick(policy)
        if self.attempt is not None:
            self.attempt.record_physics(self.world, now_s)
        if step is not None:
            self._finish_step(step, now_s)
        keeping.watch(self, now_s)
        loading.watch(self, now_s)
        self._report(step, now_s)
        if self._ends_at is not None and now_s >= self._ends_at and self.is_kept():
            self._advance(now_s)
        if self.attempt is not None:
            self.attempt.hand_over()

    def _since_last_tick(self, now_s: float) -> float:
        before_s, self._ticked_s = self._ticked_s, now_s
        return 0.0 if before_s is None else now_s - before_s

    def catch_up(self) -> None:
        """Wait for the disk, where ticks follow each other faster than in real time."""
        if self.attempt is not None:
            self.attempt.catch_up()

    def close(self, now_s: float) -> None:
        """End the session; a trial that is running is kept as interrupted."""
        self.abandon("interrupted", now_s)

    # Phases ------------------------------------------------------------------------------------------------------

    @property
    def current(self) -> TrialPlan:
        """The trial that runs or comes next; the last one, when all are over."""
        return self.plan.trials[min(self.trial, len(self.plan.trials) - 1)]

    def enter(self, phase: PhaseName, text: str, now_s: float, seconds: float | None = None) -> None:
        """Enter a phase with the words to show; it ends by itself after ``seconds``, if they are given."""
        self.phase = phase
        self._ends_at = None if seconds is None else now_s + seconds
        trials = len(self.plan.trials)
        trial = min(self.trial + 1, trials)
        self._phase_message = messages.Phase(phase, text, trial, trials, self.current.practice, seconds)
        self.record_event("phase", phase, now_s)
        self.tell(transitions.PhaseEntered(now_s, phase, trial))
        self.send(self._phase_message)

    def _advance(self, now_s: float) -> None:
        """Go on from a phase whose time is over."""
        if self.phase == "free_before":
            self.enter("countdown", "The robot starts in", now_s, self.plan.countdown_s)
        elif self.phase == "countdown" and not self.presence.lost:
            self.scenery.use_up()
            self.enter("trial", "The robot is helping you. Press a menu button to stop it.", now_s)
        elif self.phase == "free_after":
            self._after_trial(now_s)

    def begin_trial(self, now_s: float) -> None:
        """Begin the next attempt, once its world is made, the participant is in place, tracked and nobody pauses."""
        if self.completing is not None:
            self.enter("loading", "One moment: the trial is being stored.", now_s)
        elif not self.scenery.is_fresh(self.trial, self.person):
            loading.load(self, self.begin_trial, now_s)
        elif self.calibrated_for is not self.world.stage.posture:
            seating.enter_calibration(self, now_s)
        elif self.paused:
            self.enter("paused", "The experimenter has paused the session. The robot holds still.", now_s)
        elif not continuity.is_tracked(self, now_s):
            text = "Tracking is lost: look around, then press the trigger to go on."
            self.enter("paused", text, now_s)
        else:
            self._begin_attempt(now_s)

    def _begin_attempt(self, now_s: float) -> None:
        try:
            attempt = keeping.new_attempt(self, now_s)
        except OSError as error:
            keeping.pause(self, error, now_s)
            return
        if self.failing:
            keeping.forget_failures(self)
        self.attempt, self.failing = attempt, False
        self.experience = attempt.experience
        self.presence.take_arrived()
        self.recordings.append(attempt.path)
        self.tell(transitions.TrialBegun(now_s, attempt.trial, attempt.number, attempt.path))
        attempt.record_physics(self.world, now_s)
        kind = f"Trial {self.trial + 1} of {len(self.plan.trials)}"
        told = f"{'Practice' if self.current.practice else kind}: {self.plan.goal_of(self.current)}"
        text = f"{told} Move your head and arms as you like; the robot holds still."
        self.enter("free_before", text, now_s, self.plan.free_movement_s)

    def _finish_step(self, step: ControlStep, now_s: float) -> None:
        attempt = self.attempt
        assert attempt is not None
        attempt.record_step(step, now_s)
        self.experience = attempt.experience
        if attempt.steps == self.plan.trial_steps:
            self.world.hold()
            text = "The robot has finished and holds still. Move as you like."
            self.enter("free_after", text, now_s, self.plan.free_movement_s)
            loading.prepare_next(self)

    def _after_trial(self, now_s: float) -> None:
        items = self.plan.items_after(self.current)
        if not items:
            self.complete_trial(now_s)
            return
        self.asking = Asking(items)
        self.enter("questionnaire", "Point at your answer and press the trigger.", now_s)
        self.send(self.asking.question())

    def complete_trial(self, now_s: float) -> None:
        """End the attempt as completed, unless it cannot be kept, and go on."""
        recording_failure = keeping.end_attempt(self, "completed", now_s)
        kept = self.is_kept()
        failure = recording_failure or self.observer_failure
        if failure is not None:
            keeping.pause(self, failure, now_s)
        elif kept:
            self.next_trial(now_s)
        else:
            self.completing = self.trial
            self.enter("loading", "One moment: the trial is being stored.", now_s)

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
        self.world.hold()
        if self.attempt is None:
            return
        self.record_event("robot_holds", result, now_s)
        self.attempt.record_physics(self.world, now_s)
        failure = keeping.end_attempt(self, result, now_s)
        if failure is not None:
            self.problem(f"the trial is not recorded completely: {failure}")

    def _follow(self, now_s: float) -> None:
        """Move the person to the newest tracking frame, or hold them when it is stale."""
        followed = self.presence.follow(self.world, now_s)
        if followed.turned:
            name, detail = _TRACKING_LOST if followed.lost else _TRACKING_FOUND
            self.record_event(name, detail, now_s)
            kind = transitions.TrackingLost if followed.lost else transitions.TrackingFound
            self.tell(kind(now_s))
        if self.attempt is None:
            return
        for part in PARTS:
            if (part in followed.held) != (part in followed.held_before):
                self.record_event("pose_held" if part in followed.held else "pose_followed", part, now_s)
        self.attempt.record_frames(followed.arrived, followed.newest, stale=followed.lost, held=followed.held)
        self.attempt.record_targets(self.world.joint_targets_rad, now_s)

    # What goes out -----------------------------------------------------------------------------------------------

    def _scene_message(self) -> messages.Scene:
        registration = self.registration or Registration(np.zeros(3), 0.0)
        return self.world.scene(self.scenery.number, registration)

    def tell_scene(self) -> None:
        """Send the scene, unless that is what was sent last."""
        scene = self._scene_message()
        if scene != self._told_scene:
            self._told_scene = scene
            self.send(scene)

    def _report(self, step: ControlStep | None, now_s: float) -> None:
        self._reporter.tick(self.world, self.presence.followed, step)
        if self._reporter.status_is_due:
            standing = self._phase_message, self.attempt, self.world, self.presence, now_s
            self.send(status(*standing, steps=self.plan.trial_steps, paused=self.paused))

    def problem(self, text: str, role: messages.Role = "participant") -> None:
        """Tell what is wrong to whom it concerns; the experimenter is told what the participant is."""
        self.send(messages.Problem(text, role))

    def tell(self, transition: transitions.Transition) -> None:
        """Tell the observer; should it fail, the session pauses at the next tick."""
        try:
            self._observe(transition)
        except Exception as error:  # whatever keeps a database from keeping it
            self.observer_failure = error

    def is_kept(self) -> bool:
        """Whether all that the observer was told is kept; should it have failed, the session pauses."""
        try:
            return self._kept()
        except Exception as error:  # whatever keeps a database from keeping it
            self.observer_failure = error
            return False

    def record_event(self, name: str, detail: str, now_s: float) -> None:
        """Record anything that happened at one instant of a running trial."""
        if self.attempt is not None:
            self.attempt.record("/events", records.Event(name, detail), now_s)


HANDLERS: Mapping[type, Handler] = {
    **participant.HANDLERS,
    **experimenter.HANDLERS,
    Disconnected: participant.disconnected,
}
"""What a session does with each message; whose each may be, the server sees to."""

_TRACKING_LOST = "tracking_lost", f"no frame for {STALE_S} s: the person holds still"
_TRACKING_FOUND = "tracking_found", ""
