import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="training is an extra")

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning.imitation import imitate
from avrgym.learning.stable_baselines import SB3VectorEnv
from avrgym.tasks.episodes import Episodes

FEEDING = "avrgym/FeedingJaco-v1"
WORLDS, ROUNDS = 8, 4


@pytest.fixture(scope="module")
def imitated(tmp_path_factory) -> tuple[PPO, list[int]]:
    """A model after four rounds, and after how many steps it had driven episodes of its own."""
    shown = tmp_path_factory.mktemp("imitation") / "shown"
    native = AssistiveVectorEnv(FEEDING, WORLDS, people="revised", num_threads=1)
    model = PPO("MlpPolicy", VecNormalize(SB3VectorEnv(native)), n_steps=200, seed=3, device="cpu")
    heard: list[int] = []

    def hear(finished: list[tuple[float, bool]]) -> None:
        if finished:
            heard.append(model.num_timesteps)

    imitate(model, native.episodes, ROUNDS, 3, shown, hear)
    return model, heard


def test_the_policy_does_as_its_expert_does_with_people_it_never_met(imitated):
    model, _ = imitated
    normaliser = model.get_env()
    assert isinstance(normaliser, VecNormalize)
    episodes = Episodes(FEEDING, WORLDS, distribution="revised", num_threads=1)
    episodes.begin(np.arange(WORLDS), [np.random.default_rng([9, i]) for i in range(WORLDS)])
    expert = episodes.task.reactive_expert(episodes)
    shown, done = [], []
    for _ in range(40):
        observation = episodes.observe()
        shown.append(expert(observation))
        done.append(model.predict(np.asarray(normaliser.normalize_obs(observation)), deterministic=True)[0])
        episodes.step(shown[-1])
    difference, size = (np.mean(np.square(part)) for part in (np.subtract(shown, done), shown))
    assert difference < 0.5 * size


def test_only_episodes_of_the_policy_are_told_of(imitated):
    """The expert drives every world in the first round."""
    _, heard = imitated
    steps = WORLDS * 200
    assert set(heard) <= {2 * steps, 3 * steps, 4 * steps}
    assert 4 * steps in heard


def test_ppo_goes_on_where_imitation_ended(imitated):
    model, _ = imitated
    normaliser, last = model.get_env(), model._last_obs
    assert isinstance(normaliser, VecNormalize)
    native = normaliser.venv
    assert isinstance(native, SB3VectorEnv)
    np.testing.assert_array_equal(last, normaliser.normalize_obs(native.env.episodes.observe()))
    assert model._last_episode_starts is not None
    assert model._last_episode_starts.all()
