"""A simulated demonstrator: a task's expert through human delay, smoothing and tremor, with a headset's messages."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import robot
from avrgym.models.scene import CONTROL_STEP_S, SCENE_TOOL_BODY
from avrgym.policies.cartesian_control import CartesianController
from avrgym.policies.registry import ActionFunction
from avrgym.system import random_streams
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TICK_S, Steer, XRPose
from avrgym.vr.protocol.webxr import Pose, Registration

REACH_M = 0.35
"""Maximum distance of the hand from its comfortable position. Beyond it, the demonstrator opens the clutch and moves
the hand back."""
RETURN_S = 0.5
"""Duration of this motion back, with an open clutch."""


@dataclass(frozen=True)
class DemonstratorTraits:
    """Motor behaviour of a simulated demonstrator.

    Attributes:
        delay_s: visuomotor delay. Adults react to visual changes of a target within 0.15 to 0.25 s.
        smoothing_s: time constant of the hand's speed.
        tremor_m: standard deviation of the hand's position noise.
        tremor_rad: standard deviation of the hand's rotation noise.
        speed_noise: standard deviation of the noise of the hand's speed, as a share of the speed.
        scale: translation of the tool divided by the translation of the hand.
    """

    delay_s: float = 0.2
    smoothing_s: float = 0.15
    tremor_m: float = 0.001
    tremor_rad: float = 0.005
    speed_noise: float = 0.15
    scale: float = 1.0


class SimulatedDemonstrator:
    """Moves a controller like a person who follows the expert. The room's position and direction are random."""

    def __init__(self, seed: int, traits: DemonstratorTraits | None = None) -> None:
        """Creates a demonstrator. Without ``traits``, the default values are used."""
        self.traits = traits or DemonstratorTraits()
        self._random = random_streams.demonstrator_generator(seed)
        floor_w = np.array([*self._random.uniform(-1.0, 1.0, 2), 0.0])
        self._room = Registration(floor_w, float(self._random.uniform(-np.pi, np.pi)))
        self._view = self._room.xr_from_world()
        self._rest_w = floor_w + np.array([0.0, 0.0, 1.1])

    def begin(self, world: LiveWorld) -> None:
        """Begin an episode in a world. The clutch is open."""
        simulation = world.simulation
        self._expert: ActionFunction = world.expert()
        self._hand = CartesianController(simulation)
        names = simulation.bodies
        self._bodies = [
            names.index(SCENE_TOOL_BODY),
            names.index(robot.PREFIX + simulation.scene.arm.end_effector),
        ]
        self._pos_w, self._q_w = self._rest_w, transforms.IDENTITY_QUATERNION
        self._speed, self._wanted, self._noise = np.zeros(6), np.zeros(6), np.zeros(6)
        self._intended: deque[tuple[float, FloatArray]] = deque()
        self._acts_at_s, self._closes_at_s = -np.inf, 0.0

    def steer(self, world: LiveWorld, now_s: float) -> Steer:
        """Returns the message of the XR frame at this time. Call it once per tick, after ``begin``."""
        traits, random = self.traits, self._random
        if now_s >= self._acts_at_s:
            self._acts_at_s = now_s + CONTROL_STEP_S
            self._intended.append((now_s + traits.delay_s, self._expert_speed(world)))
        while self._intended and self._intended[0][0] <= now_s:
            noise = 1.0 + traits.speed_noise * random.standard_normal(6)
            self._wanted = self._intended.popleft()[1] * noise
        share = TICK_S / traits.smoothing_s
        self._speed = self._speed + share * (self._wanted - self._speed)
        tremor = np.repeat([traits.tremor_m, traits.tremor_rad], 3) * random.standard_normal(6)
        self._noise = self._noise + share * (tremor / np.sqrt(share / 2.0) - self._noise)
        clutch = now_s >= self._closes_at_s
        if clutch:
            self._pos_w = self._pos_w + TICK_S * self._speed[:3] / traits.scale
            turn = transforms.from_rotation_vector(TICK_S * self._speed[3:])
            self._q_w = transforms.normalize(transforms.multiply(turn, self._q_w))
        else:
            self._pos_w = self._pos_w + share * (self._rest_w - self._pos_w)
        if clutch and np.linalg.norm(self._pos_w - self._rest_w) > REACH_M:
            self._closes_at_s = now_s + RETURN_S
        return Steer(clutch, self._grip(), self._view, traits.scale)

    def _grip(self) -> XRPose:
        shaken = transforms.multiply(transforms.from_rotation_vector(self._noise[3:]), self._q_w)
        return self._room.from_world(Pose(self._pos_w + self._noise[:3], shaken))

    def _expert_speed(self, world: LiveWorld) -> FloatArray:
        """Returns the linear and angular velocity (6,) of the tool with the expert's action; world frame."""
        linear, angular = self._hand.velocity(self._expert(world.observe())[0])
        tool, hand = world.simulation.body_poses(0)[self._bodies]
        lever = np.asarray(np.cross(angular, tool[:3] - hand[:3]), float)
        return np.concatenate([linear + lever, angular])
