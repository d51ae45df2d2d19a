"""The command ``avrgym train``."""

import shlex
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.options import (
    ALLOWED_PEOPLE_TEXT,
    ClusterOption,
    EngineOption,
    EpisodeStepsOption,
    ForceGuardOption,
    ImpairmentOption,
    SeedOption,
    SettingsOption,
    WithdrawAfterSuccessOption,
    connect_cluster,
)
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    print_line,
    report_errors,
)
from avrgym.system.engine_names import THREADS
from avrgym.tasks.constants import EPISODE_STEPS

if TYPE_CHECKING:
    from avrgym.learning import training
    from avrgym.learning.configuration import AnyTrainingConfiguration

ADAPTIVE_RECIPE, PAPER_RECIPE, PAIR_RECIPE, VISUAL_RECIPE = RECIPE_NAMES = (
    "adaptive",
    "paper",
    "pair",
    "visual",
)
OPTIONS_FIXED_BY_RECIPE: dict[str | None, tuple[str, ...]] = {
    ADAPTIVE_RECIPE: ("--config", "--people", "--impairment", "--cluster", "--engine"),
    PAPER_RECIPE: ("--config",),
    VISUAL_RECIPE: (
        "--config",
        "--people",
        "--impairment",
        "--cluster",
        "--engine",
        "--withdraw-after-success",
        "--episode-steps",
        "--reward",
    ),
}
RECIPE_BY_OPTION = {
    "--teacher": ADAPTIVE_RECIPE,
    "--initial-policy": ADAPTIVE_RECIPE,
    "--imitation-share": ADAPTIVE_RECIPE,
    "--alternate": PAIR_RECIPE,
    "--own-reward": PAIR_RECIPE,
}
"""Recipe by option, for the options that only one recipe accepts."""
NEW_RUN_OPTIONS = (
    "--config",
    "--num-envs",
    "--reward",
    "--force-guard",
    "--withdraw-after-success",
    "--set",
    "--episode-steps",
    *RECIPE_BY_OPTION,
)
"""Options of a new training run. ``--resume`` rejects them, because they cannot change during a run."""


