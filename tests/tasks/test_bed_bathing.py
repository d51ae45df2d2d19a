from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import kinematics, transforms
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, RECLINED_POSTURE, People, Person
from avrgym.models.washcloth import PAD_CENTRE_M, PAD_HALF_SIZE_M, WASHCLOTH
from avrgym.people import distributions
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.pr2.robot import PR2
from avrgym.simulation.worlds import Simulation, State
from avrgym.tasks import placement
from avrgym.tasks.bed_bathing import reward as bed_bathing
from avrgym.tasks.bed_bathing.expert import BedBathingExpert
from avrgym.tasks.bed_bathing.reward import BedBathingState
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.person import RIGHT_ARM_LIMBS
from avrgym.tasks.registry import TASKS
from avrgym.tasks.task import StepResult
from helpers.simulation.worlds import resting_state

TASK = TASKS["BedBathing"]
MAN = Person("man", 0.60)
LEFT, BACK, UP = np.eye(3)
IDENTITY = transforms.IDENTITY_QUATERNION
SHOULDER, ELBOW, WRIST = (np.array([-0.3, y, 1.0]) for y in (0.2, -0.079, -0.369))
UPPER_ARM_M, FOREARM_M = 0.279, 0.257
UPPER_ARM_RADIUS_M, FOREARM_RADIUS_M = 0.043, 0.033
ALONG_Q = transforms.from_axis_angle(LEFT, -0.5 * np.pi)
"""Limbs hang along −z of their frames: turned so, they lie along −y, and their y points down."""
FACING_DOWN_Q = transforms.from_axis_angle(BACK, 0.5 * np.pi)
STILL = np.zeros((1, 7))
FAR_AWAY = SHOULDER + 1.0 * UP


def state(contacts: dict[tuple[float, float, float], float] | None = None, **changes: np.ndarray) -> State:
    """One world at rest: a straight arm that lies level, a cloth far above, contacts of its face (place: newtons)."""
    contact_pos, contact_force = np.zeros((1, 6, 3)), np.zeros((1, 6))
    for slot, (place, newtons) in enumerate((contacts or {}).items()):
        contact_pos[0, slot], contact_force[0, slot] = place, newtons
    segments, radii = np.tile(FAR_AWAY + 5.0 * UP, (20, 2, 1)), np.full(20, 0.1)
    upper_arm, forearm = bed_bathing.LIMB_GEOM_INDICES
    segments[upper_arm] = SHOULDER - UPPER_ARM_M * BACK, SHOULDER
    segments[forearm] = ELBOW - FOREARM_M * BACK, ELBOW
    radii[[upper_arm, forearm]] = UPPER_ARM_RADIUS_M, FOREARM_RADIUS_M
    given = {
        "robot_torso_pos_w": np.array([[-0.75, 0.15, 0.6]]),
        "tool_pos_w": FAR_AWAY[None],
        "tool_quat_w": FACING_DOWN_Q[None],
        "tool_pad_pos_w": FAR_AWAY[None],
        "tool_pad_quat_w": FACING_DOWN_Q[None],
        "right_arm_pos_w": np.stack([SHOULDER, ELBOW, WRIST])[None],
        "right_arm_quat_w": np.tile(ALONG_Q, (1, 3, 1)),
        "person_capsule_ends_w": segments[None],
        "person_radius_m": radii[None],
        "tool_force_n": contact_force.sum(axis=-1),
        "total_force_n": contact_force.sum(axis=-1),
        "tool_contact_pos_w": contact_pos,
        "tool_contact_normal_w": np.tile(-UP, (1, 6, 1)),
        "tool_contact_force_n": contact_force,
    }
    return resting_state(**given | changes)


