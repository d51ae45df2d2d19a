"""Laws of the tool servo: the tool repeats the controller's relative motion, within the speed limits."""

import numpy as np
import pytest

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.policies.cartesian_control import (
    HAND_ANGULAR_SPEED_LIMIT_RAD_S,
    HAND_SPEED_LIMIT_M_S,
    CartesianController,
)
from avrgym.policies.tool_servo import MAX_TARGET_POSITION_ERROR_M, ToolServo
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.episodes import Episodes

ENVIRONMENT = "avrgym/FeedingStretch-v1"
IDENTITY = transforms.IDENTITY_QUATERNION


class Teleoperation:
    """An arm that follows the pose of a controller, tick by tick."""

    def __init__(self, environment: str = ENVIRONMENT, seed: int = 1) -> None:
        self.episodes = Episodes(environment, 1, num_threads=1)
        self.episodes.reset(np.array([0]), [np.random.default_rng(seed)])
        self.hand = CartesianController(self.simulation)
        self.servo = ToolServo(self.simulation, self.hand.arm_chain)
        self.pos_w, self.q_w = np.zeros(3), IDENTITY

    @property
    def simulation(self) -> Simulation:
        return self.episodes.simulation

    @property
    def tool(self) -> FloatArray:
        return self.simulation.get_body_poses(0)[self.simulation.bodies.index(SCENE_TOOL_BODY)].copy()

    def engage(self, scale: float = 1.0) -> None:
        self.servo.store_reference_poses(self.pos_w, self.q_w, scale)

    def act(self, observation: FloatArray) -> FloatArray:
        return self.hand.compute_action(*self.servo.compute_hand_velocity(self.pos_w, self.q_w))[None]

    def update_action(self) -> FloatArray:
        return self.act(np.zeros(0))

    def follow(self, ticks: int, step: FloatArray | None = None, turn: FloatArray | None = None) -> None:
        for _ in range(ticks):
            if step is not None:
                self.pos_w = self.pos_w + step
            if turn is not None:
                self.q_w = transforms.multiply(transforms.from_rotation_vector(turn), self.q_w)
            self.episodes.control_loop.tick(self)


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_the_tool_repeats_the_scaled_motion_of_the_controller(scale: float) -> None:
    arm = Teleoperation()
    before = arm.tool
    arm.engage(scale)
    arm.follow(100, np.array([0.0, -0.0008, 0.0006]), np.array([0.0, 0.0, 0.002]))
    arm.follow(80)
    np.testing.assert_allclose(arm.tool[:3] - before[:3], scale * np.array([0.0, -0.08, 0.06]), atol=3e-3)
    turned = transforms.to_rotation_vector(
        transforms.multiply(arm.tool[3:], transforms.conjugate(before[3:]))
    )
    np.testing.assert_allclose(turned, [0.0, 0.0, 0.2], atol=0.02)


@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", "avrgym/BedBathingPR2-v1"])
def test_the_clutch_never_moves_the_tool(environment: str) -> None:
    """Whatever the controller's pose, its pose at the clutch commands no velocity."""
    arm, rng = Teleoperation(environment), np.random.default_rng(0)
    for scale in (0.25, 1.0):
        arm.pos_w = rng.uniform(-3.0, 3.0, 3)
        arm.q_w = transforms.normalize(rng.standard_normal(4))
        arm.engage(scale)
        np.testing.assert_allclose(arm.servo.compute_hand_velocity(arm.pos_w, arm.q_w), 0.0, atol=1e-9)
        arm.follow(15, rng.uniform(-0.01, 0.01, 3), rng.uniform(-0.02, 0.02, 3))


@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", ENVIRONMENT])
def test_a_fast_controller_meets_the_speed_limits_and_its_excess_is_lost(environment: str) -> None:
    """A jump of a metre: the hand's commanded speed has its limits, and the tool stops after the maximum lead."""
    arm = Teleoperation(environment)
    before = arm.tool
    arm.engage()
    arm.pos_w = np.array([0.0, -1.0, 0.3])
    arm.q_w = transforms.from_rotation_vector(np.array([0.0, 0.0, 2.0]))
    linear, angular = arm.servo.compute_hand_velocity(arm.pos_w, arm.q_w)
    action = arm.hand.compute_action(linear, angular)
    reached = arm.hand.compute_hand_velocity(action)
    assert np.linalg.norm(reached[0]) <= HAND_SPEED_LIMIT_M_S + 1e-9
    assert np.linalg.norm(reached[1]) <= HAND_ANGULAR_SPEED_LIMIT_RAD_S + 1e-9
    arm.follow(100)
    assert np.linalg.norm(arm.tool[:3] - before[:3]) < MAX_TARGET_POSITION_ERROR_M + 0.01