def train(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    people: Annotated[str, typer.Option(help=f"People to train with: {ALLOWED_PEOPLE_TEXT}.")] = "original",
    impairment: ImpairmentOption = "none",
    steps: Annotated[
        int | None,
        typer.Option(
            help="Total number of environment steps; default: 1 000 000, or the recipe's number. With --resume, a "
            "larger number continues a complete training run.",
            min=1,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="A folder for policy, checkpoint and log.")] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue the training run in the folder with its stored configuration."
        ),
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(help="A TOML file of hyperparameters, as --help-config prints.", metavar="FILE"),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            help="The training method. By default: imitation, then PPO. adaptive: a recurrent policy by imitation and "
            "PPO, with the people zoo/train and the impairments none, limits, weakness, tremor. paper: PPO alone, ten "
            "million steps. pair: robot and human learn together; the human has the bodies of the people. visual: "
            "imitate the policy revised with the depth image of the wrist camera.",
        ),
    ] = None,
    teacher: Annotated[
        str | None,
        typer.Option(
            help="With --recipe adaptive: the name or file of a policy to imitate instead of the task's expert."
        ),
    ] = None,
    initial_policy: Annotated[
        str | None,
        typer.Option(
            help="With --recipe adaptive: the name or file of an initial recurrent policy. Training is then by "
            "default without imitation."
        ),
    ] = None,
    imitation_share: Annotated[
        float | None,
        typer.Option(
            help="With --recipe adaptive: the share of imitation updates; the other updates are PPO. By default 0.25, "
            "at least one update; 0 with --initial-policy.",
            min=0.0,
            max=1.0,
        ),
    ] = None,
    alternate: Annotated[
        int,
        typer.Option(
            help="With --recipe pair: the number of updates in which one agent learns and the other is fixed; "
            "0: both agents learn in each update.",
            min=0,
        ),
    ] = 0,
    own_reward: Annotated[
        bool,
        typer.Option(
            "--own-reward",
            help="With --recipe pair: each agent's reward contains only the action penalty of this agent.",
        ),
    ] = False,
    reward: Annotated[
        Path | None,
        typer.Option(
            help="A file of `avrgym fit-reward`: its weights add a reward for participants' preferences.",
            metavar="FILE",
        ),
    ] = None,
    force_guard: ForceGuardOption = False,
    withdraw_after_success: WithdrawAfterSuccessOption = False,
    settings: SettingsOption = None,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
    help_config: Annotated[
        bool,
        typer.Option("--help-config", help="Print the environment's hyperparameters, and exit."),
    ] = False,
    seed: SeedOption = 0,
    engine: EngineOption = THREADS,
    num_envs: Annotated[
        int | None,
        typer.Option(
            help="Number of worlds that are stepped together; default: the number of the recipe or the task.",
            min=1,
        ),
    ] = None,
    cluster: ClusterOption = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Number of cluster workers; default: one per core, with at least 64 worlds each. Does not change "
            "the weights.",
            min=1,
        ),
    ] = None,
) -> None:
    """Train a policy by imitation and PPO.

    Install `avrgym[train]` first.
    """
    from avrgym.learning.hyperparameter_files import format_hyperparameters
    from avrgym.learning.preference_reward import read_preference_weights
    from avrgym.people.populations import HUMAN_POLICY_FILE
    from avrgym.simulation.engines.engine import check_engine_name
    from avrgym.tasks.registry import find_environment
    from avrgym.tasks.settings import parse_settings

    with report_errors():
        find_environment(env)
        if help_config:
            print_line(format_hyperparameters(env))
            return
        given = {
            "--config": config is not None,
            "--people": people != "original",
            "--impairment": impairment != "none",
            "--cluster": cluster is not None,
            "--engine": engine != THREADS,
            "--teacher": teacher is not None,
            "--initial-policy": initial_policy is not None,
            "--imitation-share": imitation_share is not None,
            "--alternate": bool(alternate),
            "--own-reward": own_reward,
            "--reward": reward is not None,
            "--force-guard": force_guard,
            "--withdraw-after-success": withdraw_after_success,
            "--set": bool(settings),
            "--episode-steps": episode_steps != EPISODE_STEPS,
            "--num-envs": num_envs is not None,
            "--jobs": jobs is not None,
        }
        _check_together(recipe, [name for name, is_given in given.items() if is_given], resume=resume)
        check_engine_name(engine)
        folder = out or Path("runs") / _run_name(env, people, impairment, recipe, seed, guarded=force_guard)
        from avrgym.learning import training

        if resume:
            configuration = _stored(folder, env, recipe)
            if steps is not None:
                configuration = replace(configuration, steps=steps)
        else:
            options = {
                "steps": steps,
                "num_envs": num_envs,
                "force_guard": force_guard,
                "withdraw_after_success": withdraw_after_success,
                "settings": parse_settings(settings or []),
                "episode_steps": episode_steps,
                "people": people,
                "impairment": impairment,
                "engine": engine,
                "teacher": teacher,
                "initial": initial_policy,
                "imitation_share": imitation_share,
                "alternate": alternate,
                "own_reward": own_reward,
                "preference_weights": None if reward is None else read_preference_weights(reward, env),
            }
            configuration = _configuration(env, seed, recipe, config, options)
        with (
            connect_cluster(cluster, jobs) as workers,
            _progress(env, configuration.total_steps, folder, recipe) as report,
        ):
            if resume:
                training.resume_training(folder, report, steps, cluster=workers)
            else:
                training.train(configuration, folder, report, cluster=workers)
    print_line(f"policy    {folder / training.POLICY_FILE}")
    if recipe == PAIR_RECIPE or (folder / HUMAN_POLICY_FILE).exists():
        print_line(f"human     {folder / HUMAN_POLICY_FILE}")


def _check_together(recipe: str | None, given: list[str], *, resume: bool) -> None:
    """Raises ``ValueError`` for an unknown recipe, or for options that cannot be combined."""
    if recipe is not None and recipe not in RECIPE_NAMES:
        raise ValueError(f"unknown recipe {recipe!r}; allowed: {', '.join(RECIPE_NAMES)}")
    fixed = [name for name in given if name in OPTIONS_FIXED_BY_RECIPE.get(recipe, ())]
    if fixed:
        raise ValueError(f"--recipe {recipe} does not accept {', '.join(fixed)}; remove these options")
    for name in given:
        if name in RECIPE_BY_OPTION and recipe != RECIPE_BY_OPTION[name]:
            raise ValueError(f"{name} needs --recipe {RECIPE_BY_OPTION[name]}")
        if resume and name in NEW_RUN_OPTIONS:
            raise ValueError(
                f"--resume does not accept {name}, because the configuration of a training run cannot change; "
                "remove this option"
            )
    if "--jobs" in given and "--cluster" not in given:
        raise ValueError("--jobs needs --cluster: without a cluster, threads of this process step the worlds")


