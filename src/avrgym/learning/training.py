"""The trainer: runs the updates of a recipe, with checkpoints, a learning curve and a final evaluation.

Needs the extra ``train``; on a device also ``gpu``. The result is a policy file that does not need PyTorch.
"""

import io
import json
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import torch

from avrgym.learning import feedforward_recipe, recurrent_recipe, visual_recipe
from avrgym.learning.configuration import (
    AnyTrainingConfiguration,
    FeedforwardConfiguration,
    RecurrentConfiguration,
    VisualConfiguration,
    contains_training_run,
    find_stored_people,
    make_feedforward_configuration,
    read_configuration,
    store_people,
    write_configuration,
)
from avrgym.learning.evaluation import evaluate
from avrgym.learning.feedforward_recipe import FeedforwardRecipe
from avrgym.learning.imitation import DEMONSTRATIONS_FOLDER
from avrgym.learning.ppo import TENSORBOARD_FOLDER
from avrgym.learning.recipe import LearningCurvePoint, Recipe
from avrgym.learning.recurrent_recipe import RecurrentRecipe
from avrgym.learning.visual_recipe import VisualRecipe
from avrgym.people.impairments import parse_impairment
from avrgym.people.populations import HUMAN_POLICY_FILE, is_trained_human
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.simulation.engines.engine import check_engine_available
from avrgym.system.files import write_atomically
from avrgym.system.locks import lock_folder
from avrgym.system.memory import get_total_memory_bytes
from avrgym.system.random_streams import VALIDATION
from avrgym.tasks.registry import find_plugins, find_task_and_scene, get_observation_and_action_size
from avrgym.tasks.world_people import find_environment_populations

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

__all__ = [
    "POLICY_FILE",
    "TENSORBOARD_FOLDER",
    "TrainingProgress",
    "make_feedforward_configuration",
    "read_configuration",
    "resume_training",
    "train",
]

