"""The worlds of a session: the one that stands, the one that is being made, and the scene that a client shows."""

from concurrent.futures import Executor
from dataclasses import replace

from avrgym.models.human import Person
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.vr.live_world.scene_message import scene_url
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.session.plan import SessionPlan
from avrgym.vr.session.preparation import BodyKey, Preparation, TrialKey


class TrialWorlds:
    """Every attempt has a new world, made ahead of time; a scene, which clients load, serves all that look alike.

    ``scenes`` holds environment and person of each scene, by the number in its address; ``number`` is that of
    ``world``, which stands.
    """

    def __init__(
        self,
        plan: SessionPlan,
        trial: int,
        person: Person,
        workers: Executor,
        scenes: list[tuple[str, Person]],
    ) -> None:
        """Make the first world, of the trial with this index; new scenes are added to ``scenes``."""
        self.scenes = scenes
        self._plan = plan
        self._preparation = Preparation(workers)
        self._fresh_for: TrialKey | None = None
        self._shown: int | None = None
        environment = plan.trials[trial].environment
        self.number = self._number(environment, person)
        self.world = LiveWorld(environment, resting(environment, person))

    @property
    def url(self) -> str:
        """The address of the scene of the world that stands."""
        return scene_url(self.number)

    def is_fresh(self, trial: int, person: Person) -> bool:
        """Whether the world that stands is made for this trial and body, and no robot has driven in it."""
        return self._fresh_for == _key(trial, person)

    def use_up(self) -> None:
        """The robot drives: the world that stands serves no other attempt."""
        self._fresh_for = None

    def prepare(self, trial: int, person: Person) -> None:
        """Have a trial's world made, unless it stands or is being made.

        Where the environment stays, its person begins as they sit or lie now, else in the task's pose.
        """
        key = _key(trial, person)
        if key in (self._fresh_for, self._preparation.key):
            return
        plan, now = self._plan.trials[trial], self.world
        if plan.environment == now.environment:
            begins = replace(person, joint_angles_rad=now.joint_targets_rad)
        else:
            begins = resting(plan.environment, person)
        self._preparation.ask(key, plan.environment, begins, plan.seed)

    def upcoming(self, trial: int, person: Person) -> str | None:
        """The address of a trial's scene, unless it is the one that stands."""
        number = self._number(self._plan.trials[trial].environment, person)
        return None if number == self.number else scene_url(number)

    @property
    def ready(self) -> bool:
        """Whether the world that was asked for is made."""
        return self._preparation.ready

    def change(self) -> None:
        """Let the prepared world stand. Raises what kept it from being made."""
        key, world = self._preparation.key, self._preparation.take()
        self.number = self._number(world.environment, world.person)
        self.world, self._fresh_for = world, key

    def forget_client(self) -> None:
        """A client that has just connected shows nothing yet."""
        self._shown = None

    def show(self, url: str) -> None:
        """The client shows the scene of this address."""
        if url == self.url:
            self._shown = self.number

    @property
    def is_shown(self) -> bool:
        """Whether the client shows the scene of the world that stands."""
        return self._shown == self.number

    def _number(self, environment: str, person: Person) -> int:
        """The number of an environment's scene with a person in it; a new one where there is none."""
        for number, (known, body) in enumerate(self.scenes):
            if known == environment and BodyKey.of(body) == BodyKey.of(person):
                return number
        self.scenes.append((environment, resting(environment, person)))
        return len(self.scenes) - 1


def resting(environment: str, person: Person) -> Person:
    """The person in the pose in which an environment's task meets people."""
    task, _ = find_environment(environment)
    return replace(person, joint_angles_rad=TASKS[task].pose.rest_rad)


def _key(trial: int, person: Person) -> TrialKey:
    return TrialKey(trial, BodyKey.of(person))
