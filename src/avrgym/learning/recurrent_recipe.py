"""Recipe of recurrent policies (``--recipe adaptive``): imitation, then PPO, the same for every environment.

The imitated expert uses the whole state of the person, without tremor. The policy receives only observations. It must
infer the rest of the state with its memory (Chen et al., "Learning by cheating", CoRL 2019). Imitation is dataset
aggregation; the loss is the error of the tool's motion, see ``compute_tool_motion_loss``. Then PPO maximises the
task's reward minus penalties for the force on the person.

Training uses several groups of simulated people: one group for each of ``ASSISTIVE_GYM_IMPAIRMENTS`` (by default people
of ``zoo/train``), and one group of static people of ``revised``. Each imitation update uses one group, each PPO update
uses all groups. A trained policy may replace the expert as teacher. Training may start from the weights of a trained
recurrent policy.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch.optim.lr_scheduler import ExponentialLR

from avrgym.array_types import BoolArray, Float32Array
from avrgym.learning.configuration import RecurrentConfiguration, find_stored_people
from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS, make_hyperparameters
from avrgym.learning.imitation import Demonstration, DemonstrationDataset
from avrgym.learning.normaliser import Normaliser, make_observation_description
from avrgym.learning.recipe import UpdateResults
from avrgym.learning.recurrent_network import RecurrentNetwork, fit_network
from avrgym.learning.recurrent_ppo import RecurrentPPO
from avrgym.learning.rollouts import Rollout, RolloutRequest, WorldSettings, roll_out
from avrgym.learning.tool_loss import ToolMotionModel, compute_tool_motion_loss
from avrgym.people.population_names import ASSISTIVE_GYM_IMPAIRMENTS, REVISED_POPULATION
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.system import random_streams
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.registry import find_task_and_scene, get_observation_and_action_size

STATIC_PEOPLE = (REVISED_POPULATION, "none")
"""Population and impairment of the training group with static people."""
TEACHER_FILE, INITIAL_POLICY_FILE = "teacher.safetensors", "initial.safetensors"
"""Names of the copies of the teacher and of the initial policy in the folder of a training run."""


@dataclass(frozen=True)
class DemonstrationWithArmAngles(Demonstration):
    """A demonstration (T, N, ...) that also contains the angles of the arm's joints, (T, N, J)."""

    joint_positions: Float32Array


def load_teacher_and_initial_policy(configuration: RecurrentConfiguration) -> dict[str, Policy]:
    """Load and return the configured teacher and initial policy, by the file names of their copies.

    Raises:
        ValueError: for an unknown or unsuitable policy. The message contains the allowed values.
    """
    policies = {TEACHER_FILE: _find_teacher(configuration), INITIAL_POLICY_FILE: _find_initial(configuration)}
    return {name: policy for name, policy in policies.items() if policy is not None}


def _find_teacher(configuration: RecurrentConfiguration) -> Policy | None:
    if configuration.teacher is None:
        return None
    teacher = registry.resolve_policy(
        configuration.teacher, configuration.environment, configuration.settings
    )
    if not isinstance(teacher, Policy) or teacher.vision is not None:
        raise ValueError(
            f"{configuration.teacher!r} cannot be a teacher; "
            "allowed: a trained policy without vision, by its name or file"
        )
    return teacher


def _find_initial(configuration: RecurrentConfiguration) -> Policy | None:
    if configuration.initial is None:
        return None
    if configuration.teacher is not None and not configuration.imitation_updates:
        raise ValueError(
            "with an initial policy, training has no imitation by default, but a teacher is given; remove the "
            "teacher, or set the imitation share above 0"
        )
    initial = registry.resolve_policy(
        configuration.initial, configuration.environment, configuration.settings
    )
    if not isinstance(initial, Policy) or initial.memory is None:
        raise ValueError(
            f"{configuration.initial!r} cannot be an initial policy; allowed: a recurrent policy, by its name or file"
        )
    return initial


