"""A policy that remembers: one recipe for every environment, first by imitation, then by PPO.

First it learns from the task's reactive expert, which knows where the person is and sees nobody tremble. The policy
sees observations only, and learns by dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1) to lead
the tool as the expert does (``tool_error``): whatever observations do not say, such as how somebody moves, it has to
remember (Chen et al., "Learning by cheating", CoRL 2019). Then it goes on by PPO, on the task's reward less a little
for each newton.
Its partners are those of ``zoo/train`` and Revised people, who never come to meet a tool. In imitation every other
round has Revised people, and the rounds between have each impairment in turn; in PPO every update has all of them.
Where the expert's ways are too sudden to be learned, a policy may be the teacher in its place. A training may also go
on from a policy that remembers: by PPO alone, unless it says how much of it imitates.
Gradients go back through 50 control steps at most (Williams and Peng, Neural Computation 2, 1990: truncated
backpropagation).

Each round follows from the training's seed, its number and the rounds before, and a checkpoint lies between any two.
"""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import json
import shutil
import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, Float32Array
from avrgym.learning.checkpoint import moments, set_moments
from avrgym.learning.configuration import ADAPTIVE_FILE
from avrgym.learning.course import CHECKPOINT_FILE, POLICY_FILE, CurvePoint, Progress, Tell
from avrgym.learning.exporting import git_commit, thinned
from avrgym.learning.imitation import Shown, load_shown
from avrgym.learning.measuring import measure
from avrgym.learning.recurrent import RecurrentNetwork, fit
from avrgym.learning.recurrent_ppo import DISCOUNT, RecurrentPPO
from avrgym.learning.rollouts import Order, Place, Rollout, roll_out
from avrgym.learning.settings_file import settings_of
from avrgym.learning.tool_error import ToolMotion, tool_error
from avrgym.learning.updates import UpdateNormaliser, observation_of
from avrgym.people.population_names import IMPAIRMENTS, REVISED, TRAIN_ZOO
from avrgym.policies import registry
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.system.files import write_whole
from avrgym.system.locks import locked
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import find_environment, plugins_of, sizes, task_and_scene

SHOWN_FOLDER = "shown"
MEASURED_EPISODES = 100
IMITATION_SHARE = 0.25
EXPERT_SHARE = 0.7
"""The expert drives all worlds in the first round, and in each later one this share of those of the round before."""
SEQUENCES = 32
"""Episodes of one step of the optimizer in imitation."""
PASSES, LAST_PASSES = 40, 1500
"""How many such steps through whole episodes a round of imitation takes, and the last one."""
LEARNING_RATE, FALL, LAST_FALL = 1e-3, 0.3, 0.01
"""The learning rate of imitation, and the share of it that is left at the end of a round and of the last."""
GRADIENT_NORM = 1.0
"""Gradients longer than this are shortened to it."""
CRITIC_ROUNDS = 4
"""Rounds after imitation in which only the critic learns, which does not know yet what the policy is worth."""
LOG_STD = -2.3, -2.6
"""Logarithm of how random actions are at the beginning and the end of PPO."""
CHANCES = 0.0, 0.05, 0.08
"""Standard deviations that a finished policy may act with: it keeps the one with which it succeeds most."""
PPO_LEARNING_RATE, LATER_LEARNING_RATE, LEFT = 3e-5, 1e-4, 0.02
"""PPO's learning rate after imitation, where a higher one takes away what was reached, and where nothing is imitated
before it; and the share of it that is left at the end."""
FORCE_WEIGHT_PER_N = 0.02
"""What each newton on the person takes off a step's reward in PPO, beyond the task's own."""
PAID_FORCE_N = 1.5
"""In PPO a reward pays for pressing, where it does, up to so many newtons."""
OVERLOAD_WEIGHT = 5.0
"""What a step's reward loses in PPO where a region of the body bears its transient limit, see ``rollouts.Order``."""
STILL = (REVISED, "none")
"""Partners in addition to those of the zoo, people and impairment: they stay as they were found."""
TEACHER_FILE, INITIAL_FILE = "teacher.safetensors", "initial.safetensors"
"""The policy that is learned from, where it is not the task's expert, and the one that is gone on from, if any."""


