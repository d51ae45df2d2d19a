import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import kinematics, transforms
from avrgym.models import human
from avrgym.models.furniture import BOWL_BODY, BOWL_INITIAL_POS_M
from avrgym.models.human import Person
from avrgym.models.robot import ROBOT_NAME_PREFIX as ROBOT
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.people import distributions
from avrgym.simulation.worlds import REMOVED_PARTICLE_POS_W, Simulation
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.feeding.task import INITIAL_SPOON_QUAT_W
from helpers.simulation.worlds import jerky_actions

FEEDING = "avrgym/FeedingJaco-v1"
STILL = np.zeros((1, 7))
FREE_MARGIN, RELEASE_MARGIN = 1.4, 3.0
"""How far joint speeds go beyond the limit, as factors: in free motion when all joints reverse at full speed, and
when a blocked arm comes free."""


def reset_episodes(
    worlds: int,
    environment: str = FEEDING,
    *,
    people: str = "revised",
    threads: int = 2,
    seed: int = 0,
    **how,
) -> Episodes:
    episodes = Episodes(environment, worlds, people=people, num_threads=threads, **how)
    episodes.reset(np.arange(worlds), [np.random.default_rng(seed + i) for i in range(worlds)])
    return episodes


def states(simulation: Simulation) -> np.ndarray:
    return np.stack([simulation.get_integration_state(world) for world in range(simulation.num_worlds)])


# Determinism


def test_threads_change_no_bit(rng):
    actions = rng.uniform(-1, 1, (10, 16, 7))
    one, two = (reset_episodes(16, threads=threads) for threads in (1, 2))
    for action in actions:
        first, second = one.step(action), two.step(action)
        assert_array_equal(first.observation, second.observation)
        assert_array_equal(first.reward, second.reward)
    assert_array_equal(states(one.simulation), states(two.simulation))


def test_two_halves_of_a_control_step_are_the_whole(rng):
    whole, halves = reset_episodes(8), reset_episodes(8)
    for action in rng.uniform(-1, 1, (5, 8, 7)):
        whole.step(action)
        halves.command_robots(action)
        halves.simulation.step(5)
        halves.simulation.step(5)
        halves.evaluate_step(action)
    assert_array_equal(states(whole.simulation), states(halves.simulation))


def test_a_new_episode_leaves_other_worlds_alone(rng):
    one, other = reset_episodes(6), reset_episodes(6)
    other.reset(np.array([1, 4]), [np.random.default_rng(99), np.random.default_rng(98)])
    action = rng.uniform(-1, 1, (6, 7))
    untouched = [0, 2, 3, 5]
    assert_array_equal(one.step(action).observation[untouched], other.step(action).observation[untouched])


def test_an_episode_does_not_remember_the_one_before(rng):
    fresh, used = reset_episodes(4), reset_episodes(4, seed=50)
    for action in rng.uniform(-1, 1, (5, 4, 7)):
        used.step(action)
    used.reset(np.arange(4), [np.random.default_rng(i) for i in range(4)])
    assert_array_equal(states(fresh.simulation)[:, 1:], states(used.simulation)[:, 1:])  # less the time
    action = rng.uniform(-1, 1, (4, 7))
    assert_array_equal(fresh.step(action).observation, used.step(action).observation)


# People


def test_each_world_has_a_person_of_its_own():
    """The world's model is that person's: geom sizes, places and the pose of the head."""
    episodes = reset_episodes(8)
    state = episodes.simulation.get_state()
    assert len(np.unique(state.head_pos_w.round(6), axis=0)) == 8
    for world in range(8):
        person = episodes.get_person(world)
        pos, q = human.compute_body_frames(distributions.repeat_person(person, 1))
        frames = human.compute_body_layout(
            np.array([person.sex == "woman"]), np.array([person.torso_height_m])
        )
        centre = pos["head"] + transforms.rotate(q["head"], frames.site_pos["head_centre"])
        assert_allclose(state.head_pos_w[world], centre[0], atol=1e-9)
        assert_allclose(transforms.angle_between(state.head_quat_w[world], q["head"][0]), 0, atol=1e-7)
        for column, name in enumerate(human.GEOMS):
            assert state.person_radius_m[world, column] == pytest.approx(frames.geom_size[name][0, 0])


