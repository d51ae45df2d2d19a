import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.learning.configuration import FeedforwardConfiguration
from avrgym.learning.feedforward_recipe import FeedforwardRecipe
from avrgym.learning.recipe import UpdateResults
from avrgym.policies.trained_policies import PolicyMetadata
from avrgym.tasks.episodes import Episodes

FEEDING = "avrgym/FeedingJaco-v1"
WORLDS, ROUNDS = 8, 4
CONFIGURATION = FeedforwardConfiguration(
    environment=FEEDING, people="revised", num_envs=WORLDS, seed=3, threads=1, imitation_rounds=ROUNDS
)


@pytest.fixture(scope="module")
def imitated(tmp_path_factory) -> tuple[FeedforwardRecipe, list[UpdateResults]]:
    """A recipe after four rounds of imitation, and the results of each."""
    recipe = FeedforwardRecipe(CONFIGURATION, tmp_path_factory.mktemp("imitation"))
    return recipe, [recipe.update() for _ in range(ROUNDS)]


@pytest.mark.slow
def test_the_policy_acts_like_its_expert_with_new_people(imitated):
    policy = imitated[0].policies(PolicyMetadata(environment=FEEDING, people="", steps=0, seed=0))[0]
    episodes = Episodes(FEEDING, WORLDS, people="revised", num_threads=1)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng([9, i]) for i in range(WORLDS)])
    expert = episodes.task.feedback_expert(episodes)
    demonstrated, imitating = [], []
    for _ in range(40):
        observation = episodes.observe()
        demonstrated.append(expert(observation))
        imitating.append(policy.compute_mean_actions(observation))
        episodes.step(demonstrated[-1])
    error, size = (np.mean(np.square(part)) for part in (np.subtract(demonstrated, imitating), demonstrated))
    assert error < 0.5 * size


@pytest.mark.slow
def test_results_are_of_episodes_that_the_policy_drove(imitated):
    """The expert drives every world in the first round."""
    first, *_, last = imitated[1]
    assert first.stage == last.stage == "imitation"
    assert first.reward_mean is None
    assert last.reward_mean is not None
