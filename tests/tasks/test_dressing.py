"""Dressing: the position of the opening on the arm, and laws of a sleeve on an arm."""

import inspect

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models import human
from avrgym.models.sleeve import RING_COUNT, SLEEVE_CLOTH, VERTICES_PER_RING
from avrgym.robots.registry import ROBOTS
from avrgym.safety.limits import QUASI_STATIC_LIMIT_N
from avrgym.simulation.worlds import State
from avrgym.tasks.dressing.reward import (
    ARM_POINTS,
    DRESSED_SHOULDER_DISTANCE_M,
    FOREARM_GEOM_INDEX,
    HAND_GEOM_INDEX,
    UPPER_ARM_GEOM_INDEX,
    compute_arm_path,
    evaluate_step,
    is_rim_around_axis,
    locate_opening,
    make_initial_task_state,
)
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from helpers.simulation.worlds import resting_state

TASK = TASKS["Dressing"]
COMFORTABLE_N = 10.0
STILL = np.zeros((1, 7))
HAND, WRIST, ELBOW, SHOULDER = (np.array([0.2, y, 1.0]) for y in (-0.65, -0.55, -0.3, 0.0))
RIM = 0.09 * np.stack(
    [(np.cos(a), 0.0, np.sin(a)) for a in np.arange(VERTICES_PER_RING) * 2.0 * np.pi / VERTICES_PER_RING]
)


def state(opening_w: np.ndarray, turn: int = 1) -> State:
    """One world at rest: a straight arm along y, and a flat opening around a centre."""
    segments = np.zeros((1, len(human.GEOMS), 2, 3))
    segments[0, HAND_GEOM_INDEX] = HAND
    segments[0, FOREARM_GEOM_INDEX] = WRIST, ELBOW
    segments[0, UPPER_ARM_GEOM_INDEX] = ELBOW, SHOULDER
    cloth = np.tile(opening_w + RIM[::turn], (RING_COUNT, 1))[None]
    return resting_state(person_capsule_ends_w=segments, cloth_pos_w=cloth, tool_pos_w=opening_w[None])


def dressed_m(opening_w: np.ndarray) -> float:
    seen = state(opening_w)
    opening = locate_opening(seen, compute_arm_path(seen))
    return float(opening.path_distance_m[0]) if opening.is_around_arm[0] else 0.0


