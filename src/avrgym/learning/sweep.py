"""Sweeps: many training runs on a Ray cluster, scheduled by Ray Tune. Needs the extras ``train`` and ``cluster``.

Each training run has its own folder, uses one core, and results in the same weights as ``training.train``.
"""

# Ray Tune's types are known only in part.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
from ray import tune
from ray.tune.schedulers import ASHAScheduler, FIFOScheduler

from avrgym.learning import training
from avrgym.learning.configuration import FeedforwardConfiguration, contains_training_run, read_configuration
from avrgym.learning.sweep_file import (
    EarlyStopping,
    PlannedTrainingRun,
    Sweep,
    plan_training_runs,
    read_sweep,
)
from avrgym.learning.training import POLICY_FILE
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.system.files import write_atomically
from avrgym.system.locks import lock_folder

SWEEP_FILE = "sweep.toml"
RAY_TUNE_FOLDER = "schedule"
"""Name of the folder with Ray Tune's state. It has a subfolder for each group of training runs."""
PLACEHOLDER_REWARD = -1e9
"""Mean reward that Ray Tune receives before the first episode ends."""

SweepReporter = Callable[[str, int], None]
"""Function that is called with the name of a training run and its number of environment steps."""
_report: ContextVar[SweepReporter] = ContextVar("_report")


@dataclass(frozen=True)
class SweepResult:
    """The result of a training run. ``outcome`` is "complete" or "stopped early". ``reward_mean`` and ``success_rate``
    are None if the run was stopped early. ``policy`` is the path of the policy file.
    """

    env: str
    people: str
    recipe: str
    seed: int
    outcome: str
    steps: int
    reward_mean: float | None
    success_rate: float | None
    policy: str


def create_sweep(file: Path, out: Path) -> None:
    """Create the folder ``out`` of a new sweep, and copy the sweep file into it.

    Raises:
        ValueError: for an invalid sweep. The message contains the allowed values.
        FileExistsError: if ``out`` already contains a sweep.
    """
    plan_training_runs(read_sweep(file), str(file))
    if (out / SWEEP_FILE).exists():
        raise FileExistsError(f"{out} already contains a sweep; choose another folder, or add --resume")
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / SWEEP_FILE, file.read_bytes())


def read_planned_runs(out: Path) -> dict[str, list[PlannedTrainingRun]]:
    """Returns the training runs of the sweep in a folder, by group.

    Raises:
        ValueError: if the folder contains no sweep.
    """
    return plan_training_runs(_stored(out), str(out / SWEEP_FILE))


def _stored(out: Path) -> Sweep:
    path = out / SWEEP_FILE
    if not path.exists():
        raise ValueError(f"{out} contains no sweep; allowed: the --out folder of a sweep")
    return read_sweep(path)


def run_sweep(out: Path, jobs: int | None, report: SweepReporter) -> list[SweepResult]:
    """Run or continue all training runs of the sweep in ``out`` on the connected cluster. Returns their results.

    Groups run one after another. Training runs of a group run in parallel, on all cores or on ``jobs`` cores. The
    folder must have the same path on every node.

    Raises:
        ValueError: if the folder contains no sweep, or another process runs it.
        RuntimeError: if training runs failed. The message contains the first error. All other runs are complete.
    """
    sweep = _stored(out)
    groups = plan_training_runs(sweep, str(out / SWEEP_FILE))
    with lock_folder(out), _quiet():
        token = _report.set(report)
        try:
            failed = [
                failure
                for number, group in enumerate(groups.values())
                for failure in _run_group(out.resolve(), f"group_{number}", group, sweep.stopping, jobs)
            ]
        finally:
            _report.reset(token)
    if failed:
        raise RuntimeError(
            f"{len(failed)} of {sum(map(len, groups.values()))} training runs failed; correct the error and add "
            f"--resume. The first error is: {failed[0]}"
        )
    return [_outcome(out, each) for group in groups.values() for each in group]