def test_a_moving_person_is_the_same_body_as_a_static_one():
    person = Person("man", 0.55, human.make_seated_joint_angles(head_z=20.0, waist_x=10.0))
    static, moving = (
        reset_episodes(1, person=person, moving=moving).simulation.get_state() for moving in (False, True)
    )
    assert_allclose(static.head_pos_w, moving.head_pos_w, atol=1e-9)
    assert_allclose(static.mouth_pos_w, moving.mouth_pos_w, atol=1e-9)
    assert_allclose(static.person_capsule_ends_w, moving.person_capsule_ends_w, atol=1e-9)
    assert_allclose(static.person_radius_m, moving.person_radius_m, atol=1e-9)


def test_a_moving_person_goes_where_the_targets_are():
    """Within 2 degrees after a second: waist and head twice as far as in a rollout, arms anywhere near."""
    episodes = reset_episodes(1, person=Person("woman", 0.54), moving=True)
    target = human.make_seated_joint_angles(
        waist_x=15.0, waist_y=10.0, head_y=-10.0, head_z=40.0, left_elbow_x=-60.0
    )
    episodes.simulation.command_person(target[None])
    episodes.simulation.step(100)
    assert_allclose(episodes.simulation.get_person_joint_angles_rad()[0], target, atol=np.radians(2.0))


# The arm


def test_without_an_action_the_arm_holds():
    episodes = reset_episodes(8)
    before = episodes.simulation.get_state().joint_positions
    for _ in range(20):
        episodes.step(np.zeros((8, 7)))
    assert_allclose(episodes.simulation.get_state().joint_positions, before, atol=1e-3)


def test_the_arm_stops_within_half_a_second_of_full_speed(rng):
    episodes = reset_episodes(8)
    for action in jerky_actions(rng, 8, 5):
        episodes.step(action)
    for _ in range(5):
        episodes.step(np.zeros((8, 7)))
    simulation = episodes.simulation
    free = [not _robot_touches(simulation.model, simulation.batch.get_data(world)) for world in range(8)]
    assert sum(free) >= 6
    before = simulation.get_state().joint_positions
    for _ in range(5):
        episodes.step(np.zeros((8, 7)))
    assert_allclose(simulation.get_state().joint_positions[free], before[free], atol=0.01)


def test_joints_move_as_fast_as_they_are_told():
    """After half a second, each within 15 % of its speed."""
    episodes = reset_episodes(1, person=Person())
    limit = episodes.scene.arm.speed_limit
    command = np.array([[0.5, -0.5, 0.5, 0.5, -0.5, 0.5, 0.5]])
    for _ in range(5):
        episodes.step(command)
    before = episodes.simulation.get_state().joint_positions
    episodes.step(command)
    moved = episodes.simulation.get_state().joint_positions - before
    assert_allclose(moved / 0.1, command * limit, atol=0.15 * 0.5 * limit.max())


@pytest.mark.slow
def test_no_joint_is_much_faster_than_its_limit(rng):
    worlds = 6
    episodes = reset_episodes(worlds)
    simulation, model = episodes.simulation, episodes.simulation.model
    joints = [model.joint(ROBOT + name).dofadr[0] for name in episodes.scene.arm.joints]
    velocity = simulation.batch.bind("qvel")
    last_touch = np.full(worlds, -1000)
    free = fastest = 0.0
    for tick, action in enumerate(np.repeat(jerky_actions(rng, worlds, 30), 5, axis=0)):
        if tick % 5 == 0:
            episodes.command_robots(action)
        simulation.step(2)
        speed = (np.abs(velocity[:, joints]) / episodes.scene.arm.speed_limit).max(axis=1)
        for world in range(worlds):
            if _robot_touches(model, simulation.batch.get_data(world)):
                last_touch[world] = tick
        untouched = tick - last_touch > 25
        free, fastest = max(free, *speed[untouched], 0.0), max(fastest, speed.max())
    assert 1.0 < free < FREE_MARGIN
    assert fastest < RELEASE_MARGIN


