"""Recipe of feed-forward policies: imitation, then PPO. It trains a robot, or a robot and a human together.

Policy and normaliser do not change during the episodes of an update. Each world has its own exploration noise. Policy,
seed and number of past steps determine the episodes. The trained weights therefore do not depend on the processes that
run the episodes.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import json
import time
from collections.abc import Callable, Sequence
from math import exp
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import torch
from stable_baselines3.common.utils import configure_logger

from avrgym.array_types import BoolArray
from avrgym.learning import ppo
from avrgym.learning.configuration import FeedforwardConfiguration, find_stored_people
from avrgym.learning.failed_episodes import FailedEpisodeSampler
from avrgym.learning.hyperparameters import IMITATION_HYPERPARAMETERS
from avrgym.learning.imitation import Demonstration, DemonstrationDataset, fit_actor
from avrgym.learning.normaliser import ObservationScales, make_observation_description
from avrgym.learning.recipe import UpdateResults
from avrgym.learning.rollouts import (
    Rollout,
    RolloutRequest,
    WorldSettings,
    load_cached_worlds,
    roll_out_agents,
)
from avrgym.learning.rsl_rl_ppo import DevicePPO, import_rsl_rl
from avrgym.networks.policy import Policy, PolicyMetadata, TrainedHumanMetadata
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.populations import format_population_label, is_trained_human, read_people_for_workers
from avrgym.system import random_streams
from avrgym.system.engine_names import THREADS
from avrgym.system.files import read_user_text
from avrgym.tasks.human_observation import make_human_observer
from avrgym.tasks.registry import get_observation_and_action_size

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

RolloutFunction = Callable[[Sequence[Policy], Sequence[RolloutRequest]], list[list[Rollout]]]
"""Function that runs the episodes of several requests. It returns a list with the result of
``rollouts.roll_out_agents`` for each request.
"""
TENSORBOARD_LOG_NAMES = "PPO", "human"
"""Names of the logs of the robot and the human in TensorBoard."""
WORLDS_PER_WORKER_RANGE = 64, 128
"""Minimum and maximum number of worlds per worker of a cluster. Training runs with few worlds may use fewer."""


def check_configuration(
    configuration: FeedforwardConfiguration, people: str, cluster: "Cluster | None"
) -> None:
    """Check the configuration of a training run.

    Raises:
        ValueError: for settings that cannot be combined. The message contains the allowed values.
        RuntimeError: if packages for training on a device are missing.
    """
    if configuration.pairing is not None:
        _check_pairing(configuration.environment, people)
    if configuration.engine == THREADS:
        return
    import_rsl_rl()
    if configuration.force_guard:
        raise ValueError(
            f"the force guard works only with the engine threads; remove --engine {configuration.engine}"
        )
    if configuration.pairing is not None or is_trained_human(people):
        raise ValueError(
            f"trained humans work only with the engine threads; remove --engine {configuration.engine}"
        )
    if cluster is not None:
        raise ValueError(
            f"--cluster works only with the engine threads; remove --cluster or --engine {configuration.engine}"
        )


def _check_pairing(environment: str, people: str) -> None:
    """Raises ``ValueError`` if the human has no actions in the environment, or is a trained human."""
    _, joints = make_human_observer(environment)
    if not joints:
        raise ValueError(
            f"people have no actions in {environment}; allowed for `--recipe pair`: tasks with moving people"
        )
    if is_trained_human(people):
        raise ValueError(
            f"{people} is a trained human, but `--recipe pair` trains a new one; allowed: the name of a population, "
            "or a people file"
        )


def count_rollout_requests(configuration: FeedforwardConfiguration, cluster: "Cluster | None") -> int:
    """Returns the number of rollout requests per update: a multiple of the number of workers. The worlds are divided
    among the requests."""
    if cluster is None:
        return 1
    least, most = WORLDS_PER_WORKER_RANGE
    worlds = configuration.num_envs
    workers = cluster.max_jobs or max(1, min(cluster.max_parallel_calls, worlds // least))
    workers = min(workers, worlds)
    return workers * -(-worlds // (workers * most))


class FeedforwardRecipe:
    """Recipe of feed-forward policies, an implementation of ``recipe.Recipe``. The agents are the robot and, if
    ``pairing`` is set, the human.
    """

    def __init__(
        self, configuration: FeedforwardConfiguration, out: Path, cluster: "Cluster | None" = None
    ) -> None:
        self._configuration, self._out = configuration, out
        self._people = find_stored_people(configuration.people, out)
        threads = configuration.threads if cluster is None else 1
        self._settings = {
            engine: WorldSettings(
                configuration.environment,
                read_people_for_workers(self._people),
                configuration.impairment,
                threads,
                engine,
                configuration.force_guard,
                configuration.withdraw_after_success,
                configuration.settings,
                configuration.episode_steps,
            )
            for engine in (THREADS, configuration.engine)
        }
        self._parts = np.array_split(
            np.arange(configuration.num_envs), count_rollout_requests(configuration, cluster)
        )
        self._roll_out_parts = _roll_out_here if cluster is None else _roll_out_on(cluster)
        self._policy_update: ppo.PolicyUpdateFunction = ppo.update_ppo_on_host
        if configuration.engine != THREADS:
            self._policy_update = DevicePPO(configuration)
            load_cached_worlds(
                self._settings[configuration.engine], configuration.num_envs
            )  # raises ValueError now if the device does not have enough memory
        self._agents = _agents(configuration, out)
        self._demonstrations = DemonstrationDataset(out, Demonstration)
        self._hard = FailedEpisodeSampler(
            configuration.num_envs, configuration.hard_share, configuration.seed
        )
        self._latest: list[tuple[float, bool]] = []
        self._log_is_open = False

    @property
    def model(self) -> ppo.PPO:
        """Returns the robot's PPO model of Stable-Baselines3."""
        return self._agents[0].model

    @property
    def num_timesteps(self) -> int:
        return ppo.count_trained_timesteps(self.model)

    @property
    def candidate_action_stds(self) -> tuple[float, ...]:
        return (exp(self._configuration.compute_log_std(self.num_timesteps)),)

    def update(self) -> UpdateResults:
        if self.num_timesteps < self._configuration.imitation_steps:
            return self._imitate()
        return self._improve()

    def export_policies(self, metadata: PolicyMetadata) -> list[Policy]:
        configuration = self._configuration
        log_std = configuration.compute_log_std(self.num_timesteps)
        name = format_population_label(configuration.people)
        human = msgspec.structs.replace(metadata, people=name, impairment=configuration.impairment)
        robot = human
        if configuration.pairing is not None:
            robot = msgspec.structs.replace(human, people=f"{name}, trained together")
        policies = [ppo.export_policy(self._agents[0], log_std, robot)]
        for agent in self._agents[1:]:
            text = "" if self._people in NAMED_DISTRIBUTIONS else read_user_text(Path(self._people))
            role = TrainedHumanMetadata(partner=policies[0].parameters_sha256, people_file=text)
            policies.append(ppo.export_policy(agent, log_std, msgspec.structs.replace(human, human=role)))
        return policies

    def checkpoint_state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Returns the state for a checkpoint, see ``Recipe.state``. It contains NumPy's global random stream, because
        Stable-Baselines3 uses this stream for minibatches.
        """
        tensors = {
            **ppo.make_agent_state(self._agents[0]),
            "torch_random": torch.get_rng_state(),
            "minibatches": json.dumps(np.random.get_state(legacy=False), default=np.ndarray.tolist),  # noqa: NPY002
        }
        if len(self._agents) > 1:
            tensors["human"] = ppo.make_agent_state(self._agents[1])
        return tensors, {"finished": self._latest, "hard": self._hard.failed_seeds}

    def restore(self, tensors: dict[str, Any], values: dict[str, Any]) -> None:
        states = [tensors, *([tensors["human"]] if len(self._agents) > 1 else [])]
        for agent, state in zip(self._agents, states, strict=True):
            ppo.restore_agent(agent, state)
        torch.set_rng_state(tensors["torch_random"])
        minibatches = json.loads(tensors["minibatches"])
        minibatches["state"]["key"] = np.array(minibatches["state"]["key"], dtype=np.uint32)
        np.random.set_state(minibatches)  # noqa: NPY002
        self._latest = [(reward, success) for reward, success in values["finished"]]
        self._hard.failed_seeds = values.get("hard", [])  # early checkpoints do not contain it
        if self.num_timesteps < self._configuration.imitation_steps:
            self._demonstrations.read_rounds(self.num_timesteps // self._configuration.steps_per_update)

    def _imitate(self) -> UpdateResults:
        configuration = self._configuration
        number = self.num_timesteps // configuration.steps_per_update
        random = random_streams.make_imitation_rng(configuration.seed, number)
        expert_drives = (
            random.random(configuration.num_envs) < IMITATION_HYPERPARAMETERS.expert_fraction**number
        )
        rollouts = self._roll_out(self._own_policies(), expert_drives=expert_drives)
        for agent, each in zip(self._agents, rollouts, strict=True):
            agent.normaliser.update_observations(each)
        rollout = rollouts[0]
        arrays = (rollout.observations[:-1], rollout.actions)
        self._demonstrations.append(Demonstration(*(each.reshape(-1, each.shape[-1]) for each in arrays)))
        last = number == configuration.imitation_updates - 1
        fit_actor(self._agents[0], self._demonstrations, random, last=last)
        self._count_update()
        return self._results("imitation", rollout.list_episode_results(~expert_drives))

    def _improve(self) -> UpdateResults:
        configuration, done, started = self._configuration, self.num_timesteps, time.monotonic()
        self._open_log()
        for model, _ in self._agents:
            ppo.set_log_std(model, configuration)
        rollouts = self._roll_out(self._own_policies(), (configuration.seed, done))
        self._count_update()
        rollout = rollouts[0]
        if configuration.hard_share > 0.0:
            self._hard.store_failures(rollout.success.tolist(), rollout.episode_mean_force_n.tolist())
        results = self._results(
            "PPO", rollout.list_episode_results(slice(self._hard.num_repeated_episodes, None))
        )
        self._log(results, rollout.nbytes, time.monotonic() - started)
        for agent, each, learns in zip(
            self._agents, rollouts, configuration.find_learning_agents(done), strict=False
        ):
            if learns:
                ppo.set_actor_trainable(agent.model, configuration)
                ppo.update_agent(agent, each, configuration.steps, self._policy_update)
        return results

    def _own_policies(self) -> list[Policy]:
        return self.export_policies(PolicyMetadata(environment="", people="", steps=0, seed=0))

    def _roll_out(
        self,
        policies: Sequence[Policy],
        noise_seed: tuple[int, int] | None = None,
        expert_drives: BoolArray | None = None,
    ) -> list[Rollout]:
        """Run an episode in every world. Returns a rollout for each agent. Experts always use the engine
        ``threads``."""
        configuration, steps = self._configuration, self.num_timesteps
        engine = configuration.engine if expert_drives is None else THREADS
        episodes = np.array(self._hard.choose_seeds(steps))
        requests = [
            RolloutRequest(
                world_settings=self._settings[engine],
                first_world_index=int(worlds[0]),
                episode_seeds=episodes[worlds],
                noise_seed=noise_seed,
                expert_controlled_mask=None if expert_drives is None else expert_drives[worlds],
                force_weight_per_n=0.0 if noise_seed is None else configuration.compute_force_weight(steps),
                detour_weight_per_m=configuration.detour_weight_per_m,
                preference_weights=configuration.preference_weights,
                shared_reward=configuration.pairing is None or configuration.pairing.shared_reward,
            )
            for worlds in self._parts
        ]
        parts = self._roll_out_parts(policies, requests)
        return [Rollout.concatenate([*of_agent]) for of_agent in zip(*parts, strict=True)]

    def _count_update(self) -> None:
        steps = self.num_timesteps + self._configuration.steps_per_update
        for model, _ in self._agents:
            model.num_timesteps = steps

    def _results(self, stage: str, episodes: list[tuple[float, bool]]) -> UpdateResults:
        """Returns mean reward and success rate of the policy's latest episodes, at most two per world."""
        if not episodes:
            return UpdateResults(stage, None, None)
        self._latest = (self._latest + episodes)[-2 * self._configuration.num_envs :]
        reward, success = (sum(column) / len(column) for column in zip(*self._latest, strict=True))
        return UpdateResults(stage, reward, success)

    def _open_log(self) -> None:
        if not self._log_is_open:
            for (model, _), name in zip(self._agents, TENSORBOARD_LOG_NAMES, strict=False):
                model.set_logger(configure_logger(0, model.tensorboard_log, name, reset_num_timesteps=False))
        self._log_is_open = True

    def _log(self, results: UpdateResults, rollout_bytes: int, seconds: float) -> None:
        logger = self.model.logger
        if results.reward_mean is not None:
            logger.record("rollout/reward_mean", results.reward_mean)
            logger.record("rollout/success_rate", results.success_rate)
        logger.record("rollout/bytes", rollout_bytes)
        logger.record("time/fps", int(self._configuration.steps_per_update / seconds))
        logger.dump(self.num_timesteps)


def _roll_out_here(policies: Sequence[Policy], requests: Sequence[RolloutRequest]) -> list[list[Rollout]]:
    return [roll_out_agents(policies, request) for request in requests]


def _roll_out_on(cluster: "Cluster") -> RolloutFunction:
    def roll_out(policies: Sequence[Policy], requests: Sequence[RolloutRequest]) -> list[list[Rollout]]:
        return cluster.starmap(roll_out_agents, [(policies, request) for request in requests])

    return roll_out


def _agents(configuration: FeedforwardConfiguration, out: Path) -> list[ppo.Agent]:
    environment = configuration.environment
    sides: list[tuple[ObservationScales, int]] = [
        (make_observation_description(environment), get_observation_and_action_size(environment)[1])
    ]
    if configuration.pairing is not None:
        sides.append(make_human_observer(environment))
    return [ppo.make_agent(configuration, observation, actions, out) for observation, actions in sides]
