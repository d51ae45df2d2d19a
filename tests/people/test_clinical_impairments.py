"""Laws of all clinical impairments: severity, unaffected joints, speed, and effect in physics."""

from copy import deepcopy
from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models.human import JOINT_INDEX, JOINTS, LOWER_LIMITS_RAD, SEATED_POSE_RAD, UPPER_LIMITS_RAD
from avrgym.people import impaired_motion, impairments
from avrgym.people.clinical_impairments import sample_motor_signs
from avrgym.people.impaired_motion import MotorSigns
from avrgym.people.population_names import SEVERITIES
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy
from avrgym.tasks.constants import PAPER_ENVIRONMENTS
from avrgym.tasks.episodes import Episodes

COUNT, STEP_S = 20, 0.1
GOAL_RAD = SEATED_POSE_RAD + np.radians(20.0)
GRADED = [f"{name}:{grade}" for name, grades in SEVERITIES.items() for grade in grades]
RISING = ("damping_n_m_s", "intention_tremor_rad", "dyskinesia_rad")
RIGHT = np.array([name.startswith("right") for name in JOINTS])
LEFT = np.array([name.startswith("left") for name in JOINTS])
HEAD = np.array([name.startswith("head") for name in JOINTS])


def signs_of(impairment: str) -> MotorSigns:
    return sample_motor_signs(
        impairment, np.random.default_rng(5).random((COUNT, impairments.NUM_RANDOM_NUMBERS))
    )


def executed(impairment: str, seconds: float = 6.0, step_s: float = STEP_S) -> np.ndarray:
    """Executed angles (T, N, 20) of people who are commanded to move all joints by 20° at 40°/s."""
    signs, rest = signs_of(impairment), np.tile(SEATED_POSE_RAD, (COUNT, 1))
    state, angles = impaired_motion.make_initial_state(rest), []
    for number in range(round(seconds / step_s)):
        target = rest + np.minimum(np.radians(40.0) * step_s * (number + 1), np.radians(20.0))
        state, angle = impaired_motion.step_impaired_motion(signs, state, target, rest, step_s)
        angles.append(angle)
    return np.array(angles)


@pytest.mark.parametrize("name", [*SEVERITIES, *GRADED])
def test_each_severity_has_a_name(name):
    assert impairments.parse_impairment(name) == name


@pytest.mark.parametrize(
    "name", ["ataxia:", "ataxia:bad", "tremor:mild", "spinal_cord_injury:C7", "hemiparesis"]
)
def test_unknown_severities_list_the_allowed_ones(name):
    with pytest.raises(ValueError, match=r"allowed: none, .*spasticity.*mild, moderate, severe.*C6, C5, C4"):
        impairments.parse_impairment(name)


@pytest.mark.parametrize("name", SEVERITIES)
def test_a_higher_severity_has_no_smaller_effect(name):
    grades = [signs_of(f"{name}:{grade}") for grade in SEVERITIES[name]]
    for less, more in pairwise(grades):
        changed = False
        for each in fields(MotorSigns):
            if each.name in ("phase", "tremor_hz"):
                continue
            sign = 1.0 if each.name in RISING else -1.0
            growth = sign * (getattr(more, each.name) - getattr(less, each.name))
            assert (growth >= 0.0).all(), each.name
            changed |= bool(growth.any())
        assert changed


@pytest.mark.parametrize("name", SEVERITIES)
def test_the_name_alone_means_any_severity(name):
    drawn = np.stack([signs_of(f"{name}:{grade}").mobility for grade in SEVERITIES[name]])
    anyone = signs_of(name).mobility
    assert (anyone >= drawn.min(axis=0) - 1e-12).all()
    assert (anyone <= drawn.max(axis=0) + 1e-12).all()


@pytest.mark.parametrize(
    ("name", "affected"),
    [
        ("hemiparesis_left", LEFT),
        ("hemiparesis_right", RIGHT),
        ("spinal_cord_injury", ~HEAD),
        ("spasticity", LEFT | RIGHT),
    ],
)
def test_unaffected_joints_follow_the_command(name, affected):
    for grade in SEVERITIES[name]:
        reached = executed(f"{name}:{grade}")[-1]
        assert_allclose(reached[:, ~affected], np.broadcast_to(GOAL_RAD, reached.shape)[:, ~affected])
        signs = signs_of(f"{name}:{grade}")
        assert (signs.torque_fraction[:, ~affected] == 1.0).all()
        assert (signs.damping_n_m_s[:, ~affected] == 0.0).all()


def test_c4_injury_leaves_only_the_head():
    moved = executed("spinal_cord_injury:C4")[-1] - SEATED_POSE_RAD
    assert_allclose(moved[:, ~HEAD], 0.0, atol=1e-12)


