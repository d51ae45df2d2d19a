"""Laws of the motion of simulated people: limits of speed and acceleration, noise, tremor, and versions."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.models.human import JOINT_INDEX, RECLINED_POSTURE, SEATED_POSTURE, Person
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.people import cooperation, distributions, impairments, motor_model, shoulder_limits
from avrgym.people.distributions import NAMED_DISTRIBUTIONS, POPULATION_DISTRIBUTIONS
from avrgym.people.zoo import partners
from avrgym.people.zoo.partner_behaviour import PartnerState
from avrgym.simulation.worlds import State
from avrgym.tasks.behaviour_model import BehaviourModel
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS
from helpers.simulation.worlds import resting_state

FEEDING = "avrgym/FeedingJaco-v1"
HEAD_Z, ELBOW = JOINT_INDEX["head_z"], JOINT_INDEX["right_elbow_x"]
WORLDS = 120
MOVING = [name for name, distribution in POPULATION_DISTRIBUTIONS.items() if distribution.is_moving]


def is_at_rest(count: int = 1) -> motor_model.MotorState:
    """People who do not sway, with different noise."""
    people = distributions.repeat_person(Person("man", 0.6), count)
    noise = np.random.default_rng(0).random((count, 3))
    return motor_model.make_initial_state(people, None, np.ones(count), noise)


def turned(state: motor_model.MotorState, goals_rad: list[float]) -> np.ndarray:
    """The targets (steps, N, 20) of people who turn the head to one goal each 0.1 s."""
    shown = []
    for goal in goals_rad:
        wanted = state.goal_angles_rad.copy()
        wanted[:, HEAD_Z] = goal
        state, targets = motor_model.advance_joint_targets_rad(
            motor_model.set_goal_angles(state, wanted), DEFAULT_SUBSTEPS
        )
        shown.append(targets)
    return np.concatenate(shown)


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("people", MOVING)
def test_no_joint_target_moves_faster_than_its_limit(people: str, task: str) -> None:
    """Of all styles, while the tool wanders near and far, with tremor."""
    rng, distribution = np.random.default_rng(5), POPULATION_DISTRIBUTIONS[people]
    uniforms = rng.random((WORLDS, cooperation.NUM_RANDOM_NUMBERS))
    body = distributions.repeat_person(
        Person("man", 0.6, TASKS[task].pose_distribution.rest_angles_rad), WORLDS
    )
    drawn = None if distribution.partners is None else distribution.partners.sample(uniforms[:, :2])
    if drawn is not None:
        body = partners.apply_partner_bodies(body, drawn)
    body = impairments.apply_impairment(body, "tremor", rng.random((WORLDS, impairments.NUM_RANDOM_NUMBERS)))
    posture = RECLINED_POSTURE if task == "BedBathing" else SEATED_POSTURE
    model = BehaviourModel(distribution, body, TASKS[task].offered_body_part, posture, human_actions=False)
    model.reset(np.arange(WORLDS), body, uniforms)
    mouth = np.tile([[0.0, -0.1, 1.2]], (WORLDS, 1))
    arm = np.tile([[[-0.2, 0.0, 1.1], [-0.2, 0.0, 0.85], [-0.2, -0.3, 0.85]]], (WORLDS, 1, 1))
    seen = replace(
        resting_state(), mouth_pos_w=mouth, head_pos_w=mouth + np.array([0.0, 0.1, 0.0]), right_arm_pos_w=arm
    )
    way, shown, startled = np.zeros((WORLDS, 3)), [], np.zeros(WORLDS, dtype=bool)

    def possible(angles: np.ndarray) -> np.ndarray:
        return shoulder_limits.clip_shoulders(impairments.clip_to_joint_ranges(body, angles))

    def observe() -> State:
        return replace(seen, tool_pos_w=mouth + way)

    for _ in range(60):
        way = np.clip(way + rng.uniform(-0.15, 0.15, way.shape), -0.5, 0.5)
        model.choose_goal_angles(observe, possible)
        shown.append(model.advance_joint_targets(possible, DEFAULT_SUBSTEPS))
        state = model.snapshot()[0]
        if isinstance(state, PartnerState):
            startled |= state.startle_count > 0.0
    speed = np.abs(np.diff(np.concatenate(shown), axis=0)).max(axis=0) / PHYSICS_STEP_S
    limit = motor_model.compute_speed_limit_rad_s(model.snapshot()[1], startled)
    assert (speed <= limit + 1e-9).all()
    assert (speed > 0.3 * limit).any(axis=0).sum() > 3, "people hardly moved"
    assert startled.any() == (drawn is not None and TASKS[task].offered_body_part in ("mouth", "arm"))


def test_accelerations_stay_within_their_limits_even_if_the_goal_jumps():
    goals = [0.8] * 5 + [-0.8] * 9 + [0.8] * 3 + [0.0] * 12
    shown = turned(is_at_rest(50), goals)
    acceleration = np.abs(np.diff(shown[..., HEAD_Z], n=2, axis=0)).max() / PHYSICS_STEP_S**2
    limit = motor_model.MAX_JOINT_ACCELERATION_RAD_S2[HEAD_Z]
    assert 0.6 * limit < acceleration <= limit


def test_movements_are_bell_shaped_and_arrive_without_overshoot():
    shown = turned(is_at_rest(), [0.5] * 20)[:, 0, HEAD_Z]
    speed = np.diff(shown) / PHYSICS_STEP_S
    assert (speed >= 0.0).all()
    assert shown.max() <= 0.5
    assert shown[-1] == pytest.approx(0.5, abs=1e-4)
    peak = int(speed.argmax())
    assert (np.diff(speed[:peak]) > -1e-3).all()
    assert (
        0.7 * motor_model.MAX_JOINT_SPEED_RAD_S[HEAD_Z]
        < speed[peak]
        <= motor_model.MAX_JOINT_SPEED_RAD_S[HEAD_Z]
    )


def test_noise_is_proportional_to_speed():
    slow, usual = is_at_rest(400), is_at_rest(400)
    slow = replace(slow, speed_factor=0.25 * slow.speed_factor)
    spread = []
    for state in (slow, usual):
        speed = np.diff(turned(state, [3.0] * 8)[-10:, :, HEAD_Z], axis=0).mean(axis=0) / PHYSICS_STEP_S
        spread.append(speed.std())
    assert spread[1] == pytest.approx(4.0 * spread[0], rel=1e-6)
    nominal = motor_model.NOISE_FREE_SPEED_FRACTION * motor_model.MAX_JOINT_SPEED_RAD_S[HEAD_Z]
    assert (
        0.5 * motor_model.SPEED_NOISE_FRACTION < spread[1] / nominal <= 1.1 * motor_model.SPEED_NOISE_FRACTION
    )
    assert np.ptp(turned(usual, [0.0] * 8), axis=0).max() == 0.0


def test_hands_of_participants_tremble_like_those_of_healthy_people():
    """8 to 12 Hz; 0.0015 to 0.035 g (Wade et al., 1982)."""
    episodes = Episodes(FEEDING, 8, people="participants", num_threads=1)
    episodes.reset(np.arange(8), [np.random.default_rng(seed) for seed in range(8)])
    angles = []
    for step in range(30):
        episodes.command_robots(np.zeros((8, episodes.action_size)))
        for substep in range(DEFAULT_SUBSTEPS):
            episodes.step_physics(substep, 1)
            if step >= 10:
                angles.append(episodes.simulation.get_person_joint_angles_rad()[:, ELBOW])
    measured = np.array(angles) - np.mean(angles, axis=0)
    spectrum = np.abs(np.fft.rfft(measured * np.hanning(len(measured))[:, None], axis=0))
    hertz = np.fft.rfftfreq(len(measured), PHYSICS_STEP_S)
    fast = hertz > 5.0
    peak_hz = hertz[fast][spectrum[fast].argmax(axis=0)]
    assert ((peak_hz > 7.4) & (peak_hz < 12.6)).all()
    acceleration = np.abs(np.diff(measured, n=2, axis=0)).max(axis=0) / PHYSICS_STEP_S**2
    gravities = motor_model.FOREARM_LENGTH_M * acceleration / motor_model.GRAVITY_M_S2
    assert ((gravities > 0.0008) & (gravities < 0.035)).all()


def head_jump(people: str) -> float:
    """The largest change of a person's servo target within 10 ms, in radians."""
    episodes = Episodes(FEEDING, 4, people=people, num_threads=1)
    episodes.reset(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
    columns = [episodes.simulation.model.actuator(f"person/head_{axis}").id for axis in "xyz"]
    shown = []
    for _ in range(12):
        episodes.command_robots(np.zeros((4, episodes.action_size)))
        for substep in range(DEFAULT_SUBSTEPS):
            episodes.step_physics(substep, 1)
            shown.append(episodes.simulation.get_servo_commands()[:, columns])
    return float(np.abs(np.diff(np.array(shown), axis=0)).max())


def test_participants_of_version_1_jump_and_others_move_evenly():
    assert head_jump("participants@1") == pytest.approx(0.08, abs=0.01)
    assert head_jump("participants") < 0.02
    assert head_jump("participants@2") == head_jump("participants")


@pytest.mark.parametrize("name", ["participants", "zoo/unseen", "zoo/train/startled", "revised"])
def test_names_without_a_version_have_the_newest(name: str) -> None:
    assert NAMED_DISTRIBUTIONS[name] == NAMED_DISTRIBUTIONS[f"{name}@2"]
    assert NAMED_DISTRIBUTIONS[f"{name}@1"] == replace(NAMED_DISTRIBUTIONS[name], motion_version=1)
    with pytest.raises(ValueError, match=rf"unknown motion version '3'.*allowed: {name}, {name}@1, {name}@2"):
        distributions.find_distribution(f"{name}@3", TASKS)


def test_whole_steps_and_single_physics_steps_give_the_same_bits(rng):
    whole, single = (Episodes(FEEDING, 3, people="zoo/train", num_threads=1) for _ in range(2))
    for episodes in (whole, single):
        episodes.reset(np.arange(3), [np.random.default_rng(seed) for seed in range(3)])
    for action in rng.uniform(-1.0, 1.0, (6, 3, whole.action_size)):
        one = whole.step(action)
        single.command_robots(action)
        for substep in range(DEFAULT_SUBSTEPS):
            single.step_physics(substep, 1)
        assert_array_equal(one.observation, single.evaluate_step(action).observation)
