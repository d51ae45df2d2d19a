"""Recomputes a recorded trial: applies the recorded commands to the same world, at the same physics steps."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.human import JOINTS
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import Recording
from avrgym.recording.recorded_world import rebuild_world
from avrgym.recording.schema import Control, Event, Physics
from avrgym.safety.region_forces import RegionLoadRecorder, RegionLoads
from avrgym.system.used_plugins import describe_plugin_differences
from avrgym.tasks.constants import SIMULATION_VERSION
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, find_plugins
from avrgym.vr.session.attempt import make_control_record

BRAKE_EVENTS = (("phase", "retreat"), ("phase", "free_after"))
"""Names and details of the recorded events at which the brakes stop the robot."""


class ReplayError(ValueError):
    """Raised if a recording cannot be replayed."""


@dataclass(frozen=True)
class ComparedState:
    """A recorded simulator state (S,) and the recomputed state (S,) at the same time of the trial."""

    time_s: float
    recorded_state: FloatArray
    recomputed_state: FloatArray

    @property
    def is_identical(self) -> bool:
        """Whether recorded and recomputed state are bit-identical."""
        return self.recorded_state.tobytes() == self.recomputed_state.tobytes()


@dataclass(frozen=True)
class ComparedStep:
    """A recorded control step and the same control step, recomputed."""

    time_s: float
    recorded_step: Control
    recomputed_step: Control


class Playback:
    """Recomputes a recording in a world that is built from its configuration.

    Times are in seconds from the start of the trial.

    Attributes:
        recording: the recording that is recomputed.
        episodes: the world, in the current state of ``recompute``.
        phase: the current phase of the session.
        is_robot_controlled: whether a driver (policy or operator) controlled the robot in the last physics step.
    """

    def __init__(self, recording: Recording, *, by_region: bool = False) -> None:
        """Compile the scene of the recording and start its episode. ``by_region``: whether to measure forces by body
        region.

        Raises:
            ReplayError: if the recording has no state, or if its scene differs from the current one.
        """
        if not recording.messages_by_topic["/physics"]:
            raise ReplayError("the recording is truncated before its first state; restore a backup")
        self.recording = recording
        _check_world_version(recording)
        try:
            self.episodes = rebuild_world(recording.configuration, by_region=by_region)
            _check_names(recording.configuration, self.episodes)
        except ValueError as error:
            raise ReplayError("; ".join([str(error), *find_changed_plugins(recording)])) from error
        self._loop = self.episodes.control_loop
        self._action: FloatArray | None = None
        self._action_is_new = self._brakes = False
        self._step: FirstWorldStep | None = None
        self.phase = ""
        self.is_robot_controlled = False
        self._stopped = self._begun = False

    def recompute(self, *, follow: bool = False) -> Iterator[ComparedState | ComparedStep]:
        """Recomputes the recording. Yields each state and each control step. Can be called once.

        Args:
            follow: whether to continue from the recorded state after a difference. By default, only the first recorded
                state is used.

        Raises:
            ReplayError: if a state or command does not fit the world.
        """
        for topic, log_time_ns, record in self.recording.messages:
            time_s = log_time_ns / 1e9
            if topic == "/physics":
                state = self._advance(time_s, record)
                if follow and not state.is_identical:
                    self.episodes.simulation.set_integration_state(state.recorded_state)
                yield state
            elif topic == "/control":
                recomputed = make_control_record(
                    record.step, self._finished_step(time_s), record.driver, record.idle
                )
                yield ComparedStep(time_s, record, recomputed)
            elif topic == "/events":
                self._apply_event(record)
            elif topic == "/body_targets":
                self.episodes.simulation.command_person(np.array([record.joint_targets]))
            elif topic == "/commands":
                self._action, self._action_is_new = np.array([record.action]), True
                self._brakes = record.brakes_on

    def _advance(self, time_s: float, physics: Physics) -> ComparedState:
        simulation, recorded = self.episodes.simulation, np.array(physics.state, float)
        self._step, self.is_robot_controlled = None, False
        if not self._begun:
            self._begin(recorded)
        elif not self._stopped:
            self.is_robot_controlled = self.phase == "trial"
            self._tick()
        return ComparedState(time_s, recorded, simulation.get_integration_state())

    def _tick(self) -> None:
        if self.phase == "retreat":
            self._loop.advance_with_action(self.update_action(), hold=self._brakes)
        else:
            self._step = self._loop.tick(self if self.is_robot_controlled else None, hold=self._brakes)

    def _begin(self, state: FloatArray) -> None:
        size = len(self.episodes.simulation.get_integration_state())
        if len(state) != size:
            raise ReplayError(
                f"a recorded state has {len(state)} values, but a state of this simulator has {size}; install the "
                f"recorded version: {format_versions(self.recording)}"
            )
        self.episodes.simulation.brake_robot()
        self.episodes.simulation.set_integration_state(state)
        self._begun = True

    def _finished_step(self, time_s: float) -> FirstWorldStep:
        if self._step is None:
            raise ReplayError(
                f"the recorded control step at {time_s:.2f} s does not end at a tick (10 ms) of the trial; restore a "
                f"backup; {format_versions(self.recording)}"
            )
        return self._step

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the recorded action (1, A) of the current control step."""
        if self._action is None:
            raise ReplayError(
                f"the recording contains no commands to the robot; restore a backup; {format_versions(self.recording)}"
            )
        self._action_is_new = False
        return self._action

    def update_action(self) -> FloatArray | None:
        """Returns the action (1, A) if a command was recorded within the control step, else ``None``."""
        return self.act(np.zeros(0)) if self._action_is_new else None

    def _apply_event(self, event: Event) -> None:
        """Updates the phase. Applies the robot's brakes before and after its retreat, and permanently if the attempt
        was aborted.
        """
        if event.name == "phase":
            self.phase = event.detail
        self._stopped = self._stopped or event.name == "robot_holds"
        if self._stopped or (event.name, event.detail) in BRAKE_EVENTS:
            self.episodes.simulation.brake_robot()
            self._loop.abort_step()


