"""A policy that remembers, learned from an expert that sees everything: one recipe for every environment.

The expert is the task's reactive one, which knows where the person is and sees nobody tremble. The policy sees
observations only, and learns by dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1) to do as the
expert does: whatever observations do not say, such as how somebody moves, it has to remember (Chen et al., "Learning by
cheating", CoRL 2019). Its partners are those of ``zoo/train``, with each impairment in turn. Gradients go back through
``WINDOW`` control steps at most (Williams and Peng, Neural Computation 2, 1990: truncated backpropagation).

Each round follows from the training's seed, its number and the rounds before, and a checkpoint lies between any two.
"""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import json
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from avrgym.learning.checkpoint import moments, set_moments
from avrgym.learning.course import CHECKPOINT_FILE, POLICY_FILE, CurvePoint, Progress, Tell
from avrgym.learning.exporting import git_commit, thinned
from avrgym.learning.imitation import Shown, load_shown
from avrgym.learning.measuring import measure
from avrgym.learning.recurrent import RecurrentNetwork
from avrgym.learning.rollouts import Order, Place, Rollout, roll_out
from avrgym.learning.updates import UpdateNormaliser, observation_of
from avrgym.people.names import IMPAIRMENTS, TRAIN_ZOO
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.system.carried import Carried
from avrgym.system.files import write_whole
from avrgym.system.locks import locked
from avrgym.tasks.known import EPISODE_STEPS
from avrgym.tasks.registry import find_environment, sizes

FILE = "distillation.json"
SHOWN_FOLDER = "shown"
MEASURED_EPISODES = 100
EXPERT_SHARE = 0.7
"""The expert drives all worlds in the first round, and in each later one this share of those of the round before."""
WINDOW = 50
SEQUENCES = 32
"""Episodes of one step of the optimizer."""
PASSES, LAST_PASSES = 40, 1500
"""How many such steps through whole episodes a round takes, and the last one."""
LEARNING_RATE, FALL, LAST_FALL = 1e-3, 0.3, 0.01
"""The learning rate, and the share of it that is left at the end of a round and of the last."""
GRADIENT_NORM = 1.0
"""Gradients longer than this are shortened to it."""


