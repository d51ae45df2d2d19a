"""Learning version 2: whole updates at a time, whose episodes any number of processes may make.

Within an update policy and normaliser stay as they are, and each world draws its own chance. So an update's episodes
follow from the policy, the training's seed and the steps so far, and the weights do not depend on who made which.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import configure_logger

from avrgym.array_types import BoolArray, Float32Array
from avrgym.geometry.arrays import moved_to, namespace, to_numpy
from avrgym.learning import checkpoint
from avrgym.learning.configuration import TrainingConfiguration, turn
from avrgym.learning.course import CHECKPOINT_FILE, Course
from avrgym.learning.imitation import Finished, Shown, imitate
from avrgym.learning.ppo import OBSERVATION_CLIP, begin_update, free_actor, make_ppo, steps_of
from avrgym.learning.rollouts import Order, Place, Rollout, roll_out_all
from avrgym.learning.stable_baselines import ObservationScale, Scaled, Trainee
from avrgym.people.populations import carried_people
from avrgym.policies.trained import Policy
from avrgym.system.engines import THREADS
from avrgym.tasks.human_view import human_view_of
from avrgym.tasks.observation import Observation
from avrgym.tasks.registry import sizes, task_and_scene

MakeAll = Callable[[Sequence[Policy], Sequence[Order]], list[list[Rollout]]]
"""Makes the episodes of several orders, wherever; of each what ``rollouts.roll_out_all`` gives."""
Improve = Callable[[PPO, Any, Any, Any], object]
"""Lets a model learn from whole episodes that were cut off: normalised observations (T + 1, N, O), the last of them
after the last step, actions (T, N, J) and scaled rewards (T, N), of single precision, where their worlds are."""
NAMES = "PPO", "human"
"""What TensorBoard's log calls the robot and the human."""


def make_here(policies: Sequence[Policy], orders: Sequence[Order]) -> list[list[Rollout]]:
    """Make them in this process, one after the other."""
    return [roll_out_all(policies, order) for order in orders]


def improve_here(model: PPO, observations: Any, actions: Any, rewards: Any) -> None:
    """Let Stable-Baselines3 improve it, in this process."""
    _fill(model, observations, actions, rewards)
    model.train()


