from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.human import People, Person
from avrgym.models.scene import build_robot_with_tool_spec
from avrgym.models.scratcher import FINGERTIPS_TO_TIP_DISTANCE_M, SCRATCHER
from avrgym.people import distributions
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.registry import ROBOTS
from avrgym.simulation.worlds import State
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.person import RIGHT_ARM_LIMBS
from avrgym.tasks.registry import TASKS
from avrgym.tasks.scratch_itch.reward import ITCH_ANGLE_RANGE_RAD, ITCH_POSITION_RANGE, ScratchItchState
from avrgym.tasks.task import StepResult
from helpers.simulation.worlds import resting_state

SCRATCHING = TASKS["ScratchItch"]
LEFT, _, UP = np.eye(3)
SHOULDER, ELBOW, WRIST = np.array([[-0.2, 0.0, 1.1], [-0.35, 0.0, 0.85], [-0.35, -0.25, 0.85]])
TURNED = transforms.from_axis_angle(LEFT, np.radians(-90.0))
"""The forearm's, whose axis −z then points forwards."""
ITCH = np.array([-0.03, 0.0, -0.12])
ITCH_W = ELBOW + np.array([-0.03, -0.12, 0.0])
STILL = np.zeros((1, 7))


def state(touch: dict[tuple[float, float, float], float] | None = None, **changes: np.ndarray) -> State:
    """One world at rest; the tool touches at places, metres from the itch in the world, with forces, newtons."""
    pos, force = np.zeros((1, 6, 3)), np.zeros((1, 6))
    for slot, (place, newtons) in enumerate((touch or {}).items()):
        pos[0, slot], force[0, slot] = ITCH_W + place, newtons
    identity = transforms.IDENTITY_QUATERNION
    given = {
        "robot_torso_pos_w": np.array([[-0.35, -0.3, 0.36]]),
        "tool_pos_w": ITCH_W[None] - 0.3 * LEFT,
        "right_arm_pos_w": np.array([[SHOULDER, ELBOW, WRIST]]),
        "right_arm_quat_w": np.array([[identity, TURNED, TURNED]]),
        "tool_force_n": force.sum(axis=-1),
        "total_force_n": force.sum(axis=-1),
        "tool_contact_pos_w": pos,
        "tool_contact_force_n": force,
    }
    return resting_state(**given | changes)