def _configuration(
    env: str, seed: int, recipe: str | None, config: Path | None, options: dict[str, Any]
) -> "AnyTrainingConfiguration":
    """Returns the configuration of a new training run. An option that is ``None`` has the recipe's default value."""
    from avrgym.learning.configuration import (
        JointTrainingSettings,
        RecurrentConfiguration,
        VisualConfiguration,
        make_feedforward_configuration,
    )
    from avrgym.learning.hyperparameter_files import read_hyperparameters
    from avrgym.learning.hyperparameters import DEFAULT_TRAINING_STEPS, PAPER_TRAINING_STEPS
    from avrgym.learning.hyperparameters import PAPER_HYPERPARAMETERS as OF_PAPER

    common = (
        "steps",
        "num_envs",
        "force_guard",
        "withdraw_after_success",
        "settings",
        "episode_steps",
        "preference_weights",
    )
    names = (*common, *(("teacher", "initial", "imitation_share") if recipe == ADAPTIVE_RECIPE else ()))
    given = {name: options[name] for name in names if options[name] is not None}
    if recipe == ADAPTIVE_RECIPE:
        return RecurrentConfiguration(environment=env, seed=seed, **given)
    if recipe == VISUAL_RECIPE:
        return VisualConfiguration(environment=env, seed=seed, **given)
    hyperparameters = OF_PAPER if recipe == PAPER_RECIPE else None
    if config is not None:
        hyperparameters = read_hyperparameters(config, env)
    pairing = None
    if recipe == PAIR_RECIPE:
        pairing = JointTrainingSettings(
            alternate=options["alternate"], shared_reward=not options["own_reward"]
        )
    steps = PAPER_TRAINING_STEPS if recipe == PAPER_RECIPE else DEFAULT_TRAINING_STEPS
    configuration = make_feedforward_configuration(
        env,
        options["people"],
        steps,
        seed,
        options["impairment"],
        hyperparameters,
        options["engine"],
        pairing,
    )
    return replace(configuration, **given)


def _stored(folder: Path, env: str, recipe: str | None) -> "AnyTrainingConfiguration":
    """Returns the stored configuration of a training run. Raises ``ValueError`` if its environment or recipe differs
    from the arguments."""
    from avrgym.learning.configuration import (
        RecurrentConfiguration,
        VisualConfiguration,
        read_configuration,
    )

    configuration = read_configuration(folder)
    if configuration.environment != env:
        raise ValueError(
            f"{folder} contains a training run of {configuration.environment}, not of {env}; allowed: "
            f"{configuration.environment}, or another --out"
        )
    recurrent = isinstance(configuration, RecurrentConfiguration)
    visual = isinstance(configuration, VisualConfiguration)
    fits = {
        None: True,
        ADAPTIVE_RECIPE: recurrent,
        VISUAL_RECIPE: visual,
        PAPER_RECIPE: not recurrent and not visual,
        PAIR_RECIPE: not recurrent and not visual and configuration.pairing,
    }
    if not fits[recipe]:
        raise ValueError(
            f"{folder} contains no training run with --recipe {recipe}; omit --recipe to continue its training run"
        )
    return configuration


@contextmanager
def _progress(
    env: str, steps: int, folder: Path, recipe: str | None
) -> "Generator[training.TrainingReporter]":
    """Context manager: show a progress bar. Yields the function that updates the bar during training."""
    from avrgym.learning.training import TENSORBOARD_FOLDER

    log = folder / TENSORBOARD_FOLDER
    with_recipe = f" --recipe {recipe}" if recipe in (ADAPTIVE_RECIPE, VISUAL_RECIPE) else ""
    again = f"avrgym train {env}{with_recipe} --resume --out {shlex.quote(str(folder))}"
    log_is_shown = False
    with show_progress_bar(env, steps, "steps", stopped=f"`{again}` continues it") as bar:

        def report(progress: "training.TrainingProgress") -> None:
            nonlocal log_is_shown
            if log.exists() and not log_is_shown:
                print_line(f"log       {log}; `tensorboard --logdir {shlex.quote(str(log))}` shows it")
                log_is_shown = True
            results = ""
            if progress.reward_mean is not None:
                results = f"  reward {progress.reward_mean:.1f}  success {100 * (progress.success_rate or 0.0):.1f} %"
            bar.update(progress.num_timesteps, label=f"{env}  {progress.stage}{results}")

        yield report


def _run_name(env: str, people: str, impairment: str, recipe: str | None, seed: int, *, guarded: bool) -> str:
    from avrgym.people.distributions import NAMED_DISTRIBUTIONS

    population = people.replace("/", "-") if people in NAMED_DISTRIBUTIONS else Path(people).stem
    parts = [env.removeprefix("avrgym/"), *([] if recipe == ADAPTIVE_RECIPE else [population])]
    parts += [] if impairment == "none" else [impairment.replace(":", "-")]
    parts += [] if recipe is None else [recipe]
    parts += ["guarded"] if guarded else []
    return "-".join([*parts, str(seed)])
