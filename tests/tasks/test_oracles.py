import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.simulation.worlds import MAX_SERVO_LEAD_RAD
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.motion_planner import COLLISION_COST_S, MotionPlanner
from avrgym.tasks.feeding.expert import FeedingExpert

COUNT = 4
STILL = np.zeros((COUNT, 7))


def reset_episodes(count: int = COUNT, robot: str = "Jaco", first: int = 0) -> Episodes:
    """Feeding episodes with revised people, world i from stream ``first`` + i."""
    episodes = Episodes(f"avrgym/Feeding{robot}-v1", count, people="revised", num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng([5, first + i]) for i in range(count)])
    return episodes


@pytest.fixture(scope="module")
def start() -> Episodes:
    """Episodes that nobody steps."""
    return reset_episodes()


def nearby(
    planner: MotionPlanner, way: tuple[float, float, float], turn_rad: float
) -> tuple[np.ndarray, np.ndarray]:
    """The tool's pose, moved along ``way`` and turned about the vertical."""
    turn = transforms.from_axis_angle([0.0, 0.0, 1.0], np.full(len(planner.tool_quat_w), turn_rad))
    return planner.tool_pos_w + way, transforms.multiply(turn, planner.tool_quat_w)


# The planner


def test_a_planner_starts_at_the_tool(start):
    planner, state = MotionPlanner(start), start.simulation.get_state()
    assert_allclose(planner.tool_pos_w, state.tool_pos_w, atol=1e-9)
    assert_allclose(transforms.angle_between(planner.tool_quat_w, state.tool_quat_w), 0.0, atol=1e-6)


def test_a_tool_follows_a_straight_line():
    """Asked for and done, within 5 mm, where nothing is in the way; it arrives within 2 mm and 1°."""
    episodes = reset_episodes(robot="PR2")
    planner = MotionPlanner(episodes)
    begin = planner.tool_pos_w
    target, q_w = nearby(planner, (-0.04, 0.0, 0.08), 0.2)
    along = transforms.normalize(target - begin)
    for _ in range(45):
        episodes.step(planner.compute_action_to_pose(target, q_w, 0.05, 0.1))
        for pos in (planner.tool_pos_w, episodes.simulation.get_state().tool_pos_w):
            way = pos - begin
            off = way - (way * along).sum(axis=-1, keepdims=True) * along
            assert np.linalg.norm(off, axis=-1).max() < 0.005
    state = episodes.simulation.get_state()
    assert np.linalg.norm(state.tool_pos_w - target, axis=-1).max() < 0.002
    assert np.degrees(transforms.angle_between(state.tool_quat_w, q_w)).max() < 1.0


def test_a_tool_moves_and_turns_no_faster_than_it_may():
    episodes = reset_episodes()
    planner = MotionPlanner(episodes)
    target, q_w = nearby(planner, (0.1, 0.1, 0.0), 1.0)
    for _ in range(10):
        pos, q = planner.tool_pos_w, planner.tool_quat_w
        episodes.step(planner.compute_action_to_pose(target, q_w, 0.05, 0.2))
        assert np.linalg.norm(planner.tool_pos_w - pos, axis=-1).max() <= CONTROL_STEP_S * 0.05 + 1e-4
        assert transforms.angle_between(planner.tool_quat_w, q).max() <= CONTROL_STEP_S * 0.2 + 1e-3


def test_actions_are_shares_of_the_joints_speeds(start):
    """However far and fast it should go."""
    planner = MotionPlanner(start)
    action = planner.compute_action_to_pose(planner.tool_pos_w + 1.0, planner.tool_quat_w, 10.0, 10.0)
    assert np.abs(action).max() <= 1.0 + 1e-12
    far = MotionPlanner(start)
    assert_allclose(
        np.abs(far.compute_action_to_joint_positions(far.joint_positions + np.linspace(-3.0, 3.0, 7))).max(
            axis=-1
        ),
        1.0,
    )


