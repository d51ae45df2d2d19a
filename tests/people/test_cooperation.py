from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, SEATED_POSTURE, Person
from avrgym.people import cooperation, distributions, motor_model
from avrgym.people.cooperation import CooperationState
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes

UNHURRIED = np.ones(1), np.zeros((1, 3))
"""Pace and noise."""
HEAD_Z, HEAD_X = JOINT_INDEX["head_z"], JOINT_INDEX["head_x"]
WAIST_X, SHOULDER_Y = JOINT_INDEX["waist_x"], JOINT_INDEX["right_shoulder_y"]


@pytest.fixture(scope="module")
def upright() -> State:
    """One person who sits upright and looks ahead, to −y."""
    episodes = Episodes("avrgym/FeedingJaco-v1", 1, person=Person("man", 0.6), num_threads=1)
    episodes.reset(np.array([0]), [np.random.default_rng(0)])
    return episodes.simulation.get_state()


def mind(uniforms: float = 0.5) -> CooperationState:
    who = distributions.repeat_person(Person("man", 0.6), 1)
    return cooperation.make_initial_state(who, np.full((1, cooperation.NUM_RANDOM_NUMBERS), uniforms))


def with_tool(state: State, offset: list[float]) -> State:
    """The tool at an offset from the mouth, world frame."""
    return replace(state, tool_pos_w=state.mouth_pos_w + offset)


def after(
    state: State,
    steps: int,
    offered: cooperation.OfferedBodyPart = "mouth",
    start: CooperationState | None = None,
) -> CooperationState:
    """The person after some steps of 0.1 s, in each of which the motor model moves the joints."""
    now = start or mind()
    moved = motor_model.make_initial_state(
        distributions.repeat_person(Person("man", 0.6), 1), None, *UNHURRIED
    )
    for _ in range(steps):
        now, goals = cooperation.choose_goal_angles(
            now, moved.goal_angles_rad, state, offered, SEATED_POSTURE
        )
        moved, _ = motor_model.advance_joint_targets_rad(motor_model.set_goal_angles(moved, goals), 10)
        now = replace(now, joint_targets_rad=moved.second_filter_angles_rad)
    return now


def test_no_reaction_before_the_reaction_time(upright):
    aside = with_tool(upright, [0.5, -0.5, 0.0])
    for quickness in (0.0, 0.5, 0.99):
        person = mind(quickness)
        before = after(aside, int(person.reaction_delay_steps[0]), start=person)
        assert_array_equal(before.joint_targets_rad, person.joint_targets_rad)
        later = after(aside, int(person.reaction_delay_steps[0]) + 1, start=person)
        assert not np.array_equal(later.joint_targets_rad, person.joint_targets_rad)
        assert 0.2 <= 0.1 * person.reaction_delay_steps[0] <= 0.4


@pytest.mark.parametrize(("side", "sign"), [(0.4, 1.0), (-0.4, -1.0)])
def test_the_face_turns_to_the_side_of_the_tool(upright, side, sign):
    turned = after(with_tool(upright, [side, -0.4, 0.0]), 20).joint_targets_rad[0]
    assert sign * turned[HEAD_Z] > 0.1
    moved = np.flatnonzero(np.abs(turned - mind().joint_targets_rad[0]) > 1e-9)
    assert set(moved) <= {HEAD_X, HEAD_Z}


def test_a_full_turn_would_look_straight_at_the_tool(upright):
    aside = with_tool(upright, [0.2, -0.5, 0.1])
    whole = replace(mind(), facing_share=np.ones(1))
    angles = after(aside, 30, start=whole).joint_targets_rad
    _, q_w = human.compute_body_frames(distributions.repeat_person(Person("man", 0.6, angles[0]), 1))
    looks = transforms.rotate(q_w["head"], [0.0, -1.0, 0.0])[0]
    to_tool = (aside.tool_pos_w - aside.head_pos_w)[0]
    assert_allclose(looks, to_tool / np.linalg.norm(to_tool), atol=1e-6)


def test_they_lean_to_a_tool_that_is_near_and_in_front(upright):
    leaning = after(with_tool(upright, [0.0, -0.15, 0.0]), 30).joint_targets_rad[0, WAIST_X]
    assert leaning == pytest.approx(cooperation.LEAN_ANGLE_RAD, abs=1e-6)
    assert after(with_tool(upright, [0.0, -0.6, 0.0]), 30).joint_targets_rad[0, WAIST_X] == 0.0
    assert after(with_tool(upright, [0.0, 0.4, 0.0]), 30).joint_targets_rad[0, WAIST_X] == 0.0


def test_the_arm_is_lifted_once_towards_a_tool_that_is_near(upright):
    near = replace(upright, tool_pos_w=upright.right_arm_pos_w[:, 1] + [-0.2, 0.0, 0.0])
    for steps in (30, 60):
        lifted = after(near, steps, "arm").joint_targets_rad[0] - mind().joint_targets_rad[0]
        assert lifted[SHOULDER_Y] == pytest.approx(cooperation.ARM_LIFT_ANGLE_RAD, abs=1e-5)
    far = replace(upright, tool_pos_w=upright.right_arm_pos_w[:, 1] + [-0.8, 0.0, 0.0])
    assert_array_equal(after(far, 30, "arm").joint_targets_rad, mind().joint_targets_rad)


def test_only_participants_move():
    def head_path(distribution: str) -> float:
        episodes = Episodes("avrgym/FeedingJaco-v1", 2, people=distribution, num_threads=1)
        episodes.reset(np.arange(2), [np.random.default_rng(i) for i in range(2)])
        begin = episodes.simulation.get_state().head_pos_w
        for _ in range(20):
            episodes.step(np.zeros((2, 7)))
        return float(np.abs(episodes.simulation.get_state().head_pos_w - begin).max())

    assert head_path("participants") > 0.002
    assert head_path("revised") == 0.0


def test_behaviour_does_not_depend_on_other_worlds(upright, rng):
    uniforms = rng.random((5, cooperation.NUM_RANDOM_NUMBERS))
    who = distributions.repeat_person(Person("man", 0.6), 5)
    together = cooperation.make_initial_state(who, uniforms)
    for i in range(5):
        alone = cooperation.make_initial_state(
            distributions.repeat_person(Person("man", 0.6), 1), uniforms[i : i + 1]
        )
        for name, array in vars(alone).items():
            assert_array_equal(array, getattr(together, name)[i : i + 1])
