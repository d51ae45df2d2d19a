"""The commands about environments, people and policies: ``envs``, ``train``, ``fit-people`` and ``evaluate``."""

import shlex
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.options import (
    PEOPLE,
    Cluster,
    Engine,
    Impairment,
    Seed,
    WithdrawAfterSuccess,
    chosen_environments,
    on_cluster,
)
from avrgym.cli.progress import progress_bar
from avrgym.cli.terminal import (
    Jobs,
    JsonFile,
    check_json,
    plain_errors,
    print_regions,
    print_table,
    say,
    say_left_out,
    warn,
    write_json,
)
from avrgym.people.population_names import POPULATION_NAMES
from avrgym.policies.names import CHOICES
from avrgym.system.engines import THREADS

if TYPE_CHECKING:
    from avrgym.learning import training

STEPS = 1_000_000
"""Of a training, unless another number is asked for."""
NOT_SHOWN = ("force_regions", "plugin_differences", "start_draws_mean", "start_draws_max", "starts_refused")
"""What `evaluate` prints elsewhere than in its table."""
ADAPTIVE, PAPER, PAIR = RECIPES = ("adaptive", "paper", "pair")
"""For policies that remember; what the paper did; and for a robot and a human who learn together."""
SETTLED: dict[str | None, tuple[str, ...]] = {
    ADAPTIVE: ("--config", "--people", "--impairment", "--cluster", "--engine"),
    PAPER: ("--config",),
}
"""Options that a recipe leaves no choice of."""


def envs(json_file: JsonFile = None) -> None:
    """List the environments."""
    from avrgym.policies.registry import skipped_plugins
    from avrgym.policies.trained import packaged_policies
    from avrgym.tasks.registry import ENVIRONMENTS, sizes

    rows = [
        {
            "env": environment,
            "task": task,
            "robot": robot,
            "observation_size": sizes(environment)[0],
            "policies": sorted(packaged_policies(environment)),
        }
        for environment, (task, robot) in ENVIRONMENTS.items()
    ]
    print_table(rows)
    for reason in skipped_plugins():
        say(f"skipped {reason}")
    with plain_errors():
        write_json(json_file, rows)