def test_servo_targets_stay_near_a_blocked_arm(start):
    """Nobody steps the world: the arm does not follow."""
    planner = MotionPlanner(start)
    target, q_w = nearby(planner, (0.0, 0.3, 0.0), 0.0)
    for _ in range(20):
        planner.compute_action_to_pose(target, q_w, 0.2, 0.5)
    ahead = np.abs(planner.joint_positions - start.simulation.get_state().joint_positions).max()
    one_step = start.scene.arm.speed_limit.max() * CONTROL_STEP_S
    assert 0.05 < ahead <= MAX_SERVO_LEAD_RAD + one_step + 1e-9


def test_a_swing_arrives_at_its_angles_with_the_tool_level():
    episodes = reset_episodes()
    planner = MotionPlanner(episodes)
    target = planner.joint_positions + np.array([0.3, 0.1, -0.2, 0.2, 0.3, 0.2, 0.4])
    target = planner.solve_inverse_kinematics(
        planner.compute_tool_pose(target)[0], planner.tool_quat_w, target
    )
    for _ in range(40):
        episodes.step(
            planner.compute_action_to_joint_positions(
                planner.plan_joint_space_step(target, 0.3, np.radians(10.0))
            )
        )
        z_w = transforms.rotate(planner.tool_quat_w, [0.0, 0.0, 1.0])
        assert np.degrees(np.arccos(z_w[:, 2])).max() < 11.0
    assert_allclose(episodes.simulation.get_state().joint_positions, target, atol=0.01)


def test_found_angles_have_the_pose(start):
    planner = MotionPlanner(start)
    pos_w, q_w = nearby(planner, (0.05, 0.05, 0.05), -0.3)
    angles, cost = planner.find_joint_positions(pos_w[:, None], q_w[:, None])
    found_pos, found_q = planner.compute_tool_pose(angles[:, 0])
    assert np.isfinite(cost).all()
    assert np.linalg.norm(found_pos - pos_w, axis=-1).max() < 0.003
    assert transforms.angle_between(found_q, q_w).max() < 0.03


def test_nothing_is_found_out_of_reach(start):
    planner = MotionPlanner(start)
    _, cost = planner.find_joint_positions(
        planner.tool_pos_w[:, None] + [0.0, 0.0, 2.0], planner.tool_quat_w[:, None]
    )
    assert np.isinf(cost).all()


def test_it_costs_to_reach_through_the_table(start):
    """A hand in the air is free; with the spoon in the table's top it is not."""
    planner = MotionPlanner(start)
    in_table = np.tile([0.0, -0.70, 0.735], (COUNT, 1))
    poses = np.stack([nearby(planner, (0.0, 0.1, 0.0), 0.0)[0], in_table], axis=1)
    _, cost = planner.find_joint_positions(
        poses, np.stack([planner.tool_quat_w, planner.tool_quat_w], axis=1)
    )
    assert (cost[:, 0] < 5.0).all()
    assert (cost[:, 1] > COLLISION_COST_S).all()


def test_planning_does_not_depend_on_other_worlds(start):
    together, alone = MotionPlanner(start), MotionPlanner(reset_episodes(1, first=2))
    target, q_w = nearby(together, (0.1, 0.2, 0.0), 0.5)
    only = slice(2, 3)
    actions = together.compute_action_to_pose(target, q_w, 0.2, 0.8)
    assert_array_equal(alone.compute_action_to_pose(target[only], q_w[only], 0.2, 0.8), actions[only])
    angles, cost = together.find_joint_positions(target[:, None], q_w[:, None])
    alone_angles, alone_cost = alone.find_joint_positions(target[only, None], q_w[only, None])
    assert_array_equal(alone_angles, angles[only])
    assert_array_equal(alone_cost, cost[only])


# Feeding


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_the_oracle_feeds_people_gently(robot):
    """All of eight; no touch is firmer than ten newtons."""
    episodes = reset_episodes(8, robot)
    act, step = FeedingExpert(episodes), None
    for _ in range(90):
        step = episodes.step(act(episodes.observe()))
        assert step.force_on_person_n.max() < 10.0
    assert step is not None
    assert step.success.all()