@dataclass(frozen=True, kw_only=True)
class Distillation:
    """What is trained where: ``steps`` environment steps in all, whole rounds of an episode in each world."""

    environment: str
    people: str = TRAIN_ZOO
    steps: int = 500_000
    seed: int = 0
    worlds: int = 64
    memory: int = 128
    hidden: tuple[int, ...] = (128, 128)
    threads: int = 0

    @property
    def rounds(self) -> int:
        """How many episodes are made in each world."""
        return -(-self.steps // (self.worlds * EPISODE_STEPS))

    @property
    def whole_steps(self) -> int:
        """Environment steps in all."""
        return self.rounds * self.worlds * EPISODE_STEPS


def distil(configuration: Distillation, out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Train, and leave ``policy.safetensors`` in a folder that holds no training yet.

    Raises:
        ValueError: for an unknown environment, naming what there is.
        FileExistsError: when ``out`` already holds a training.
    """
    find_environment(configuration.environment)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileExistsError(f"{out} is not empty; choose another folder, or go on with --resume")
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        write_whole(out / FILE, msgspec.json.format(msgspec.json.encode(asdict(configuration))))
        return _Learner(configuration, out, tell).learn()


def resume(out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Go on with the training in ``out``, to the same weights as if it had never been cut off.

    Raises:
        ValueError: when there is none, when it is complete, or when its files are damaged.
    """
    configuration = stored_distillation(out)
    with locked(out):
        learner = _Learner(configuration, out, tell)
        if (out / CHECKPOINT_FILE).exists():
            if not (out / SHOWN_FOLDER).exists():
                raise ValueError(f"the training in {out} is complete")
            learner.restore()
        return learner.learn()


def stored_distillation(out: Path) -> Distillation:
    """What the training in ``out`` is made of.

    Raises:
        ValueError: when there is none, or its file is damaged.
    """
    path = out / FILE
    if not path.exists():
        raise ValueError(f"{out} holds no training of an adaptive policy to resume")
    try:
        return msgspec.json.decode(path.read_bytes(), type=Distillation)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: {error}") from error


class _Learner:
    """A training as it stands between two rounds."""

    def __init__(self, configuration: Distillation, out: Path, tell: Tell) -> None:
        self._configuration, self._out, self._tell = configuration, out, tell
        observation_size, action_size = sizes(configuration.environment)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(configuration.seed)
            self._network = RecurrentNetwork(
                observation_size, configuration.memory, configuration.hidden, action_size
            )
        self._normaliser = UpdateNormaliser(observation_of(configuration.environment), discount=0.99)
        self._shown: list[Shown] = []
        self._curve: list[CurvePoint] = []
        self._seconds_before, self._began = 0.0, time.monotonic()

    def restore(self) -> None:
        """Go on from the checkpoint."""
        path = self._out / CHECKPOINT_FILE
        try:
            state = torch.load(path, weights_only=True)
            self._network.load_state_dict(state["network"])
            set_moments(self._normaliser.obs_rms, state["observations"])
            notes: dict[str, Any] = json.loads(state["notes"])
            self._shown = [load_shown(self._file(number)) for number in range(notes["rounds"])]
        except Exception as error:  # torch raises many kinds
            raise ValueError(f"{path}: not a checkpoint of this training ({error})") from error
        self._curve = [(steps, reward, success) for steps, reward, success in notes["curve"]]
        self._seconds_before = notes["seconds"]

    def learn(self) -> Policy:
        """Do the rounds that remain, and measure what they led to."""
        configuration, path = self._configuration, self._out / POLICY_FILE
        (self._out / SHOWN_FOLDER).mkdir(exist_ok=True)
        for number in range(len(self._shown), configuration.rounds):
            self._round(number)
        self._say(f"measuring, {MEASURED_EPISODES} episodes")
        policy = measure(path, configuration.people, "none", MEASURED_EPISODES)
        shutil.rmtree(self._out / SHOWN_FOLDER)
        return policy

    def _round(self, number: int) -> None:
        configuration = self._configuration
        random = np.random.default_rng([configuration.seed, 2, number])
        by_expert = random.random(configuration.worlds) < EXPERT_SHARE**number
        rollout = roll_out(self._policy(), self._order(number, by_expert))
        self._normaliser.see(rollout)
        shown = Shown(rollout.observations[:-1], rollout.actions)
        np.savez(self._file(number), **asdict(shown))
        self._shown.append(shown)
        self._fit(random, last=number == configuration.rounds - 1)
        self._hear(rollout, ~by_expert)
        self._save()
        self._say(f"round {number + 1} of {configuration.rounds}")

    def _order(self, number: int, by_expert: NDArray[np.bool_]) -> Order:
        """A round's episodes; those of another seed, round or world are others."""
        configuration = self._configuration
        place = Place(
            configuration.environment,
            Carried.of(configuration.people),
            IMPAIRMENTS[number % len(IMPAIRMENTS)],
            configuration.threads,
            "threads",
        )
        random = np.random.default_rng([configuration.seed, 1, number])
        return Order(place, 0, random.integers(2**31, size=configuration.worlds), by_expert=by_expert)

    def _fit(self, random: np.random.Generator, *, last: bool) -> None:
        """Least squares over all episodes so far, at a rate that falls; in the last round longer."""
        observations = torch.as_tensor(
            self._normaliser.normalize_obs(
                np.concatenate([each.observations for each in self._shown], axis=1)
            )
        )
        actions = torch.as_tensor(np.concatenate([each.actions for each in self._shown], axis=1))
        passes, fall = (LAST_PASSES, LAST_FALL) if last else (PASSES, FALL)
        optimizer = torch.optim.Adam(self._network.parameters(), LEARNING_RATE)
        rate = torch.optim.lr_scheduler.ExponentialLR(optimizer, fall ** (1.0 / passes))
        for _ in range(passes):
            columns = torch.as_tensor(random.integers(actions.shape[1], size=SEQUENCES))
            remembered = None
            for first in range(0, EPISODE_STEPS, WINDOW):
                window = slice(first, first + WINDOW)
                means, remembered = self._network(observations[window, columns], remembered)
                loss = torch.nn.functional.mse_loss(means, actions[window, columns])
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self._network.parameters(), GRADIENT_NORM)
                optimizer.step()
                remembered = remembered.detach()
            rate.step()

    def _hear(self, rollout: Rollout, own: NDArray[np.bool_]) -> None:
        finished = rollout.finished(own)
        if finished:
            reward, success = (sum(column) / len(column) for column in zip(*finished, strict=True))
            self._curve.append((self._steps, reward, success))

    def _say(self, stage: str) -> None:
        reward, success = self._curve[-1][1:] if self._curve else (None, None)
        self._tell(Progress(stage, self._steps, reward, success))

    def _save(self) -> None:
        """Save where the training is, between two rounds, and the policy as it is now."""
        notes = {"rounds": len(self._shown), "curve": self._curve, "seconds": self._seconds}
        buffer = io.BytesIO()
        torch.save(
            {
                "network": self._network.state_dict(),
                "observations": moments(self._normaliser.obs_rms),
                "notes": json.dumps(notes),
            },
            buffer,
        )
        write_whole(self._out / CHECKPOINT_FILE, buffer.getvalue())
        self._policy().save(self._out / POLICY_FILE, overwrite=True)

    def _policy(self) -> Policy:
        configuration = self._configuration
        metadata = PolicyMetadata(
            environment=configuration.environment,
            people=configuration.people,
            impairment="each in turn",
            steps=self._steps,
            seed=configuration.seed,
            git_commit=git_commit(),
            seconds=round(self._seconds, 1),
            curve=thinned(self._curve),
        )
        return self._network.policy(self._normaliser, metadata)

    @property
    def _steps(self) -> int:
        return len(self._shown) * self._configuration.worlds * EPISODE_STEPS

    @property
    def _seconds(self) -> float:
        return self._seconds_before + time.monotonic() - self._began

    def _file(self, number: int) -> Path:
        return self._out / SHOWN_FOLDER / f"round_{number:04}.npz"