def train(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    people: Annotated[str, typer.Option(help=f"Whom to train with: {PEOPLE}.")] = "original",
    impairment: Impairment = "none",
    steps: Annotated[
        int | None,
        typer.Option(
            help=f"Environment steps in all; {STEPS}, or the recipe's own number. With --resume, more than before go "
            "on beyond.",
            min=1,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="A folder for policy, checkpoint and log.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the training in the folder, as it was configured.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(help="A TOML file of training settings, as --help-config prints.", metavar="FILE"),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            help="How; without it by imitation, then PPO. adaptive: a policy that remembers, in the same two stages, "
            "with zoo/train and every impairment. paper: PPO alone, ten million steps. pair: robot and human "
            "together; the human has the bodies of the people.",
        ),
    ] = None,
    teacher: Annotated[
        str | None,
        typer.Option(
            help="With --recipe adaptive: a policy to imitate, by its name or file, in place of the task's expert."
        ),
    ] = None,
    initial_policy: Annotated[
        str | None,
        typer.Option(
            help="With --recipe adaptive: a policy that remembers to go on from, by its name or file; by PPO alone, "
            "unless --imitation-share says how much imitates."
        ),
    ] = None,
    imitation_share: Annotated[
        float | None,
        typer.Option(
            help="With --recipe adaptive: what share of its rounds imitate; PPO does the others. 0.25 unless named, at "
            "least one round; none with --initial-policy unless named.",
            min=0.0,
            max=1.0,
        ),
    ] = None,
    alternate: Annotated[
        int,
        typer.Option(
            help="With --recipe pair: for how many updates one of the two learns while the other stays as it is; "
            "0 lets both learn in each.",
            min=0,
        ),
    ] = 0,
    own_reward: Annotated[
        bool,
        typer.Option("--own-reward", help="With --recipe pair: each pays for its own effort."),
    ] = False,
    withdraw_after_success: WithdrawAfterSuccess = False,
    help_config: Annotated[
        bool,
        typer.Option("--help-config", help="Print the environment's training settings, and train nothing."),
    ] = False,
    seed: Seed = 0,
    engine: Engine = THREADS,
    worlds: Annotated[
        int | None,
        typer.Option(help="Worlds of an update; without it the task's or the recipe's own number.", min=1),
    ] = None,
    cluster: Cluster = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Workers of the cluster; without it one for each 64 worlds, and core. Changes no weight.",
            min=1,
        ),
    ] = None,
) -> None:
    """Train a policy with PPO. Needs the extra `train`."""
    from avrgym.learning.configuration import PAPER_SETTINGS, PAPER_STEPS, Pairing
    from avrgym.learning.settings_file import read_settings, settings_text
    from avrgym.people.populations import HUMAN_FILE
    from avrgym.simulation.engines.engine import check_engine
    from avrgym.tasks.registry import find_environment

    with plain_errors():
        find_environment(env)
        if help_config:
            say(settings_text(env))
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
            "--withdraw-after-success": withdraw_after_success,
            "--worlds": worlds is not None,
            "--jobs": jobs is not None,
        }
        _check_together(recipe, [name for name, is_given in given.items() if is_given], resume=resume)
        settings = PAPER_SETTINGS if recipe == PAPER else None
        if config is not None:
            settings = read_settings(config, env)
        check_engine(engine)
        training = _training()
        if recipe == ADAPTIVE:
            folder = out or Path("runs") / f"{env.removeprefix('avrgym/')}-{recipe}-{seed}"
            choices = {
                "steps": steps,
                "worlds": worlds,
                "teacher": teacher,
                "initial": initial_policy,
                "imitation_share": imitation_share,
                "withdraw_after_success": withdraw_after_success or None,
            }
            _train_adaptive(env, seed, choices, folder, resume=resume)
            say(f"policy    {folder / training.POLICY_FILE}")
            return
        folder = out or Path("runs") / _run_name(env, people, impairment, recipe, seed)
        if resume:
            configuration = training.stored_configuration(folder)
            if configuration.environment != env:
                raise ValueError(f"{folder} holds a training of {configuration.environment}, not of {env}")
            if recipe == PAIR and configuration.pairing is None:
                raise ValueError(f"{folder} holds a training of a robot alone, and no pair")
            configuration = replace(configuration, steps=steps or configuration.steps)
        else:
            steps = steps or (PAPER_STEPS if recipe == PAPER else STEPS)
            pairing = Pairing(alternate=alternate, shared_reward=not own_reward) if recipe == PAIR else None
            configuration = training.configuration_for(
                env, people, steps, seed, impairment, settings, engine, pairing
            )
            configuration = replace(configuration, worlds=worlds or configuration.worlds)
        with on_cluster(cluster, jobs) as workers, _shown(env, configuration.whole_steps, folder) as tell:
            if resume:
                training.resume(folder, tell, steps, cluster=workers)
            else:
                training.train(configuration, folder, tell, cluster=workers)
    say(f"policy    {folder / training.POLICY_FILE}")
    if configuration.pairing is not None:
        say(f"human     {folder / HUMAN_FILE}")


def _check_together(recipe: str | None, given: list[str], *, resume: bool) -> None:
    """Refuse a recipe that there is not, and options given that do not go with it or with each other."""
    if recipe is not None and recipe not in RECIPES:
        raise ValueError(f"unknown recipe {recipe!r}; allowed: {', '.join(RECIPES)}")
    settled = [name for name in given if name in SETTLED.get(recipe, ())]
    if settled:
        raise ValueError(
            f"--recipe {recipe} says that itself or cannot do it: leave out {', '.join(settled)}"
        )
    of_pairs = any(name in given for name in ("--alternate", "--own-reward"))
    if of_pairs and recipe != PAIR:
        raise ValueError(f"--alternate and --own-reward go with --recipe {PAIR}")
    for name in ("--teacher", "--initial-policy", "--imitation-share", "--withdraw-after-success"):
        if name in given and (recipe != ADAPTIVE or resume):
            raise ValueError(f"{name} goes with a new training by --recipe {ADAPTIVE}")
    if resume and of_pairs:
        raise ValueError("a pair goes on as it began; --resume goes without --alternate and --own-reward")
    if resume and "--config" in given:
        raise ValueError("a training goes on with the settings it began with; --resume goes without --config")
    if resume and "--worlds" in given:
        raise ValueError("--worlds belongs to a new training: this one goes on as it was configured")
    if "--jobs" in given and "--cluster" not in given:
        raise ValueError("--jobs goes with --cluster: without one, threads of this process step the worlds")


