"""Partners of the zoo that command the robot."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.commands.preferences import SPEED_FACTOR_STEP
from avrgym.people.population_names import ALLOWED_PEOPLE_TEXT, TRAIN_ZOO, UNSEEN_ZOO
from avrgym.people.zoo.commanding_partners import COMMANDING_PARTNER_SETS, PartnerCommands
from avrgym.people.zoo.partners import PARTNERS, ZOO_PARTNER_SETS
from avrgym.people.zoo.styles import COMMAND_PARAMETER_SOURCES, COMMANDING_STYLE_NAME
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy, find_policy_file
from avrgym.safety.pacing import WAITING_MODE
from avrgym.tasks.episodes import Episodes

ENVIRONMENT, STEP_S = "avrgym/FeedingJaco-v1", 0.1


def test_only_populations_of_their_name_contain_them() -> None:
    assert COMMANDING_STYLE_NAME in ALLOWED_PEOPLE_TEXT
    assert COMMANDING_STYLE_NAME not in {partner.style for partner in PARTNERS}
    assert not set(COMMANDING_PARTNER_SETS) & set(ZOO_PARTNER_SETS)
    trained, unseen = (
        COMMANDING_PARTNER_SETS[f"{zoo}/{COMMANDING_STYLE_NAME}"].command_parameters
        for zoo in (TRAIN_ZOO, UNSEEN_ZOO)
    )
    for name in COMMAND_PARAMETER_SOURCES:
        assert not set(getattr(trained, name)) & set(getattr(unseen, name))


def test_commands_follow_the_parameters() -> None:
    """Ready comes after the delay, the speed becomes comfortable, and the rate of waits is that of each partner."""
    worlds, rng = 40, np.random.default_rng(0)
    people = PartnerCommands(COMMANDING_PARTNER_SETS[f"{TRAIN_ZOO}/{COMMANDING_STYLE_NAME}"], worlds)
    uniforms = rng.random((worlds, 3))
    people.reset(np.arange(worlds), uniforms)
    own = COMMANDING_PARTNER_SETS[f"{TRAIN_ZOO}/{COMMANDING_STYLE_NAME}"]
    parameters = own.command_parameters.select_partners(own.sample_partner_rows(uniforms[:, :2]))
    speed, waits, before = np.ones(worlds), np.zeros(worlds), people.snapshot()
    for _ in range(600):
        waits += dict(people.step(np.zeros(worlds, dtype=bool), speed, STEP_S))["wait"]
    assert (np.abs(waits - parameters.wait_commands_per_min) <= 1.0).all()
    people.restore(before)
    waiting, ready_s = np.ones(worlds, dtype=bool), np.full(worlds, np.inf)
    for step in range(30):
        given = dict(people.step(waiting, speed, STEP_S))
        assert not given["wait"].any()
        assert step == 0 or not (given["slower"] | given["faster"]).any()
        speed = speed + SPEED_FACTOR_STEP * (given["faster"].astype(float) - given["slower"])
        ready_s = np.where(given["ready"], np.minimum(ready_s, STEP_S * (step + 1)), ready_s)
    assert (np.abs(ready_s - parameters.ready_delay_s) <= STEP_S).all()
    assert (
        np.abs(speed - parameters.comfortable_speed) < np.abs(1.0 - parameters.comfortable_speed) + 1e-9
    ).all()


def test_the_robot_waits_for_them_and_a_copy_continues_bit_identically() -> None:
    episodes = Episodes(ENVIRONMENT, 2, people=f"{TRAIN_ZOO}/{COMMANDING_STYLE_NAME}", num_threads=1)
    generators = [np.random.default_rng(seed) for seed in range(2)]
    episodes.reset(np.arange(2), generators)
    policy = Policy.load(find_policy_file("revised", ENVIRONMENT))
    act = registry.make_action_function(policy, episodes, generators)
    pacing, waited, gone_on = episodes.control_loop.pacing, np.zeros(2, dtype=bool), np.zeros(2, dtype=bool)
    assert pacing is not None
    observation = episodes.observe()
    for _ in range(140):
        observation = episodes.step(act(observation)).observation
        waited |= pacing.mode_index == WAITING_MODE
        gone_on |= waited & (pacing.mode_index != WAITING_MODE)
    assert gone_on.all()
    copy = pickle.loads(pickle.dumps(episodes))
    for _ in range(5):
        action = act(observation)
        observation = episodes.step(action).observation
        assert_array_equal(copy.step(action).observation, observation)


def test_they_need_an_engine_with_the_pacing_layer() -> None:
    with pytest.raises(ValueError, match="people that give commands are not possible with engine 'warp'"):
        Episodes(ENVIRONMENT, 1, people=f"{TRAIN_ZOO}/{COMMANDING_STYLE_NAME}", engine="warp")