def _run_group(
    out: Path,
    name: str,
    group: Sequence[PlannedTrainingRun],
    stopping: EarlyStopping | None,
    jobs: int | None,
) -> list[str]:
    """Run a group of training runs. Returns the error messages of failed runs."""
    schedule = out / RAY_TUNE_FOLDER / name
    trainable = tune.with_resources(_train_one, {"cpu": 1})
    if tune.Tuner.can_restore(str(schedule)):
        tuner = tune.Tuner.restore(str(schedule), trainable, resume_unfinished=True, restart_errored=True)
    else:
        tuner = tune.Tuner(
            trainable,
            param_space={
                "training": tune.grid_search(
                    [
                        {"folder": str(out / each.folder_name), "configuration": asdict(each.configuration)}
                        for each in group
                    ]
                )
            },
            tune_config=tune.TuneConfig(
                metric="reward_mean",
                mode="max",
                scheduler=_scheduler(stopping, group[0].configuration.total_steps),
                max_concurrent_trials=jobs,
                reuse_actors=False,
            ),
            run_config=tune.RunConfig(
                name=name, storage_path=str(schedule.parent), verbose=0, callbacks=[_Listener()]
            ),
        )
    return [f"{each.path}: {str(each.error).strip().splitlines()[-1]}" for each in tuner.fit() if each.error]


def _scheduler(stopping: EarlyStopping | None, steps: int) -> Any:
    if stopping is None:
        return FIFOScheduler()
    grace, factor = min(stopping.after_steps, steps), stopping.factor
    return ASHAScheduler(time_attr="steps", max_t=steps + 1, grace_period=grace, reduction_factor=factor)


class _Listener(tune.Callback):
    """Reports the name and the number of environment steps of each training run."""

    def on_trial_result(self, iteration: int, trials: Any, trial: Any, result: Any, **info: Any) -> None:
        _report.get()(Path(trial.config["training"]["folder"]).name, int(result["steps"]))


def _train_one(given: dict[str, Any]) -> None:
    """Start or continue one training run on a worker, and report to Ray Tune after every update."""
    out = Path(given["training"]["folder"])
    configuration = msgspec.convert(given["training"]["configuration"], FeedforwardConfiguration)

    def report(now: training.TrainingProgress) -> None:
        reward = PLACEHOLDER_REWARD if now.reward_mean is None else now.reward_mean
        tune.report({"steps": now.num_timesteps, "reward_mean": reward})

    if (complete := _complete(out)) is not None:
        tune.report({"steps": complete.steps, "reward_mean": complete.measured["reward_mean"]})
        return
    if contains_training_run(out):
        training.resume_training(out, report)
    else:
        training.train(replace(configuration, threads=1), out, report)


def _complete(out: Path) -> PolicyMetadata | None:
    """Returns the metadata of the policy if the training run in ``out`` is complete, otherwise None."""
    path = out / POLICY_FILE
    metadata = Policy.load(path).metadata if path.exists() else None
    return metadata if metadata is not None and metadata.measured else None


def _outcome(out: Path, each: PlannedTrainingRun) -> SweepResult:
    folder = out / each.folder_name
    configuration = read_configuration(folder)
    metadata = Policy.load(folder / POLICY_FILE).metadata
    measured: dict[str, Any] = metadata.measured
    return SweepResult(
        env=configuration.environment,
        people=configuration.people,
        recipe=each.recipe_name,
        seed=configuration.seed,
        outcome="complete" if measured else "stopped early",
        steps=metadata.steps,
        reward_mean=measured.get("reward_mean"),
        success_rate=measured.get("success_rate"),
        policy=str(folder / POLICY_FILE),
    )


@contextmanager
def _quiet() -> Generator[None]:
    """Context manager: turns off Ray Tune's log files, output and handling of Ctrl+C."""
    variables = {
        "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
        "TUNE_DISABLE_SIGINT_HANDLER": "1",
        "RAY_AIR_NEW_OUTPUT": "0",
    }
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