def _train_adaptive(env: str, seed: int, choices: dict[str, Any], folder: Path, *, resume: bool) -> None:
    """Train by the recipe ``ADAPTIVE``; ``choices`` are of ``AdaptiveTraining``, None where nobody chose."""
    from avrgym.learning import adaptive

    if resume:
        configuration = adaptive.stored_training(folder)
        if configuration.environment != env:
            raise ValueError(f"{folder} holds a training of {configuration.environment}, not of {env}")
        if choices["steps"] is not None:
            configuration = adaptive.lengthened(configuration, choices["steps"])
    else:
        made = {name: choice for name, choice in choices.items() if choice is not None}
        configuration = adaptive.AdaptiveTraining(environment=env, seed=seed, **made)
    again = f"avrgym train {env} --recipe {ADAPTIVE} --resume --out {shlex.quote(str(folder))}"
    with progress_bar(env, configuration.whole_steps, "steps", stopped=f"`{again}` goes on") as bar:

        def tell(now: "training.Progress") -> None:
            bar.show(now.steps, words=f"{env}  {now.stage}{_so_far(now)}")

        if resume:
            adaptive.resume(folder, tell, choices["steps"])
        else:
            adaptive.train(configuration, folder, tell)


def _so_far(now: "training.Progress") -> str:
    if now.reward_mean is None:
        return ""
    return f"  reward {now.reward_mean:.1f}  success {now.success_rate:.1%}".replace("%", " %")


def _training() -> ModuleType:
    from avrgym.learning import training

    return training


@contextmanager
def _shown(env: str, steps: int, folder: Path) -> "Generator[training.Tell]":
    """Gives what shows how a training in a folder stands."""
    from avrgym.learning.training import LOG_FOLDER

    log, again = folder / LOG_FOLDER, f"avrgym train {env} --resume --out {shlex.quote(str(folder))}"
    told = False
    with progress_bar(env, steps, "steps", stopped=f"`{again}` goes on") as bar:

        def tell(now: "training.Progress") -> None:
            nonlocal told
            if not told:
                say(
                    f"log       {log}; `tensorboard --logdir {shlex.quote(str(log))}` shows it while it grows"
                )
            told = True
            bar.show(now.steps, words=f"{env}  {now.stage}{_so_far(now)}")

        yield tell


def _run_name(env: str, people: str, impairment: str, recipe: str | None, seed: int) -> str:
    from avrgym.people.distributions import NAMED_DISTRIBUTIONS

    whom = people.replace("/", "-") if people in NAMED_DISTRIBUTIONS else Path(people).stem
    limited = [] if impairment == "none" else [impairment]
    by_recipe = [] if recipe is None else [recipe]
    return "-".join([env.removeprefix("avrgym/"), whom, *limited, *by_recipe, str(seed)])


def fit_people(
    study: Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")],
    out: Annotated[Path, typer.Option(help="A new file of people.", metavar="FILE")] = Path("people.toml"),
) -> None:
    """Fit people to a study's participants.

    For `train`, `evaluate` and `view --people FILE`.
    """
    from avrgym.analysis.fit_people import fit_people, write_people

    with plain_errors():
        with progress_bar("reading recordings", unit="recordings") as bar:
            fit = fit_people(study, bar.show)
        write_people(fit, out)
    for recording in fit.left_out:
        say(f"left out  {recording}")
    say(fit.remarks)
    say(f"people    {out}")