@pytest.mark.parametrize("turn", [1, -1])
def test_a_rim_winds_around_what_goes_through_it(turn: int) -> None:
    inside, beside, along = np.zeros((1, 3)), np.array([[0.2, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    rim = RIM[None, ::turn]
    assert is_rim_around_axis(rim, inside, along)[0]
    assert not is_rim_around_axis(rim, beside, along)[0]
    assert not is_rim_around_axis(rim, inside, np.array([[1.0, 0.0, 0.0]]))[0]


@pytest.mark.parametrize("share", [0.1, 0.35, 0.6, 0.95])
def test_the_dressed_length_is_the_way_of_the_opening_from_the_hand(share: float) -> None:
    place = HAND + share * (SHOULDER - HAND)
    assert_allclose(dressed_m(place), share * 0.65, atol=1e-12)
    assert dressed_m(place + np.array([0.15, 0.0, 0.0])) == 0.0, "beside the arm"


def test_nothing_is_dressed_before_the_hand() -> None:
    assert dressed_m(HAND - np.array([0.0, 0.02, 0.0])) == 0.0


def test_each_place_counts_once_and_success_stays() -> None:
    task_state = make_initial_task_state(TASK_PEOPLE, np.zeros((1, TASK.num_random_numbers)))
    events, newly = [], 0.0
    ways = (-0.05, 0.0, 0.11, 0.2, 0.36, 0.65 - DRESSED_SHOULDER_DISTANCE_M + 0.01, 0.2, -0.05)
    for way in ways:
        result = evaluate_step(state(HAND + np.array([0.0, way, 0.0])), STILL, task_state)
        task_state = result.task_state
        events.append(int(result.num_events[0]))
        newly += float(result.reward_terms["newly_dressed_m"][0])
    assert events == [0, 0, 1, 0, 1, 1, 0, 0]
    assert sum(events) == len(ARM_POINTS)
    assert result.success.all()
    assert_allclose(newly, 0.65 - DRESSED_SHOULDER_DISTANCE_M + 0.01)


TASK_PEOPLE = human.People.from_persons(
    [human.Person(joint_angles_rad=TASK.pose_distribution.rest_angles_rad)]
)


# The sleeve


def reset_episodes(robot: str, count: int, people: str = "revised") -> Episodes:
    episodes = Episodes(f"avrgym/Dressing{robot}-v1", count, people=people, num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng([8, world]) for world in range(count)])
    return episodes


def test_a_held_sleeve_hangs_from_its_hoop_at_rest() -> None:
    """It keeps its size, touches nobody, and stops to swing."""
    episodes = reset_episodes("Jaco", 1)
    start = episodes.get_state()
    for _ in range(30):
        step = episodes.step(np.zeros((1, 7)))
    state, before = episodes.get_state(), start.cloth_pos_w[0, :VERTICES_PER_RING]
    held = list(SLEEVE_CLOTH.attached_vertices)
    assert_allclose(state.cloth_pos_w[0, held], before[held], atol=0.01)
    assert state.cloth_pos_w[0, :, 2].mean() < start.cloth_pos_w[0, :, 2].mean() - 0.02
    assert edges_m(state).max() < 1.15 * edges_m(start).max()
    assert step.force_on_person_n[0] < 0.05
    rest = state.cloth_pos_w
    episodes.step(np.zeros((1, 7)))
    assert np.abs(episodes.get_state().cloth_pos_w - rest).max() < 0.005


def edges_m(state: State) -> np.ndarray:
    corners = state.cloth_pos_w[0][SLEEVE_CLOTH.faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("people", ["revised", "participants", "zoo/unseen"])
@pytest.mark.parametrize("robot", [name for name in ROBOTS if f"avrgym/Dressing{name}-v1" in ENVIRONMENTS])
def test_experts_dress_the_whole_arm_gently(robot: str, people: str) -> None:
    """The sleeve is around the arm at the end. Its free end hangs, and part of it can pass through a bent arm.

    Stretch dresses fewer people.
    """
    episodes = reset_episodes(robot, 6, people)
    expert, strongest_n = episodes.task.expert(episodes), np.zeros(6)
    for _ in range(110):
        step = episodes.step(expert(episodes.observe()))
        strongest_n = np.maximum(strongest_n, step.force_on_person_n)
    assert step.success.mean() >= (0.6 if robot == "Stretch" else 0.8)
    assert strongest_n[step.success].max() < COMFORTABLE_N
    assert strongest_n.max() < 0.5 * QUASI_STATIC_LIMIT_N.min()
    state = episodes.get_state()
    *others, free_end = (ring_is_around_arm(state, ring)[step.success] for ring in range(1, RING_COUNT))
    assert np.all(others)
    assert free_end.mean() >= 0.6


def ring_is_around_arm(state: State, ring: int) -> np.ndarray:
    path, rim = (
        compute_arm_path(state),
        state.cloth_pos_w[:, ring * VERTICES_PER_RING : (ring + 1) * VERTICES_PER_RING],
    )
    ahead = ((rim.mean(axis=1)[:, None] - path.section_start_w) * path.section_direction_w).sum(axis=-1)
    inside = np.clip(ahead, 0.0, path.length_m)
    foot = path.section_start_w + inside[..., None] * path.section_direction_w
    row, section = np.arange(len(rim)), np.linalg.norm(rim.mean(axis=1)[:, None] - foot, axis=-1).argmin(-1)
    return is_rim_around_axis(rim, foot[row, section], path.section_direction_w[row, section])


def test_forces_of_the_cloth_are_those_of_all_less_those_of_the_robot() -> None:
    """The expert draws the sleeve over the hand: cloth touches the arm, the robot does not."""
    episodes = reset_episodes("Jaco", 2)
    expert, touched = episodes.task.expert(episodes), 0
    for _ in range(40):
        episodes.step(expert(episodes.observe()))
        seen = episodes.get_state()
        assert (seen.cloth_force_n <= seen.total_force_n + 1e-9).all()
        assert_array_equal(seen.links_force_n, 0.0)
        assert (seen.tool_force_n <= seen.total_force_n + 1e-9).all()
        touched += int((seen.cloth_force_n > 0.05).sum())
    assert touched > 20


# The other side of the person


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_mount_mirrored_twice_is_the_same(robot: str) -> None:
    for mount in ROBOTS[robot].mounts.values():
        if (
            mount.carrier_builder is not None
            and "mirrored" not in inspect.signature(mount.carrier_builder).parameters
        ):
            continue
        once = mount.mirror()
        twice = once.mirror()
        assert once.pos_w[0] * mount.pos_w[0] < 0.0
        assert_allclose(twice.pos_w, mount.pos_w)
        assert_allclose(np.cos(twice.yaw_rad - mount.yaw_rad), 1.0)
        assert twice.base_range == mount.base_range
