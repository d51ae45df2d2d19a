"""Laws of obstruction: lag is not obstruction, and parts without obstruction are at their tracked poses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_live_world import pose_of

from avrgym.geometry import transforms
from avrgym.models import human, robot
from avrgym.models.human import Person
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.vr.live_world.drivers import Driver, OperatorDriver
from avrgym.vr.live_world.obstruction import OBSTRUCTION_START_DISPLACEMENT_M, ObstructionMonitor
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TICK_S, VelocityCommand, WorldState
from avrgym.vr.tracking.body import RELAXED_JOINT_ANGLES_RAD, BodyPose
from avrgym.vr.tracking.jumps import TRACKED_BODY_PARTS
from helpers.vr.visit import ENVIRONMENT, Visit, plan

NEAR_M = 0.01


class Sitting:
    """Somebody in a world whose robot stands still, and who moves their right hand."""

    def __init__(self) -> None:
        person = Person("woman", 0.54, RELAXED_JOINT_ANGLES_RAD)
        self.world = LiveWorld(ENVIRONMENT, person)
        self.obstruction = ObstructionMonitor(self.world.simulation, self.world.skeleton)
        self.rest = pose_of(person, self.world.scene_config.posture, RELAXED_JOINT_ANGLES_RAD)
        assert self.rest.left is not None
        assert self.rest.right is not None
        self.start_w = self.rest.right.pos_w

    def reach(self, hand_w: np.ndarray, driver: Driver | None = None) -> tuple[str, ...]:
        """Go on for a tick towards a place of the right hand's centre; what is held back."""
        assert self.rest.right is not None
        pose = BodyPose(self.rest.head_pose, self.rest.left, replace(self.rest.right, pos_w=hand_w))
        self.world.follow_pose(pose)
        self.world.tick(driver)
        return self.obstruction.detect_obstructed_parts()

    def hand_w(self, side: str = "right") -> np.ndarray:
        """Where the centre of a simulated hand is."""
        pose = self._pose(f"{human.PERSON_NAME_PREFIX}{side}_hand")
        return pose[:3] - transforms.rotate(pose[3:], [0.0, 0.0, self.world.skeleton.hand_m])

    def tool_w(self) -> np.ndarray:
        """Where the robot's tool is."""
        return self._pose(SCENE_TOOL_BODY)[:3]

    def robot_w(self) -> np.ndarray:
        """Where the part of the robot is that is nearest to the right hand."""
        parts = [
            self._pose(name)[:3] for name in self.world.bodies if name.startswith(robot.ROBOT_NAME_PREFIX)
        ]
        return min(parts, key=lambda pos_w: float(np.linalg.norm(pos_w - self.hand_w())))

    def _pose(self, body: str) -> np.ndarray:
        return self.world.simulation.get_body_poses(0)[self.world.bodies.index(body)]


@pytest.fixture
def sitting() -> Sitting:
    return Sitting()


def test_a_hand_that_is_only_late_is_not_held_back(sitting: Sitting) -> None:
    """At up to 1 m/s in free air the simulated hand is more than 3 cm late."""
    late_m = []
    for turn in np.linspace(0.0, 4.0 * np.pi, 200):
        wanted = sitting.start_w + np.array([0.0, 0.08 * (np.cos(turn) - 1.0), 0.16 * np.sin(turn)])
        assert sitting.reach(wanted) == ()
        late_m.append(float(np.linalg.norm(sitting.hand_w() - wanted)))
    assert max(late_m) > 0.03


def test_who_is_not_held_back_is_where_they_are_tracked(sitting: Sitting) -> None:
    """A hand presses ever farther into the robot, comes to rest each time, and lets go."""
    goal = sitting.robot_w()
    held: list[bool] = []
    assert sitting.rest.left is not None
    for share in (*np.linspace(0.0, 1.0, 13), *np.linspace(1.0, 0.0, 4)):
        wanted = sitting.start_w + share * (goal - sitting.start_w)
        for _ in range(50):
            parts = sitting.reach(wanted)
        held.append("right" in parts)
        for side, tracked_w in (("right", wanted), ("left", sitting.rest.left.pos_w)):
            off_m = np.linalg.norm(sitting.hand_w(side) - tracked_w)
            assert side in parts or off_m < NEAR_M, f"{side} hand {off_m:.3f} m off at {share:.2f} of the way"
    assert not held[0]
    assert held[12]
    assert not held[-1]


def test_a_robot_that_pushes_an_arm_holds_it_back(sitting: Sitting) -> None:
    """An operator drives the tool at a hand before it, which stays where it is tracked until it cannot."""
    before_tool_w = sitting.tool_w() + 0.2 * transforms.normalize(sitting.start_w - sitting.tool_w())
    for share in np.linspace(0.0, 1.0, 100):
        sitting.reach(sitting.start_w + share * (before_tool_w - sitting.start_w))
    operator = OperatorDriver()
    sitting.world.prepare_driver(operator)
    held = [sitting.reach(before_tool_w, operator) for _ in range(50)]
    for tick in range(300):
        way_w = sitting.hand_w() - sitting.tool_w()
        left, backward, up = (0.5 * transforms.normalize(way_w)).tolist()
        operator.apply_velocity_command(
            VelocityCommand(True, (-backward, left, up), (0.0, 0.0, 0.0)), tick * TICK_S
        )
        held.append(sitting.reach(before_tool_w, operator))
    assert held[:50] == [()] * 50
    assert "right" in held[-1]
    assert np.linalg.norm(sitting.hand_w() - before_tool_w) > OBSTRUCTION_START_DISPLACEMENT_M


def test_a_body_is_held_back_that_is_not_tracked(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(free_movement_s=5.0))
    visit.tick(20)
    assert visit.received(WorldState)[-1].deviating_parts == list(TRACKED_BODY_PARTS)
    visit.go_to("free_before")
    visit.tick(30)
    state = visit.received(WorldState)[-1]
    assert state.deviating_parts == []
    np.testing.assert_allclose(
        np.frombuffer(state.joint_targets, "<f4"), visit.session.world.joint_targets_rad, atol=1e-6
    )
    visit.tracking = False
    visit.tick(30)
    assert visit.received(WorldState)[-1].deviating_parts == list(TRACKED_BODY_PARTS)
