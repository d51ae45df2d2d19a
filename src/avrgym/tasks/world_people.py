"""The people of N worlds, sampled from populations. Behaviour models, trained policies or human actions move them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.arrays import choose_index, get_namespace, to_device_of
from avrgym.models.human import JOINTS, People, Person
from avrgym.models.scene import CONTROL_STEP_S, DEFAULT_SUBSTEPS, PHYSICS_STEP_S, SceneConfig
from avrgym.networks.policy import PolicyError
from avrgym.people import cooperation, distributions, impaired_motion, impairments, shoulder_limits
from avrgym.people.arm_clearance import make_furniture_boxes
from avrgym.people.clinical_impairments import sample_motor_signs
from avrgym.people.distributions import PoseDistribution
from avrgym.people.impaired_motion import ImpairedMotionState, MotorSigns
from avrgym.people.motor_model import MOTION_VERSION
from avrgym.people.populations import Population, TrainedHumans, find_populations
from avrgym.people.zoo import partners
from avrgym.people.zoo.commanding_partners import CommandingPartners, PartnerCommands
from avrgym.simulation.start_clearance import EXTRA_TREMOR_CLEARANCE_M
from avrgym.simulation.state import State
from avrgym.tasks.behaviour_model import BehaviourModel
from avrgym.tasks.human_observation import make_human_observer
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.tasks.settings import PERSON_SETTINGS, Settings
from avrgym.tasks.task import replace_task_states
from avrgym.tasks.task_transform import transform_state

NUM_RANDOM_NUMBERS = (
    distributions.NUM_RANDOM_NUMBERS + impairments.NUM_RANDOM_NUMBERS + cooperation.NUM_RANDOM_NUMBERS
)
"""Number of uniform random numbers for each person: for the body, the impairment and the behaviour."""
_POPULATION, _EXPLORATION = 2, 3
"""Indices of two uniform random numbers of the behaviour.

