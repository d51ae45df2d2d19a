"""Other served arms and heights of seat and bed: the same task in a mirrored or raised scene."""

from dataclasses import replace

import numpy as np
import pytest

from avrgym.geometry import kinematics, transforms
from avrgym.learning.evaluation import evaluate
from avrgym.models import human
from avrgym.models.human import BODIES
from avrgym.models.task_frame import X_AXIS_INDEX, TaskFrame, exchange_side_in_name
from avrgym.people.distributions import repeat_person
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, find_task_and_scene
from avrgym.tasks.settings import Settings, make_settings
from avrgym.tasks.task_transform import transform_state

OTHER = {"left": "right", "right": "left"}
SERVED = [each for each, (task, _) in ENVIRONMENTS.items() if TASKS[task].served_arm is not None]
MIRROR = TaskFrame(is_mirrored=True)


def on_other_arm(environment: str) -> Settings:
    """Settings with the arm that the task does not serve by default."""
    return Settings(served_arm=OTHER[TASKS[ENVIRONMENTS[environment][0]].served_arm])  # type: ignore[index,arg-type]


def begun(environment: str, settings: Settings, worlds: int = 2) -> Episodes:
    episodes = Episodes(environment, worlds, people="revised", num_threads=1, settings=settings)
    episodes.reset(np.arange(worlds), [random_streams.make_episode_rng(world) for world in range(worlds)])
    return episodes


def test_a_mirrored_person_has_mirrored_bodies() -> None:
    angles = np.random.default_rng(0).uniform(0.5 * human.LOWER_LIMITS_RAD, 0.5 * human.UPPER_LIMITS_RAD)
    people = repeat_person(human.Person(joint_angles_rad=angles), 1)
    mirrored = MIRROR.transform_people(people)
    pos_w, q_w = human.compute_body_frames(people)
    other_pos_w, other_q_w = human.compute_body_frames(mirrored)
    for body in BODIES:
        np.testing.assert_allclose(
            other_pos_w[exchange_side_in_name(body)], MIRROR.transform_points(pos_w[body]), atol=1e-12
        )
        there = MIRROR.transform_rotations(q_w[body], X_AXIS_INDEX)
        assert transforms.angle_between(other_q_w[exchange_side_in_name(body)], there).max() < 1e-6
    np.testing.assert_array_equal(MIRROR.transform_people(mirrored).joint_angles_rad, angles[None])


@pytest.mark.parametrize("environment", SERVED)
def test_a_mirrored_chain_is_the_mirror_image_of_the_arm(environment: str) -> None:
    _, scene = find_task_and_scene(environment, on_other_arm(environment))
    real, mirrored = placement.make_arm_chain(scene), placement.make_arm_chain(scene.scene_in_task_frame)
    positions = scene.arm.seed_pose + np.random.default_rng(0).uniform(-0.1, 0.1, (5, len(scene.arm.joints)))
    (pos, q), (other_pos, other_q) = (
        kinematics.forward_kinematics(chain, positions) for chain in (real, mirrored)
    )
    np.testing.assert_allclose(other_pos, pos * [1.0, -1.0, 1.0], atol=1e-9)
    x, other_x = (transforms.rotate(each, [1.0, 0.0, 0.0]) for each in (q, other_q))
    np.testing.assert_allclose(other_x, x * [1.0, -1.0, 1.0], atol=1e-9)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", SERVED)
def test_the_other_arm_is_served_from_its_side(environment: str) -> None:
    """The person is the mirror image of the default one, and the tool begins on the served arm's side."""
    usual, other = Settings(), on_other_arm(environment)
    default, mirrored = begun(environment, usual), begun(environment, other)
    assert mirrored.task.served_arm == other.served_arm
    assert str(other.served_arm) in mirrored.task.goal_description
    if (default.num_initial_state_samples == mirrored.num_initial_state_samples).all():
        expected = MIRROR.transform_joint_angles(default.people.joint_angles_rad)
        np.testing.assert_array_equal(mirrored.people.joint_angles_rad, expected)
    sides = [np.sign(each.simulation.get_state().tool_pos_w[:, 0]) for each in (default, mirrored)]
    np.testing.assert_array_equal(sides[0], -sides[1])
    first = default.simulation.get_state()
    again = transform_state(transform_state(first, MIRROR, 1), MIRROR, 1)
    np.testing.assert_array_equal(again.person_capsule_ends_w, first.person_capsule_ends_w)
    np.testing.assert_array_equal(again.tool_quat_w, first.tool_quat_w)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(
    ("environment", "name", "value", "rise_m"),
    [
        ("avrgym/BedBathingJaco-v1", "bed_height_m", 0.65, 0.10),
        ("avrgym/ScratchItchJaco-v1", "seat_height_m", 0.535, 0.05),
        ("avrgym/FeedingPR2-v1", "seat_height_m", 0.535, 0.05),
        ("avrgym/ArmManipulationPR2-v1", "seat_height_m", 0.435, -0.05),
    ],
)
def test_the_person_rises_with_the_furniture(
    environment: str, name: str, value: float, rise_m: float
) -> None:
    """Only the person and the things on seat or bed rise; the task sees the person at the usual height."""
    default, raised = begun(environment, Settings()), begun(environment, make_settings({name: value}))
    head_w, raised_w = (each.simulation.get_state().head_pos_w for each in (default, raised))
    if (default.num_initial_state_samples == raised.num_initial_state_samples).all():
        np.testing.assert_allclose(raised_w - head_w, [[0.0, 0.0, rise_m]] * 2, atol=1e-9)
    frame = raised.scene.scene_in_task_frame.task_frame
    seen = transform_state(raised.simulation.get_state(), frame, 1)
    np.testing.assert_allclose(seen.head_pos_w, raised_w - [0.0, 0.0, rise_m], atol=1e-9)
    on_seat = not default.scene.mount.is_on_floor and default.scene.posture.is_seated
    base_m = [each.simulation.get_initial_base_pose()[0][:, 2] for each in (default, raised)]
    np.testing.assert_allclose(base_m[1] - base_m[0], rise_m if on_seat else 0.0, atol=1e-9)


def test_the_torso_follows_the_backrest() -> None:
    scene = begun("avrgym/BedBathingPR2-v1", Settings(backrest_deg=45.0), worlds=1).scene
    posture = scene.posture
    assert posture.hips_deg + posture.thigh_deg == -90.0
    person = replace(repeat_person(human.Person(), 1), joint_angles_rad=np.zeros((1, 20)))
    pos_w, _ = human.compute_body_frames(person, posture)
    y, z = (pos_w["head"] - pos_w["hips"])[0, 1:]
    assert np.degrees(np.arctan2(z, y)) == pytest.approx(45.0)


def test_people_who_execute_actions_refuse_the_other_arm() -> None:
    with pytest.raises(ValueError, match="remove served_arm"):
        Episodes("avrgym/ScratchItchJaco-v1", 1, human_actions=True, settings=Settings(served_arm="left"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("environment", "settings"),
    [(each, on_other_arm(each)) for each in SERVED if each.endswith(("PR2-v1", "Jaco-v1"))]
    + [
        ("avrgym/FeedingPR2-v1", Settings(seat_height_m=0.55)),
        ("avrgym/BedBathingPR2-v1", Settings(backrest_deg=45.0)),
    ],
)
def test_experts_work_in_other_scenes(environment: str, settings: Settings) -> None:
    found = evaluate(environment, "oracle", "revised", 6, 0, settings=settings)
    assert found.success_rate >= 4 / 6
