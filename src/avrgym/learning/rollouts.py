"""Episodes for training: the same of the same policy and order, in whatever process and beside whomever they are made.

So the worlds of an update may be shared among processes, and a part that was lost is made again. On an engine with a
device of its own they stay there from an episode's beginning to its end.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, Float32Array, FloatArray
from avrgym.geometry.arrays import moved_to, namespace, to_numpy
from avrgym.learning.evaluation import watched_step
from avrgym.policies.actors import Actor, ActorThere
from avrgym.policies.trained import Policy
from avrgym.safety.limits import TRANSIENT_LIMIT_N
from avrgym.safety.region_forces import RegionWatch
from avrgym.system.engines import THREADS
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes, Step
from avrgym.tasks.experts.filtered import filtered
from avrgym.tasks.task import Controller

NOISE_STREAMS = 4, 5
"""Of the robots' actions and of the humans', of the streams that are drawn from a training's seed; the others choose
episodes, experts and minibatches."""


@dataclass(frozen=True)
class Place:
    """The worlds of a training, which a process compiles once; on any engine but threads they stay on its device."""

    environment: str
    people: TransferredFile
    impairment: str
    threads: int
    engine: str
    withdraw_after_success: bool = False


@dataclass(frozen=True)
class Order:
    """Whole episodes in n of a training's worlds, from the world ``first`` on.

    Args:
        place: where.
        first: the number of the first world in the training.
        episodes: seeds that the episodes are drawn from, (n,).
        noise: what the actions' chance is drawn from, beside the world's number; without it there is none.
        by_expert: (n,) which worlds an expert drives, see ``_expert_for``; it then says in all of them what it would
            do. Experts compute on the host only.
        teacher: a policy that is the expert, in place of the task's own; it acts without chance.
        force_weight_per_n: what each newton on the person takes off a step's reward.
        paid_force_n: up to how many newtons a task's reward pays for pressing, where it does; the rest is taken off.
        overload_weight: what it takes off a step's reward when a region of the body bears its transient limit in any
            physics step; from half the limit on evenly, and above it more. Measured on the host only.
        detour_weight_per_m: what each metre of a detour that the tool has to make to its goal takes off, but for an
            episode's last step.
        shared_reward: whether a human who acts beside the robot is rewarded as the robot is, see
            ``Episodes.human_reward``.
    """

    place: Place
    first: int
    episodes: NDArray[np.int64]
    noise: tuple[int, int] | None = None
    by_expert: BoolArray | None = None
    teacher: Policy | None = None
    force_weight_per_n: float = 0.0
    paid_force_n: float = np.inf
    overload_weight: float = 0.0
    detour_weight_per_m: float = 0.0
    shared_reward: bool = True


@dataclass(frozen=True)
class Rollout:
    """Whole episodes of n worlds; time comes first, T steps, then the world.

    ``observations`` (T + 1, n, O) are the plain ones, the last of them after the last step. ``actions`` (T, n, J) are
    those of the policy before they are clipped, or the expert's. ``rewards`` (T, n) are less what the order takes off.
    Of each episode (n,): the sum of the task's own rewards, whether it succeeded, the mean force on the person. These
    are always on the host, the others are tensors where the worlds are on a device. ``arm_angles_rad`` (T, n, J) are
    those before each step, where an expert says what to do.
    """

    observations: Any
    actions: Any
    rewards: Any
    episode_return: FloatArray
    success: BoolArray
    episode_force_n: FloatArray
    arm_angles_rad: Float32Array | None = None

    @classmethod
    def joined(cls, parts: list["Rollout"]) -> "Rollout":
        """The worlds of several parts beside each other."""
        if len(parts) == 1:
            return parts[0]
        names = parts[0]._arrays
        return cls(**{name: _beside([getattr(part, name) for part in parts]) for name in names})

    @property
    def nbytes(self) -> int:
        """How many bytes its arrays have."""
        return sum(array.nbytes for array in self._arrays.values())

    @property
    def _arrays(self) -> dict[str, Any]:
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: array for name, array in arrays.items() if array is not None}

    def finished(self, of: slice | BoolArray = slice(None)) -> list[tuple[float, bool]]:
        """Return and success of some of its episodes."""
        return [*zip(self.episode_return[of].tolist(), self.success[of].tolist(), strict=True)]


def _beside(arrays: list[Any]) -> Any:
    """Arrays of the same steps, of other worlds each."""
    return np.concatenate(arrays, axis=1 if arrays[0].ndim == 3 else -1)


def roll_out(policy: Policy, order: Order) -> Rollout:
    """Make the episodes of an order, of a robot; see ``roll_out_all``."""
    return roll_out_all([policy], order)[0]


def roll_out_all(policies: Sequence[Policy], order: Order) -> list[Rollout]:
    """Make the episodes of an order as the robot met them, and as the human did where one acts beside it.

    ``policies`` are the robot's and, where the human acts, the human's.

    Raises:
        RuntimeError, ValueError: where episodes on a device are worth nothing, see ``Episodes.check``.
    """
    count = len(order.episodes)
    by_region = order.overload_weight > 0.0
    worlds = worlds_of(order.place, count, steered=len(policies) > 1, by_region=by_region)
    generators = [np.random.default_rng(int(seed)) for seed in order.episodes]
    first = worlds.begin(np.arange(count), generators)
    xp: Any = namespace(first)
    robot = _Agent(policies[0], NOISE_STREAMS[0], order, first)
    humans = [_Agent(policy, NOISE_STREAMS[1], order, worlds.observe_as_human()) for policy in policies[1:]]
    expert = None if order.by_expert is None else _expert_for(policies[0], order, worlds)
    returns = force_n = xp.zeros(count, dtype=xp.float64, device=first.device)
    success: Any = None
    arm_angles_rad: list[FloatArray] = []
    for number in range(EPISODE_STEPS):
        action = robot.act(number)
        if expert is not None:
            arm_angles_rad.append(worlds.simulation.arm_angles_rad())
            shown = worlds.led(np.clip(expert(worlds.observe()), -1.0, 1.0))
            robot.done[-1] = shown.astype(np.float32)
            assert order.by_expert is not None
            action = np.where(order.by_expert[:, None], robot.done[-1], action)
        for human in humans:
            worlds.steer_people(np.clip(human.act(number), -1.0, 1.0).astype(float))
        action = xp.astype(xp.clip(action, -1.0, 1.0), first.dtype)
        step, overload = _watched(worlds, action) if by_region else (worlds.step(action), 0.0)
        robot.see(step.observation)
        cost = _cost(worlds, order, step, last=number == EPISODE_STEPS - 1) + order.overload_weight * overload
        robot.rewards.append(step.reward - cost)
        for human in humans:
            human.see(worlds.observe_as_human())
            reward = worlds.human_reward(step, human.done[-1].astype(float), shared=order.shared_reward)
            human.rewards.append(reward - cost)
        returns = returns + step.reward
        force_n = force_n + step.force_on_person_n / EPISODE_STEPS
        success = step.success
    worlds.check()
    of_episodes = to_numpy(returns), to_numpy(success), to_numpy(force_n)
    rollouts = [agent.rollout(*of_episodes) for agent in (robot, *humans)]
    if expert is not None:
        rollouts[0] = replace(rollouts[0], arm_angles_rad=np.stack(arm_angles_rad).astype(np.float32))
    return rollouts


def _watched(worlds: Episodes, action: FloatArray) -> tuple[Step, FloatArray]:
    """One control step, and how far (n,) it loaded a region of the body above half its transient limit.

    0 is half the limit or less in all its physics steps, 1 the whole of it.
    """
    watch = RegionWatch(len(action))
    step = watched_step(worlds, action, watch)
    share = (watch.loads().peak_n / TRANSIENT_LIMIT_N).max(axis=-1)
    return step, np.maximum(2.0 * share - 1.0, 0.0)


def _expert_for(policy: Policy, order: Order, worlds: Episodes) -> Controller:
    """Whom a policy learns from: the order's teacher, or the task's reactive expert.

    One that remembers learns from the patient one, where there is one, and from experts who see nobody tremble.
    """
    if order.teacher is not None:
        return Actor(order.teacher, len(order.episodes)).mean
    task = worlds.task
    if policy.memory is None:
        return task.feedback_expert(worlds)
    return filtered(task.memory_expert or task.feedback_expert)(worlds)


class _Agent:
    """One agent in the worlds of an order: what it sees, does and is rewarded with, where its worlds are."""

    def __init__(self, policy: Policy, noise_stream: int, order: Order, first: Any) -> None:
        """Begin with the first observations, (n, O)."""
        self._xp: Any = namespace(first)
        self.seen: list[Any] = []
        self.done: list[Any] = []
        self.rewards: list[Any] = []
        self._actor = Actor(policy, len(order.episodes)) if self._xp is np else ActorThere(policy, first)
        self._chance = moved_to(policy.action_deviation * _noise(policy, noise_stream, order), first)
        self.see(first)

    def see(self, observation: Any) -> None:
        """Take what it observes, (n, O)."""
        self.seen.append(self._xp.astype(observation, self._xp.float32))

    def act(self, number: int) -> Any:
        """Its actions (n, J) in the step of that number, before they are clipped."""
        mean = self._actor.mean(self.seen[-1])
        self.done.append(self._xp.astype(mean + self._chance[number], self._xp.float32))
        return self.done[-1]

    def rollout(self, returns: FloatArray, success: BoolArray, force_n: FloatArray) -> Rollout:
        """All of it, with what came of the episodes."""
        xp = self._xp
        told = xp.astype(xp.stack(self.rewards), xp.float32)
        return Rollout(xp.stack(self.seen), xp.stack(self.done), told, returns, success, force_n)


def _noise(policy: Policy, stream: int, order: Order) -> FloatArray:
    """The actions' chance (T, n, J), in standard deviations; each world draws its own."""
    shape = (EPISODE_STEPS, policy.action_size)
    if order.noise is None:
        return np.zeros((EPISODE_STEPS, len(order.episodes), policy.action_size))
    seed, steps = order.noise
    numbers = range(order.first, order.first + len(order.episodes))
    streams = (np.random.default_rng([seed, stream, steps, number]) for number in numbers)
    return np.stack([each.standard_normal(shape) for each in streams], axis=1)


