import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="training is an extra")


from avrgym.learning.course import Course
from avrgym.learning.training import Progress, TrainingConfiguration
from avrgym.learning.updates import UpdateLearner, make_here
from avrgym.tasks.episodes import Episodes

FEEDING = "avrgym/FeedingJaco-v1"
WORLDS, ROUNDS = 8, 4


HOW = TrainingConfiguration(
    environment=FEEDING, people="revised", worlds=WORLDS, seed=3, threads=1, imitation_rounds=ROUNDS
)


@pytest.fixture(scope="module")
def imitated(tmp_path_factory) -> tuple[UpdateLearner, list[int]]:
    """A learner after four rounds, and after how many steps it had driven episodes of its own."""
    out = tmp_path_factory.mktemp("imitation")
    heard: list[Progress] = []
    learner = UpdateLearner(HOW, "revised", out, Course(HOW, out, heard.append), 1, make_here, 1)
    learner.imitate(ROUNDS, out / "shown")
    return learner, [progress.steps for progress in heard if progress.reward_mean is not None]


@pytest.mark.slow
def test_the_policy_does_as_its_expert_does_with_people_it_never_met(imitated):
    policy = imitated[0].save()[0]
    episodes = Episodes(FEEDING, WORLDS, distribution="revised", num_threads=1)
    episodes.begin(np.arange(WORLDS), [np.random.default_rng([9, i]) for i in range(WORLDS)])
    expert = episodes.task.feedback_expert(episodes)
    shown, done = [], []
    for _ in range(40):
        observation = episodes.observe()
        shown.append(expert(observation))
        done.append(policy.mean(observation))
        episodes.step(shown[-1])
    difference, size = (np.mean(np.square(part)) for part in (np.subtract(shown, done), shown))
    assert difference < 0.5 * size


@pytest.mark.slow
def test_only_episodes_of_the_policy_are_told_of(imitated):
    """The expert drives every world in the first round."""
    _, heard = imitated
    steps = WORLDS * 200
    assert set(heard) <= {2 * steps, 3 * steps, 4 * steps}
    assert 4 * steps in heard
