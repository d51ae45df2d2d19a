"""Laws of the arm's inverse kinematics: exact, within ranges, smooth, with a natural elbow position."""

from collections.abc import Iterable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from avrgym.geometry import transforms
from avrgym.models.human import JOINT_INDEX, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, Person
from avrgym.vr.tracking.arm import (
    ARM_JOINTS,
    ArmLengths,
    ArmSolver,
    measure_solve_time_ms,
    solve_comfortable_angles,
)

PERSON = Person("woman", 0.54)
LENGTHS = ArmLengths.from_person(PERSON)
JOINTS = [JOINT_INDEX[f"right_{part}"] for part in ARM_JOINTS]
LOWER, UPPER = LOWER_LIMITS_RAD[JOINTS], UPPER_LIMITS_RAD[JOINTS]
RELAXED = np.radians([8.0, -15.0, 0.0, -90.0, 0.0, 0.0, 0.0])
REACH_M = LENGTHS.upper_arm_m + LENGTHS.forearm_m

Hand = tuple[np.ndarray, np.ndarray]
"""Place (3,) and axes (3, 3) as columns, in the shoulder's frame."""


def upper_arm(angles: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("YXZ", angles[:3]).as_matrix()


def elbow_of(angles: np.ndarray) -> np.ndarray:
    return -LENGTHS.upper_arm_m * upper_arm(angles)[:, 2]


def hand_of(angles: np.ndarray) -> Hand:
    forearm = upper_arm(angles) @ Rotation.from_euler("XZ", angles[3:5]).as_matrix()
    hand = forearm @ Rotation.from_euler("XY", angles[5:]).as_matrix()
    return elbow_of(angles) - LENGTHS.forearm_m * forearm[:, 2] - LENGTHS.wrist_to_hand_length_m * hand[
        :, 2
    ], hand


def error(angles: np.ndarray, hand: Hand) -> tuple[float, float]:
    """Metres and degrees between where the hand is and where it should be."""
    pos, axes = hand_of(angles)
    cosine = 0.5 * (np.trace(hand[1].T @ axes) - 1.0)
    return float(np.linalg.norm(pos - hand[0])), float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def smooth(start: np.ndarray, end: np.ndarray, frames: int) -> Iterable[np.ndarray]:
    """From one array to another with least jerk."""
    for s in np.linspace(0.0, 1.0, frames):
        yield start + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * (end - start)


def solve(solver: ArmSolver, hand: Hand, start_rad: np.ndarray) -> np.ndarray:
    """The angles (7,) of one arm."""
    pos, axes = hand
    return solver.solve(pos[None], axes[None], start_rad[None])[0]


def follow(solver: ArmSolver, hands: Iterable[Hand], angles: np.ndarray) -> list[np.ndarray]:
    """The angles frame by frame."""
    followed = []
    for hand in hands:
        angles = solve(solver, hand, angles)
        followed.append(angles)
    return followed


def hand_at(pos: list[float], fingers: list[float], palm: list[float]) -> Hand:
    """A right hand at a place, its fingers and its palm towards directions."""
    z = -transforms.normalize(fingers)
    x = transforms.normalize(np.array(palm) - (z @ palm) * z)
    return np.array(pos), np.stack([x, np.cross(z, x), z], axis=1)


def brought(solver: ArmSolver, hand: Hand) -> np.ndarray:
    """The angles after the hand came from rest to a pose in a second, and stayed for half of one."""
    start = hand_of(RELAXED)
    turn = Rotation.from_matrix(hand[1] @ start[1].T).as_rotvec()
    way = (
        ((1.0 - s) * start[0] + s * hand[0], Rotation.from_rotvec(s * turn).as_matrix() @ start[1])
        for s in map(float, smooth(np.array(0.0), np.array(1.0), 100))
    )
    return follow(solver, [hand] * 50, follow(solver, way, RELAXED)[-1])[-1]


def test_the_closed_form_brings_the_hand_to_any_pose_of_an_arm(rng: np.random.Generator) -> None:
    for angles in rng.uniform(LOWER, UPPER, (100, 7)):
        hand = hand_of(angles)
        pos, axes = hand
        solved = solve_comfortable_angles(LENGTHS, pos[None], axes[None], rng.uniform(LOWER, UPPER)[None])
        metres, degrees = error(solved[0], hand)
        assert metres < 0.006
        assert degrees < 1.5


def test_a_wrist_may_lie_in_line_with_the_hinge_of_the_elbow() -> None:
    """The hinge of an arm that hangs straight down points sideways, and there the wrist shall go."""
    wrist, axes = np.array([0.4, 0.0, 0.0]), np.eye(3)
    hand = wrist - LENGTHS.wrist_to_hand_length_m * axes[:, 2], axes
    solved = solve_comfortable_angles(LENGTHS, hand[0][None], axes[None], np.zeros((1, 7)))
    metres, degrees = error(solved[0], hand)
    assert metres < 0.006
    assert degrees < 1.5


def test_an_arm_stays_where_its_hand_stays() -> None:
    hand = hand_of(RELAXED)
    angles = follow(ArmSolver(PERSON), [hand] * 300, RELAXED)
    assert np.abs(angles[-1] - angles[-2]).max() < 1e-4
    assert error(angles[-1], hand)[0] < 1e-4


@pytest.mark.slow
def test_hands_come_to_nearly_every_pose_within_the_ranges(rng: np.random.Generator) -> None:
    """Within a second from the relaxed pose, 98 % of poses within 1 cm and 5°, in the full ranges of all joints."""
    solver, reached = ArmSolver(PERSON), []
    for goal in rng.uniform(LOWER, UPPER, (50, 7)):
        way = [hand_of(angles) for angles in (*smooth(RELAXED, goal, 65), *[goal] * 35)]
        metres, degrees = error(follow(solver, way, RELAXED)[-1], way[-1])
        reached.append(metres < 0.01 and degrees < 5.0)
    assert np.mean(reached) >= 0.98


def test_hands_never_stray_in_the_middle_of_the_ranges(rng: np.random.Generator) -> None:
    """Where joints stay in the inner half of their ranges, the hand is followed all the way."""
    solver = ArmSolver(PERSON)
    for goal in RELAXED + 0.5 * (rng.uniform(LOWER, UPPER, (15, 7)) - RELAXED):
        way = [hand_of(angles) for angles in smooth(RELAXED, goal, 100)]
        for hand, angles in zip(way, follow(solver, way, RELAXED), strict=True):
            metres, degrees = error(angles, hand)
            assert metres < 0.01
            assert degrees < 5.0


def test_no_joint_jumps_while_the_arm_stretches_and_bends_again() -> None:
    """Forward, farther than the arm is long, and back, past the direction in which shoulder y and z coincide."""
    solver = ArmSolver(PERSON)
    near, far = [-0.02, -0.25, -0.20], [-0.02, -1.3 * REACH_M, 0.02]
    axes = hand_of(RELAXED)[1]
    way = [*smooth(np.array(near), np.array(far), 120), *smooth(np.array(far), np.array(near), 120)]
    angles = follow(solver, [(pos, axes) for pos in way], brought(solver, (np.array(near), axes)))
    for pos, before, after in zip(way[1:], angles, angles[1:], strict=False):
        assert np.abs(after - before).max() < 0.1
        wrist_m = float(np.linalg.norm(pos + LENGTHS.wrist_to_hand_length_m * axes[:, 2]))
        if wrist_m < REACH_M:
            assert error(after, (pos, axes))[0] < 0.01
        else:
            assert error(after, (pos, axes))[0] < wrist_m - REACH_M + 0.01
    assert np.abs(angles[-1] - angles[0]).max() < 0.3


def test_the_result_depends_only_on_pose_and_start(rng: np.random.Generator) -> None:
    solver, hand = ArmSolver(PERSON), hand_of(rng.uniform(LOWER, UPPER))
    first = solve(solver, hand, RELAXED)
    solve(solver, hand_of(rng.uniform(LOWER, UPPER)), rng.uniform(LOWER, UPPER))
    np.testing.assert_array_equal(solve(solver, hand, RELAXED), first)
    np.testing.assert_array_equal(solve(ArmSolver(PERSON), hand, RELAXED), first)


def test_arms_that_are_solved_together_do_not_mind_each_other(rng: np.random.Generator) -> None:
    starts, solver = rng.uniform(LOWER, UPPER, (4, 7)), ArmSolver(PERSON)
    hands = [hand_of(angles) for angles in rng.uniform(LOWER, UPPER, (4, 7))]
    pos, axes = (np.stack(parts) for parts in zip(*hands, strict=True))
    alone = [solve(solver, hand, start) for hand, start in zip(hands, starts, strict=True)]
    np.testing.assert_allclose(solver.solve(pos, axes, starts), alone, atol=1e-12)


COMMON_POSES = {
    "in the lap": hand_at([0.06, -0.28, -0.19], [0.3, -1.0, -0.1], [0.0, 0.0, -1.0]),
    "on the armrest": hand_at([-0.11, -0.25, -0.19], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]),
    "before the chest": hand_at([0.10, -0.25, 0.01], [1.0, -0.2, 0.2], [0.0, 1.0, 0.0]),
    "at the mouth": hand_at([0.11, -0.20, 0.12], [0.6, 0.1, 0.8], [0.2, 1.0, 0.0]),
    "hanging": hand_at([-0.14, -0.05, -0.36], [0.0, -0.2, -1.0], [1.0, 0.0, 0.0]),
    "stretched forward": hand_at([0.0, -0.50, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", COMMON_POSES)
def test_elbows_hang_down_and_outward_in_common_poses(name: str) -> None:
    """Below the shoulder, not inward of the line from shoulder to wrist, and no joint wound up."""
    hand = COMMON_POSES[name]
    angles = brought(ArmSolver(PERSON), hand)
    elbow, wrist = elbow_of(angles), hand[0] + LENGTHS.wrist_to_hand_length_m * hand[1][:, 2]
    on_line = (elbow @ wrist) / (wrist @ wrist) * wrist
    assert error(angles, hand)[0] < 0.01
    assert elbow[2] < 0.0
    assert elbow[2] <= on_line[2] + 0.05
    assert elbow[0] <= on_line[0] + 0.02
    assert np.abs(np.degrees(angles[[0, 2]])).max() < 60.0


def test_how_long_a_solution_takes_is_told() -> None:
    assert 0.0 < measure_solve_time_ms(calls=5) < 1000.0