def evaluate(
    env: Annotated[
        list[str] | None, typer.Argument(help="Environment ids; `avrgym envs` lists them.")
    ] = None,
    all_environments: Annotated[bool, typer.Option("--all", help="Every environment.")] = False,
    policy: Annotated[
        list[str] | None, typer.Option(help=f"Who drives, revised unless named: {CHOICES}. Repeatable.")
    ] = None,
    people: Annotated[
        list[str] | None, typer.Option(help=f"Whom to meet, revised unless named: {PEOPLE}. Repeatable.")
    ] = None,
    impairment: Impairment = "none",
    cross_play: Annotated[
        bool,
        typer.Option(
            "--cross-play",
            help="Show success as a matrix of policies and people; unless named, original and revised policies with "
            f"{', '.join(POPULATION_NAMES)}.",
        ),
    ] = False,
    episodes: Annotated[int, typer.Option(help="Episodes per environment.", min=1)] = 100,
    seed: Seed = 0,
    stream: Annotated[
        str,
        typer.Option(
            help="What episodes are drawn from: showing, for figures that are shown; choosing, for whatever is "
            "chosen by them, such as settings and checkpoints."
        ),
    ] = "showing",
    jobs: Jobs = None,
    cluster: Cluster = None,
    allow_other_environment: Annotated[
        bool,
        typer.Option(
            "--allow-other-environment", help="Run a policy that was trained for another environment."
        ),
    ] = False,
    force_guard: Annotated[
        bool,
        typer.Option(
            "--force-guard", help="Keep arms from pressing too hard or coming too fast, as live sessions do."
        ),
    ] = False,
    withdraw_after_success: WithdrawAfterSuccess = False,
    engine: Engine = THREADS,
    regions: Annotated[
        bool, typer.Option("--regions", help="Show the forces by region of the body too.")
    ] = False,
    json_file: JsonFile = None,
) -> None:
    """Measure reward, success and force over many episodes.

    Of each policy with each group of people.
    """
    from avrgym.learning.cross_play import cross_play as evaluate_each
    from avrgym.learning.cross_play import matrix
    from avrgym.learning.seed_streams import stream_of
    from avrgym.tasks.constants import EPISODE_STEPS
    from avrgym.tasks.placement_check import excess_draws

    with plain_errors():
        check_json(json_file)
        chosen = chosen_environments(env, all_environments)
        policies = policy or (["original", "revised"] if cross_play else ["revised"])
        groups = people or ([*POPULATION_NAMES] if cross_play else ["revised"])
        steps = len(chosen) * len(policies) * len(groups) * episodes * EPISODE_STEPS
        with (
            on_cluster(cluster, jobs) as workers,
            progress_bar(f"evaluating {', '.join(policies)}", steps, "steps") as bar,
        ):
            metrics = evaluate_each(
                chosen,
                policies,
                groups,
                episodes,
                seed,
                bar.advance,
                impairment=impairment,
                stream=stream_of(stream),
                jobs=jobs,
                cluster=workers,
                allow_other_environment=allow_other_environment,
                force_guard=force_guard,
                withdraw_after_success=withdraw_after_success,
                engine=engine,
                leave_out=say_left_out if all_environments else None,
            )
        rows = [asdict(each) for each in metrics]
        if cross_play:
            print_table(matrix(metrics))
        else:
            print_table([{name: row[name] for name in row if name not in NOT_SHOWN} for row in rows])
        if regions:
            print_regions({_whose(row): row["force_regions"] for row in rows})
        write_json(json_file, rows)
        for row in rows:
            for difference in row["plugin_differences"]:
                warn(f"{_whose(row)}: not as the policy was trained: {difference}")
            crowded = excess_draws(row["start_draws_mean"], row["start_draws_max"])
            if crowded:
                warn(f"{_whose(row)}: {crowded}; {row['starts_refused']} people were left out")


def _whose(row: dict[str, Any]) -> str:
    return f"{row['env']}, {row['policy']} with {row['people']}"
