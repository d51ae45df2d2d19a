"""Sweeps: many trainings on a Ray cluster, scheduled by Ray Tune. Needs the extras ``train`` and ``cluster``.

Each training has a folder of its own, takes one core, and leaves what ``training.train`` leaves, to the bit.
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
from avrgym.learning.configuration import (
    CONFIGURATION_FILE,
    TrainingConfiguration,
    stored_configuration,
)
from avrgym.learning.course import POLICY_FILE
from avrgym.learning.sweep_file import Planned, Stopping, Sweep, planned, read_sweep
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.system.files import write_whole
from avrgym.system.locks import locked

SWEEP_FILE = "sweep.toml"
SCHEDULE_FOLDER = "schedule"
"""Where Ray Tune keeps which trainings run, have ended or were broken off, a folder for each group."""
NOTHING_YET = -1e9
"""Stands for the mean reward as long as no episode has ended."""

Told = Callable[[str, int], None]
"""Hears the name of a training and how many steps it has made."""
_told: ContextVar[Told] = ContextVar("_told")


@dataclass(frozen=True)
class Outcome:
    """What came of a training; the figures are those of its policy's file, None where it was not measured."""

    env: str
    people: str
    recipe: str
    seed: int
    outcome: str
    steps: int
    reward_mean: float | None
    success_rate: float | None
    policy: str


def begin(file: Path, out: Path) -> None:
    """Make the folder of a new sweep, with a copy of its file.

    Raises:
        ValueError: for what cannot be trained, naming what is allowed.
        FileExistsError: when ``out`` already holds a sweep.
    """
    planned(read_sweep(file), str(file))
    if (out / SWEEP_FILE).exists():
        raise FileExistsError(f"{out} already holds a sweep; choose another folder, or go on with --resume")
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / SWEEP_FILE, file.read_bytes())


def plan_of(out: Path) -> dict[str, list[Planned]]:
    """The trainings of the sweep in a folder, by group.

    Raises:
        ValueError: when it holds none.
    """
    return planned(_stored(out), str(out / SWEEP_FILE))


def _stored(out: Path) -> Sweep:
    path = out / SWEEP_FILE
    if not path.exists():
        raise ValueError(f"{out} holds no sweep to resume")
    return read_sweep(path)


def run(out: Path, jobs: int | None, told: Told) -> list[Outcome]:
    """Make, or go on with, all trainings of the sweep in ``out``, on the cluster that is connected.

    Trainings of a group run at the same time, as many as there are cores, or ``jobs``; then comes the next group.
    Every node needs to see the folder at the same path.

    Raises:
        ValueError: when it holds no sweep, or goes on in another process.
        RuntimeError: naming the trainings that failed; the others are made.
    """
    sweep = _stored(out)
    groups = planned(sweep, str(out / SWEEP_FILE))
    with locked(out), _quiet():
        token = _told.set(told)
        try:
            failed = [
                failure
                for number, group in enumerate(groups.values())
                for failure in _run_group(out.resolve(), f"group_{number}", group, sweep.stopping, jobs)
            ]
        finally:
            _told.reset(token)
    if failed:
        raise RuntimeError(f"of {sum(map(len, groups.values()))} trainings {len(failed)} failed: {failed[0]}")
    return [_outcome(out, each) for group in groups.values() for each in group]


def _run_group(
    out: Path, name: str, group: Sequence[Planned], stopping: Stopping | None, jobs: int | None
) -> list[str]:
    """What went wrong in those that failed."""
    schedule = out / SCHEDULE_FOLDER / name
    trainable = tune.with_resources(_train_one, {"cpu": 1})
    if tune.Tuner.can_restore(str(schedule)):
        tuner = tune.Tuner.restore(str(schedule), trainable, resume_unfinished=True, restart_errored=True)
    else:
        tuner = tune.Tuner(
            trainable,
            param_space={
                "training": tune.grid_search(
                    [
                        {"folder": str(out / each.name), "made_of": asdict(each.configuration)}
                        for each in group
                    ]
                )
            },
            tune_config=tune.TuneConfig(
                metric="reward_mean",
                mode="max",
                scheduler=_scheduler(stopping, group[0].configuration.whole_steps),
                max_concurrent_trials=jobs,
                reuse_actors=False,
            ),
            run_config=tune.RunConfig(
                name=name, storage_path=str(schedule.parent), verbose=0, callbacks=[_Listener()]
            ),
        )
    return [f"{each.path}: {str(each.error).strip().splitlines()[-1]}" for each in tuner.fit() if each.error]


def _scheduler(stopping: Stopping | None, steps: int) -> Any:
    if stopping is None:
        return FIFOScheduler()
    grace, factor = min(stopping.after_steps, steps), stopping.factor
    return ASHAScheduler(time_attr="steps", max_t=steps + 1, grace_period=grace, reduction_factor=factor)


class _Listener(tune.Callback):
    """Tells of each training's progress."""

    def on_trial_result(self, iteration: int, trials: Any, trial: Any, result: Any, **info: Any) -> None:
        _told.get()(Path(trial.config["training"]["folder"]).name, int(result["steps"]))


def _train_one(given: dict[str, Any]) -> None:
    """On a worker: make one training, or go on with it, and report to Ray Tune after every update."""
    out = Path(given["training"]["folder"])
    configuration = msgspec.convert(given["training"]["made_of"], TrainingConfiguration)

    def tell(now: training.Progress) -> None:
        reward = NOTHING_YET if now.reward_mean is None else now.reward_mean
        tune.report({"steps": now.steps, "reward_mean": reward})

    if (made := _complete(out)) is not None:
        tune.report({"steps": made.steps, "reward_mean": made.measured["reward_mean"]})
        return
    if (out / CONFIGURATION_FILE).exists():
        training.resume(out, tell)
    else:
        training.train(replace(configuration, threads=1), out, tell)


def _complete(out: Path) -> PolicyMetadata | None:
    """What the policy's file says of itself, where the training is complete."""
    path = out / POLICY_FILE
    metadata = Policy.load(path).metadata if path.exists() else None
    return metadata if metadata is not None and metadata.measured else None


def _outcome(out: Path, each: Planned) -> Outcome:
    folder = out / each.name
    configuration = stored_configuration(folder)
    metadata = Policy.load(folder / POLICY_FILE).metadata
    measured: dict[str, Any] = metadata.measured
    return Outcome(
        env=configuration.environment,
        people=configuration.people,
        recipe=each.recipe,
        seed=configuration.seed,
        outcome="complete" if measured else "stopped early",
        steps=metadata.steps,
        reward_mean=measured.get("reward_mean"),
        success_rate=measured.get("success_rate"),
        policy=str(folder / POLICY_FILE),
    )


@contextmanager
def _quiet() -> Generator[None]:
    """Keep Ray Tune from logs of its own beside the trainings', from printing, and from taking Ctrl+C for itself."""
    said = {
        "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
        "TUNE_DISABLE_SIGINT_HANDLER": "1",
        "RAY_AIR_NEW_OUTPUT": "0",
    }
    before = {name: os.environ.get(name) for name in said}
    os.environ.update(said)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