The first number selects the population. The second is the seed of the exploration noise of a trained human.
"""


def find_environment_populations(name_or_path: str, environment_id: str) -> tuple[Population, ...]:
    """Returns the populations for a value of ``--people`` in an environment.

    Raises:
        ValueError: for an unknown name (the message lists the allowed names), or for a damaged file. Also for humans
            that were trained for another environment, or have a network of a wrong size.
    """
    populations = find_populations(name_or_path, TASKS)
    for population in populations:
        if population.trained_policy is None:
            continue
        trained_for = population.trained_policy.metadata.environment
        if trained_for != environment_id:
            raise PolicyError(
                f"{population.name}: this human was trained for {trained_for}; for {environment_id}, train one with "
                f"`avrgym train {environment_id} --recipe pair`"
            )
        view, joints = make_human_observer(environment_id)
        sizes = (population.trained_policy.observation_size, population.trained_policy.action_size)
        if sizes != (view.size, joints):
            raise PolicyError(
                f"{population.name}: the lengths of observation and action are {sizes[0]} and {sizes[1]}; allowed in "
                f"{environment_id}: {view.size} and {joints}"
            )
    return populations


class WorldPeople:
    """The people of N worlds. ``people`` are their bodies, on the host.

    Attributes:
        trained_humans: the trained policies that move people, if any.
        is_moving: whether people move during episodes.
        commands: the commands of partners to the robot; ``None`` if these people give no commands.
        moves_every_physics_step: whether their joint targets change every 10 ms.
        interpolates_targets: whether joint targets that change every 0.1 s are interpolated.
        extra_clearance_m: additional clearance that the motion of these people needs.
    """

    def __init__(
        self,
        name_or_path: str,
        environment_id: str,
        scene: SceneConfig,
        num_worlds: int,
        *,
        person: Person | None,
        impairment: str,
        driven: bool,
        human_actions: bool,
        settings: Settings,
    ) -> None:
        """Find the populations. Call ``create_people`` before any other method.

        Args:
            name_or_path: the populations, see ``Episodes``.
            environment_id: environment id such as ``avrgym/FeedingJaco-v1``.
            scene: the furniture, and the posture of people.
            num_worlds: number N of worlds.
            person: one fixed person, instead of ``name_or_path``.
            impairment: a name in ``people.impairments.IMPAIRMENTS``.
            driven: whether the caller moves the people's joints.
            human_actions: whether people execute actions.
            settings: heights and joint ranges of sampled people.

        Raises:
            ValueError: for unknown names, or for populations that do not fit the environment. Also for settings of
                sampled people together with a fixed person.
        """
        given = [name for name in PERSON_SETTINGS if name in settings.changed_values]
        if given and person is not None:
            raise ValueError(
                f"the setting {given[0]} is not possible with a fixed person; remove {given[0]} or the person"
            )
        self._settings = settings
        self.fixed_person = person
        self._task, self._frame = (
            TASKS[find_environment(environment_id)[0]],
            scene.scene_in_task_frame.task_frame,
        )
        self._posture, self._mirror_axis = scene.scene_in_task_frame.posture, scene.tool.mirror_axis
        self._furniture = make_furniture_boxes(scene.furniture).transform_to_frame(self._frame)
        requested = impairments.parse_impairment(impairment)
        self._populations = [
            replace(population, impairment=population.choose_impairment(requested))
            for population in find_environment_populations(name_or_path, environment_id)
        ]
        self._policies = [
            each.trained_policy for each in self._populations if each.trained_policy is not None
        ]
        by_policy = bool(self._policies) and not (human_actions or driven)
        self.trained_humans = TrainedHumans(self._policies, num_worlds) if by_policy else None
        self._actions = human_actions or by_policy
        if self._actions and self._frame.is_mirrored:
            raise ValueError(
                "the setting served_arm is not possible for people with human actions or trained policies; remove "
                "served_arm"
            )
        are_partners = any(each.distribution.partners is not None for each in self._populations)
        clinical = any(impairments.is_clinical_impairment(each.impairment) for each in self._populations)
        trembles = clinical or any(each.impairment == "tremor" for each in self._populations)
        self.extra_clearance_m = EXTRA_TREMOR_CLEARANCE_M if are_partners or trembles else 0.0
        self.is_moving = not driven and (
            self._actions
            or any(
                each.distribution.is_moving or impairments.needs_movable_joints(each.impairment)
                for each in self._populations
            )
        )
        self._clinical = self.is_moving and clinical
        versions = {each.distribution.motion_version for each in self._populations}
        self.moves_every_physics_step = self.is_moving and not self._actions and versions == {MOTION_VERSION}
        self.interpolates_targets = (
            self.is_moving
            and not self.moves_every_physics_step
            and (self._actions or are_partners or clinical)
        )
        own = self._populations[0].distribution.partners
        self.commands = None
        if isinstance(own, CommandingPartners) and self.is_moving and not self._actions:
            self.commands = PartnerCommands(own, num_worlds)
        self._num_worlds = num_worlds
        self._steps_per_target = max(1, round(CONTROL_STEP_S / scene.control_step_s))
        self._steps = np.zeros(num_worlds, dtype=int)

    @property
    def needs_host(self) -> bool:
        """Whether the motion of these people can be computed only on the host, not on a device."""
        return bool(self._policies) or self._actions

    @property
    def has_random_arm_pose(self) -> bool:
        """Whether the initial pose of the people's right arm is random."""
        return self.fixed_person is None and any(
            self._pose(each).has_random_arm_pose for each in self._populations
        )

    def create_people(self, example_array: Any) -> None:
        """Create the people, and their behaviour model on the device of ``example_array``."""
        self._exemplar = example_array
        self._set_people(distributions.repeat_person(self.fixed_person or Person(), self._num_worlds))
        self._signs = self._motion = None
        if self._clinical:
            signs = impaired_motion.make_unimpaired_signs(np.zeros((self._num_worlds, len(JOINTS))))
            motion = impaired_motion.make_initial_state(self.people.joint_angles_rad)
            self._signs, self._motion = (
                to_device_of(signs, example_array),
                to_device_of(motion, example_array),
            )
        self._behaviour = BehaviourModel(
            self._populations[0].distribution,
            self._frame.transform_people(self.people),
            self._task.offered_body_part,
            self._posture,
            human_actions=self._actions,
            example_array=example_array,
        )

    def _set_people(self, people: People) -> None:
        self.people = people
        self._device_people = to_device_of(people, self._exemplar)
        self._people_in_frame = self._frame.transform_people(self._device_people)

    def reset_to_fixed_person(self) -> None:
        """Replace the people of all worlds by copies of the fixed person."""
        self._set_people(
            distributions.repeat_person(self.fixed_person or Person(), len(self.people.torso_height_m))
        )

    def reset(self, ids: IntArray, uniforms: FloatArray) -> People:
        """Sample people for worlds ``ids`` (n,). Returns these people.

        ``uniforms`` (n, ``NUM_RANDOM_NUMBERS``) are uniform random numbers.
        """
        bounds = np.cumsum([distributions.NUM_RANDOM_NUMBERS, impairments.NUM_RANDOM_NUMBERS])
        for_bodies, for_impairments, for_behaviour = np.split(uniforms, bounds, axis=1)
        chosen = choose_index(for_behaviour[:, _POPULATION], len(self._populations))
        people = self._sample(self._populations[0], for_bodies, for_impairments, for_behaviour)
        for number, population in enumerate(self._populations[1:], start=1):
            (rows,) = np.nonzero(chosen == number)
            others = self._sample(population, for_bodies[rows], for_impairments[rows], for_behaviour[rows])
            people = replace_task_states(people, others, rows)
        self._set_people(replace_task_states(self.people, people, ids))
        self._behaviour.reset(ids, self._frame.transform_people(people), for_behaviour)
        if self._signs is not None and self._motion is not None:
            self._signs = replace_task_states(self._signs, self._sample_signs(chosen, for_impairments), ids)
            start = impaired_motion.make_initial_state(people.joint_angles_rad)
            self._motion = replace_task_states(self._motion, start, ids)
        self._steps[ids] = 0
        if self.commands is not None:
            self.commands.reset(ids, for_behaviour)
        if self.trained_humans is not None:
            self.trained_humans.reset(ids, chosen, for_behaviour[:, _EXPLORATION])
        return people

    def _sample(
        self,
        population: Population,
        for_bodies: FloatArray,
        for_impairments: FloatArray,
        for_behaviour: FloatArray,
    ) -> People:
        """Returns n people of a population, sampled from uniform random numbers."""
        distribution, heights_m = population.distribution, self._settings.torso_height_m
        if heights_m is not None:
            distribution = replace(
                distribution,
                torso_height_man_m=heights_m,
                torso_height_woman_m=heights_m,
                has_anthropometric_bodies=False,
            )
        if self.fixed_person is not None:
            people = distributions.repeat_person(self.fixed_person, len(for_bodies))
        else:
            people = distributions.sample_people(
                distribution, self._pose(population), self._posture, self._furniture, for_bodies
            )
        if distribution.partners is not None:
            people = partners.apply_partner_bodies(people, distribution.partners.sample(for_behaviour[:, :2]))
        if self.fixed_person is None:
            people = self._frame.transform_people(people)
        people = impairments.apply_impairment(people, population.impairment, for_impairments)
        share = self._settings.range_share
        return people if share == 1.0 else impairments.limit_joint_ranges(people, share * people.range_share)

    def _sample_signs(self, chosen: IntArray, for_impairments: FloatArray) -> MotorSigns:
        """Returns sampled motor signs of n people. ``chosen`` (n,) are the indices of their populations."""
        signs = impaired_motion.make_unimpaired_signs(for_impairments[:, 1:])
        for number, population in enumerate(self._populations):
            if impairments.is_clinical_impairment(population.impairment):
                (rows,) = np.nonzero(chosen == number)
                signs = replace_task_states(
                    signs, sample_motor_signs(population.impairment, for_impairments[rows]), rows
                )
        return signs

    def _pose(self, population: Population) -> PoseDistribution:
        return population.distribution.get_pose_distribution(self._task.name, self._task.pose_distribution)

    def command_joint_targets(self, action: FloatArray) -> None:
        """Move the people's joint targets by actions (N, K), see ``Episodes.command_people``."""
        joints = cooperation.OFFERED_JOINTS[self._task.offered_body_part]
        self._behaviour.move_joint_targets(joints, action, self._limit)

    def step(self, observe: Callable[[], State]) -> tuple[FloatArray, BoolArray | None]:
        """Returns joint targets (N, 20) for the end of the next 0.1 s, and the mask (N,) of worlds with new targets.

        If the mask is ``None``, the targets of all worlds are new. Call this method in every control step, or every 0.1
        s if control steps are longer. With ``moves_every_physics_step``, call ``advance_joint_targets`` instead.
        """
        world_mask = self._due(self._steps_per_target)
        self._steps += 1
        targets = self._behaviour.step(
            self._observing(observe), self._people_in_frame, self._limit_in_frame, world_mask
        )
        return self._impaired(
            self._frame.transform_joint_angles(targets), CONTROL_STEP_S, world_mask
        ), world_mask

    def advance_joint_targets(self, observe: Callable[[], State], count: int) -> FloatArray:
        """Returns the joint targets (``count``, N, 20) for the ends of the next ``count`` physics steps.

        ``count`` divides ``DEFAULT_SUBSTEPS``. The sum of all previous counts is a multiple of ``count``.
        """
        world_mask = self._due(DEFAULT_SUBSTEPS)
        if world_mask is None or world_mask.any():
            self._behaviour.choose_goal_angles(self._observing(observe), self._limit_in_frame, world_mask)
        self._steps += count
        targets = self._frame.transform_joint_angles(
            self._behaviour.advance_joint_targets(self._limit_in_frame, count)
        )
        if self._signs is None:
            return targets
        return get_namespace(targets).stack([self._impaired(each, PHYSICS_STEP_S) for each in targets])

    def _due(self, every: int) -> BoolArray | None:
        """Returns the mask (N,) of worlds in which people observe and choose goals now; ``None``: all worlds."""
        due = self._steps % every == 0
        return None if due.all() else due

    def _impaired(
        self, targets_rad: FloatArray, step_s: float, world_mask: BoolArray | None = None
    ) -> FloatArray:
        """Returns the joint targets (N, 20) that people with impairments execute after ``step_s``.

        ``world_mask`` (N,): worlds whose motion is advanced; ``None``: all worlds.
        """
        if self._signs is None or self._motion is None:
            return targets_rad
        motion, executed = impaired_motion.step_impaired_motion(
            self._signs, self._motion, targets_rad, self._device_people.joint_angles_rad, step_s
        )
        if world_mask is None:
            self._motion = motion
        else:
            rows = np.nonzero(world_mask)[0]
            taken = ImpairedMotionState(**{name: array[rows] for name, array in vars(motion).items()})
            self._motion = replace_task_states(self._motion, taken, rows)
        return self._limit(executed)

    def _observing(self, observe: Callable[[], State]) -> Callable[[], State]:
        """Returns a function like ``observe``, with the result converted to the task's frame."""
        return lambda: transform_state(observe(), self._frame, self._mirror_axis)

    def _limit_in_frame(self, joint_angles_rad: FloatArray) -> FloatArray:
        return clip_joint_angles(self._people_in_frame, joint_angles_rad)

    def _limit(self, joint_angles_rad: FloatArray) -> FloatArray:
        return clip_joint_angles(self._device_people, joint_angles_rad)

    def snapshot(self) -> dict[str, Any]:
        """Returns the state of the people on which the next steps depend."""
        return {
            "people": self.people,
            "behaviour": self._behaviour.snapshot(),
            "trained": None if self.trained_humans is None else self.trained_humans.snapshot(),
            "steps": self._steps.copy(),
            "commands": None if self.commands is None else self.commands.snapshot(),
            "impaired": (self._signs, self._motion),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state of the people from the result of ``snapshot``."""
        self._set_people(snapshot["people"])
        self._behaviour.restore(snapshot["behaviour"])
        self._steps = snapshot["steps"].copy()
        if self.commands is not None:
            self.commands.restore(snapshot["commands"])
        self._signs, self._motion = snapshot["impaired"]
        if self.trained_humans is not None:
            self.trained_humans.restore(snapshot["trained"])


def clip_joint_angles(people: People, joint_angles_rad: FloatArray) -> FloatArray:
    """Returns joint angles (..., N, 20), clipped to the joint ranges and shoulder limits of these people."""
    return shoulder_limits.clip_shoulders(impairments.clip_to_joint_ranges(people, joint_angles_rad))
