"""The worlds of a session: the current world, the next world, and the scene that the client shows."""

from concurrent.futures import Executor
from dataclasses import replace

from avrgym.models.human import Person
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.vr.live_world.scene_message import make_scene_url
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.session.plan import SessionPlan
from avrgym.vr.session.world_preparation import BodyKey, WorldKey, WorldPreparation


class TrialWorlds:
    """Provides a new world for every attempt, built in advance. Worlds with the same appearance share a scene.

    ``scenes`` contains environment, person and settings of each scene. A scene's number is its index in this list.
    ``world`` is the current world. ``scene_number`` is the number of its scene.
    """

    def __init__(
        self,
        plan: SessionPlan,
        trial: int,
        person: Person,
        workers: Executor,
        scenes: list[tuple[str, Person, Settings]],
    ) -> None:
        """Build the world of the trial with index ``trial``. New scenes are added to ``scenes``."""
        self.scenes = scenes
        self._plan = plan
        self._preparation = WorldPreparation(workers)
        self._fresh_for: WorldKey | None = None
        self._shown: int | None = None
        environment, settings = plan.trials[trial].environment, plan.find_trial_settings(plan.trials[trial])
        self.scene_number = self._number(environment, settings, person)
        self.world = LiveWorld(environment, make_resting_person(environment, person, settings), settings)

    @property
    def scene_url(self) -> str:
        """The address of the GLB file of the current world's scene."""
        return make_scene_url(self.scene_number)

    def is_world_unused(self, trial: int, person: Person) -> bool:
        """Returns whether the current world was built for this trial and body, and its robot has not moved."""
        return self._fresh_for == _key(trial, person)

    def mark_world_used(self) -> None:
        """Mark the current world as used: the robot moves."""
        self._fresh_for = None

    def prepare_world(self, trial: int, person: Person) -> None:
        """Start to build a trial's world, if it does not exist and is not in preparation.

        In the same environment with the same settings, the new person has the current pose. Otherwise the new person
        has the rest pose of the task.
        """
        key = _key(trial, person)
        if key in (self._fresh_for, self._preparation.world_key):
            return
        plan, now = self._plan.trials[trial], self.world
        settings = self._plan.find_trial_settings(plan)
        if (plan.environment, settings) == (now.environment_id, now.settings):
            start_person = replace(person, joint_angles_rad=now.joint_targets_rad)
        else:
            start_person = make_resting_person(plan.environment, person, settings)
        self._preparation.start(key, plan.environment, start_person, settings, plan.seed)

    def find_next_scene_url(self, trial: int, person: Person) -> str | None:
        """Returns the address of a trial's scene; ``None`` if it is the current scene."""
        plan = self._plan.trials[trial]
        number = self._number(plan.environment, self._plan.find_trial_settings(plan), person)
        return None if number == self.scene_number else make_scene_url(number)

    @property
    def is_world_ready(self) -> bool:
        """Whether the requested world is built. ``switch_world`` then makes it the current world."""
        return self._preparation.is_ready

    def switch_world(self) -> None:
        """Replace the current world by the prepared world. If its preparation raised an error, raises this error."""
        key, world = self._preparation.world_key, self._preparation.pop_world()
        self.scene_number = self._number(world.environment_id, world.settings, world.person)
        self.world, self._fresh_for = world, key

    def reset_shown_scene(self) -> None:
        """Reset the shown scene, because a client has just connected and shows no scene yet."""
        self._shown = None

    def mark_scene_shown(self, url: str) -> None:
        """Record which scene the client shows, by its address."""
        if url == self.scene_url:
            self._shown = self.scene_number

    @property
    def is_scene_shown(self) -> bool:
        """Whether the client shows the current world's scene."""
        return self._shown == self.scene_number

    def _number(self, environment: str, settings: Settings, person: Person) -> int:
        """Returns the number of an environment's scene with this person. Adds the scene if it does not exist."""
        for number, (known, body, applied) in enumerate(self.scenes):
            same = (known, applied) == (environment, settings)
            if same and BodyKey.from_person(body) == BodyKey.from_person(person):
                return number
        self.scenes.append((environment, make_resting_person(environment, person, settings), settings))
        return len(self.scenes) - 1


def make_resting_person(environment: str, person: Person, settings: Settings = DEFAULT_SETTINGS) -> Person:
    """Returns the person in the rest pose of an environment's task."""
    task, _ = find_task_and_scene(environment, settings)
    return replace(person, joint_angles_rad=task.pose_distribution.rest_angles_rad)


def _key(trial: int, person: Person) -> WorldKey:
    return WorldKey(trial, BodyKey.from_person(person))