class UpdateLearner:
    """Models that are given the episodes of each update, from ``parts`` beside each other that ``make_all`` makes.

    The first is the robot's ``model``; where robot and human are trained together there is the human's, too.
    ``improve`` lets one learn from them. Experts drive on threads, whatever the engine.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        people: str,
        out: Path,
        course: Course,
        parts: int,
        make_all: MakeAll,
        threads: int,
        improve: Improve = improve_here,
    ) -> None:
        self._configuration, self._out, self._course = configuration, out, course
        whom = carried_people(people)
        self._places = {
            engine: Place(configuration.environment, whom, configuration.impairment, threads, engine)
            for engine in (THREADS, configuration.engine)
        }
        self._parts = np.array_split(np.arange(configuration.worlds), parts)
        self._make_all, self._improve = make_all, improve
        self._trainees = trainees_of(configuration, out)
        self.model = self._trainees[0].model

    @property
    def place(self) -> Place:
        """Where PPO's episodes are made."""
        return self._places[self._configuration.engine]

    def restore(self) -> None:
        """Go on from the checkpoint."""
        _, notes = checkpoint.restore(self._out / CHECKPOINT_FILE, self._trainees)
        self._course.resume(notes)

    def save(self) -> list[Policy]:
        """Save where the training is, between two updates; the policies as they are now."""
        return self._course.save(self._trainees, [])

    def imitate(self, rounds: int, shown: Path) -> None:
        """Do the rounds of imitation that remain."""
        configuration = self._configuration
        imitate(
            self.model,
            self._trainees[0].normaliser,
            configuration.worlds,
            rounds,
            configuration.seed,
            shown,
            self._gather,
            self._imitated,
        )

    def _gather(self, by_expert: BoolArray) -> tuple[Shown, Finished]:
        rollouts = self._roll_out(self._course.policies(self._trainees), by_expert=by_expert)
        for trainee, each in zip(self._trainees, rollouts, strict=True):
            trainee.normaliser.see(each)
        rollout = rollouts[0]
        observations = rollout.observations[:-1]
        shown = Shown(*(array.reshape(-1, array.shape[-1]) for array in (observations, rollout.actions)))
        return shown, rollout.finished(~by_expert)

    def _imitated(self, finished: Finished) -> None:
        self._count(steps_of(self.model))
        self._course.imitated(steps_of(self.model), finished)
        self.save()

    def learn(self, steps: int) -> None:
        """Make so many environment steps more, whole updates."""
        configuration = self._configuration
        last = steps_of(self.model) + steps
        for (model, _), name in zip(self._trainees, NAMES, strict=False):
            model.set_logger(configure_logger(0, model.tensorboard_log, name, reset_num_timesteps=False))
        while (done := steps_of(self.model)) < last:
            began = time.monotonic()
            policies = self.save()
            for model, _ in self._trainees:
                begin_update(model, configuration)
            rollouts = self._roll_out(policies, (configuration.seed, done))
            self._count(done + configuration.update_steps)
            self._log(rollouts[0], began)
            for trainee, rollout, learns in zip(
                self._trainees, rollouts, turn(configuration, done), strict=False
            ):
                if learns:
                    free_actor(trainee.model, configuration)
                    learn_from(trainee, rollout, last, self._improve)
        self.save()

    def _count(self, steps: int) -> None:
        """Say how many environment steps were made in all."""
        for model, _ in self._trainees:
            model.num_timesteps = steps

    def _roll_out(
        self,
        policies: Sequence[Policy],
        noise: tuple[int, int] | None = None,
        by_expert: BoolArray | None = None,
    ) -> list[Rollout]:
        """An episode in every world, as each agent met it."""
        configuration, steps = self._configuration, steps_of(self.model)
        episodes = np.array(self._course.hard.choose(steps))
        orders = [
            Order(
                place=self.place if by_expert is None else self._places[THREADS],
                first=int(worlds[0]),
                episodes=episodes[worlds],
                noise=noise,
                by_expert=None if by_expert is None else by_expert[worlds],
                force_weight_per_n=0.0 if noise is None else configuration.force_weight_at(steps),
                detour_weight_per_m=configuration.detour_weight_per_m,
                shared_reward=configuration.pairing is None or configuration.pairing.shared_reward,
            )
            for worlds in self._parts
        ]
        made = self._make_all(policies, orders)
        return [Rollout.joined([*parts]) for parts in zip(*made, strict=True)]

    def _log(self, rollout: Rollout, began: float) -> None:
        configuration, logger, hard = self._configuration, self.model.logger, self._course.hard
        if configuration.hard_share > 0.0:
            hard.judge(rollout.success.tolist(), rollout.episode_force_n.tolist())
        self._course.hear("PPO", steps_of(self.model), rollout.finished(slice(hard.again, None)))
        _, reward, success = self._course.latest
        logger.record("rollout/reward_mean", reward)
        logger.record("rollout/success_rate", success)
        logger.record("rollout/bytes", rollout.nbytes)
        logger.record("time/fps", int(configuration.update_steps / (time.monotonic() - began)))
        logger.dump(steps_of(self.model))


