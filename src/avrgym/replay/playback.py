"""A recorded trial lived through again: the same world, told the same at the same ticks, stepped anew."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.human import JOINTS, Person
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control, Event, Physics
from avrgym.replay.trial import ReplayError
from avrgym.system.used_plugins import differences, stored
from avrgym.tasks.constants import WORLD_VERSION
from avrgym.tasks.control_loop import ControlStep
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, plugins_of
from avrgym.vr.session.attempt import control_record

HALTS = (("phase", "retreat"), ("phase", "free_after"))
"""Events at which the robot is halted. Recordings of earlier versions hold no retreat."""


@dataclass(frozen=True)
class StateAgain:
    """A recorded state of the simulator (S,), and the state that stepping leads to in its place."""

    time_s: float
    recorded: FloatArray
    stepped: FloatArray

    @property
    def identical(self) -> bool:
        """Whether they agree in every bit."""
        return self.recorded.tobytes() == self.stepped.tobytes()


@dataclass(frozen=True)
class StepAgain:
    """A recorded control step, and what the same step gives now."""

    time_s: float
    recorded: Control
    stepped: Control


class Playback:
    """The world of a recording, made anew from its metadata. Times count from the beginning of the trial.

    ``episodes`` is that world as it stands between two moments of ``run``, ``phase`` the session's phase then;
    ``driven``: the step that led there was one of a robot that somebody drove.
    """

    def __init__(self, recording: Recording, *, by_region: bool = False) -> None:
        """Compile the scene and begin the episode; ``by_region`` as of ``Episodes``.

        Raises:
            ReplayError: for a recording that breaks off before its first state or does not say what it was made
                with, and for one whose scene has changed since.
        """
        if not recording.topics["/physics"]:
            raise ReplayError("it breaks off before its first state")
        self.recording = recording
        _check_world_version(recording)
        try:
            self.episodes = _episodes(recording.metadata, by_region)
            _check_names(recording.metadata, self.episodes)
        except ReplayError as error:
            raise ReplayError("; ".join([str(error), *changed_plugins(recording)])) from error
        self._loop = self.episodes.loop
        self._action: FloatArray | None = None
        self._told = self._brakes = False
        self._step: ControlStep | None = None
        self.phase = ""
        self.driven = False
        self._held = self._begun = False

    def run(self, *, follow: bool = False) -> Iterator[StateAgain | StepAgain]:
        """Step through the recording, once.

        Args:
            follow: whether the world goes on from each recorded state, should its own be another. Otherwise only
                the first one is taken over.

        Raises:
            ReplayError: at a state or a command that does not fit the world.
        """
        for topic, log_time_ns, record in self.recording.messages:
            time_s = log_time_ns / 1e9
            if topic == "/physics":
                state = self._advance(time_s, record)
                if follow and not state.identical:
                    self.episodes.simulation.restore(state.recorded)
                yield state
            elif topic == "/control":
                stepped = control_record(record.step, self._finished_step(time_s), record.driver, record.idle)
                yield StepAgain(time_s, record, stepped)
            elif topic == "/events":
                self._hear(record)
            elif topic == "/body_targets":
                self.episodes.simulation.command_person(np.array([record.joint_targets]))
            elif topic == "/commands":
                self._action, self._told = np.array([record.action]), True
                self._brakes = record.brakes

    def _advance(self, time_s: float, physics: Physics) -> StateAgain:
        simulation, recorded = self.episodes.simulation, np.array(physics.state, float)
        self._step, self.driven = None, False
        if not self._begun:
            self._begin(recorded)
        elif not self._held:
            self.driven = self.phase == "trial"
            self._tick()
        return StateAgain(time_s, recorded, simulation.integration_state())

    def _tick(self) -> None:
        if self.phase == "retreat":
            self._loop.move(self.amend(), hold=self._brakes)
        else:
            self._step = self._loop.tick(self if self.driven else None, hold=self._brakes)

    def _begin(self, state: FloatArray) -> None:
        size = len(self.episodes.simulation.integration_state())
        if len(state) != size:
            raise ReplayError(
                f"its states have {len(state)} numbers, this simulator's have {size}: {made_with(self.recording)}"
            )
        self.episodes.simulation.halt_robot()
        self.episodes.simulation.restore(state)
        self._begun = True

    def _finished_step(self, time_s: float) -> ControlStep:
        if self._step is None:
            raise ReplayError(
                f"the control step that it holds at {time_s:.2f} s ends at no tick of the trial"
            )
        return self._step

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the recorded action (1, J)."""
        if self._action is None:
            raise ReplayError(f"it holds no commands to the robot: {made_with(self.recording)}")
        self._told = False
        return self._action

    def amend(self) -> FloatArray | None:
        """Returns an action (1, J) that was recorded within a control step, if there is one."""
        return self.act(np.zeros(0)) if self._told else None

    def _hear(self, event: Event) -> None:
        """A trial drives the robot; it halts around its retreat, or for good when the attempt is broken off."""
        if event.name == "phase":
            self.phase = event.detail
        self._held = self._held or event.name == "robot_holds"
        if self._held or (event.name, event.detail) in HALTS:
            self.episodes.simulation.halt_robot()
            self._loop.abort_step()


def made_with(recording: Recording) -> str:
    """Which versions wrote a recording, and which of its plug-ins have changed since."""
    versions = recording.metadata.get("versions", {})
    named = ", ".join(f"{name} {version}" for name, version in versions.items())
    words = f"it was recorded with {named or 'versions that it does not name'}"
    return "; ".join([words, *changed_plugins(recording)])


def changed_plugins(recording: Recording) -> list[str]:
    """Task and robot of a recording that are not what they were then, in words; its commands need no controller."""
    environment: str = recording.metadata.get("environment", "")
    before = [each for each in stored(recording.metadata.get("plugins")) or () if each.kind != "controller"]
    return differences(before, plugins_of(environment) if environment in ENVIRONMENTS else ())


def _check_world_version(recording: Recording) -> None:
    version = recording.metadata.get("world_version")
    if version != WORLD_VERSION:
        raise ReplayError(
            f"it was made in version {version} of the simulated world; this release steps version {WORLD_VERSION}: "
            f"{made_with(recording)}"
        )


def _episodes(metadata: dict[str, Any], by_region: bool) -> Episodes:
    try:
        person = Person(**metadata["person"], joint_angles_rad=np.array(metadata["start_rad"], float))
        episodes = Episodes(
            metadata["environment"],
            1,
            person=person,
            moving=True,
            num_threads=1,
            by_region=by_region,
        )
        episodes.begin_as(metadata["start"])
    except KeyError as error:
        raise ReplayError(
            f"its configuration lacks {error}, without which its world cannot be made"
        ) from error
    except (TypeError, ValueError) as error:
        raise ReplayError(f"its world cannot be made: {error}") from error
    return episodes


def _check_names(metadata: dict[str, Any], episodes: Episodes) -> None:
    here = {"joints": list(JOINTS), "bodies": list(episodes.simulation.bodies)}
    for kind, names in here.items():
        if metadata.get(kind) != names:
            changed = sorted({*names} ^ {*metadata.get(kind, ())})
            raise ReplayError(f"the {kind} of its scene are not those of today: {', '.join(changed)}")
