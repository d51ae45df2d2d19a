"""Rollouts: whole episodes for training. A rollout depends only on policy and request, not on the process.

The worlds of an update can therefore be divided among processes, and a failed request can be repeated. If the engine
uses a device, arrays stay on the device for the whole episode.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, Float32Array, FloatArray
from avrgym.geometry.arrays import get_namespace, to_device_of, to_numpy
from avrgym.learning.preference_reward import preference_reward
from avrgym.policies.actors import Actor, DeviceActor
from avrgym.policies.trained_policies import Policy
from avrgym.safety.limits import TRANSIENT_LIMIT_N
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.system import random_streams
from avrgym.system.engine_names import THREADS
from avrgym.system.random_streams import NoiseGeneratorFactory
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.filtered_expert import filter_tremor
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import Controller


@dataclass(frozen=True)
class WorldSettings:
    """Settings of the worlds of a training run. A process compiles these worlds once.

    If the engine uses a device, whole control steps run on the device.
    """

    environment: str
    people: TransferredFile
    impairment: str = "none"
    threads: int = 1
    engine: str = THREADS
    force_guard: bool = False
    withdraw_after_success: bool = False
    environment_settings: Settings = DEFAULT_SETTINGS
    episode_steps: int = EPISODE_STEPS


@dataclass(frozen=True)
class RolloutRequest:
    """A request to run whole episodes in n worlds of a training run.

    Attributes:
        world_settings: settings of the worlds in which the episodes run.
        first_world_index: number of the first of these worlds in the training run.
        episode_seeds: seeds of the episodes, (n,).
        noise_seed: two numbers, usually the seed of the training run and the number of past environment steps. These
            two numbers and the number of the world are the seed of the exploration noise. ``None``: no noise.
        expert_controlled_mask: mask (n,) of the worlds that an expert controls, see ``_expert_for``. With a mask, the
            expert's actions are recorded in all worlds. Experts compute on the host only. ``None``: no expert.
        teacher: a policy that replaces the task's expert; it acts without noise.
        force_weight_per_n: reward penalty per newton on the person.
        max_rewarded_force_n: force on the person in newtons above which a reward for force does not increase.
        overload_weight: reward penalty in a step in which the force on a body region equals its transient limit. The
            penalty increases linearly from half the limit. Only on the host.
        detour_weight_per_m: reward penalty per metre of the tool's detour. The last step of an episode has no such
            penalty.
        preference_weights: weights of reward terms for an additional reward, see ``preference_reward``.
        shared_reward: whether a trained human receives the robot's reward, see ``Episodes.compute_human_reward``.
    """

    world_settings: WorldSettings
    first_world_index: int
    episode_seeds: NDArray[np.int64]
    noise_seed: tuple[int, int] | None = None
    expert_controlled_mask: BoolArray | None = None
    teacher: Policy | None = None
    force_weight_per_n: float = 0.0
    max_rewarded_force_n: float = np.inf
    overload_weight: float = 0.0
    detour_weight_per_m: float = 0.0
    preference_weights: Mapping[str, float] = field(default_factory=dict[str, float])
    shared_reward: bool = True


@dataclass(frozen=True)
class Rollout:
    """Whole episodes of T steps in n worlds. The first axis of arrays is time, the second axis is the world.

    ``observations`` (T + 1, n, O) are not normalised; the last observation is the one after the last step. ``actions``
    (T, n, A) are the policy's actions before clipping, or the expert's actions. ``rewards`` (T, n) contain the
    request's penalties. ``joint_positions`` (T, n, J) are angles before each step; ``None`` without an expert. If the
    worlds are on a device, these arrays are tensors. The results per episode (n,) are always on the host:
    ``episode_return`` (the sum of the task's rewards without penalties), ``success`` and ``episode_mean_force_n``
    (the mean force on the person).
    """

    observations: Any
    actions: Any
    rewards: Any
    episode_return: FloatArray
    success: BoolArray
    episode_mean_force_n: FloatArray
    joint_positions: Float32Array | None = None

    @classmethod
    def concatenate(cls, parts: list["Rollout"]) -> "Rollout":
        """Combine rollouts of different worlds into one rollout, along the world axis."""
        if len(parts) == 1:
            return parts[0]
        names = parts[0]._arrays
        return cls(**{name: _joined([getattr(part, name) for part in parts]) for name in names})

    @property
    def nbytes(self) -> int:
        """Returns the total size of all arrays of the rollout, in bytes."""
        return sum(array.nbytes for array in self._arrays.values())

    @property
    def _arrays(self) -> dict[str, Any]:
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: array for name, array in arrays.items() if array is not None}

    def list_episode_results(self, of: slice | BoolArray = slice(None)) -> list[tuple[float, bool]]:
        """Returns a list of the return and the success of each episode. ``of`` selects some episodes."""
        return [*zip(self.episode_return[of].tolist(), self.success[of].tolist(), strict=True)]


def _joined(arrays: list[Any]) -> Any:
    """Returns arrays of different worlds, concatenated along the world axis."""
    return np.concatenate(arrays, axis=1 if arrays[0].ndim == 3 else -1)


def roll_out(policy: Policy, request: RolloutRequest) -> Rollout:
    """Run a request's episodes with a robot's policy. Returns the rollout; see ``roll_out_agents``."""
    return roll_out_agents([policy], request)[0]


def roll_out_agents(policies: Sequence[Policy], request: RolloutRequest) -> list[Rollout]:
    """Run a request's episodes. Returns a rollout for each policy.

    ``policies`` contains the robot's policy and, for a trained human, the human's policy.

    Raises:
        RuntimeError, ValueError: for invalid episodes on a device, see ``Episodes.check_device_results``.
    """
    count = len(request.episode_seeds)
    by_region = request.overload_weight > 0.0
    worlds = load_cached_worlds(
        request.world_settings, count, human_actions=len(policies) > 1, by_region=by_region
    )
    generators = [random_streams.make_training_episode_rng(int(seed)) for seed in request.episode_seeds]
    first = worlds.reset(np.arange(count), generators)
    xp: Any = get_namespace(first)
    robot = _Agent(policies[0], random_streams.make_robot_noise_rng, request, first)
    humans = [
        _Agent(policy, random_streams.make_human_noise_rng, request, worlds.observe_humans())
        for policy in policies[1:]
    ]
    expert = None if request.expert_controlled_mask is None else _expert_for(policies[0], request, worlds)
    returns = force_n = xp.zeros(count, dtype=xp.float64, device=first.device)
    success: Any = None
    joint_positions: list[FloatArray] = []
    length = request.world_settings.episode_steps
    for number in range(length):
        action = robot.act(number)
        if expert is not None:
            joint_positions.append(worlds.simulation.get_joint_positions())
            expert_action = worlds.control_loop.apply_withdrawal(np.clip(expert(worlds.observe()), -1.0, 1.0))
            robot.actions[-1] = expert_action.astype(np.float32)
            assert request.expert_controlled_mask is not None
            action = np.where(request.expert_controlled_mask[:, None], robot.actions[-1], action)
        for human in humans:
            worlds.command_people(np.clip(human.act(number), -1.0, 1.0).astype(float))
        action = xp.astype(xp.clip(action, -1.0, 1.0), first.dtype)
        step, overload = _step_with_overload(worlds, action) if by_region else (worlds.step(action), 0.0)
        robot.observe(step.observation)
        penalty = _penalty(worlds, request, step, last=number == length - 1)
        penalty = penalty + request.overload_weight * overload
        robot.rewards.append(step.reward - penalty)
        for human in humans:
            human.observe(worlds.observe_humans())
            reward = worlds.compute_human_reward(
                step, human.actions[-1].astype(float), shared=request.shared_reward
            )
            human.rewards.append(reward - penalty)
        returns = returns + step.reward
        force_n = force_n + step.force_on_person_n / length
        success = step.success
    worlds.check_device_results()
    results = to_numpy(returns), to_numpy(success), to_numpy(force_n)
    rollouts = [agent.rollout(*results) for agent in (robot, *humans)]
    if expert is not None:
        rollouts[0] = replace(rollouts[0], joint_positions=np.stack(joint_positions).astype(np.float32))
    return rollouts


def _step_with_overload(worlds: Episodes, action: FloatArray) -> tuple[StepOutcome, FloatArray]:
    """Make a control step. Returns the step and the overload (n,): the maximum over body regions and physics steps.

    The overload of a region is 0 up to half the transient limit. It then increases linearly, to 1 at the limit.
    """
    recorder = RegionLoadRecorder(len(action))
    step = worlds.step(action, recorder)
    share = (recorder.compute_loads().peak_force_n / TRANSIENT_LIMIT_N).max(axis=-1)
    return step, np.maximum(2.0 * share - 1.0, 0.0)


def _expert_for(policy: Policy, request: RolloutRequest, worlds: Episodes) -> Controller:
    """Returns the request's teacher, or the task's expert if there is no teacher.

    If the task has a memory-based expert, a recurrent policy imitates this expert. Tremor is filtered from this
    expert's input.
    """
    if request.teacher is not None:
        return Actor(request.teacher, len(request.episode_seeds)).compute_mean_actions
    task = worlds.task
    if policy.memory is None:
        return task.feedback_expert(worlds)
    return filter_tremor(task.memory_expert or task.feedback_expert)(worlds)


class _Agent:
    """One agent (robot or human) in all worlds of a request: its observations, actions and rewards on the worlds'
    device."""

    def __init__(
        self, policy: Policy, noise: NoiseGeneratorFactory, request: RolloutRequest, first: Any
    ) -> None:
        """Create the agent for the worlds of a request. ``first`` (n, O) are the first observations."""
        self._xp: Any = get_namespace(first)
        self.observations: list[Any] = []
        self.actions: list[Any] = []
        self.rewards: list[Any] = []
        numpy = self._xp is np
        self._actor = Actor(policy, len(request.episode_seeds)) if numpy else DeviceActor(policy, first)
        self._noise = to_device_of(policy.action_std * _noise(policy, noise, request), first)
        self.observe(first)

    def observe(self, observation: Any) -> None:
        """Store the observations (n, O) after a step."""
        self.observations.append(self._xp.astype(observation, self._xp.float32))

    def act(self, number: int) -> Any:
        """Returns the actions (n, A) in step ``number``, before clipping."""
        mean = self._actor.compute_mean_actions(self.observations[-1])
        self.actions.append(self._xp.astype(mean + self._noise[number], self._xp.float32))
        return self.actions[-1]

    def rollout(self, returns: FloatArray, success: BoolArray, force_n: FloatArray) -> Rollout:
        """Returns the agent's rollout. The arguments are the results per episode (n,)."""
        xp = self._xp
        rewards = xp.astype(xp.stack(self.rewards), xp.float32)
        return Rollout(
            xp.stack(self.observations), xp.stack(self.actions), rewards, returns, success, force_n
        )


def _noise(policy: Policy, stream: NoiseGeneratorFactory, request: RolloutRequest) -> FloatArray:
    """Returns standard normal exploration noise (T, n, A). Each world has its own random stream."""
    length = request.world_settings.episode_steps
    shape = (length, policy.action_size)
    count = len(request.episode_seeds)
    if request.noise_seed is None:
        return np.zeros((length, count, policy.action_size))
    seed, steps = request.noise_seed
    worlds = range(request.first_world_index, request.first_world_index + count)
    return np.stack([stream(seed, steps, world).standard_normal(shape) for world in worlds], axis=1)


def _penalty(worlds: Episodes, request: RolloutRequest, step: StepOutcome, *, last: bool) -> FloatArray:
    """Returns the sum (n,) of the request's penalties in a step, without the overload penalty."""
    penalty = request.force_weight_per_n * step.force_on_person_n + _excess_reward(
        request.max_rewarded_force_n, worlds, step
    )
    if request.preference_weights:
        penalty = penalty - preference_reward(
            step, request.preference_weights, request.world_settings.episode_steps
        )
    detour_m = worlds.task.compute_detour_m
    if last or detour_m is None or not request.detour_weight_per_m:
        return penalty
    return penalty + request.detour_weight_per_m * detour_m(worlds.simulation.get_state(), worlds.task_state)


def _excess_reward(limit_n: float, worlds: Episodes, step: StepOutcome) -> FloatArray:
    """Returns the reward (n,) for the part of forces above a limit. Reward terms in newtons have names that end with
    ``_n``."""
    xp = get_namespace(step.reward)
    excess = xp.zeros_like(step.reward)
    for name, weight in worlds.task.reward_weights.items():
        if weight > 0.0 and name.endswith("_n"):
            term = step.reward_terms[name]
            excess = excess + weight * xp.maximum(term - limit_n, xp.zeros_like(term))
    return excess


@lru_cache(maxsize=2)
def load_cached_worlds(
    settings: WorldSettings, count: int, *, human_actions: bool = False, by_region: bool = False
) -> Episodes:
    """Returns the worlds of a request. They are cached for two numbers of worlds, because the requests of an update
    have at most two sizes.

    Raises:
        ValueError: if the worlds need more memory than the device has.
    """
    return Episodes(
        settings.environment,
        count,
        people=settings.people.get_local_path(),
        impairment=settings.impairment,
        num_threads=settings.threads,
        engine=settings.engine,
        on_device=settings.engine != THREADS,
        withdraw_after_success=settings.withdraw_after_success,
        human_actions=human_actions,
        by_region=by_region,
        force_guard=settings.force_guard,
        settings=settings.environment_settings,
    )
