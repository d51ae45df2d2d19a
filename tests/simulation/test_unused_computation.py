"""What physics leaves out changes no bit, and is nothing that could touch or move."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.models import collision_bits
from avrgym.models.robot import ROBOT_NAME_PREFIX
from avrgym.simulation.unused_computation import remove_unused_computation
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS

LEFT_OUT = ("body_gravcomp", "geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity")


def reset_episodes(environment: str, *, moving: bool) -> Episodes:
    episodes = Episodes(environment, 1, num_threads=1, moving=moving)
    episodes.reset(np.array([0]), [np.random.default_rng(3)])
    return episodes


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(6)
def test_every_step_gives_the_bits_that_the_whole_model_gives(environment, moving):
    simulation = reset_episodes(environment, moving=moving).simulation
    light = simulation.batch.get_model(0)
    whole = simulation.batch.get_model(0)
    for field in LEFT_OUT:
        getattr(whole, field)[:] = getattr(simulation.model, field)
    state = simulation.get_integration_state()
    worlds = [(model, mujoco.MjData(model)) for model in (light, whole)]
    for model, data in worlds:
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    rng = np.random.default_rng(0)
    for _ in range(40):
        command = rng.uniform(-1.0, 1.0, light.nu)
        for model, data in worlds:
            data.ctrl[:] = command
            mujoco.mj_step(model, data)
        (_, one), (_, other) = worlds
        for field in ("qpos", "qvel", "sensordata", "qfrc_passive", "qfrc_constraint"):
            assert getattr(one, field).tobytes() == getattr(other, field).tobytes(), field
        assert_array_equal(one.contact.geom, other.contact.geom)


def test_of_a_robot_beside_still_people_only_what_moves_may_touch():
    model = reset_episodes("avrgym/FeedingPR2-v1", moving=False).simulation.batch.model
    robots = [geom for geom in range(model.ngeom) if of_body(model, geom).startswith(ROBOT_NAME_PREFIX)]
    still = [geom for geom in robots if model.body_weldid[model.geom_bodyid[geom]] == 0]
    assert still
    assert not model.geom_contype[still].any()
    assert not model.geom_conaffinity[still].any()
    moved = [geom for geom in robots if geom not in still]
    assert model.geom_contype[moved].all()


def test_people_who_move_may_touch_a_robots_base():
    simulation = reset_episodes("avrgym/FeedingPR2-v1", moving=True).simulation
    for field in LEFT_OUT[1:]:
        assert_array_equal(getattr(simulation.batch.model, field), getattr(simulation.model, field), field)


def test_the_model_itself_stays_whole():
    simulation = reset_episodes("avrgym/FeedingPR2-v1", moving=False).simulation
    before = {field: getattr(simulation.model, field).copy() for field in LEFT_OUT}
    remove_unused_computation(simulation.model)
    for field, values in before.items():
        assert_array_equal(getattr(simulation.model, field), values, field)
    assert (simulation.model.geom_contype == collision_bits.ROBOT.contype).sum() > 20


def of_body(model: mujoco.MjModel, geom: int) -> str:
    return model.body(model.geom_bodyid[geom]).name