def test_c5_flexes_the_elbow_and_c6_extends_the_wrist():
    """Key muscles of ISNCSCI: elbow flexors at C5, wrist extensors at C6, elbow extensors only at C7."""
    elbow, wrist = JOINT_INDEX["right_elbow_x"], JOINT_INDEX["right_wrist_x"]
    c4, c5, c6 = (signs_of(f"spinal_cord_injury:{level}").torque_fraction for level in ("C4", "C5", "C6"))
    assert (c4[:, elbow] < 0.1).all()
    assert (c5[:, elbow, 0] > 0.1).all()
    assert (c5[:, wrist] < 0.1).all()
    assert (c6[:, elbow, 0] == 1.0).all()
    assert (c6[:, wrist] > 0.1).all()
    assert (c6[:, elbow, 1] < 0.1).all()


@pytest.mark.parametrize("step_s", [0.1, 0.01])
@pytest.mark.parametrize("name", ["spasticity:severe", "hemiparesis_right:severe"])
def test_no_joint_exceeds_its_speed(name, step_s):
    speed = np.abs(np.diff(executed(name, step_s=step_s), axis=0)) / step_s
    assert (speed <= signs_of(name).max_speed_rad_s + 1e-9).all()


def test_ataxic_people_overshoot_and_tremble_near_the_goal():
    moved = [executed(f"ataxia:{grade}", step_s=0.01) for grade in SEVERITIES["ataxia"]]
    past = [np.degrees((angles - GOAL_RAD).max(axis=0)) for angles in moved]
    assert (past[0].mean(axis=0) > 0.2).all()
    assert (np.diff([each.mean() for each in past]) > 0.0).all()
    signs, rest = signs_of("ataxia:severe"), np.tile(SEATED_POSE_RAD, (COUNT, 1))
    state = impaired_motion.make_initial_state(rest)
    still = [
        impaired_motion.step_impaired_motion(signs, state, rest, rest, STEP_S)[1] - rest for _ in range(10)
    ]
    assert not np.any(still), "no intention, no tremor"


def test_dyskinesia_is_slow_and_within_its_amplitude():
    moved = executed("dyskinesia:severe", seconds=20.0, step_s=0.02) - executed(
        "hemiparesis_left:mild", 20.0, 0.02
    )
    signs, head = signs_of("dyskinesia:severe"), JOINT_INDEX["head_z"]
    wave = moved[:, :, head]
    assert (np.abs(wave) <= signs.dyskinesia_rad[:, head] + 1e-9).all()
    assert (np.ptp(wave, axis=0) > signs.dyskinesia_rad[:, head]).all()
    power = np.abs(np.fft.rfft(wave - wave.mean(axis=0), axis=0)) ** 2
    hz = np.fft.rfftfreq(len(wave), 0.02)
    assert power[hz < 3.0].sum() > 0.98 * power.sum()


def test_the_motion_hardly_depends_on_the_step():
    for name in ("spasticity:moderate", "ataxia:moderate"):
        coarse, fine = executed(name), executed(name, step_s=0.01)
        assert_allclose(coarse[-1], fine[-1], atol=np.radians(0.5))


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize(("environment", "name"), [*zip(PAPER_ENVIRONMENTS * 3, GRADED, strict=False)])
def test_adaptive_policies_run_and_joints_stay_within_limits(environment, name):
    episodes = Episodes(environment, 2, people="participants", impairment=name, num_threads=1)
    policy = registry.resolve_policy("adaptive", environment)
    assert isinstance(policy, Policy)
    generators = [np.random.default_rng(seed) for seed in range(2)]
    observation = episodes.reset(np.arange(2), generators)
    act = registry.make_action_function(policy, episodes, generators)
    for _ in range(20):
        observation = episodes.step(act(observation)).observation
        assert np.isfinite(observation).all()
        angles = episodes.simulation.get_person_joint_angles_rad()
        assert (angles >= LOWER_LIMITS_RAD - 0.05).all()
        assert (angles <= UPPER_LIMITS_RAD + 0.05).all()


def test_a_spastic_elbow_resists_fast_stretches():
    torque_n_m = []
    for grade in SEVERITIES["spasticity"]:
        episodes = Episodes("avrgym/ScratchItchJaco-v1", 1, impairment=f"spasticity:{grade}", num_threads=1)
        episodes.reset(np.array([0]), [np.random.default_rng(3)])
        damping = episodes.simulation.batch.expanded("dof_damping")
        assert damping is not None
        dof = episodes.simulation.model.joint("person/right_elbow_x").dofadr[0]
        torque_n_m.append(damping[0, dof] * np.radians(100.0))
    assert torque_n_m == sorted(torque_n_m)
    assert 0.5 < torque_n_m[0] < torque_n_m[-1] < 4.0


def test_a_copy_continues_with_the_same_bits():
    episodes = Episodes("avrgym/FeedingJaco-v1", 2, people="participants", impairment="ataxia", num_threads=1)
    episodes.reset(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    still = np.zeros((2, 7))
    for _ in range(5):
        episodes.step(still)
    copy = deepcopy(episodes)
    for _ in range(5):
        assert_array_equal(episodes.step(still).observation, copy.step(still).observation)
