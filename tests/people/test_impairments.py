import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models.human import JOINT_INDEX, JOINTS, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, People
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.people import impairments
from avrgym.people.population_names import IMPAIRMENTS
from avrgym.tasks.episodes import Episodes

COUNT = 500
ENVIRONMENT = "avrgym/FeedingJaco-v1"
STILL = np.zeros((4, 7))


@pytest.fixture
def group(rng) -> People:
    angles = rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, (COUNT, len(JOINTS)))
    return People.make_unimpaired(rng.random(COUNT) < 0.5, rng.uniform(0.5, 0.6, COUNT), angles)


def impaired(group: People, name: str, rng: np.random.Generator) -> People:
    uniforms = rng.random((COUNT, impairments.NUM_RANDOM_NUMBERS))
    return impairments.apply_impairment(group, impairments.parse_impairment(name), uniforms)


def reset_episodes(impairment: str, people: str = "original") -> Episodes:
    episodes = Episodes(ENVIRONMENT, 4, people=people, impairment=impairment, num_threads=1)
    episodes.reset(np.arange(4), [np.random.default_rng(i) for i in range(4)])
    return episodes


def test_without_an_impairment_nothing_changes(group, rng):
    assert impaired(group, "none", rng) is group


def test_limits_shrink_ranges_and_pose(group, rng):
    limited = impaired(group, "limits", rng)
    assert 0.5 <= limited.range_share.min() < 0.51
    assert 0.99 < limited.range_share.max() <= 1.0
    share = limited.range_share[:, None]
    assert (limited.joint_angles_rad >= share * LOWER_LIMITS_RAD).all()
    assert (limited.joint_angles_rad <= share * UPPER_LIMITS_RAD).all()
    kept = (group.joint_angles_rad >= share * LOWER_LIMITS_RAD) & (
        group.joint_angles_rad <= share * UPPER_LIMITS_RAD
    )
    assert_array_equal(limited.joint_angles_rad[kept], group.joint_angles_rad[kept])


def test_weakness_reduces_strength_to_a_quarter_at_most(group, rng):
    weak = impaired(group, "weakness", rng)
    assert 0.25 <= weak.strength_share.min() < 0.26
    assert 0.98 < weak.strength_share.max() <= 1.0


def test_tremor_amplitudes_match_the_reference(group, rng):
    tremor = np.degrees(impaired(group, "tremor", rng).tremor_rad)
    for name, joint in JOINTS.items():
        most = followed_of_the_reference({"torso": 0.0, "head": 20.0}.get(joint.body, 10.0))
        assert 0.98 * most <= tremor[:, JOINT_INDEX[name]].max() <= most


def followed_of_the_reference(target: float) -> float:
    """How far a joint goes either way whose motor closes a twentieth of the gap in each of five steps."""
    angle = 0.0
    for step in range(200):
        for _ in range(5):
            angle += 0.05 * ((-1.0) ** step * target - angle)
    return abs(angle)


def test_joints_tremble_with_their_amplitude():
    episodes, angles = reset_episodes("tremor"), []
    for _ in range(12):
        episodes.command_robots(STILL)
        for substep in range(DEFAULT_SUBSTEPS):
            episodes.step_physics(substep, 1)
            angles.append(episodes.simulation.get_person_joint_angles_rad())
        episodes.evaluate_step(STILL)
    heads = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]
    swing = np.ptp(np.array(angles[-4 * DEFAULT_SUBSTEPS :]), axis=0)[:, heads] / 2.0
    assert (swing < 1.3 * episodes.people.tremor_rad[:, heads] + 1e-3).all()
    assert swing.max() > np.radians(1.0)


def test_the_tremor_of_the_head_alternates_every_control_step():
    episodes = reset_episodes("tremor")
    heads = []
    for _ in range(12):
        episodes.step(STILL)
        heads.append(episodes.simulation.get_person_joint_angles_rad()[:, JOINT_INDEX["head_z"]])
    steps = np.diff(np.array(heads)[2:], axis=0)
    assert (steps[1:] * steps[:-1] < 0.0).all()


def test_weak_people_have_less_torque_and_hold_their_pose():
    episodes = reset_episodes("weakness")
    before = episodes.simulation.get_person_joint_angles_rad()
    torque = episodes.simulation.batch.expanded("actuator_forcerange")
    assert torque is not None
    actuators = [episodes.simulation.model.actuator(f"person/{name}").id for name in JOINTS]
    expected = episodes.people.strength_share[:, None] * [joint.torque_limit_n_m for joint in JOINTS.values()]
    assert_allclose(torque[:, actuators, 1], expected)
    for _ in range(10):
        episodes.step(STILL)
    assert_allclose(episodes.simulation.get_person_joint_angles_rad(), before, atol=0.002)


@pytest.mark.parametrize("name", IMPAIRMENTS)
@pytest.mark.fast_cases(5)
def test_the_same_seed_gives_the_same_impaired_people(name):
    first, second = reset_episodes(name, "revised"), reset_episodes(name, "revised")
    for _ in range(3):
        assert_array_equal(first.step(STILL).observation, second.step(STILL).observation)


def test_an_unknown_impairment_lists_the_impairments():
    expected = "unknown impairment 'gout'; allowed: none, limits, weakness, tremor, spasticity"
    with pytest.raises(ValueError, match=expected):
        Episodes(ENVIRONMENT, 1, impairment="gout")