POLICY_FILE, CHECKPOINT_FILE = "policy.safetensors", "checkpoint.pt"
EVALUATION_EPISODES = 100
"""Number of episodes of the final evaluation of each policy."""
STORED_RESULT_NAMES = ("episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")
"""Names of the results of the final evaluation that the policy file contains."""
MAX_CURVE_POINTS = 100
"""Maximum number of points of the learning curve in a policy file."""
ASSUMED_BYTES_PER_WORLD = 4 << 20
"""Assumed memory in bytes of a world and its part of a rollout. The largest scenes need less."""


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a training run: stage, number of environment steps, and results of the policy's latest episodes.

    Mean reward and success rate are None before the policy completes its first episode.
    """

    stage: str
    num_timesteps: int
    reward_mean: float | None
    success_rate: float | None


TrainingReporter = Callable[[TrainingProgress], object]


def train(
    configuration: AnyTrainingConfiguration,
    out: Path,
    report: TrainingReporter = lambda progress: None,
    *,
    cluster: "Cluster | None" = None,
) -> Policy:
    """Trains and returns a policy. Writes policy, configuration, checkpoint and TensorBoard's log into ``out``.

    If robot and human are trained together (``--recipe pair``), ``human.safetensors`` contains the human's policy. The
    policy file contains results on the validation split. After an interruption, ``out`` contains the latest policy and
    checkpoint; ``resume_training`` continues the training run.

    Args:
        configuration: settings of the training run.
        out: a folder without a training run.
        report: called after every update.
        cluster: a cluster that runs the episodes. Without a cluster, this process runs them. The trained weights are
            the same.

    Raises:
        ValueError: for an unknown environment, people or policy, or if another process uses ``out``.
        FileExistsError: if ``out`` already contains a training run.
        RuntimeError: if the worlds need more memory than the cluster has, or the cluster does not answer.
    """
    _check_unused(out)
    _check(configuration, configuration.people, cluster)
    recurrent = isinstance(configuration, RecurrentConfiguration)
    copied = recurrent_recipe.load_teacher_and_initial_policy(configuration) if recurrent else {}
    if isinstance(configuration, VisualConfiguration):
        copied = {visual_recipe.TEACHER_FILE: visual_recipe.load_teacher(configuration)}
    if Path(configuration.people).is_dir() and is_trained_human(configuration.people):
        configuration = replace(configuration, people=f"{configuration.people.rstrip('/')}/")
    out.mkdir(parents=True, exist_ok=True)
    with lock_folder(out):
        _check_unused(out)
        store_people(configuration.people, out)
        for name, policy in copied.items():
            policy.save(out / name)
        trainer = _Trainer(configuration, out, report, cluster)
        write_configuration(configuration, out)
        return trainer.run()


def resume_training(
    out: Path,
    report: TrainingReporter = lambda progress: None,
    steps: int | None = None,
    *,
    cluster: "Cluster | None" = None,
) -> Policy:
    """Continue the training run in ``out`` from its latest checkpoint. Returns the trained policy.

    The interruption does not change the trained weights. Without a checkpoint, training restarts with the same seed.

    Args:
        out: the folder of the training run.
        report: called after every update.
        steps: new total number of environment steps; default: that of the configuration. The number of imitation steps
            does not change. PPO uses the learning rate and the exploration noise for this total.
        cluster: a cluster that runs the episodes. The trained weights are the same.

    Raises:
        ValueError: if ``out`` contains no training run, or a complete one. Also if another process uses ``out``, or if
            files are damaged.
    """
    configuration = stored = read_configuration(out)
    _check(configuration, find_stored_people(configuration.people, out), cluster)
    with lock_folder(out):
        if steps is not None and steps != configuration.steps:
            configuration = _lengthened(configuration, steps, out)
        trainer = _Trainer(configuration, out, report, cluster)
        if (out / CHECKPOINT_FILE).exists():
            trainer.restore()
        if configuration != stored:
            write_configuration(configuration, out)
        return trainer.run()


def _check_unused(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"{out} is a file; set --out to a folder")
    if contains_training_run(out):
        raise FileExistsError(
            f"{out} already contains a training run; choose another folder, or add --resume"
        )


def _lengthened(configuration: AnyTrainingConfiguration, steps: int, out: Path) -> AnyTrainingConfiguration:
    """Returns the configuration with the total number of environment steps ``steps``."""
    policy = out / POLICY_FILE
    done = Policy.load(policy).metadata.steps if policy.exists() else 0
    if isinstance(configuration, FeedforwardConfiguration) and steps <= done:
        raise ValueError(
            f"the training run in {out} has completed {done} steps; allowed for --steps: a larger number"
        )
    return configuration.with_steps(steps)


def _check(configuration: AnyTrainingConfiguration, people: str, cluster: "Cluster | None") -> None:
    """Raise an error for an invalid configuration, before any file is written."""
    find_task_and_scene(configuration.environment, configuration.settings)
    find_environment_populations(people, configuration.environment)
    _check_memory(configuration, cluster)
    if isinstance(configuration, RecurrentConfiguration | VisualConfiguration):
        if cluster is not None:
            raise ValueError(
                "the recipes adaptive and visual cannot use a cluster; remove --cluster, or choose another --recipe"
            )
        return
    parse_impairment(configuration.impairment)
    check_engine_available(configuration.engine)
    feedforward_recipe.check_configuration(configuration, people, cluster)
    if cluster is not None:
        worlds = -(
            -configuration.num_envs // feedforward_recipe.count_rollout_requests(configuration, cluster)
        )
        cluster.reserve_memory(worlds * ASSUMED_BYTES_PER_WORLD)


def _check_memory(configuration: AnyTrainingConfiguration, cluster: "Cluster | None") -> None:
    """Raises ``ValueError`` if the worlds (with a cluster: the episodes) need more memory than this computer has."""
    observation, action = get_observation_and_action_size(configuration.environment)
    episode = configuration.episode_steps * (3 * observation + 2 * action + 8) * np.dtype(np.float32).itemsize
    worlds = configuration.num_envs
    needed, available = worlds * (episode if cluster else ASSUMED_BYTES_PER_WORLD), get_total_memory_bytes()
    if available is not None and needed > available:
        raise ValueError(
            f"{worlds} worlds need {needed / 2**30:.1f} GiB of memory; this computer has "
            f"{available / 2**30:.1f} GiB; allowed: {available * worlds // needed} worlds (num_envs) or fewer"
        )


def _recipe(configuration: AnyTrainingConfiguration, out: Path, cluster: "Cluster | None") -> Recipe:
    if isinstance(configuration, RecurrentConfiguration):
        return RecurrentRecipe(configuration, out)
    if isinstance(configuration, VisualConfiguration):
        return VisualRecipe(configuration, out)
    return FeedforwardRecipe(configuration, out, cluster)


class _Trainer:
    """Runs a training run in this process, and writes checkpoints into its folder."""

    def __init__(
        self,
        configuration: AnyTrainingConfiguration,
        out: Path,
        report: TrainingReporter,
        cluster: "Cluster | None",
    ) -> None:
        self._configuration, self._out, self._report = configuration, out, report
        self._recipe = _recipe(configuration, out, cluster)
        self._curve: list[LearningCurvePoint] = []
        self._seconds_before, self._started = 0.0, time.monotonic()

    def restore(self) -> None:
        """Restore the latest checkpoint.

        Raises:
            ValueError: for a damaged file, or if the training run is complete.
        """
        path = self._out / CHECKPOINT_FILE
        try:
            tensors: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
            values: dict[str, Any] = json.loads(tensors["notes"])
        except Exception as error:  # torch raises many types of exceptions
            raise ValueError(
                f"{path}: not a checkpoint of this training run ({error}); start a new training run"
            ) from error
        try:
            self._recipe.restore(tensors, values)
        except (KeyError, TypeError, RuntimeError) as error:
            raise ValueError(
                f"{path}: not a checkpoint of this training run ({error}); start a new training run"
            ) from error
        self._curve = [(steps, reward, success) for steps, reward, success in values["curve"]]
        self._seconds_before = values["seconds"]
        finished = not (self._out / DEMONSTRATIONS_FOLDER).exists()
        if self._recipe.num_timesteps >= self._configuration.steps and finished and self._is_evaluated():
            raise ValueError(
                f"the training run in {self._out} is complete after {self._recipe.num_timesteps} steps; "
                "set --steps to a larger number to continue it"
            )

    def run(self) -> Policy:
        """Run the remaining updates, and evaluate the finished policy. Returns this policy."""
        recipe, configuration = self._recipe, self._configuration
        while recipe.num_timesteps < configuration.steps:
            update = recipe.update()
            if update.reward_mean is not None and update.success_rate is not None:
                self._curve.append((recipe.num_timesteps, update.reward_mean, update.success_rate))
            self._save()
            number = recipe.num_timesteps // configuration.steps_per_update
            self._tell(f"{update.stage}, update {number} of {configuration.total_updates}")
        policy = self._evaluate()
        shutil.rmtree(self._out / DEMONSTRATIONS_FOLDER, ignore_errors=True)
        return policy

    def _tell(self, stage: str) -> None:
        reward, success = self._curve[-1][1:] if self._curve else (None, None)
        self._report(TrainingProgress(stage, self._recipe.num_timesteps, reward, success))

    def _is_evaluated(self) -> bool:
        return bool(Policy.load(self._out / POLICY_FILE).metadata.measured)

    def _save(self) -> None:
        """Write the checkpoint and the current policies into the folder of the training run."""
        tensors, values = self._recipe.checkpoint_state()
        notes = {**values, "curve": self._curve, "seconds": self._seconds}
        buffer = io.BytesIO()
        torch.save({**tensors, "notes": json.dumps(notes)}, buffer)
        write_atomically(self._out / CHECKPOINT_FILE, buffer.getvalue())
        self._save_policies(self._policies())

    def _policies(self) -> list[Policy]:
        configuration = self._configuration
        metadata = PolicyMetadata(
            environment=configuration.environment,
            people=configuration.people,
            steps=self._recipe.num_timesteps,
            seed=configuration.seed,
            git_commit=_git_commit(),
            seconds=round(self._seconds, 1),
            curve=self._curve,
            plugins=find_plugins(configuration.environment),
            force_guard=configuration.force_guard,
            settings=configuration.settings.changed_values,
        )
        return [
            with_metadata(policy, curve=downsample_curve(policy.metadata.curve))
            for policy in self._recipe.export_policies(metadata)
        ]

    def _save_policies(self, policies: list[Policy]) -> None:
        for policy, name in zip(policies, (POLICY_FILE, HUMAN_POLICY_FILE), strict=False):
            policy.save(self._out / name, overwrite=True)

    def _evaluate(self) -> Policy:
        """Evaluate the policy with each candidate for the action standard deviation. Writes and returns the policy with
        the highest success rate.
        """
        robot, *humans = self._policies()
        evaluated: list[Policy] = []
        stds = self._recipe.candidate_action_stds
        for action_std in stds:
            noise = f" with action_std {action_std:g}" if len(stds) > 1 else ""
            self._tell(f"evaluation{noise}, {EVALUATION_EPISODES} episodes")
            candidate = replace(robot, action_std=action_std)
            self._save_policies([candidate])
            evaluated.append(with_metadata(candidate, measured=self._results()))
        best = max(evaluated, key=lambda policy: policy.metadata.measured["success_rate"])
        results = best.metadata.measured
        self._save_policies([best, *(with_metadata(human, measured=results) for human in humans)])
        return best

    def _results(self) -> dict[str, Any]:
        """Evaluate the saved policy with the training population, or with the human that was trained together with it.
        Returns the results that the policy file stores."""
        configuration, out = self._configuration, self._out
        people, impairment = find_stored_people(configuration.people, out), "none"
        if isinstance(configuration, FeedforwardConfiguration):
            impairment = configuration.impairment
            if configuration.pairing is not None:
                people, impairment = str(out / HUMAN_POLICY_FILE), "none"
        row = evaluate(
            configuration.environment,
            str(out / POLICY_FILE),
            people,
            EVALUATION_EPISODES,
            seed=0,
            impairment=impairment,
            split=VALIDATION,
            force_guard=configuration.force_guard,
            settings=configuration.settings,
            steps=configuration.episode_steps,
        )
        names = (
            [*STORED_RESULT_NAMES, "guard_interventions"]
            if configuration.force_guard
            else STORED_RESULT_NAMES
        )
        return {name: getattr(row, name) for name in names}

    @property
    def _seconds(self) -> float:
        """Returns the duration of the training run until now, in seconds."""
        return self._seconds_before + time.monotonic() - self._started


def with_metadata(policy: Policy, **changes: Any) -> Policy:
    """Returns a copy of the policy; ``changes`` are new values of metadata fields."""
    return replace(policy, metadata=msgspec.structs.replace(policy.metadata, **changes))


def downsample_curve(curve: list[LearningCurvePoint]) -> list[LearningCurvePoint]:
    """Returns at most ``MAX_CURVE_POINTS`` points of a curve, including the last point."""
    stride = -(-len(curve) // MAX_CURVE_POINTS) or 1
    return curve[::-stride][::-1]


@cache
def _git_commit() -> str:
    """Returns the Git commit of this code, or an empty text if it is unknown."""
    found = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent, check=False
    )
    return found.stdout.strip()