class UpdateNormaliser:
    """Scales observations and rewards, and learns of both once an update; see ``stable_baselines.Normaliser``."""

    def __init__(self, observation: Scaled, discount: float) -> None:
        self.obs_rms: Any = ObservationScale(observation)
        self.ret_rms: Any = RunningMeanStd()
        self.clip_obs, self.epsilon = OBSERVATION_CLIP, 1e-8
        self._discount = discount

    def normalize_obs(self, obs: Any) -> Any:
        """Observations (…, O) in standard deviations from the mean, single precision."""
        xp = namespace(obs)
        deviation = np.sqrt(self.obs_rms.var + self.epsilon)
        scaled = (obs - moved_to(self.obs_rms.mean, obs)) / moved_to(deviation, obs)
        return xp.astype(xp.clip(scaled, -self.clip_obs, self.clip_obs), xp.float32)

    def see(self, rollout: Rollout) -> None:
        """Learn what observations are like."""
        observations, xp = rollout.observations, namespace(rollout.observations)
        _see(self.obs_rms, xp.astype(observations.reshape(-1, observations.shape[-1]), xp.float64))

    def rewards(self, rollout: Rollout) -> Any:
        """Learn how far discounted returns go, and scale rewards (T, n) by that."""
        rewards, xp = rollout.rewards, namespace(rollout.rewards)
        so_far = xp.zeros(rewards.shape[1], dtype=xp.float64, device=rewards.device)
        returns: list[Any] = []
        for reward in rewards:
            so_far = so_far * self._discount + reward
            returns.append(so_far)
        _see(self.ret_rms, xp.stack(returns).reshape(-1))
        scaled = rewards / moved_to(np.sqrt(self.ret_rms.var + self.epsilon), rewards)
        return xp.astype(xp.clip(scaled, -10.0, 10.0), xp.float32)


def _see(statistics: RunningMeanStd, samples: Any) -> None:
    """Take in what samples (S, …) were like; nothing but their moments leaves a device."""
    xp = namespace(samples)
    mean, variance = (to_numpy(moment(samples, axis=0)) for moment in (xp.mean, xp.var))
    statistics.update_from_moments(mean, variance, len(samples))


def observation_of(environment: str) -> Observation:
    """What observations in an environment are."""
    task, scene = task_and_scene(environment)
    return task.observation(scene)


def trainees_of(configuration: TrainingConfiguration, out: Path) -> list[Trainee[UpdateNormaliser]]:
    """The robot, and the human where one is trained beside it, before they have learned anything."""
    environment = configuration.environment
    agents: list[tuple[Scaled, int]] = [(observation_of(environment), sizes(environment)[1])]
    if configuration.pairing is not None:
        agents.append(human_view_of(environment))
    return [
        Trainee(
            make_ppo(configuration, seen.size, acted, out),
            UpdateNormaliser(seen, configuration.discount),
        )
        for seen, acted in agents
    ]


def learn_from(
    trainee: Trainee[UpdateNormaliser], rollout: Rollout, last: int, improve: Improve = improve_here
) -> None:
    """Have a model learn from an update's episodes, in a training that ends after ``last`` steps."""
    model, normaliser = trainee
    rewards = normaliser.rewards(rollout)
    observations = normaliser.normalize_obs(rollout.observations)
    model._update_current_progress_remaining(steps_of(model), last)  # pyright: ignore[reportPrivateUsage]
    improve(model, observations, rollout.actions, rewards)
    normaliser.see(rollout)


def _fill(model: PPO, observations: Float32Array, actions: Float32Array, rewards: Float32Array) -> None:
    """Put whole episodes into a model's buffer: observations (T + 1, N, O), actions and rewards of each step.

    Episodes are cut off, not over: what may follow the last step counts with the critic's value.
    """
    buffer, policy = model.rollout_buffer, model.policy
    policy.set_training_mode(False)
    buffer.reset()
    count = rewards.shape[1]
    seen, done = torch.as_tensor(observations), torch.as_tensor(actions)
    with torch.no_grad():
        last_values: Any = policy.predict_values(seen[-1])
        for number, reward in enumerate(rewards):
            value, log_probability, _ = policy.evaluate_actions(seen[number], done[number])
            if number == len(rewards) - 1:
                reward = reward + model.gamma * last_values.numpy().ravel()
            starts = np.full(count, number == 0)
            buffer.add(observations[number], actions[number], reward, starts, value, log_probability)
    over: Any = np.ones(count, dtype=bool)
    buffer.compute_returns_and_advantage(last_values, over)
