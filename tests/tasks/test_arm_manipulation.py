"""Arm manipulation: the success criterion, the limp arm, and the expert."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.furniture.wheelchair import ARMREST_FRONT_Y_M, ARMREST_HALF_WIDTH_M, ARMREST_TOP_HEIGHT_M
from avrgym.simulation.worlds import RightArmPoses
from avrgym.tasks.arm_manipulation import reward
from avrgym.tasks.arm_manipulation.expert import compute_scooper_quat_w
from avrgym.tasks.arm_manipulation.reward import RESTING_FOREARM_HEIGHT_M, RESTING_FOREARM_X_M, SUCCESS_STEPS
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS
from avrgym.tasks.task import compute_joint_strength_fractions

TASK = TASKS["ArmManipulation"]
LENGTH_M = 0.28
OUTER_EDGE_M = RESTING_FOREARM_X_M - ARMREST_HALF_WIDTH_M
TOP_M = ARMREST_TOP_HEIGHT_M + RESTING_FOREARM_HEIGHT_M


def arm(elbow_w, direction_w) -> RightArmPoses:
    """An arm whose forearm points from the elbow in a direction."""
    elbow, way = np.array([elbow_w], float), transforms.normalize(np.array([direction_w], float))
    across = np.array([[1.0, 0.0, 0.0]]) if abs(way[0, 2]) == 1.0 else np.cross(way, [0.0, 0.0, 1.0])
    across = transforms.normalize(across)
    q_w = transforms.from_matrix(np.stack([across, np.cross(-way, across), -way], axis=-1))
    pos_w = np.stack([elbow, elbow, elbow + LENGTH_M * way], axis=1)
    return RightArmPoses(pos_w, np.tile(q_w[:, None], (1, 3, 1)))


def reset_episodes(robot: str, count: int) -> Episodes:
    episodes = Episodes(f"avrgym/ArmManipulation{robot}-v1", count, people="revised", num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng([8, i]) for i in range(count)])
    return episodes


@pytest.mark.parametrize(
    ("elbow_w", "direction_w", "share"),
    [
        ((RESTING_FOREARM_X_M, 0.1, TOP_M), (0.0, -1.0, 0.0), 1.0),
        ((RESTING_FOREARM_X_M, ARMREST_FRONT_Y_M + 0.5 * LENGTH_M, TOP_M), (0.0, -1.0, 0.0), 0.5),
        ((OUTER_EDGE_M - 0.01, 0.0, TOP_M), (0.0, -1.0, 0.0), 0.0),
        ((OUTER_EDGE_M - 0.3 * LENGTH_M, 0.0, TOP_M), (1.0, 0.0, 0.0), 0.7),
        ((RESTING_FOREARM_X_M, 0.0, ARMREST_TOP_HEIGHT_M - 0.01), (0.0, -1.0, 0.0), 0.0),
        ((RESTING_FOREARM_X_M, 0.0, TOP_M), (0.0, 0.0, -1.0), 0.1),
    ],
    ids=["on the armrest", "half in front", "outside", "across the edge", "below", "hanging"],
)
def test_the_part_of_the_forearm_above_the_armrest_counts(elbow_w, direction_w, share):
    assert_allclose(
        reward.compute_forearm_fraction_above_armrest(arm(elbow_w, direction_w)), share, atol=1e-9
    )


@pytest.mark.parametrize("direction_w", [(0.0, -1.0, 0.0), (-0.5, -0.7, -0.5), (0.0, 0.0, -1.0)])
def test_the_scooper_faces_the_forearm_from_below(direction_w):
    lying = arm((RESTING_FOREARM_X_M, 0.0, TOP_M), direction_w)
    up_w = reward.compute_forearm_up_direction_w(lying)
    assert_allclose(up_w @ transforms.normalize(np.array(direction_w)), 0.0, atol=1e-9)
    assert up_w[0, 2] >= -1e-9
    q_w = compute_scooper_quat_w(lying, np.array([1.0, 0.0, 0.0]))
    assert_allclose(transforms.rotate(q_w, [0.0, 0.0, 1.0]), up_w, atol=1e-9)


def test_success_takes_one_second_and_remains():
    episodes = reset_episodes("Jaco", 1)
    lifted, state = arm((RESTING_FOREARM_X_M, 0.1, TOP_M), (0.0, -1.0, 0.0)), episodes.get_state()
    fallen, resting = state, replace(state, **vars(lifted))
    task_state, succeeded = episodes.task_state, []
    for step in [resting] * (SUCCESS_STEPS - 1) + [fallen] + [resting] * SUCCESS_STEPS + [fallen]:
        result = TASK.evaluate_step(step, np.zeros((1, 7)), task_state)
        task_state = result.task_state
        succeeded.append(bool(result.success[0]))
    assert succeeded == [False] * (2 * SUCCESS_STEPS - 1) + [True] * 2


def test_only_the_right_arm_is_limp():
    episodes = reset_episodes("Jaco", 1)
    assert TASK.strength_share is not None
    shares = compute_joint_strength_fractions(TASK.strength_share)
    limp = np.array([name.startswith("right_") for name in human.JOINTS])
    assert (shares[limp] <= 0.03).all()
    assert (shares[~limp] == 1.0).all()
    model = episodes.simulation.batch.get_model(0)
    ranges = [model.actuator(human.PERSON_NAME_PREFIX + name).forcerange[1] for name in human.JOINTS]
    assert_allclose(ranges, shares * human.JOINT_TORQUE_LIMITS_N_M)


@pytest.mark.parametrize("share", [0.0, 1.5, {"right_elbow": 0.1}, {"right_elbow_x": 0.0}])
def test_an_impossible_strength_is_rejected(share):
    with pytest.raises(
        ValueError,
        match=r"task ArmManipulation: the field `strength_share` is .*allowed: None, a number above 0",
    ):
        replace(TASK, strength_share=share)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["Jaco", "PR2", "Panda", "Gen3", "UR5"])
def test_the_expert_lifts_the_arm_gently(robot):
    episodes = reset_episodes(robot, 16)
    acts = episodes.task.expert(episodes)
    steps = [episodes.step(acts(episodes.observe())) for _ in range(EPISODE_STEPS)]
    assert steps[-1].success.mean() >= 0.75
    force_n = np.array([step.force_on_person_n for step in steps])
    assert np.median(force_n[force_n > 0.0]) < 10.0
