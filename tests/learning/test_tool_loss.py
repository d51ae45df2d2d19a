import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

from avrgym.geometry import kinematics, transforms
from avrgym.learning.normaliser import make_observation_description
from avrgym.learning.rollouts import Rollout, RolloutRequest, WorldSettings, roll_out
from avrgym.learning.tool_loss import (
    ACTION_ERROR_WEIGHT,
    HALF_WEIGHT_TOOL_MOTION,
    LOSS_ROTATION_UNIT_RAD,
    LOSS_TRANSLATION_UNIT_M,
    ToolMotionModel,
    compute_tool_motion_loss,
)
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks import placement
from avrgym.tasks.registry import ENVIRONMENTS, find_task_and_scene

pytestmark = pytest.mark.usefixtures("one_thread")

ENVIRONMENT = "avrgym/DrinkingJaco-v1"


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_tool_motion_predicts_the_motion_of_actions(environment):
    (_, scene), random = find_task_and_scene(environment), np.random.default_rng(1)
    chain = placement.make_arm_chain(scene)
    joints = len(scene.arm.joints)
    joint_positions = scene.arm.seed_pose + random.uniform(-0.5, 0.5, (40, 3, joints))
    actions = random.uniform(-0.01, 0.01, (40, 3, joints))
    predicted = (
        ToolMotionModel(scene)
        .compute_scaled_jacobian(joint_positions.astype(np.float32))
        .numpy()[..., :joints]
        @ actions[..., None]
    )
    step = actions * scene.arm.speed_limit * CONTROL_STEP_S
    before, after = (
        kinematics.forward_kinematics(chain, rows.reshape(-1, joints))
        for rows in (joint_positions, joint_positions + step)
    )
    turn = transforms.to_rotation_vector(transforms.multiply(after[1], transforms.conjugate(before[1])))
    moved = np.concatenate(
        [(after[0] - before[0]) / LOSS_TRANSLATION_UNIT_M, turn / LOSS_ROTATION_UNIT_RAD], axis=-1
    )
    assert np.abs(moved).max() > 0.005
    assert_allclose(predicted.reshape(-1, 6), moved, atol=5e-5)


def test_the_loss_weights_errors_by_the_motion_of_the_tool():
    _, scene = find_task_and_scene(ENVIRONMENT)
    motion = ToolMotionModel(scene).compute_scaled_jacobian(np.asarray(scene.arm.seed_pose, np.float32))
    joints = len(scene.arm.joints)
    wanted = torch.zeros(joints)
    assert compute_tool_motion_loss(wanted, wanted, motion) == 0.0
    *_, axes = np.linalg.svd(motion.numpy().astype(float))
    most, nothing = (torch.as_tensor(axes[row], dtype=torch.float32) for row in (0, joints - 1))
    costs = [
        float(compute_tool_motion_loss(wanted + wrong, wanted, motion))
        for wrong in (nothing, most, 2.0 * most)
    ]
    assert_allclose(costs[0], ACTION_ERROR_WEIGHT / joints, rtol=1e-3)
    assert costs[1] > 10.0 * costs[0]
    assert_allclose(costs[2], 4.0 * costs[1], rtol=1e-4)


def test_the_loss_of_an_error_falls_with_the_demonstrated_motion():
    _, scene = find_task_and_scene(ENVIRONMENT)
    motion = ToolMotionModel(scene).compute_scaled_jacobian(np.asarray(scene.arm.seed_pose, np.float32))
    wanted = torch.linspace(-0.5, 0.5, len(scene.arm.joints))
    wrong = torch.full_like(wanted, 0.01)
    length = float((motion @ wanted).square().sum().sqrt())
    meant = [times * HALF_WEIGHT_TOOL_MOTION / length * wanted for times in (0.0, 1.0, 10.0)]
    is_at_rest, slow, fast = (float(compute_tool_motion_loss(each + wrong, each, motion)) for each in meant)
    assert_allclose([slow / is_at_rest, fast / is_at_rest], [1 / 2, 1 / 101], rtol=1e-4)


def test_a_rollout_contains_arm_angles_with_an_expert():
    policy = Policy.load(find_packaged_policies(ENVIRONMENT)["adaptive"])
    place = WorldSettings(
        ENVIRONMENT, TransferredFile.read("zoo/train"), "none", 1, "threads", episode_steps=5
    )
    parts = [
        roll_out(
            policy,
            RolloutRequest(
                place, first, np.arange(first, first + 2), expert_controlled_mask=np.array([True, False])
            ),
        )
        for first in (0, 2)
    ]
    joined = Rollout.concatenate(parts)
    entries = make_observation_description(ENVIRONMENT)
    names = [entry.name for entry in entries.entries]
    end = int(entries.entry_end_indices[names.index("arm_angles_rad")])
    joints = entries.entries[names.index("arm_angles_rad")].size
    assert joined.joint_positions is not None
    assert_allclose(joined.joint_positions, joined.observations[:-1, :, end - joints : end], atol=1e-6)
    assert joined.nbytes == sum(part.nbytes for part in parts)
    alone = roll_out(policy, RolloutRequest(place, 0, np.arange(2)))
    assert alone.joint_positions is None