@pytest.mark.parametrize("sex", human.SEXES)
@pytest.mark.parametrize("torso_height_m", human.TORSO_HEIGHT_RANGE_M)
def test_the_left_hand_lies_beside_the_thigh(sex: human.Sex, torso_height_m: float) -> None:
    model = human.compile_person_model(
        Person(sex, torso_height_m, TASK.pose_distribution.rest_angles_rad), RECLINED_POSTURE, moving=False
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hand, thigh = (model.geom(human.PERSON_NAME_PREFIX + name).id for name in ("left_hand", "left_thigh"))
    assert mujoco.mj_geomDistance(model, data, hand, thigh, 0.5, None) > 0.03


def on_top_of_upper_arm(along_m: float, above_m: float = 0.0) -> tuple[float, float, float]:
    return tuple(SHOULDER - along_m * BACK + (UPPER_ARM_RADIUS_M + above_m) * UP)


def fresh(*persons: Person) -> BedBathingState:
    who = People.from_persons(persons or [MAN])
    return TASK.make_initial_task_state(who, np.zeros((len(who.is_woman), TASK.num_random_numbers)))


def evaluated(
    seen: State, task_state: BedBathingState | None = None, action: np.ndarray = STILL
) -> StepResult:
    return TASK.evaluate_step(seen, action, task_state or fresh())


def term(result: StepResult, name: str) -> float:
    return float(result.reward_terms[name][0])


def marker_places(seen: State, task_state: BedBathingState) -> np.ndarray:
    """Where the markers (2, ``MARKERS``, 3) are on the skin, world frame."""
    pos_w, q_w = seen.right_arm_pos_w[0, :2, None], seen.right_arm_quat_w[0, :2, None]
    return pos_w + transforms.rotate(q_w, task_state.marker_pos[0])


# Markers


def test_markers_lie_on_the_skin_in_rings_three_centimetres_apart():
    task_state = fresh()
    for limb, radius, length, around in ((0, 0.043, 0.279, 9), (1, 0.033, 0.257, 6)):
        pos = task_state.marker_pos[0, limb][task_state.exists[0, limb]]
        assert_allclose(np.hypot(pos[:, 0], pos[:, 1]), radius)
        rings = np.unique(-pos[:, 2].round(9))
        assert_allclose(np.diff(rings), 0.03)
        assert len(rings) == int(length / 0.03)
        assert_allclose(rings.mean(), 0.5 * length)
        assert len(pos) == around * len(rings)
        gaps = np.linalg.norm(pos[:, None] - pos[None], axis=-1) + np.eye(len(pos))
        arc = 2.0 * radius * np.arcsin(0.5 * gaps.min() / radius)
        assert 0.03 - 1e-9 <= arc < 0.04


def test_the_number_of_markers_follows_the_person():
    task_state = fresh(MAN, Person("woman", 0.54), Person("man", 0.75), Person("woman", 0.75))
    counts = task_state.exists.sum(axis=-1)
    assert counts.tolist() == [[81, 48], [56, 35], [99, 60], [84, 50]]
    assert not task_state.wiped.any()


def test_every_allowed_person_has_room_for_all_markers():
    """The next ring or the next marker around would not fit into what is there."""
    for sex in human.SEXES:
        task_state = fresh(Person(sex, human.TORSO_HEIGHT_RANGE_M[1]))
        size = human.compute_body_layout(
            np.array([sex == "woman"]), np.array([0.75]), RECLINED_POSTURE
        ).geom_size
        for limb, name in enumerate(RIGHT_ARM_LIMBS):
            radius, half_length = size[name][0, 0], size[name][0, 1]
            expected = int(2.0 * half_length / 0.03) * int(2.0 * np.pi * radius / 0.03)
            assert task_state.exists[0, limb].sum() == expected


def test_marks_are_drawn_above_the_skin_until_they_are_wiped():
    assert TASK.markers is not None
    seen, task_state = state(), fresh()
    marks = TASK.markers.compute_positions_w(seen, task_state)
    assert marks.shape == (1, TASK.markers.num_markers, 3)
    shown = marks[0][task_state.exists[0].ravel()]
    from_axis = np.hypot(shown[:, 0] - SHOULDER[0], shown[:, 2] - SHOULDER[2])
    assert_allclose(np.unique(from_axis.round(6)), [0.033 + 0.008, 0.043 + 0.008])
    assert ((marks[0, :, 2] < 0.0) == ~task_state.exists[0].ravel()).all()
    wiped = evaluated(state({on_top_of_upper_arm(0.14): 3.0})).task_state
    hidden = TASK.markers.compute_positions_w(seen, wiped)[0, :, 2] < 0.0
    assert hidden.sum() == (~task_state.exists).sum() + wiped.wiped.sum() > (~task_state.exists).sum()


# Wiping


def wiped_by(seen: State) -> tuple[np.ndarray, np.ndarray]:
    """Where the markers are that one step wipes, and those that it leaves."""
    result = evaluated(seen)
    pos = marker_places(seen, fresh())
    wiped = result.task_state.wiped[0]
    assert term(result, "markers_wiped") == result.num_events[0] == wiped.sum()
    return pos[wiped], pos[fresh().exists[0] & ~wiped]


def test_one_contact_wipes_what_is_within_two_and_a_half_centimetres():
    place = on_top_of_upper_arm(0.10)
    wiped, left = wiped_by(state({place: 1.0}))
    assert len(wiped) > 0
    assert (np.linalg.norm(wiped - place, axis=-1) < 0.025).all()
    assert (np.linalg.norm(left - place, axis=-1) >= 0.025).all()


def test_the_pad_wipes_between_the_ends_of_its_contact():
    first, last = on_top_of_upper_arm(0.08), on_top_of_upper_arm(0.18)
    wiped, left = wiped_by(state({last: 1.0, first: 2.0}))
    between = np.linspace(first, last, 1001)
    nearest = np.linalg.norm(wiped[:, None] - between, axis=-1).min(axis=-1)
    assert (nearest < 0.025).all()
    assert (np.linalg.norm(left[:, None] - between, axis=-1).min(axis=-1) >= 0.025 - 1e-6).all()
    alone = [len(wiped_by(state({end: 1.0}))[0]) for end in (first, last)]
    assert len(wiped) > sum(alone)


def test_contacts_on_two_limbs_are_not_joined():
    """Of an arm that is touched near the shoulder and near the wrist, the middle is not wiped."""
    near_shoulder = on_top_of_upper_arm(0.03)
    near_wrist = tuple(ELBOW - 0.22 * BACK + FOREARM_RADIUS_M * UP)
    wiped, _ = wiped_by(state({near_shoulder: 1.0, near_wrist: 1.0}))
    assert len(wiped) > 0
    ends = np.array([near_shoulder, near_wrist])
    assert (np.linalg.norm(wiped[:, None] - ends, axis=-1).min(axis=-1) < 0.025).all()


def test_a_contact_without_force_or_far_from_the_limb_wipes_nothing():
    for contacts in (
        {on_top_of_upper_arm(0.10): 0.0},
        {on_top_of_upper_arm(0.10, above_m=0.0251): 3.0},
        {tuple(SHOULDER + 0.10 * BACK): 3.0},
    ):
        wiped, _ = wiped_by(state(contacts))
        assert len(wiped) == 0


def touching(
    tool_pad_quat_w: np.ndarray, angle_deg: float, about_rad: float, *, behind_face_m: float = 0.0
) -> State:
    """A cloth whose contact's normal is so far off its face's towards one of its sides, at a place behind the face."""
    angle, place = np.radians(angle_deg), np.array(on_top_of_upper_arm(0.10))
    normal = [np.cos(angle), np.sin(angle) * np.cos(about_rad), np.sin(angle) * np.sin(about_rad)]
    return state(
        {tuple(place): 3.0},
        tool_contact_normal_w=np.tile(transforms.rotate(tool_pad_quat_w, normal), (1, 6, 1)),
        tool_pad_pos_w=(place + behind_face_m * transforms.rotate(tool_pad_quat_w, [1.0, 0.0, 0.0]))[None],
        tool_pad_quat_w=tool_pad_quat_w[None],
    )


@pytest.mark.parametrize(
    "tool_pad_quat_w", [FACING_DOWN_Q, ALONG_Q, transforms.normalize([1.0, -2.0, 0.5, 3.0])]
)
@pytest.mark.fast_cases(1)
def test_only_the_face_wipes(tool_pad_quat_w):
    """Whichever way the cloth is turned: with its face and the face's rim, never with its sides or its back."""
    for about_rad in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        for angle_deg, wipes in ((0, True), (30, True), (70, True), (80, False), (90, False), (180, False)):
            result = evaluated(touching(tool_pad_quat_w, angle_deg, about_rad))
            assert (term(result, "markers_wiped") > 0) == wipes
        for behind_m, wipes in ((0.0, True), (0.006, True), (0.012, False), (0.02, False)):
            result = evaluated(touching(tool_pad_quat_w, 50, about_rad, behind_face_m=behind_m))
            assert (term(result, "markers_wiped") > 0) == wipes


def test_a_side_that_touches_adds_nothing_to_what_the_face_wipes():
    seen = state({on_top_of_upper_arm(0.08): 2.0, on_top_of_upper_arm(0.18): 1.0})
    normals_w = seen.tool_contact_normal_w.copy()
    normals_w[0, 1] = LEFT  # a side's, where the face looks down
    alone = evaluated(state({on_top_of_upper_arm(0.08): 2.0}))
    both = evaluated(replace(seen, tool_contact_normal_w=normals_w))
    assert_array_equal(both.task_state.wiped, alone.task_state.wiped)


@pytest.mark.parametrize(("side", "wipes"), [("face", True), ("lower", False), ("upper", False)])
def test_in_the_world_it_is_the_face_that_wipes(side, wipes):
    """A cloth that lies along the upper arm and is pressed on it, with one of its sides or another, by a real arm."""
    scene, who = (
        TASK.make_scene(JACO),
        distributions.repeat_person(Person("man", 0.60, TASK.pose_distribution.rest_angles_rad), 1),
    )
    shoulder, elbow, _ = placement.compute_right_arm_joint_pos_w(who, RECLINED_POSTURE)[0]
    along = transforms.normalize(elbow - shoulder)
    down = transforms.normalize(-UP + (UP @ along) * along)
    x, half = {"face": (down, 0), "lower": (np.cross(down, along), 2), "upper": (np.cross(along, down), 2)}[
        side
    ]
    tool_q = transforms.from_matrix(np.stack([x, along, np.cross(x, along)], axis=-1))
    pad = 0.5 * (shoulder + elbow) - (UPPER_ARM_RADIUS_M + PAD_HALF_SIZE_M[half] + 0.015) * down
    tool = (pad - transforms.rotate(tool_q, PAD_CENTRE_M))[None]
    uniforms = np.random.default_rng(0).random((1, TASK.num_random_numbers))
    start = placement.find_initial_state(
        scene, who, {}, tool, tool_q[None], tool[:, None], tool_q[None, None], uniforms
    )
    simulation = Simulation(scene, 1, num_threads=1)
    simulation.reset(np.array([0]), replace(start, furniture_pos_w={"nightstand": start.robot_base_pos_w}))
    task_state, pressed_n = fresh(), 0.0
    for _ in range(6):
        _, _, jacobian = kinematics.compute_jacobian(
            placement.make_arm_chain(scene), simulation.get_joint_positions()
        )
        velocity = transforms.rotate(transforms.conjugate(start.robot_base_quat_w[0]), 0.04 * down)
        rates = np.linalg.pinv(jacobian[0]) @ np.concatenate([velocity, np.zeros(3)])
        simulation.command_robot((rates / scene.arm.speed_limit)[None])
        simulation.step()
        seen = simulation.get_state()
        task_state, pressed_n = (
            TASK.evaluate_step(seen, STILL, task_state).task_state,
            max(pressed_n, seen.total_force_n[0]),
        )
    assert pressed_n > 1.0
    assert task_state.wiped.any() == wipes


def test_the_force_of_a_side_on_the_arm_is_at_the_target_too():
    seen = state({on_top_of_upper_arm(0.10): 20.0}, tool_contact_normal_w=np.tile(LEFT, (1, 6, 1)))
    result = evaluated(seen)
    assert term(result, "strong_force_at_arm_n") == 20.0
    assert term(result, "force_elsewhere_n") == 0.0


def test_a_marker_counts_once():
    seen = state({on_top_of_upper_arm(0.10): 3.0})
    result = evaluated(seen)
    assert term(result, "markers_wiped") > 0
    assert term(evaluated(seen, result.task_state), "markers_wiped") == 0
    assert evaluated(seen, result.task_state).task_state.wiped.sum() == result.task_state.wiped.sum()


def test_thirty_percent_of_the_markers_are_a_success():
    """39 of 129, wherever they are, and it lasts."""
    task_state = fresh()
    existing = np.flatnonzero(task_state.exists)
    for count, success in ((38, False), (39, True)):
        wiped = np.zeros(task_state.wiped.size, dtype=bool)
        wiped[existing[-count:]] = True
        result = evaluated(state(), replace(task_state, wiped=wiped.reshape(task_state.wiped.shape)))
        assert result.success[0] == success


# The other terms


def test_distance_is_from_the_cloth_to_the_skin():
    for above in (0.0, 0.02, 0.3):
        face = np.array(on_top_of_upper_arm(0.14, above_m=above))
        result = evaluated(state(tool_pos_w=face[None]))
        assert term(result, "distance_m") == result.distance_m[0] == pytest.approx(above, abs=1e-9)
    inside = np.array(on_top_of_upper_arm(0.14, above_m=-0.003))
    assert term(evaluated(state(tool_pos_w=inside[None])), "distance_m") == 0.0


def test_distance_is_from_the_nearest_part_of_the_cloth():
    """Beyond the forearm's end it is the end of the 10 cm of cloth that is near."""
    half_length = PAD_HALF_SIZE_M[1]
    tip = ELBOW - (FOREARM_M + FOREARM_RADIUS_M) * BACK
    beyond = tip - (half_length + 0.05) * BACK - PAD_HALF_SIZE_M[0] * UP
    seen = state(tool_pos_w=beyond[None])
    assert term(evaluated(seen), "distance_m") == pytest.approx(0.05, abs=1e-6)


def test_force_on_the_arm_is_at_the_target_and_any_other_is_not():
    on_arm = on_top_of_upper_arm(0.10)
    seen = state({on_arm: 4.0, tuple(FAR_AWAY): 3.0}, total_force_n=np.array([9.0]))
    result = evaluated(seen)
    assert term(result, "force_elsewhere_n") == pytest.approx(5.0)
    assert term(result, "strong_force_at_arm_n") == 0.0
    assert term(evaluated(state({on_arm: 4.0})), "force_elsewhere_n") == 0.0


def test_only_strong_force_at_the_target_is_disliked():
    for newtons, counted in ((9.99, 0.0), (10.0, 10.0), (25.0, 25.0)):
        half = 0.5 * newtons
        both = state({on_top_of_upper_arm(0.10): half, tuple(ELBOW + FOREARM_RADIUS_M * UP): half})
        assert term(evaluated(both), "strong_force_at_arm_n") == pytest.approx(counted)


def test_action_and_speed_terms():
    seen = state(tool_velocity_w=np.array([[0.3, 0.0, -0.4]]))
    result = evaluated(seen, action=np.array([[1.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.5]]))
    assert term(result, "action_squared") == 1.5
    assert term(result, "tool_speed_m_s") == pytest.approx(0.5)


def test_the_weights_are_those_of_the_paper():
    assert TASK.reward_weights == {
        "distance_m": -1.0,
        "action_squared": -0.01,
        "markers_wiped": 5.0,
        "tool_speed_m_s": -0.25,
        "force_elsewhere_n": -0.01,
        "strong_force_at_arm_n": -0.05,
    }


def test_the_reward_is_the_weighted_sum():
    seen = state(
        {on_top_of_upper_arm(0.10): 20.0},
        tool_velocity_w=np.array([[0.0, 0.2, 0.0]]),
        total_force_n=np.array([27.0]),
    )
    result = evaluated(seen, action=np.full((1, 7), 0.5))
    distance, wiped = term(result, "distance_m"), term(result, "markers_wiped")
    assert distance > 0.9
    assert wiped > 0
    expected = -distance - 0.01 * 7 * 0.25 + 5 * wiped - 0.25 * 0.2 - 0.01 * 7.0 - 0.05 * 20.0
    assert TASK.compute_reward(result.reward_terms)[0] == pytest.approx(expected)
    assert set(result.reward_terms) == set(TASK.reward_weights)


def test_worlds_are_evaluated_independently():
    worlds = [state({on_top_of_upper_arm(0.10): 3.0}), state(), state({on_top_of_upper_arm(0.20): 12.0})]
    arrays = {
        name: np.concatenate([getattr(world, name) for world in worlds])
        for name in vars(worlds[0])
        if name != "furniture_pos_w"
    }
    together = TASK.evaluate_step(State(**arrays, furniture_pos_w={}), np.zeros((3, 7)), fresh(MAN, MAN, MAN))
    for index, world in enumerate(worlds):
        alone = evaluated(world)
        for name, value in together.reward_terms.items():
            assert value[index] == alone.reward_terms[name][0], name
        assert_array_equal(together.task_state.wiped[index], alone.task_state.wiped[0])


# Observation


def test_the_observation_has_the_documented_order():
    """Tool − torso, tool rotation, arm angles, shoulder, elbow and wrist − torso, force at the tool."""
    tool_q = transforms.normalize([[1.0, 2.0, 3.0, 4.0]])
    seen = state(joint_positions=np.arange(7.0)[None], tool_quat_w=tool_q, tool_force_n=np.array([9.0]))
    torso = seen.robot_torso_pos_w[0]
    expected = np.concatenate(
        [FAR_AWAY - torso, tool_q[0], np.arange(7.0), SHOULDER - torso, ELBOW - torso, WRIST - torso, [9.0]]
    )
    observation = TASK.make_observation_spec(TASK.make_scene(JACO))
    assert_allclose(observation.compute(seen, fresh()), expected[None])
    assert observation.size == len(expected) == 24
    assert [entry.size for entry in observation.entries] == [3, 4, 7, 3, 3, 3, 1]


# Start


def test_the_person_lies_with_the_right_arm_away_from_the_body():
    rest = {name: np.degrees(TASK.pose_distribution.rest_angles_rad[i]) for name, i in JOINT_INDEX.items()}
    moved = {name: angle for name, angle in rest.items() if angle != 0.0}
    assert moved == pytest.approx(
        {
            "right_shoulder_y": 20.0,
            "right_shoulder_x": -20.0,
            "right_elbow_x": -45.0,
            "left_shoulder_y": -14.0,
            "left_elbow_x": -45.0,
        }
    )
    spread = {name for name, i in JOINT_INDEX.items() if TASK.pose_distribution.max_offset_rad[i] != 0.0}
    assert spread == {name for name in JOINT_INDEX if name.startswith("right_")}
    assert_allclose(np.degrees(TASK.pose_distribution.max_offset_rad).max(), 10.0)


@pytest.mark.parametrize("robot", [JACO, PR2])
def test_episodes_begin_with_the_cloth_beside_the_arm(robot):
    episodes = Episodes(f"avrgym/BedBathing{robot.name}-v1", 16, people="revised", num_threads=1)
    episodes.reset(np.arange(16), [np.random.default_rng(i) for i in range(16)])
    seen = episodes.simulation.get_state()
    hand = seen.tool_pos_w + transforms.rotate(seen.tool_quat_w, WASHCLOTH.grip_pos)
    assert_allclose(hand, np.tile([-0.5, -0.1, 1.0], (16, 1)), atol=0.006)
    face = transforms.rotate(seen.tool_quat_w, [1.0, 0.0, 0.0])
    assert_allclose(face, np.tile([np.sqrt(0.5), 0.0, -np.sqrt(0.5)], (16, 1)), atol=0.06)
    assert (seen.robot_force_n == 0.0).all()
    assert (bed_bathing.compute_cloth_distance_m(seen) > 0.02).all()


def test_the_nightstand_goes_with_the_robot(rng):
    scene = TASK.make_scene(JACO)
    start = TASK.sample_initial_states(
        scene, distributions.repeat_person(MAN, 8), rng.random((8, TASK.num_random_numbers))
    )
    assert_array_equal(start.furniture_pos_w["nightstand"], start.robot_base_pos_w)
    assert np.abs(start.robot_base_pos_w - [-0.75, 0.15, 0.6]).max() <= 0.1
    assert (
        TASK.sample_initial_states(
            TASK.make_scene(PR2),
            distributions.repeat_person(MAN, 1),
            rng.random((1, TASK.num_random_numbers)),
        ).furniture_pos_w
        == {}
    )


# Wiping by script


@pytest.mark.parametrize("robot", [JACO, PR2])
@pytest.mark.fast_cases(1)
def test_the_expert_washes_most_people_gently(robot):
    episodes = Episodes(f"avrgym/BedBathing{robot.name}-v1", 4, people="revised", num_threads=2)
    observation = episodes.reset(np.arange(4), [np.random.default_rng(i) for i in range(4)])
    oracle, strongest, step = BedBathingExpert(episodes), 0.0, None
    for _ in range(150):
        step = episodes.step(oracle(observation))
        observation = step.observation
        strongest = max(strongest, float(step.force_on_person_n.max()))
    assert step is not None
    assert step.success.sum() >= 3
    assert 1.0 < strongest < 40.0