def _robot_touches(model: mujoco.MjModel, data: mujoco.MjData) -> bool:
    """Whether the robot, or the tool it holds, touches anything but the food on the tool."""
    pairs = [(model.geom_bodyid[contact.geom1], model.geom_bodyid[contact.geom2]) for contact in data.contact]
    names = [{model.body(first).name, model.body(second).name} for first, second in pairs]
    return any(
        any(name.startswith(ROBOT) for name in pair) and not any(name.startswith("food") for name in pair)
        for pair in names
    )


# Food


def test_food_stays_on_a_still_spoon():
    """All pieces of 16 worlds for 5 s, none moving more than 2 mm after it has settled."""
    episodes = reset_episodes(16)

    def on_tool() -> np.ndarray:
        state = episodes.simulation.get_state()
        offset = state.particle_pos_w - state.tool_pos_w[:, None]
        return transforms.rotate(transforms.conjugate(state.tool_quat_w)[:, None], offset)

    for _ in range(10):
        episodes.step(np.zeros((16, 7)))
    settled = on_tool()
    assert np.abs(settled[..., 0]).max() < 0.03
    assert np.abs(settled[..., 1]).max() < 0.02
    assert np.abs(settled[..., 2]).max() < 0.01
    for _ in range(40):
        episodes.step(np.zeros((16, 7)))
    assert_allclose(on_tool(), settled, atol=0.002)


def test_parked_food_rests_far_from_everything():
    episodes = reset_episodes(2)
    gone = np.zeros((2, 8), dtype=bool)
    gone[0, [2, 7]] = gone[1, 0] = True
    episodes.simulation.remove_particles(gone)
    for _ in range(10):
        episodes.step(np.zeros((2, 7)))
    state = episodes.simulation.get_state()
    assert_allclose(state.particle_pos_w[gone], np.broadcast_to(REMOVED_PARTICLE_POS_W, (3, 3)), atol=0.2)
    assert np.abs(state.particle_velocity_w[gone]).max() < 1e-3
    beside = np.abs(state.particle_pos_w[~gone] - np.repeat(state.tool_pos_w, [6, 7], axis=0))
    assert beside.max() < 0.05


# Forces


def pressed(scene) -> Simulation:
    """A world in which the spoon's tip presses on the middle of the face."""
    simulation = Simulation(scene, 1, num_threads=1)
    who = distributions.repeat_person(Person("man", 0.60), 1)
    head = human.compute_body_frames(who)[0]["head"]
    tool = head + np.array([0.0, -0.135, 0.06])
    bowl = {BOWL_BODY: np.array([BOWL_INITIAL_POS_M])}
    level, uniforms = INITIAL_SPOON_QUAT_W[None], np.full((1, placement.NUM_RANDOM_NUMBERS), 0.5)
    start = placement.find_initial_state(
        scene, who, bowl, tool, level, tool[:, None], level[:, None], uniforms
    )
    simulation.reset(np.array([0]), start)
    for _ in range(8):
        now = simulation.get_state().joint_positions
        _, _, jacobian = kinematics.compute_jacobian(placement.make_arm_chain(scene), now)
        ahead = transforms.rotate(transforms.conjugate(start.robot_base_quat_w[0]), [0.0, 0.06, 0.0])
        rates = np.linalg.pinv(jacobian[0]) @ np.concatenate([ahead, np.zeros(3)])
        simulation.command_robot((rates / scene.arm.speed_limit)[None])
        simulation.step()
    return simulation


def contact_force(model: mujoco.MjModel, data: mujoco.MjData, by: str, on: str) -> np.ndarray:
    """The sum (3,), world frame, of contact forces by bodies whose names begin with ``by`` on those with ``on``."""
    total, force = np.zeros(3), np.zeros(6)
    for index, contact in enumerate(data.contact):
        first, second = (model.body(model.geom_bodyid[geom]).name for geom in (contact.geom1, contact.geom2))
        mujoco.mj_contactForce(model, data, index, force)
        on_second = contact.frame.reshape(3, 3).T @ force[:3]
        if first.startswith(by) and second.startswith(on):
            total += on_second
        elif first.startswith(on) and second.startswith(by):
            total -= on_second
    return total