@dataclass(frozen=True)
class ShownWithArm(Shown):
    """What an expert showed, (T, N, ...), and where the arm's joints were then, (T, N, J)."""

    arm_angles_rad: Float32Array


@dataclass(frozen=True, kw_only=True)
class AdaptiveTraining:
    """Settings of adaptive training: ``steps`` environment steps in all, whole rounds of an episode in each world.

    ``imitation_share`` of the rounds imitate, the first ones: the task's expert, or ``teacher``, a policy by its name
    or file. ``initial`` is a recurrent policy to start from, by its name or file; its
    layer sizes replace ``memory`` and ``hidden``. ``withdraw_after_success`` is as of ``Episodes``: then
    contact after success earns nothing, and imitation shows the withdrawal. Unless the share is given it is
    ``IMITATION_SHARE``, and with an initial policy none.
    """

    environment: str
    people: str = TRAIN_ZOO
    steps: int = 1_280_000
    imitation_share: float | None = None
    seed: int = 0
    worlds: int = 64
    memory: int = 128
    hidden: tuple[int, ...] = (128, 128)
    threads: int = 0
    teacher: str | None = None
    initial: str | None = None
    withdraw_after_success: bool = False

    @property
    def rounds(self) -> int:
        """How many episodes are made in each world."""
        return -(-self.steps // (self.worlds * EPISODE_STEPS))

    @property
    def imitation_rounds(self) -> int:
        """How many of them imitate; at least one where it begins with nothing."""
        least, share = (1, IMITATION_SHARE) if self.initial is None else (0, 0.0)
        if self.imitation_share is not None:
            share = self.imitation_share
        return max(least, round(share * self.rounds))

    def ppo_share(self, number: int) -> float:
        """What share of the rounds in which the policy learns by PPO are done before the round of that number."""
        first = self.imitation_rounds + CRITIC_ROUNDS
        return max(0.0, (number - first) / max(1, self.rounds - first))

    @property
    def whole_steps(self) -> int:
        """Environment steps in all."""
        return self.rounds * self.worlds * EPISODE_STEPS


def train(configuration: AdaptiveTraining, out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Train, and leave ``policy.safetensors`` in a folder that holds no training yet.

    Raises:
        ValueError: for an unknown environment, teacher or initial policy, naming what there is, for one of another
            environment, for an initial policy without memory, and for both where nothing imitates.
        FileExistsError: when ``out`` already holds a training.
    """
    find_environment(configuration.environment)
    teacher, initial = _find_teacher(configuration), _find_initial(configuration)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"{out} is not empty; choose another folder, or go on with --resume")
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        for policy, name in ((teacher, TEACHER_FILE), (initial, INITIAL_FILE)):
            if policy is not None:
                policy.save(out / name)
        _store(configuration, out)
        return _Learner(configuration, out, tell).learn()


def resume(out: Path, tell: Tell = lambda progress: None, steps: int | None = None) -> Policy:
    """Go on with the training in ``out``, to the same weights as if it had never been cut off.

    With more ``steps`` it goes on by PPO, also when it had ended, with the chance and the learning rate of so long a
    training.

    Raises:
        ValueError: when there is none, when it is complete, when ``steps`` are fewer than it has, or when its files
            are damaged.
    """
    stored = stored_training(out)
    configuration = stored if steps is None else lengthened(stored, steps)
    with locked(out):
        learner = _Learner(configuration, out, tell)
        if (out / CHECKPOINT_FILE).exists():
            learner.restore()
            if learner.rounds == configuration.rounds and not (out / SHOWN_FOLDER).exists():
                raise ValueError(f"the training in {out} is complete; --steps with a larger number goes on")
        if configuration != stored:
            _store(configuration, out)
        return learner.learn()


def lengthened(training: AdaptiveTraining, steps: int) -> AdaptiveTraining:
    """The training with more steps, as many of them of imitation as before.

    Raises:
        ValueError: for fewer.
    """
    longer = replace(training, steps=steps)
    if longer.rounds < training.rounds:
        raise ValueError(
            f"{steps} steps are fewer than the training's {training.steps}; allowed: those or more"
        )
    return replace(longer, imitation_share=training.imitation_rounds / longer.rounds)


def stored_training(out: Path) -> AdaptiveTraining:
    """What the training in ``out`` is made of.

    Raises:
        ValueError: when there is none, or its file is damaged.
    """
    path = out / ADAPTIVE_FILE
    if not path.exists():
        raise ValueError(f"{out} holds no training of an adaptive policy to resume")
    try:
        return msgspec.json.decode(path.read_bytes(), type=AdaptiveTraining)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: {error}") from error


def _find_teacher(training: AdaptiveTraining) -> Policy | None:
    """The policy that is learned from, where one is named."""
    if training.teacher is None:
        return None
    teacher = registry.find(training.teacher, training.environment)
    if not isinstance(teacher, Policy):
        raise ValueError(f"{training.teacher!r} cannot teach; allowed: a trained policy, by its name or file")
    return teacher


def _find_initial(training: AdaptiveTraining) -> Policy | None:
    """The policy that is gone on from, where one is named."""
    if training.initial is None:
        return None
    if training.teacher is not None and not training.imitation_rounds:
        raise ValueError(
            "a training that goes on from a policy imitates nobody unless its imitation share says so: leave out the "
            "teacher, or give the share"
        )
    initial = registry.find(training.initial, training.environment)
    if not isinstance(initial, Policy) or initial.memory is None:
        raise ValueError(
            f"{training.initial!r} cannot be gone on from; allowed: a policy that remembers, by its name or file"
        )
    return initial


def _store(training: AdaptiveTraining, out: Path) -> None:
    write_whole(out / ADAPTIVE_FILE, msgspec.json.format(msgspec.json.encode(asdict(training))))


class _Learner:
    """A training as it stands between two rounds; ``rounds`` are done."""

    def __init__(self, configuration: AdaptiveTraining, out: Path, tell: Tell) -> None:
        self._configuration, self._out, self._tell = configuration, out, tell
        self._teacher = None if configuration.teacher is None else Policy.load(out / TEACHER_FILE)
        self._initial = None if configuration.initial is None else Policy.load(out / INITIAL_FILE)
        observation_size, action_size = sizes(configuration.environment)
        _, scene = task_and_scene(configuration.environment)
        self._tool_motion = ToolMotion(scene)
        self._normaliser = UpdateNormaliser(observation_of(configuration.environment), DISCOUNT)
        torch.set_num_threads(1)  # so that sums keep their order
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(configuration.seed)
            if self._initial is None:
                self._network = RecurrentNetwork(
                    observation_size, configuration.memory, configuration.hidden, action_size
                )
            else:
                self._network = RecurrentNetwork.of(self._initial)
                self._normaliser.obs_rms.mean = self._initial.observation_mean.copy()
                self._normaliser.obs_rms.var = self._initial.observation_variance.copy()
            self._ppo = RecurrentPPO(self._network, observation_size)
        self.rounds = 0
        self._shown: list[ShownWithArm] = []
        self._curve: list[CurvePoint] = []
        self._seconds_before, self._began = 0.0, time.monotonic()

    def restore(self) -> None:
        """Go on from the checkpoint."""
        path = self._out / CHECKPOINT_FILE
        try:
            state = torch.load(path, weights_only=True)
            self._network.load_state_dict(state["network"])
            self._ppo.restore(state["ppo"])
            set_moments(self._normaliser.obs_rms, state["observations"])
            set_moments(self._normaliser.ret_rms, state["returns"])
            notes: dict[str, Any] = json.loads(state["notes"])
            self.rounds = notes["rounds"]
            if self.rounds < self._configuration.imitation_rounds:
                self._shown = [load_shown(self._file(number), ShownWithArm) for number in range(self.rounds)]
        except Exception as error:  # torch raises many kinds
            raise ValueError(f"{path}: not a checkpoint of this training ({error})") from error
        self._curve = [(steps, reward, success) for steps, reward, success in notes["curve"]]
        self._seconds_before = notes["seconds"]

    def learn(self) -> Policy:
        """Do the rounds that remain, and measure what they led to."""
        configuration = self._configuration
        (self._out / SHOWN_FOLDER).mkdir(exist_ok=True)
        for number in range(self.rounds, configuration.rounds):
            if number < configuration.imitation_rounds:
                stage, (rollout, own) = "imitation", self._imitate(number)
            else:
                stage, (rollout, own) = "PPO", self._improve(number)
            self.rounds += 1
            self._hear(rollout, own)
            self._save()
            self._say(f"{stage}, round {number + 1} of {configuration.rounds}")
        policy = self._with_its_chance()
        shutil.rmtree(self._out / SHOWN_FOLDER)
        return policy

    def _with_its_chance(self) -> Policy:
        """The finished policy, measured with each chance that it may act with; leaves the best in its file."""
        path, measured = self._out / POLICY_FILE, list[Policy]()
        for chance in CHANCES:
            self._say(f"measuring with chance {chance:g}, {MEASURED_EPISODES} episodes")
            self._policy(chance).save(path, overwrite=True)
            measured.append(measure(path, self._configuration.people, "none", MEASURED_EPISODES))
        best = max(measured, key=lambda policy: policy.metadata.measured["success_rate"])
        best.save(path, overwrite=True)
        return best

    def _imitate(self, number: int) -> tuple[Rollout, BoolArray]:
        """A round's episodes, and which of them (N,) the policy drove."""
        configuration = self._configuration
        random = np.random.default_rng([configuration.seed, 2, number])
        by_expert = random.random(configuration.worlds) < EXPERT_SHARE**number
        turn, still = divmod(number, 2)
        partner = STILL if still else (configuration.people, IMPAIRMENTS[turn % len(IMPAIRMENTS)])
        order = Order(
            self._place(*partner),
            0,
            self._episodes(number),
            noise=(configuration.seed, number),
            by_expert=by_expert,
            teacher=self._teacher,
        )
        chance = 0.0 if self._teacher is None else self._teacher.action_deviation
        rollout = roll_out(self._policy(chance), order)
        if self._initial is None:
            self._normaliser.see(rollout)
        assert rollout.arm_angles_rad is not None
        shown = ShownWithArm(rollout.observations[:-1], rollout.actions, rollout.arm_angles_rad)
        np.savez(self._file(number), **asdict(shown))
        self._shown.append(shown)
        self._fit(random, last=number == configuration.imitation_rounds - 1)
        return rollout, ~by_expert

    def _improve(self, number: int) -> tuple[Rollout, BoolArray]:
        """A round's episodes, with chance, all of the policy's own."""
        configuration = self._configuration
        share = configuration.ppo_share(number)
        deviation = float(np.exp(np.interp(share, (0.0, 1.0), LOG_STD)))
        policy, episodes = self._policy(deviation), self._episodes(number)
        partners = [*((configuration.people, impairment) for impairment in IMPAIRMENTS), STILL]
        worlds = np.array_split(np.arange(configuration.worlds), len(partners))
        orders = [
            Order(
                self._place(*partner),
                int(part[0]),
                episodes[part],
                noise=(configuration.seed, number),
                force_weight_per_n=FORCE_WEIGHT_PER_N,
                paid_force_n=PAID_FORCE_N,
                overload_weight=OVERLOAD_WEIGHT,
                detour_weight_per_m=settings_of(configuration.environment).detour_weight_per_m,
            )
            for partner, part in zip(partners, worlds, strict=True)
            if len(part)
        ]
        rollout = Rollout.joined([roll_out(policy, order) for order in orders])
        learns = number >= configuration.imitation_rounds + CRITIC_ROUNDS
        rate = PPO_LEARNING_RATE if configuration.imitation_rounds else LATER_LEARNING_RATE
        self._ppo.improve(
            torch.as_tensor(self._normaliser.normalize_obs(rollout.observations)),
            torch.as_tensor(rollout.actions),
            torch.as_tensor(self._normaliser.rewards(rollout)),
            deviation,
            np.random.default_rng([configuration.seed, 2, number]),
            rate * max(LEFT, 1.0 - share) if learns else 0.0,
        )
        return rollout, np.ones(configuration.worlds, bool)

    def _place(self, people: str, impairment: str) -> Place:
        configuration = self._configuration
        return Place(
            configuration.environment,
            TransferredFile.of(people),
            impairment,
            configuration.threads,
            "threads",
            configuration.withdraw_after_success,
        )

    def _episodes(self, number: int) -> NDArray[np.int64]:
        """Seeds (N,) of a round's episodes; those of another seed, round or world are others."""
        random = np.random.default_rng([self._configuration.seed, 1, number])
        return random.integers(2**31, size=self._configuration.worlds)

    def _fit(self, random: np.random.Generator, *, last: bool) -> None:
        """Least error of the tool in all episodes so far, at a rate that falls; in imitation's last round longer."""
        seen, done, angles_rad = (
            np.concatenate([getattr(each, field.name) for each in self._shown], axis=1)
            for field in fields(ShownWithArm)
        )
        observations, actions = torch.as_tensor(self._normaliser.normalize_obs(seen)), torch.as_tensor(done)
        passes, fall = (LAST_PASSES, LAST_FALL) if last else (PASSES, FALL)
        optimizer = torch.optim.Adam(self._network.parameters(), LEARNING_RATE)
        rate = torch.optim.lr_scheduler.ExponentialLR(optimizer, fall ** (1.0 / passes))
        for _ in range(passes):
            columns = random.integers(actions.shape[1], size=SEQUENCES)
            targets = [actions[:, columns], self._tool_motion.per_action(angles_rad[:, columns])]
            fit(self._network, optimizer, observations[:, columns], tool_error, targets, GRADIENT_NORM)
            rate.step()

    def _hear(self, rollout: Rollout, own: BoolArray) -> None:
        finished = rollout.finished(own)
        if finished:
            reward, success = (sum(column) / len(column) for column in zip(*finished, strict=True))
            self._curve.append((self._steps, reward, success))

    def _say(self, stage: str) -> None:
        reward, success = self._curve[-1][1:] if self._curve else (None, None)
        self._tell(Progress(stage, self._steps, reward, success))

    def _save(self) -> None:
        """Save where the training is, between two rounds, and the policy as it is now."""
        notes = {"rounds": self.rounds, "curve": self._curve, "seconds": self._seconds}
        buffer = io.BytesIO()
        torch.save(
            {
                "network": self._network.state_dict(),
                "ppo": self._ppo.state(),
                "observations": moments(self._normaliser.obs_rms),
                "returns": moments(self._normaliser.ret_rms),
                "notes": json.dumps(notes),
            },
            buffer,
        )
        write_whole(self._out / CHECKPOINT_FILE, buffer.getvalue())
        self._policy().save(self._out / POLICY_FILE, overwrite=True)

    def _policy(self, deviation: float = 0.0) -> Policy:
        configuration = self._configuration
        steps, seconds, curve = 0, 0.0, list[CurvePoint]()
        if self._initial is not None:
            before = self._initial.metadata
            steps, seconds, curve = before.steps, before.seconds, before.curve
        since = [(steps + done, reward, success) for done, reward, success in self._curve]
        metadata = PolicyMetadata(
            environment=configuration.environment,
            people=configuration.people,
            impairment="each in turn",
            steps=steps + self._steps,
            seed=configuration.seed,
            git_commit=git_commit(),
            seconds=round(seconds + self._seconds, 1),
            curve=thinned([*curve, *since]),
            plugins=plugins_of(configuration.environment),
        )
        return self._network.policy(self._normaliser, metadata, deviation)

    @property
    def _steps(self) -> int:
        return self.rounds * self._configuration.worlds * EPISODE_STEPS

    @property
    def _seconds(self) -> float:
        return self._seconds_before + time.monotonic() - self._began

    def _file(self, number: int) -> Path:
        return self._out / SHOWN_FOLDER / f"round_{number:04}.npz"
