"""Tasks and people give the same results on tensors as on NumPy arrays, and copy nothing to the host in a step."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("torch", reason="tensors come with the extra for training")

import torch

from avrgym.geometry import transforms
from avrgym.models.furniture import BOWL_BODY
from avrgym.models.furniture.wheelchair import ARMREST_FRONT_Y_M, ARMREST_HALF_WIDTH_M, ARMREST_TOP_HEIGHT_M
from avrgym.models.human import GEOMS, JOINTS, RECLINED_POSTURE, SEATED_POSTURE, People
from avrgym.models.scene import MAX_TOOL_CONTACTS
from avrgym.people import cooperation, distributions, impaired_motion, impairments, shoulder_limits
from avrgym.people.clinical_impairments import sample_motor_signs
from avrgym.people.distributions import POPULATION_DISTRIBUTIONS
from avrgym.people.population_names import IMPAIRMENTS, SEVERITIES
from avrgym.people.zoo import partners
from avrgym.robots.registry import find_robot
from avrgym.simulation.state import State
from avrgym.tasks.arm_manipulation.reward import RESTING_FOREARM_X_M
from avrgym.tasks.behaviour_model import BehaviourModel
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from helpers.simulation.tensors import as_tensors, assert_tensors_close, single_precision

WORLDS = 32
CROWD_W = np.array([0.0, -0.35, 1.1])
"""Where mouths are, in the world frame, in metres."""


def around(rng: np.random.Generator, *shape: int, spread: float = 0.03) -> Any:
    """Places about a point where mouths are, so near each other that things touch."""
    return CROWD_W + rng.uniform(-spread, spread, (WORLDS, *shape, 3))


def rotations(rng: np.random.Generator, *shape: int) -> Any:
    return transforms.normalize(rng.normal(size=(WORLDS, *shape, 4)))


def crowded_state(
    rng: np.random.Generator, joints: int, particles: int, vertices: int = 0, *, drives: bool = False
) -> State:
    """Worlds in which all that matters is within centimetres, and some of it touches."""
    touching = rng.random((WORLDS, MAX_TOOL_CONTACTS)) < 0.5
    forces = {name: rng.uniform(0.0, 30.0, WORLDS) for name in ("robot", "tool", "total", "links", "cloth")}
    velocity = {name: rng.normal(size=(WORLDS, 3)) for name in ("end_effector", "tool")}
    fallen = np.where(rng.random((WORLDS, particles, 1)) < 0.3, [0.0, 0.0, 1.0], 0.0)
    ends = around(rng, len(GEOMS), 2, spread=0.3)
    ends[:, 0, 1] = ends[:, 0, 0]  # a ball
    return State(
        robot_torso_pos_w=around(rng),
        joint_positions=rng.uniform(-3.0, 3.0, (WORLDS, joints)),
        base_displacement=rng.uniform(-0.3, 0.3, (WORLDS, 3 if drives else 0)),
        tool_pos_w=around(rng),
        tool_quat_w=rotations(rng),
        tool_pad_pos_w=around(rng),
        tool_pad_quat_w=rotations(rng),
        head_pos_w=around(rng),
        head_quat_w=rotations(rng),
        mouth_pos_w=around(rng),
        furniture_pos_w={BOWL_BODY: around(rng) - [0.0, 0.0, 0.3]},
        particle_pos_w=around(rng, particles) - fallen * rng.uniform(0.2, 1.2, (WORLDS, particles, 1)),
        particle_velocity_w=rng.normal(size=(WORLDS, particles, 3)),
        cloth_pos_w=around(rng, vertices, spread=0.3),
        person_capsule_ends_w=ends,
        person_radius_m=rng.uniform(0.002, 0.04, (WORLDS, len(GEOMS))),
        right_arm_pos_w=around(rng, 3),
        right_arm_quat_w=rotations(rng, 3),
        tool_contact_pos_w=around(rng, MAX_TOOL_CONTACTS, spread=0.05),
        tool_contact_normal_w=transforms.normalize(rng.normal(size=(WORLDS, MAX_TOOL_CONTACTS, 3))),
        tool_contact_force_n=np.where(touching, rng.uniform(0.0, 8.0, touching.shape), 0.0),
        **{f"{name}_force_n": force for name, force in forces.items()},
        **{f"{name}_velocity_w": each for name, each in velocity.items()},
        left_arm_pos_w=around(rng, 3),
        left_arm_quat_w=rotations(rng, 3),
    )


def people_from(uniforms: Any, distribution: str, impairment: str, task: str) -> People:
    population, usual = POPULATION_DISTRIBUTIONS[distribution], TASKS[task]
    of_people, of_mind, of_impairment = np.cumsum(
        [distributions.NUM_RANDOM_NUMBERS, cooperation.NUM_RANDOM_NUMBERS, impairments.NUM_RANDOM_NUMBERS]
    ).tolist()
    posture = RECLINED_POSTURE if task == "BedBathing" else SEATED_POSTURE
    who = distributions.sample_people(
        population,
        population.get_pose_distribution(task, usual.pose_distribution),
        posture,
        None,
        uniforms[:, :of_people],
    )
    if population.partners is not None:
        who = partners.apply_partner_bodies(who, population.partners.sample(uniforms[:, of_people:of_mind]))
    return impairments.apply_impairment(
        who, impairments.parse_impairment(impairment), uniforms[:, of_mind:of_impairment]
    )


NUM_UNIFORMS = (
    distributions.NUM_RANDOM_NUMBERS + cooperation.NUM_RANDOM_NUMBERS + impairments.NUM_RANDOM_NUMBERS
)


def step(environment: str, state: Any, action: Any, task_state: Any) -> tuple[Any, ...]:
    """All that is computed for a step once physics is done."""
    name, robot = ENVIRONMENTS[environment]
    task = TASKS[name]
    result = task.evaluate_step(state, action, task_state)
    seen = task.make_observation_spec(task.make_scene(find_robot(robot)))
    detour = () if task.compute_detour_m is None else (task.compute_detour_m(state, result.task_state),)
    return result, task.compute_reward(result.reward_terms), seen.compute(state, result.task_state), *detour


@pytest.fixture(params=ENVIRONMENTS)
def situation(request: pytest.FixtureRequest) -> tuple[str, State, Any, Any]:
    """An environment, a state, an action, and what the task keeps."""
    name, robot = ENVIRONMENTS[request.param]
    task, rng = TASKS[name], np.random.default_rng(7)
    scene = task.make_scene(find_robot(robot))
    joints = len(scene.arm.joints)
    particles, vertices = (
        0 if part is None else len(part.bodies) for part in (scene.tool.particles, scene.tool.cloth)
    )
    drives = scene.robot.drive is not None
    state = crowded_state(rng, joints, particles, vertices, drives=drives)
    kept = task.make_initial_task_state(
        people_from(rng.random((WORLDS, NUM_UNIFORMS)), "revised", "none", name),
        rng.random((WORLDS, task.num_random_numbers)),
    )
    if task.markers is not None:
        spots = task.markers.compute_positions_w(state, kept)[
            :, rng.integers(task.markers.num_markers, size=MAX_TOOL_CONTACTS)
        ]
        state = replace(state, tool_contact_pos_w=spots + rng.uniform(-0.01, 0.01, spots.shape))
    if name == "ArmManipulation":
        corner = [RESTING_FOREARM_X_M - ARMREST_HALF_WIDTH_M, ARMREST_FRONT_Y_M, ARMREST_TOP_HEIGHT_M]
        state = replace(state, right_arm_pos_w=state.right_arm_pos_w + (corner - CROWD_W))
    return request.param, state, rng.uniform(-1.0, 1.0, (WORLDS, len(scene.action_names))), kept


def test_rewards_are_equal_on_tensors(situation: tuple[str, State, Any, Any]) -> None:
    environment, state, action, kept = situation
    for _ in range(2):
        wanted = step(environment, state, action, kept)
        assert_tensors_close(step(environment, *as_tensors((state, action, kept))), wanted, environment)
        kept = wanted[0].task_state
    constant = [name for name, term in step(*situation)[0].reward_terms.items() if np.ptp(term) == 0.0]
    assert not constant, "nothing happened that they count"


@pytest.mark.fast_cases(4)
def test_a_step_copies_nothing_to_the_host(situation: tuple[str, State, Any, Any]) -> None:
    environment, *given = situation
    result, reward, observation, *_ = step(environment, *as_tensors(tuple(given), "meta"))
    assert {
        each.device.type for each in (reward, observation, result.success, result.removed_particles_mask)
    } == {"meta"}


def test_single_precision_stays_single(situation: tuple[str, State, Any, Any]) -> None:
    environment, *given = situation
    result, reward, observation, *_ = step(environment, *single_precision(as_tensors(tuple(given))))
    assert {each.dtype for each in (reward, observation, *result.reward_terms.values())} == {torch.float32}
    wanted, _, seen, *_ = step(environment, *given)
    assert_allclose(observation, seen, rtol=1e-5, atol=1e-5)
    assert_allclose(result.distance_m, wanted.distance_m, rtol=1e-5, atol=1e-5)


def behaviour_models(
    who: People, uniforms: Any, sights: Any, *, distribution: str, task: str, steered: bool
) -> list[Any]:
    """Where people want their joints in each of some control steps."""
    offered, posture = (
        TASKS[task].offered_body_part,
        RECLINED_POSTURE if task == "BedBathing" else SEATED_POSTURE,
    )
    model = BehaviourModel(
        POPULATION_DISTRIBUTIONS[distribution], who, offered, posture, human_actions=steered
    )
    model.reset(np.arange(WORLDS), who, uniforms)
    joints = cooperation.OFFERED_JOINTS[offered]

    def possible(angles: Any) -> Any:
        return shoulder_limits.clip_shoulders(impairments.clip_to_joint_ranges(who, angles))

    def targets(sight: Any) -> Any:
        if steered:
            model.move_joint_targets(
                joints, uniforms[:, :1] + 0.0 * who.tremor_rad[:, : len(joints)], possible
            )
            return model.step(lambda: sight, who, possible)
        model.choose_goal_angles(lambda: sight, possible)
        return model.advance_joint_targets(possible, 10)

    return [targets(sight) for sight in sights]


@pytest.mark.fast_cases(5)
@pytest.mark.parametrize(
    ("distribution", "impairment", "steered"),
    [(*kind, False) for kind in product(POPULATION_DISTRIBUTIONS, IMPAIRMENTS)]
    + [("original", "none", True)],
)
@pytest.mark.parametrize("task", TASKS)
def test_people_behave_equally_on_tensors(
    task: str, distribution: str, impairment: str, steered: bool
) -> None:
    rng = np.random.default_rng(3)
    uniforms = rng.random((WORLDS, NUM_UNIFORMS))
    who = people_from(uniforms, distribution, impairment, task)
    assert_tensors_close(people_from(as_tensors(uniforms), distribution, impairment, task), who)
    given = (
        who,
        uniforms[:, -cooperation.NUM_RANDOM_NUMBERS :],
        tuple(crowded_state(rng, 7, 0) for _ in range(4)),
    )
    wanted = behaviour_models(*given, distribution=distribution, task=task, steered=steered)
    assert_tensors_close(
        tuple(behaviour_models(*as_tensors(given), distribution=distribution, task=task, steered=steered)),
        tuple(wanted),
    )


@pytest.mark.parametrize("impairment", SEVERITIES)
def test_impaired_motion_is_equal_on_tensors(impairment: str) -> None:
    rng = np.random.default_rng(3)
    rest, targets = rng.normal(size=(2, WORLDS, len(JOINTS)))

    def moved(uniforms: Any, rest: Any, targets: Any) -> tuple[Any, ...]:
        signs, state = sample_motor_signs(impairment, uniforms), impaired_motion.make_initial_state(rest)
        return tuple(impaired_motion.step_impaired_motion(signs, state, targets, rest, 0.1))

    given = rng.random((WORLDS, impairments.NUM_RANDOM_NUMBERS)), rest, targets
    assert_tensors_close(moved(*as_tensors(given)), moved(*given))


@pytest.mark.parametrize("distribution", ["participants", "zoo/train"])
@pytest.mark.parametrize("task", ["Feeding", "ScratchItch"])
def test_behaviour_copies_nothing_to_the_host(task: str, distribution: str) -> None:
    rng = np.random.default_rng(3)
    uniforms = rng.random((WORLDS, NUM_UNIFORMS))
    who = people_from(uniforms, distribution, "tremor", task)
    given = who, uniforms[:, -cooperation.NUM_RANDOM_NUMBERS :], (crowded_state(rng, 7, 0),)
    (targets,) = behaviour_models(
        *as_tensors(given, "meta"), distribution=distribution, task=task, steered=False
    )
    assert targets.device.type == "meta"