def _cost(worlds: Episodes, order: Order, step: Step, *, last: bool) -> FloatArray:
    """What an order takes off the rewards of a step, (n,)."""
    cost = order.force_weight_per_n * step.force_on_person_n + _paid_beyond(order.paid_force_n, worlds, step)
    detour_m = worlds.task.detour_m
    if last or detour_m is None or not order.detour_weight_per_m:
        return cost
    return cost + order.detour_weight_per_m * detour_m(worlds.simulation.state(), worlds.task_state)


def _paid_beyond(most_n: float, worlds: Episodes, step: Step) -> FloatArray:
    """What the reward's terms in newtons paid (n,) for those beyond the most; their names end with their unit."""
    xp = namespace(step.reward)
    paid = xp.zeros_like(step.reward)
    for name, weight in worlds.task.weights.items():
        if weight > 0.0 and name.endswith("_n"):
            term = step.reward_terms[name]
            paid = paid + weight * xp.maximum(term - most_n, xp.zeros_like(term))
    return paid


@lru_cache(maxsize=2)
def worlds_of(place: Place, count: int, *, steered: bool = False, by_region: bool = False) -> Episodes:
    """So many worlds, made once: of a training whose worlds are not shared evenly a process makes parts of two sizes.

    Raises:
        ValueError: for more worlds than there is memory for.
    """
    return Episodes(
        place.environment,
        count,
        distribution=place.people.here(),
        impairment=place.impairment,
        num_threads=place.threads,
        engine=place.engine,
        on_device=place.engine != THREADS,
        withdraw_after_success=place.withdraw_after_success,
        steered=steered,
        by_region=by_region,
    )