def itching(scratches: int = 0, last: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ScratchItchState:
    """An itch on the outside of the forearm, scratched last at a place, metres from it in the limb's frame."""
    last_scratch = (ITCH + last)[None]
    return ScratchItchState(np.array([1]), ITCH[None], last_scratch, np.array([scratches]))


def evaluated(
    seen: State, task_state: ScratchItchState | None = None, action: np.ndarray = STILL
) -> StepResult:
    return SCRATCHING.evaluate_step(seen, action, task_state or itching())


def term(result: StepResult, name: str) -> float:
    return float(result.reward_terms[name][0])


def scratches(result: StepResult) -> int:
    return int(result.task_state.scratches[0])


# Scratches


def test_the_first_touch_of_the_itch_is_a_scratch():
    result = evaluated(state({(0.0, 0.0, 0.0): 3.0}))
    assert scratches(result) == 1
    assert term(result, "scratch_force_n") == term(result, "force_at_itch_n") == 3.0


def test_no_touch_is_no_scratch():
    assert scratches(evaluated(state())) == 0


@pytest.mark.parametrize(("moved_m", "counted"), [(0.0099, 0), (0.0101, 1)])
def test_a_scratch_is_new_where_the_touch_has_moved_by_a_centimetre(moved_m, counted):
    """The forearm's axis is the world's y."""
    result = evaluated(state({(0.0, moved_m, 0.0): 3.0}), itching(scratches=7))
    assert scratches(result) - 7 == result.num_events[0] == counted
    assert term(result, "scratch_force_n") == 3.0 * counted
    assert term(result, "force_at_itch_n") == 3.0


def test_the_distance_counts_from_the_last_scratch_in_the_limbs_frame():
    first = evaluated(state({(0.0, 0.009, 0.0): 3.0}))
    assert_allclose(first.task_state.last_scratch, [ITCH + 0.009 * UP], atol=1e-12)
    assert scratches(evaluated(state({(0.0, -0.002, 0.0): 3.0}), first.task_state)) == 2
    assert scratches(evaluated(state({(0.0, 0.0, 0.0): 3.0}), first.task_state)) == 1


def test_a_limb_that_moves_under_a_tool_that_goes_along_is_not_scratched():
    before = evaluated(state({(0.0, 0.0, 0.0): 3.0})).task_state
    moved = state({(0.1, 0.0, 0.0): 3.0})
    moved = replace(moved, right_arm_pos_w=moved.right_arm_pos_w + 0.1 * LEFT)
    assert scratches(evaluated(moved, before)) == 1


@pytest.mark.parametrize(("newtons", "counted"), [(9.99, 1), (10.0, 0)])
def test_a_scratch_is_softer_than_ten_newtons(newtons, counted):
    assert scratches(evaluated(state({(0.0, 0.0, 0.0): newtons}))) == counted


@pytest.mark.parametrize(("away_m", "counted"), [(0.0249, 1), (0.0251, 0)])
def test_the_itch_reaches_two_and_a_half_centimetres(away_m, counted):
    result = evaluated(state({(0.0, away_m, 0.0): 3.0}))
    assert scratches(result) == counted
    assert term(result, "force_at_itch_n") == 3.0 * counted


def test_the_touch_is_where_its_forces_are_on_average():
    result = evaluated(state({(0.0, 0.01, 0.0): 3.0, (0.0, -0.01, 0.0): 1.0, (0.0, 0.2, 0.0): 50.0}))
    assert_allclose(result.task_state.last_scratch, [ITCH + 0.005 * UP], atol=1e-12)


def test_twenty_five_scratches_are_a_success_that_lasts():
    assert not evaluated(state({(0.0, 0.0, 0.0): 3.0}), itching(23, last=(0.0, 0.0, 0.02))).success[0]
    last = evaluated(state({(0.0, 0.0, 0.0): 3.0}), itching(24, last=(0.0, 0.0, 0.02)))
    assert last.success[0]
    assert evaluated(state(), last.task_state).success[0]


# The other terms


def test_distance_is_from_tip_to_itch():
    result = evaluated(state())
    assert term(result, "distance_m") == result.distance_m[0] == pytest.approx(0.3)


def test_force_elsewhere_is_all_force_but_that_at_the_itch():
    seen = state({(0.0, 0.0, 0.0): 4.0, (0.1, 0.0, 0.0): 3.0}, total_force_n=np.array([12.0]))
    result = evaluated(seen)
    assert result.force_on_person_n[0] == 12.0
    assert term(result, "force_at_itch_n") == 4.0
    assert term(result, "force_elsewhere_n") == 8.0


@pytest.mark.parametrize(("newtons", "strong"), [(9.9, 0.0), (10.0, 10.0), (25.0, 25.0)])
def test_force_at_the_itch_is_strong_from_ten_newtons(newtons, strong):
    assert term(evaluated(state({(0.0, 0.0, 0.0): newtons})), "strong_force_at_itch_n") == strong


def test_the_weights_are_those_of_the_paper():
    assert SCRATCHING.reward_weights == {
        "distance_m": -1.0,
        "action_squared": -0.01,
        "force_at_itch_n": 0.01,
        "scratch_force_n": 2.0,
        "tool_speed_m_s": -0.25,
        "force_elsewhere_n": -0.01,
        "strong_force_at_itch_n": -0.05,
    }


def test_the_reward_is_the_weighted_sum():
    seen = state(
        {(0.0, 0.0, 0.0): 4.0}, total_force_n=np.array([6.0]), tool_velocity_w=np.array([[0.3, 0.0, 0.4]])
    )
    result = evaluated(seen, action=np.full((1, 7), 0.5))
    expected = -0.3 - 0.01 * 7 * 0.25 + 0.01 * 4 + 2 * 4 - 0.25 * 0.5 - 0.01 * 2
    assert SCRATCHING.compute_reward(result.reward_terms)[0] == pytest.approx(expected)
    assert set(result.reward_terms) == set(SCRATCHING.reward_weights)


# Observation


def test_the_observation_has_the_documented_order():
    tool_q = transforms.normalize([[1.0, 2.0, 3.0, 4.0]])
    seen = state(joint_positions=np.arange(7.0)[None], tool_quat_w=tool_q, tool_force_n=np.array([9.0]))
    torso, tool = seen.robot_torso_pos_w[0], seen.tool_pos_w[0]
    joints = [place - torso for place in (SHOULDER, ELBOW, WRIST)]
    expected = np.concatenate(
        [tool - torso, tool_q[0], tool - ITCH_W, ITCH_W - torso, np.arange(7.0), *joints, [9.0]]
    )
    observation = SCRATCHING.make_observation_spec(SCRATCHING.make_scene(JACO))
    assert_allclose(observation.compute(seen, itching()), expected[None], atol=1e-12)
    assert observation.size == len(expected) == 30
    assert [entry.size for entry in observation.entries] == [3, 4, 3, 3, 7, 3, 3, 3, 1]


def test_the_itch_is_marked_where_it_is_above_skin_and_sleeve():
    assert SCRATCHING.markers is not None
    above = ITCH_W + np.array([-0.008, 0.0, 0.0])
    assert_allclose(SCRATCHING.markers.compute_positions_w(state(), itching()), above[None, None], atol=1e-12)


# The itch


@pytest.fixture(scope="module")
def itches() -> tuple[People, ScratchItchState]:
    uniforms = np.random.default_rng(5).random((4000, SCRATCHING.num_random_numbers))
    who = distributions.repeat_person(Person("man", 0.70), 4000)
    return who, SCRATCHING.make_initial_task_state(who, uniforms)


@pytest.mark.parametrize("limb", range(len(RIGHT_ARM_LIMBS)))
def test_it_itches_on_the_skin_of_either_limb(itches, limb):
    """On its cylinder, between the shares of its length and as far around as documented, evenly."""
    who, task_state = itches
    spots = task_state.itch[task_state.limb == limb]
    assert len(spots) == pytest.approx(2000, abs=150)
    radius, half_length, _ = human.compute_body_layout(who.is_woman, who.torso_height_m).geom_size[
        RIGHT_ARM_LIMBS[limb]
    ][0]
    assert_allclose(np.hypot(spots[:, 0], spots[:, 1]), radius)
    along = -spots[:, 2] / (2.0 * half_length)
    around = np.arctan2(spots[:, 1], -spots[:, 0]) / ITCH_ANGLE_RANGE_RAD[limb]
    for share, (low, high) in ((along, ITCH_POSITION_RANGE), (around, (-1.0, 1.0))):
        assert low <= share.min()
        assert share.max() <= high
        even = low + (high - low) * np.array([0.25, 0.5, 0.75])
        assert_allclose(np.quantile(share, [0.25, 0.5, 0.75]), even, atol=0.08)


# Start


@pytest.fixture(scope="module", params=ROBOTS)
def episodes(request) -> Episodes:
    """Episodes that have begun, with each robot."""
    episodes = Episodes(f"avrgym/ScratchItch{request.param}-v1", 6, people="revised", num_threads=1)
    episodes.reset(np.arange(6), [np.random.default_rng(i) for i in range(6)])
    return episodes


def test_episodes_begin_with_the_hand_beside_the_arm(episodes):
    seen = episodes.simulation.get_state()
    hand = seen.tool_pos_w + transforms.rotate(seen.tool_quat_w, episodes.scene.tool.grip_pos)
    x = -0.55 if episodes.scene.mount.is_on_floor else -0.5
    assert np.abs(hand - [x, 0.0, 0.8]).max() < 0.05 + 0.035
    assert_array_equal(seen.robot_force_n, 0.0)


def test_people_spread_their_right_arm(episodes):
    who = episodes.people
    from_pose = np.degrees(who.joint_angles_rad - human.make_seated_joint_angles(right_shoulder_y=30.0))
    arm = np.array([name.startswith("right_") for name in human.JOINTS])
    assert 5.0 < np.abs(from_pose[:, arm]).max() < 10.0
    assert_array_equal(from_pose[:, ~arm & ~distributions.WAIST_JOINT_MASK], 0.0)


# The scratcher


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("name", ROBOTS)
def test_the_tip_is_five_centimetres_past_the_fingers(name):
    scene = SCRATCHING.make_scene(ROBOTS[name])
    model = build_robot_with_tool_spec(scene, appearance=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tool = data.body("tool")
    farthest = -np.inf
    for geom in np.nonzero(model.geom_group == VISUAL_GROUP)[0].tolist():
        body = model.body(model.geom_bodyid[geom]).name
        if "finger" in body and body.startswith(scene.arm.finger_prefix):
            vertices = corners_m(model, geom)
            points_w = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            farthest = max(farthest, ((points_w - tool.xpos) @ tool.xmat.reshape(3, 3)[:, 0]).max())
    assert -farthest == pytest.approx(FINGERTIPS_TO_TIP_DISTANCE_M, abs=0.002)
    assert SCRATCHER.particles is None


def corners_m(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Vertices (V, 3) of a mesh, or corners (8, 3) of a box, in the geom's frame."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return np.array(list(product((-1, 1), repeat=3))) * model.geom_size[geom]
    mesh = model.mesh(model.geom_dataid[geom])
    return model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]


# By script


@pytest.mark.slow
def test_the_expert_scratches_gently():
    """Most of three people are scratched often enough in an episode."""
    episodes = Episodes("avrgym/ScratchItchJaco-v1", 3, people="revised", num_threads=1)
    observation = episodes.reset(np.arange(3), [np.random.default_rng(i) for i in range(3)])
    act = episodes.task.expert(episodes)
    for _ in range(EPISODE_STEPS):
        step = episodes.step(act(observation))
        assert np.isfinite(step.observation).all()
    assert step.success.sum() >= 2
