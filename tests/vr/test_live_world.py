"""Laws of the live world: every environment can be used, and the person follows the participant."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import Person, Posture
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from avrgym.vr.live_world.drivers import make_driver
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking.body import BodyPose
from helpers.vr.visit import constant_policy

SETTLED_TICKS = 100


def pose_of(person: Person, posture: Posture, angles_rad: np.ndarray) -> BodyPose:
    """Where head and hands of a person with joint angles (20,) are."""
    model = human.compile_person_model(person, posture, moving=True)
    data = mujoco.MjData(model)
    data.qpos[:] = angles_rad
    mujoco.mj_kinematics(model, data)
    head, left, right = (
        Pose(
            data.site(human.PERSON_NAME_PREFIX + site).xpos.copy(),
            transforms.normalize(data.body(human.PERSON_NAME_PREFIX + body).xquat),
        )
        for site, body in (
            ("head_centre", "head"),
            ("left_hand_centre", "left_hand"),
            ("right_hand_centre", "right_hand"),
        )
    )
    return BodyPose(head, left, right)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(4)
def test_a_persons_head_and_hands_come_to_the_participants(environment: str) -> None:
    """Sitting or lying, from the task's rest: a nod, a lean and both arms, in the simulated physics.

    A limp right arm is exempt: its joints are too weak to follow the tracked hand, and the robot must move it.
    """
    task, _ = ENVIRONMENTS[environment]
    rest_rad = TASKS[task].pose_distribution.rest_angles_rad
    person = Person("woman", 0.56, rest_rad)
    world = LiveWorld(environment, person)
    lifted = human.make_seated_joint_angles(waist_x=4, head_x=10, right_shoulder_y=15, left_shoulder_y=-15)
    wanted = pose_of(person, world.scene_config.posture, lifted)
    for _ in range(SETTLED_TICKS):
        world.follow_pose(wanted)
        world.tick(None)
    reached = pose_of(person, world.scene_config.posture, world.simulation.get_person_joint_angles_rad()[0])
    followed = [(reached.head_pose, wanted.head_pose), (reached.left, wanted.left)]
    if TASKS[task].strength_share is None:
        followed.append((reached.right, wanted.right))
    for there, here in followed:
        assert there is not None
        assert here is not None
        assert np.linalg.norm(there.pos_w - here.pos_w) < 0.01
        assert np.degrees(transforms.angle_between(there.q_w, here.q_w)) < 5.0


def test_a_lost_hand_keeps_its_pose() -> None:
    world = LiveWorld("avrgym/ScratchItchJaco-v1", Person())
    raised = pose_of(
        world.person, world.scene_config.posture, human.make_seated_joint_angles(right_shoulder_x=-40)
    )
    for _ in range(SETTLED_TICKS):
        world.follow_pose(raised)
    before = world.joint_targets_rad
    world.follow_pose(BodyPose(raised.head_pose, raised.left, None))
    right = [i for i, name in enumerate(human.JOINTS) if name.startswith("right_")]
    np.testing.assert_array_equal(world.joint_targets_rad[right], before[right])


def test_a_policys_chance_comes_from_the_seed_of_the_trial() -> None:
    world = LiveWorld("avrgym/FeedingJaco-v1", Person())
    driver = make_driver(replace(constant_policy(world.environment_id), action_std=0.1), background=False)

    def actions(seed: int) -> list[np.ndarray]:
        world.reset(seed)
        world.prepare_driver(driver)
        steps = (world.tick(driver) for _ in range(30))
        return [step.action for step in steps if step is not None]

    first = actions(5)
    assert len(first) == 3
    assert not np.array_equal(first[0], first[1])
    np.testing.assert_array_equal(actions(5), first)
    assert not np.array_equal(actions(6), first)
