"""The world of a participant: one scene with a moving person, simulated in ticks of 10 ms."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.commands.preferences import TrialRules
from avrgym.commands.vocabulary import CommandName
from avrgym.models.body_names import Side
from avrgym.models.human import Person
from avrgym.models.scene import DEFAULT_SUBSTEPS, SceneConfig
from avrgym.policies.registry import ActionFunction
from avrgym.safety.force_guard import ForceGuard
from avrgym.safety.pacing import PacingLayer
from avrgym.safety.retreat import Retreat
from avrgym.simulation.worlds import Simulation
from avrgym.system import random_streams
from avrgym.tasks.control_loop import ControlLoop, FirstWorldStep
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import Task
from avrgym.vr.live_world.drivers import Driver, make_zero_action
from avrgym.vr.live_world.scene_message import encode_world_poses, make_scene_message
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.tracking.body import ARM_JOINT_INDICES as ARM_JOINTS
from avrgym.vr.tracking.body import BodyPose, BodySolver, make_skeleton

BRAKING_TICKS = 30
"""Number of ticks for which the brakes stop the robot before its retreat."""
MAX_REST_RETURN_STEP_RAD = 0.01
"""Maximum rotation per tick, in radians, of the joints of an arm that returns to its rest pose (1 rad/s)."""


class LiveWorld:
    """One world with a person that follows the participant's motion, and a robot that a driver commands.

    A driver acts at the control rate, by default 10 Hz. Physics and person are updated at 100 Hz.
    """

    def __init__(self, environment_id: str, person: Person, settings: Settings = DEFAULT_SETTINGS) -> None:
        """Compile the scene for a person.

        Raises:
            ValueError: for an unknown environment (the message lists the allowed ids), or invalid settings.
        """
        self._episodes = Episodes(
            environment_id, 1, person=person, moving=True, num_threads=1, by_region=True, settings=settings
        )
        self._solver = BodySolver(person, self._episodes.scene.posture)
        self._loop = self._episodes.control_loop
        self._zeros = make_zero_action(self._episodes)
        self.person = person
        self.joint_targets_rad = person.joint_angles_rad
        self.ticks = 0
        self.reset(seed=0)

    @property
    def applied_action(self) -> FloatArray | None:
        """The robot's new action (A,) if the action changed at the latest tick, otherwise ``None``."""
        return self._loop.applied_action

    @property
    def is_braked(self) -> bool:
        """Whether the latest action is zero and the brakes are engaged."""
        return self._loop.is_braked

    @property
    def guard(self) -> ForceGuard | None:
        """The force guard of the current episode; ``None`` without a force guard."""
        return self._loop.guard

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies of the scene, in the order of their poses in state messages."""
        return self._episodes.simulation.bodies

    @property
    def simulation(self) -> Simulation:
        """The physics simulation, with this world as its only world."""
        return self._episodes.simulation

    @property
    def environment_id(self) -> str:
        """The environment's id, such as ``avrgym/FeedingJaco-v1``."""
        return self._episodes.environment_id

    @property
    def scene_config(self) -> SceneConfig:
        """Furniture, posture, robot and tool of the scene."""
        return self._episodes.scene

    @property
    def task(self) -> Task:
        """The task of the environment: its goal, reward and success criterion."""
        return self._episodes.task

    @property
    def settings(self) -> Settings:
        """The settings with which the scene was built."""
        return self._episodes.settings

    @property
    def time_s(self) -> float:
        """Simulated time in seconds since the creation of the world. A reset does not change it."""
        return self.ticks * TICK_S

    def reset(self, seed: int) -> None:
        """Reset robot, furniture and food to the initial state of an episode. The person's pose does not change.

        ``seed``: seed of the initial state and of a policy's exploration noise.

        Raises:
            NoClearanceError: if the person obstructs every initial state. It is a ``ValueError``.
        """
        self._loop = self._episodes.control_loop = ControlLoop(self._episodes)
        self._episodes.set_person(replace(self.person, joint_angles_rad=self.joint_targets_rad))
        self._generators = [random_streams.make_episode_rng(seed)]
        self._episodes.reset(np.array([0]), self._generators)
        self.episode_start = self._episodes.get_episode_start(0)
        self._retreat = Retreat(self._episodes.simulation)
        self.stop_robot()

    def follow_pose(self, pose: BodyPose, resting: Collection[Side] = ()) -> None:
        """Command joint targets with which the person's head and hands follow the participant's pose.

        ``resting``: arms that return to their rest pose while their hand has no pose.
        """
        targets = self._solver.solve(pose, self.joint_targets_rad)
        for arm in resting:
            if getattr(pose, arm) is None:
                joints = ARM_JOINTS[arm]
                way = self._episodes.task.pose_distribution.rest_angles_rad[joints] - targets[joints]
                targets[joints] += np.clip(way, -MAX_REST_RETURN_STEP_RAD, MAX_REST_RETURN_STEP_RAD)
        self.joint_targets_rad = targets
        self._episodes.simulation.command_person(self.joint_targets_rad[None])

    def stop_robot(self) -> None:
        """Stop the robot with its brakes. Discards an unfinished control step."""
        self._episodes.simulation.brake_robot()
        self._loop.abort_step()
        self._retreated_ticks: int | None = None

    def start_retreat(self) -> None:
        """Stop the robot, then move its tool away from the person, at most once per episode; see ``safety.retreat``."""
        self.stop_robot()
        self._retreated_ticks = 0

    @property
    def is_retreating(self) -> bool:
        """Whether the robot retreats: it moves its tool away from the person."""
        return self._retreated_ticks is not None

    def prepare_driver(
        self,
        driver: Driver,
        *,
        force_guard: bool = False,
        withdraw_after_success: bool = False,
        rules: TrialRules | None = None,
    ) -> None:
        """Prepare a driver for the current episode, and build the control loop with its safety layers."""
        self._loop = self._episodes.control_loop = ControlLoop(
            self._episodes,
            force_guard=force_guard,
            withdraw_after_success=withdraw_after_success,
            reward_withdrawal=True,
            rules=rules,
        )
        if self._loop.pacing is not None:
            self._loop.pacing.prepare_retreat(0)
        driver.reset(self._episodes, self._generators)

    @property
    def pacing(self) -> PacingLayer | None:
        """The pacing layer, which executes commands to the robot; ``None`` without it."""
        return self._loop.pacing

    def apply_command(self, command: CommandName) -> bool:
        """Applies a command of the participant. Returns whether the command has an effect on the robot."""
        return bool(self._loop.apply_command(command)[0])

    def make_expert(self) -> ActionFunction:
        """Returns an expert for the current episode: a function of observations (1, O) to actions (1, A).

        Training imitates the same expert. Its actions depend only on the current state. A driver may therefore deviate
        from them.
        """
        task = self._episodes.task
        return (task.memory_expert or task.feedback_expert)(self._episodes)

    def observe(self) -> FloatArray:
        """Returns the observation (1, O) of the current state."""
        return self._episodes.observe()

    @property
    def is_withdrawing(self) -> bool:
        """Whether the robot withdraws its tool after success, or waits after the withdrawal."""
        return bool(self._loop.withdrawing_mask[0])

    def tick(self, driver: Driver | None, *, hold: bool = False) -> FirstWorldStep | None:
        """Advances the world by 10 ms. Returns the control step at its last tick, otherwise ``None``.

        ``driver``: a prepared driver that moves the robot. With ``hold``, the brakes hold the robot, also during a
        retreat. Only the force guard can then move it.
        """
        self.ticks += 1
        if self._retreated_ticks is not None:
            self._tick_retreat(self._retreated_ticks, hold=hold)
            return None
        return self._loop.tick(driver, hold=hold)

    def _tick_retreat(self, ticks: int, *, hold: bool) -> None:
        """Commands the robot every 0.1 s until the retreat is complete. ``ticks``: number of ticks since its start."""
        if hold:
            self._loop.advance_with_action(self._zeros if self._loop.is_moving else None, hold=True)
            return
        due = ticks >= BRAKING_TICKS and (ticks - BRAKING_TICKS) % DEFAULT_SUBSTEPS == 0
        action = self._retreat.compute_next_action() if due else None
        self._retreated_ticks = None if due and action is None else ticks + 1
        self._loop.advance_with_action(None if action is None else action[None])

    def integration_state(self) -> FloatArray:
        """Returns MuJoCo's integration state, see ``Simulation.integration_state``."""
        return self._episodes.simulation.get_integration_state()

    @property
    def skeleton(self) -> messages.Skeleton:
        """Dimensions of the person's body in metres, for clients."""
        return make_skeleton(self.person, self._episodes.scene.posture)

    def encode_poses(self) -> bytes:
        """Returns the poses of ``bodies`` and marks, encoded as in ``messages.WorldState``."""
        return encode_world_poses(self._episodes)

    def make_scene_message(self, number: int, registration: Registration) -> messages.Scene:
        """Returns the description of the scene for clients. ``number``: number of the scene in its URL."""
        return make_scene_message(number, self._episodes, registration)