def test_the_force_sensors_are_the_sums_of_contact_forces(feeding_scene):
    simulation = pressed(feeding_scene)
    simulation.step(9)
    data, model = simulation.batch.get_data(0), simulation.batch.get_model(0)
    mujoco.mj_forward(model, data)
    by_tool = contact_force(model, data, SCENE_TOOL_BODY, human.PERSON_NAME_PREFIX)
    by_robot = contact_force(model, data, ROBOT, human.PERSON_NAME_PREFIX)
    simulation.step(1)
    state = simulation.get_state()
    assert by_tool[1] > 5.0  # towards the person's back
    assert_allclose(state.tool_force_n[0], np.linalg.norm(by_tool), rtol=1e-9)
    assert_allclose(state.robot_force_n[0], np.linalg.norm(by_robot), rtol=1e-9)


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData, by: str) -> list[float]:
    """The lengths of the forces of contacts between bodies whose names begin with ``by`` and the person."""
    lengths, force = [], np.zeros(6)
    for index, contact in enumerate(data.contact):
        names = {model.body(model.geom_bodyid[geom]).name for geom in (contact.geom1, contact.geom2)}
        if any(n.startswith(by) for n in names) and any(
            n.startswith(human.PERSON_NAME_PREFIX) for n in names
        ):
            mujoco.mj_contactForce(model, data, index, force)
            lengths.append(float(np.linalg.norm(force[:3])))
    return lengths


@pytest.mark.slow
def test_forces_on_the_person_add_up_over_contacts_of_links_and_tool():
    """A robot that flails among people for 4 s; nothing that presses from two sides cancels out."""
    simulation, by_links = reset_episodes(16, "avrgym/ScratchItchJaco-v1").simulation, 0
    for action in jerky_actions(np.random.default_rng(3), 16, 40):
        simulation.command_robot(action)
        simulation.step(9)
        expected = []
        for world in range(16):
            model, data = simulation.batch.get_model(world), simulation.batch.get_data(world)
            mujoco.mj_forward(model, data)
            expected.append([sum(contact_forces(model, data, by)) for by in (ROBOT, SCENE_TOOL_BODY)])
        total, tool = np.array(expected).T
        simulation.step(1)
        state = simulation.get_state()
        assert_allclose(state.total_force_n, total, rtol=1e-6, atol=1e-9)
        assert_allclose(state.links_force_n, total - tool, rtol=1e-6, atol=1e-6)
        assert (state.total_force_n >= state.robot_force_n * (1.0 - 1e-9)).all()
        by_links += (state.links_force_n > 1.0).sum()
    assert by_links > 0


def test_an_untouched_person_feels_nothing():
    state = reset_episodes(8).simulation.get_state()
    assert_array_equal(state.tool_force_n, 0.0)
    assert_array_equal(state.robot_force_n, 0.0)
    assert_array_equal(state.total_force_n, 0.0)
    assert_array_equal(state.links_force_n, 0.0)


# Stability


def test_random_actions_keep_everything_finite_and_without_a_warning(rng):
    """2 000 control steps over 64 worlds, at full speed one way or the other."""
    episodes = reset_episodes(64)
    for action in jerky_actions(rng, 64, 32):
        step = episodes.step(action)
        assert np.isfinite(step.observation).all()
        assert np.isfinite(step.reward).all()
    for world in range(64):
        warnings = [int(warning.number) for warning in episodes.simulation.batch.get_data(world).warning]
        assert not any(warnings), (world, warnings)


def test_a_warning_would_be_seen(capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its log
    episodes = reset_episodes(1)
    episodes.simulation.batch.bind("qvel")[0, 0] = np.nan
    episodes.simulation.step(1)
    assert any(warning.number for warning in episodes.simulation.batch.get_data(0).warning)
    capfd.readouterr()


def test_a_state_does_not_change_with_the_world(rng):
    episodes = reset_episodes(2, people="participants")
    state = episodes.simulation.get_state()
    before = {name: np.copy(value) for name, value in vars(state).items() if isinstance(value, np.ndarray)}
    for action in jerky_actions(rng, 2, 10):
        episodes.step(action)
    for name, value in before.items():
        assert_array_equal(getattr(state, name), value, err_msg=name)