class RecurrentRecipe:
    """Recipe of recurrent policies (``--recipe adaptive``), an implementation of ``recipe.Recipe``."""

    def __init__(self, configuration: RecurrentConfiguration, out: Path) -> None:
        self._people = find_stored_people(configuration.people, out)
        self._configuration = configuration
        self._teacher = None if configuration.teacher is None else Policy.load(out / TEACHER_FILE)
        self._initial = None if configuration.initial is None else Policy.load(out / INITIAL_POLICY_FILE)
        observation_size, action_size = get_observation_and_action_size(configuration.environment)
        _, scene = find_task_and_scene(configuration.environment, configuration.settings)
        self._tool_motion = ToolMotionModel(scene)
        self._normaliser = Normaliser(
            make_observation_description(configuration.environment), RECURRENT_HYPERPARAMETERS.gamma
        )
        torch.set_num_threads(1)  # more threads would change the order of sums
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(configuration.seed)
            if self._initial is None:
                self._network = RecurrentNetwork(
                    observation_size, configuration.memory_size, configuration.net_arch, action_size
                )
            else:
                self._network = RecurrentNetwork.from_policy(self._initial)
                self._normaliser.obs_rms.mean = self._initial.observation_mean.copy()
                self._normaliser.obs_rms.var = self._initial.observation_variance.copy()
            self._ppo = RecurrentPPO(self._network, observation_size)
        self._demonstrations = DemonstrationDataset(out, DemonstrationWithArmAngles)
        self._updates = 0

    @property
    def num_timesteps(self) -> int:
        return self._updates * self._configuration.steps_per_update

    @property
    def candidate_action_stds(self) -> tuple[float, ...]:
        return RECURRENT_HYPERPARAMETERS.candidate_action_stds

    def update(self) -> UpdateResults:
        imitates = self._updates < self._configuration.imitation_updates
        update = self._imitate(self._updates) if imitates else self._improve(self._updates)
        self._updates += 1
        return update

    def export_policies(self, metadata: PolicyMetadata) -> list[Policy]:
        steps, seconds, curve = metadata.steps, metadata.seconds, metadata.curve
        if self._initial is not None:
            before = self._initial.metadata
            curve = [*before.curve, *((before.steps + done, *results) for done, *results in curve)]
            steps, seconds = before.steps + steps, round(before.seconds + seconds, 1)
        metadata = msgspec.structs.replace(
            metadata,
            people=self._configuration.people,
            impairment="each in turn",
            steps=steps,
            seconds=seconds,
            curve=curve,
        )
        return [self._network.to_policy(self._normaliser, metadata)]

    def checkpoint_state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        tensors = {
            "network": self._network.state_dict(),
            "ppo": self._ppo.checkpoint_state(),
            **self._normaliser.checkpoint_state(),
        }
        return tensors, {"rounds": self._updates}

    def restore(self, tensors: dict[str, Any], values: dict[str, Any]) -> None:
        self._network.load_state_dict(tensors["network"])
        self._ppo.restore(tensors["ppo"])
        self._normaliser.restore(tensors)
        self._updates = values["rounds"]
        if self._updates < self._configuration.imitation_updates:
            self._demonstrations.read_rounds(self._updates)

    def _imitate(self, number: int) -> UpdateResults:
        configuration = self._configuration
        random = random_streams.make_imitation_rng(configuration.seed, number)
        expert_drives = (
            random.random(configuration.num_envs) < RECURRENT_HYPERPARAMETERS.expert_fraction**number
        )
        turn, still = divmod(number, 2)
        impairment = ASSISTIVE_GYM_IMPAIRMENTS[turn % len(ASSISTIVE_GYM_IMPAIRMENTS)]
        partner = STATIC_PEOPLE if still else (self._people, impairment)
        request = RolloutRequest(
            self._settings(*partner),
            0,
            self._episode_seeds(number),
            noise_seed=(configuration.seed, number),
            expert_controlled_mask=expert_drives,
            teacher=self._teacher,
        )
        rollout = roll_out(self._policy(0.0 if self._teacher is None else self._teacher.action_std), request)
        if self._initial is None:
            self._normaliser.update_observations(rollout)
        assert rollout.joint_positions is not None
        self._demonstrations.append(
            DemonstrationWithArmAngles(rollout.observations[:-1], rollout.actions, rollout.joint_positions)
        )
        self._fit(random, last=number == configuration.imitation_updates - 1)
        return _results("imitation", rollout, ~expert_drives)

    def _improve(self, number: int) -> UpdateResults:
        configuration = self._configuration
        progress = configuration.compute_ppo_progress(number)
        action_std = float(np.exp(np.interp(progress, (0.0, 1.0), RECURRENT_HYPERPARAMETERS.log_std)))
        policy, seeds = self._policy(action_std), self._episode_seeds(number)
        partners = [
            *((self._people, impairment) for impairment in ASSISTIVE_GYM_IMPAIRMENTS),
            STATIC_PEOPLE,
        ]
        parts = np.array_split(np.arange(configuration.num_envs), len(partners))
        requests = [
            RolloutRequest(
                self._settings(*partner),
                int(worlds[0]),
                seeds[worlds],
                noise_seed=(configuration.seed, number),
                force_weight_per_n=RECURRENT_HYPERPARAMETERS.force_weight_per_n,
                max_rewarded_force_n=RECURRENT_HYPERPARAMETERS.max_rewarded_force_n,
                overload_weight=RECURRENT_HYPERPARAMETERS.overload_weight,
                preference_weights=configuration.preference_weights,
                detour_weight_per_m=make_hyperparameters(configuration.environment).detour_weight_per_m,
            )
            for partner, worlds in zip(partners, parts, strict=True)
            if len(worlds)
        ]
        rollout = Rollout.concatenate([roll_out(policy, request) for request in requests])
        self._ppo.update(
            torch.as_tensor(self._normaliser.normalize_obs(rollout.observations)),
            torch.as_tensor(rollout.actions),
            torch.as_tensor(self._normaliser.normalize_rewards(rollout)),
            action_std,
            random_streams.make_imitation_rng(configuration.seed, number),
            self._learning_rate(number, progress),
        )
        return _results("PPO", rollout, slice(None))

    def _learning_rate(self, number: int, progress: float) -> float:
        """Returns PPO's learning rate in an update; 0 while only the critic learns."""
        imitates = self._configuration.imitation_updates
        if number < imitates + RECURRENT_HYPERPARAMETERS.critic_only_updates:
            return 0.0
        first = (
            RECURRENT_HYPERPARAMETERS.learning_rate
            if imitates
            else RECURRENT_HYPERPARAMETERS.learning_rate_without_imitation
        )
        return first * max(RECURRENT_HYPERPARAMETERS.final_lr_fraction, 1.0 - progress)

    def _settings(self, people: str, impairment: str) -> WorldSettings:
        configuration = self._configuration
        return WorldSettings(
            configuration.environment,
            TransferredFile.read(people),
            impairment,
            configuration.threads,
            force_guard=configuration.force_guard,
            withdraw_after_success=configuration.withdraw_after_success,
            environment_settings=configuration.settings,
            episode_steps=configuration.episode_steps,
        )

    def _episode_seeds(self, number: int) -> NDArray[np.int64]:
        random = random_streams.make_episode_seed_rng(self._configuration.seed, number)
        return random.integers(2**31, size=self._configuration.num_envs)

    def _policy(self, action_std: float) -> Policy:
        metadata = PolicyMetadata(environment=self._configuration.environment, people="", steps=0, seed=0)
        return self._network.to_policy(self._normaliser, metadata, action_std)

    def _fit(self, random: np.random.Generator, *, last: bool) -> None:
        """Fit the network to all demonstrations with ``compute_tool_motion_loss``. The last round has more gradient
        steps.
        """
        observed, actions, joint_positions = (
            self._demonstrations.concatenate(name, axis=1)
            for name in ("observations", "actions", "joint_positions")
        )
        observations, actions = (
            torch.as_tensor(each) for each in (self._normaliser.normalize_obs(observed), actions)
        )
        steps, decay = (
            (
                RECURRENT_HYPERPARAMETERS.final_round_gradient_steps,
                RECURRENT_HYPERPARAMETERS.final_round_lr_decay,
            )
            if last
            else (RECURRENT_HYPERPARAMETERS.gradient_steps, RECURRENT_HYPERPARAMETERS.lr_decay)
        )
        optimizer = torch.optim.Adam(
            self._network.parameters(), RECURRENT_HYPERPARAMETERS.imitation_learning_rate
        )
        schedule = ExponentialLR(optimizer, decay ** (1.0 / steps))
        for _ in range(steps):
            columns = random.integers(
                actions.shape[1], size=RECURRENT_HYPERPARAMETERS.imitation_minibatch_episodes
            )
            targets = [
                actions[:, columns],
                self._tool_motion.compute_scaled_jacobian(joint_positions[:, columns]),
            ]
            fit_network(
                self._network,
                optimizer,
                observations[:, columns],
                compute_tool_motion_loss,
                targets,
                RECURRENT_HYPERPARAMETERS.imitation_max_grad_norm,
            )
            schedule.step()


def _results(stage: str, rollout: Rollout, own: slice | BoolArray) -> UpdateResults:
    """Returns mean reward and success rate of the episodes ``own``, in which the policy controlled the robot."""
    episodes = rollout.list_episode_results(own)
    if not episodes:
        return UpdateResults(stage, None, None)
    reward, success = (sum(column) / len(column) for column in zip(*episodes, strict=True))
    return UpdateResults(stage, reward, success)