def compute_region_loads(recording: Recording, progress: Callable[[], None] = lambda: None) -> RegionLoads:
    """Returns the contact forces (1, R) on the person's body regions, over all steps in which a driver controlled the
    robot.

    Args:
        recording: the recording of one attempt.
        progress: called after each recorded state.

    Raises:
        ReplayError: if the recording cannot be recomputed.
    """
    playback, watch = Playback(recording, by_region=True), RegionLoadRecorder(1)
    for compared in playback.recompute(follow=True):
        if isinstance(compared, ComparedState):
            if playback.is_robot_controlled:
                watch.add_forces(playback.episodes.simulation.compute_region_force_n())
            progress()
    return watch.compute_loads()


def format_title(recording: Recording) -> str:
    """Returns the title of a recording: environment, policy, trial, attempt, and whether the participant is
    simulated."""
    trial = recording.configuration
    kind = "practice" if trial.practice else f"trial {trial.trial_number}"
    participant = "simulated participant" if trial.simulated else "participant"
    scene = trial.environment.removeprefix("avrgym/")
    return f"{scene}, {trial.policy}, {kind}, attempt {trial.attempt_number}: {participant}"


def find_phase_start_times(recording: Recording) -> list[tuple[float, str]]:
    """Returns the start time (in seconds) and the name of each phase."""
    events = recording.messages_by_topic["/events"]
    return [(time_ns / 1e9, event.detail) for time_ns, event in events if event.name == "phase"]


def find_robot_motion_end_s(recording: Recording) -> float:
    """Returns the time in seconds after which the robot does not move: the start of the questionnaire.

    Without a questionnaire, returns the end of the recording.
    """
    starts = (time_s for time_s, name in find_phase_start_times(recording) if name == "questionnaire")
    return next(starts, recording.duration_s)


def find_control_time_range_s(recording: Recording) -> tuple[float, float]:
    """Returns the start and end time of the robot's control steps in seconds.

    Without control steps, returns 0 and ``find_robot_motion_end_s``.
    """
    starts = [time_s for time_s, name in find_phase_start_times(recording) if name == "trial"]
    control = recording.messages_by_topic["/control"]
    if not starts or not control:
        return 0.0, find_robot_motion_end_s(recording)
    return starts[0], control[-1][0] / 1e9


def format_versions(recording: Recording) -> str:
    """Returns a text with the recorded versions and the plug-ins that have changed since the recording."""
    return "; ".join(
        [f"it was recorded with {recording.configuration.versions}", *find_changed_plugins(recording)]
    )


def find_changed_plugins(recording: Recording) -> list[str]:
    """Returns the task and robot plug-ins that differ from the recorded ones.

    Controllers are omitted, because replay does not run them.
    """
    environment = recording.configuration.environment
    before = [each for each in recording.configuration.plugins if each.kind != "controller"]
    return describe_plugin_differences(
        before, find_plugins(environment) if environment in ENVIRONMENTS else ()
    )


def _check_world_version(recording: Recording) -> None:
    version = recording.configuration.world_version
    if version != SIMULATION_VERSION:
        raise ReplayError(
            f"the recording has version {version} of the simulated world; this release simulates "
            f"version {SIMULATION_VERSION}; install the recorded version: {format_versions(recording)}"
        )


def _check_names(configuration: TrialConfiguration, episodes: Episodes) -> None:
    for kind, recorded, now in (
        ("joints", configuration.joint_names, tuple(JOINTS)),
        ("bodies", configuration.body_names, tuple(episodes.simulation.bodies)),
    ):
        if recorded != now:
            raise ReplayError(
                f"the {kind} of the recorded scene have changed: {', '.join(sorted({*now} ^ {*recorded}))}; "
                f"install the recorded version: {configuration.versions}"
            )
