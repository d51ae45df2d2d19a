"""A simulated demonstrator: an operator who follows the task's expert and sends the messages of a headset."""

from collections import deque

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import robot
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.policies.cartesian_control import CartesianController
from avrgym.policies.registry import ActionFunction
from avrgym.policies.simulated_operator import TOUCH_DELAY_S, SimulatedOperator
from avrgym.system import random_streams
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TICK_S, ControllerPoseCommand
from avrgym.vr.protocol.webxr import Pose, Registration

MAX_HAND_DISTANCE_M = 0.35
"""Maximum distance in metres of the hand from its comfortable position. Beyond it, the demonstrator opens the clutch
and moves the hand back. The tool follows the hand only while the clutch is closed."""
HAND_RETURN_DURATION_S = 0.5
"""Duration in seconds of this motion back, with an open clutch."""
CONTACT_SPEED_SHARE = 0.5
"""Speed of the tool on the person, divided by that of the expert. Otherwise the delayed force control oscillates."""
OBSERVATION_S = 1.5
"""Time in seconds for which a demonstrator who corrects a policy observes the tool before a decision."""
MIN_INTENDED_PATH_M = 0.02
"""Length in metres of the expert's path during the observation below which the demonstrator does not take over."""
MIN_PROGRESS_SHARE = 0.25
"""The demonstrator takes over if the tool's path is shorter than this share (0 to 1) of the expert's path."""
CORRECTION_DURATION_S = 3.0
"""Time in seconds from a takeover to the release of the robot."""


class SimulatedDemonstrator:
    """Moves a headset's controller like a person who follows the expert. The room's position and direction are random.

    In contact with the person, the demonstrator feels the force: they react earlier, and move more slowly.

    With ``corrects``, a policy drives. If the tool does not move along the expert's path, the demonstrator takes over
    for a short time.
    """

    def __init__(self, seed: int, *, corrects: bool = False) -> None:
        self._corrects = corrects
        self._random = random_streams.make_demonstrator_rng(seed)
        floor_w = np.array([*self._random.uniform(-1.0, 1.0, 2), 0.0])
        self._room = Registration(floor_w, float(self._random.uniform(-np.pi, np.pi)))
        self._view = self._room.xr_from_world()
        self._rest_w = floor_w + np.array([0.0, 0.0, 1.1])

    def begin_episode(self, world: LiveWorld) -> None:
        """Begin an episode in a world. The clutch is open."""
        simulation = world.simulation
        self._expert: ActionFunction = world.make_expert()
        self._hand = CartesianController(simulation)
        self._operator = SimulatedOperator([self._random], 6, world.settings.control_hz)
        names = simulation.bodies
        self._bodies = [
            names.index(SCENE_TOOL_BODY),
            names.index(robot.ROBOT_NAME_PREFIX + simulation.scene.arm.end_effector),
        ]
        self._pos_w, self._q_w = self._rest_w, transforms.IDENTITY_QUATERNION
        self._speed = np.zeros(6)
        self._acts_at_s, self._closes_at_s = -np.inf, 0.0
        self._releases_at_s = -np.inf if self._corrects else np.inf
        self._tool_pos_w = simulation.get_body_poses(0)[self._bodies[0], :3]
        self._observed: deque[tuple[float, float]] = deque()

    def make_controller_message(self, world: LiveWorld, now_s: float) -> ControllerPoseCommand:
        """Returns the message of the XR frame at this time. Call it once per tick, after ``begin_episode``."""
        if now_s >= self._acts_at_s:
            self._acts_at_s = now_s + 1.0 / world.settings.control_hz
            intended = self._expert_speed(world)
            if world.simulation.get_tool_net_force_n()[0] > 0.0:
                self._speed = self._operator.compute_commands(
                    CONTACT_SPEED_SHARE * intended[None], TOUCH_DELAY_S
                )[0]
            else:
                self._speed = self._operator.compute_commands(intended[None])[0]
            if now_s >= self._releases_at_s and self._is_off_path(world, intended[:3]):
                self._releases_at_s = now_s + CORRECTION_DURATION_S
        clutch = self._closes_at_s <= now_s < self._releases_at_s
        if clutch:
            self._pos_w = self._pos_w + TICK_S * self._speed[:3]
            turn = transforms.from_rotation_vector(TICK_S * self._speed[3:])
            self._q_w = transforms.normalize(transforms.multiply(turn, self._q_w))
        elif now_s < self._closes_at_s:
            left_s = max(self._closes_at_s - now_s, TICK_S)
            self._pos_w = self._pos_w + TICK_S / left_s * (self._rest_w - self._pos_w)
        if clutch and np.linalg.norm(self._pos_w - self._rest_w) > MAX_HAND_DISTANCE_M:
            self._closes_at_s = now_s + HAND_RETURN_DURATION_S
        return ControllerPoseCommand(
            clutch, self._room.from_world(Pose(self._pos_w, self._q_w)), self._view, 1.0
        )

    def _expert_speed(self, world: LiveWorld) -> FloatArray:
        """Returns the tool's linear and angular velocity (6,) with the expert's action, in m/s and rad/s in the world
        frame."""
        linear, angular = self._hand.compute_hand_velocity(self._expert(world.observe())[0])
        tool, hand = world.simulation.get_body_poses(0)[self._bodies]
        lever = np.asarray(np.cross(angular, tool[:3] - hand[:3]), float)
        return np.concatenate([linear + lever, angular])

    def _is_off_path(self, world: LiveWorld, intended_m_s: FloatArray) -> bool:
        """Returns whether the tool has not moved along the expert's path for ``OBSERVATION_S``."""
        pos_w = world.simulation.get_body_poses(0)[self._bodies[0], :3]
        way, self._tool_pos_w = pos_w - self._tool_pos_w, pos_w
        step_m = float(np.linalg.norm(intended_m_s)) / world.settings.control_hz
        direction = intended_m_s / max(float(np.linalg.norm(intended_m_s)), 1e-9)
        self._observed.append((step_m, float(way @ direction)))
        if len(self._observed) < OBSERVATION_S * world.settings.control_hz:
            return False
        intended_m, progress_m = (sum(column) for column in zip(*self._observed, strict=True))
        self._observed.popleft()
        off = intended_m > MIN_INTENDED_PATH_M and progress_m < MIN_PROGRESS_SHARE * intended_m
        if off:
            self._observed.clear()
        return off
