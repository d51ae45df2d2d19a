"""Learning version 1: the normaliser learns at every step, chance is drawn for all worlds at once.

Trainings that were begun so go on so, to the same bits; new ones learn by ``updates``.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning import checkpoint
from avrgym.learning.configuration import TrainingConfiguration
from avrgym.learning.course import CHECKPOINT_FILE, Course
from avrgym.learning.imitation import Finished, Gather, Shown, imitate
from avrgym.learning.ppo import OBSERVATION_CLIP, begin_update, free_actor, make_ppo, steps_of
from avrgym.learning.stable_baselines import (
    ObservationScale,
    SB3VectorEnv,
    Trainee,
    finished_episodes,
    go_on_from,
)
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.known import EPISODE_STEPS


class StepwiseLearner:
    """A model that learns over an environment of its own."""

    def __init__(self, configuration: TrainingConfiguration, people: str, out: Path, course: Course) -> None:
        self._configuration, self._out, self._course = configuration, out, course
        native = AssistiveVectorEnv(
            configuration.environment,
            configuration.worlds,
            people=people,
            impairment=configuration.impairment,
            num_threads=configuration.threads,
        )
        self._env = SB3VectorEnv(native)
        self._env.detour_weight_per_m = configuration.detour_weight_per_m
        self._normaliser = VecNormalize(self._env, gamma=configuration.discount, clip_obs=OBSERVATION_CLIP)
        self._normaliser.obs_rms = ObservationScale(native.episodes.observation)
        self.model = make_ppo(configuration, self._normaliser, out)
        self._trainees = (Trainee(self.model, self._normaliser),)

    def restore(self) -> None:
        """Go on from the checkpoint."""
        episodes, notes = checkpoint.restore(self._out / CHECKPOINT_FILE, self._trainees)
        go_on_from(self.model, self._env.env.begin_again_from(episodes))
        self._course.resume(notes)

    def save(self) -> None:
        """Save where the training is, between two updates."""
        self._course.save(self._trainees, self._env.env.drawn_from)

    def imitate(self, rounds: int, shown: Path) -> None:
        """Do the rounds of imitation that remain."""
        configuration, model = self._configuration, self.model
        if not model.num_timesteps:
            self._normaliser.reset()
        episodes = self._env.env.episodes
        gather = _gatherer(model, self._normaliser, episodes)
        imitate(
            model,
            self._normaliser,
            configuration.worlds,
            rounds,
            configuration.seed,
            shown,
            gather,
            self._imitated,
        )
        go_on_from(model, episodes.observe())

    def _imitated(self, finished: Finished) -> None:
        self._course.imitated(steps_of(self.model), finished)
        self.save()

    def learn(self, steps: int) -> None:
        """Make so many environment steps more."""
        watch = _Watch(self, self._configuration, self._course, self._env)
        self.model.learn(steps, callback=watch, reset_num_timesteps=False)
        self.save()


class _Watch(BaseCallback):
    """Gathers finished episodes, logs each update, and saves policy and checkpoint before the next.

    An update's episodes are whole, so that each checkpoint lies between episodes.
    """

    def __init__(
        self,
        learner: StepwiseLearner,
        configuration: TrainingConfiguration,
        course: Course,
        env: SB3VectorEnv,
    ) -> None:
        super().__init__()
        self._learner, self._configuration, self._course, self._env = learner, configuration, course, env

    def _on_rollout_start(self) -> None:
        configuration = self._configuration
        assert isinstance(self.model, PPO)
        if configuration.hard_share > 0.0:
            chosen = self._course.hard.choose(self.num_timesteps)
            go_on_from(self.model, self._env.begin([*chosen]))
        self._learner.save()
        begin_update(self.model, configuration)
        self._env.force_weight_per_n = configuration.force_weight_at(self.num_timesteps)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert isinstance(self.model, PPO)
        infos, hard = self.locals["infos"], self._course.hard
        if self._configuration.hard_share > 0.0:
            hard.judge(*([info[name] for info in infos] for name in ("success", "episode_force_n")))
        self._course.hear("PPO", self.num_timesteps, finished_episodes(infos[hard.again :]))
        _, reward, success = self._course.latest
        self.logger.record("rollout/reward_mean", reward)
        self.logger.record("rollout/success_rate", success)
        free_actor(self.model, self._configuration)


def _gatherer(model: PPO, normaliser: VecNormalize, episodes: Episodes) -> Gather:
    """Makes one episode in every world: what the expert showed, and return and success of the policy's own."""

    def gather(by_expert: NDArray[np.bool_]) -> tuple[Shown, Finished]:
        expert = episodes.task.reactive_expert(episodes)
        observation = episodes.observe()
        seen: list[NDArray[np.float64]] = []
        shown: list[NDArray[np.float64]] = []
        infos: list[dict[str, Any]] = []
        for _ in range(EPISODE_STEPS):
            seen.append(observation)
            shown.append(np.clip(expert(observation), -1.0, 1.0))
            own, _ = model.predict(np.asarray(normaliser.normalize_obs(observation)), deterministic=True)
            actions = np.where(by_expert[:, None], shown[-1], own)
            infos = cast(list[dict[str, Any]], normaliser.step(actions)[3])
            observation = np.asarray(normaliser.get_original_obs())
        own_infos = [info for info, shows in zip(infos, by_expert, strict=True) if not shows]
        observations, actions = (np.concatenate(rows).astype(np.float32) for rows in (seen, shown))
        return Shown(observations, actions), finished_episodes(own_infos)

    return gather
