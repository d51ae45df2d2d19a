"""The commands about environments, people and policies: ``envs``, ``train``, ``fit-people`` and ``evaluate``."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from avrgym.cli.cluster import Address, on_cluster
from avrgym.cli.options import PEOPLE, Impairment, Seed, chosen_environments
from avrgym.cli.terminal import (
    Jobs,
    JsonFile,
    check_json,
    plain_errors,
    print_regions,
    print_table,
    progress_bar,
    say,
    write_json,
)
from avrgym.people.distributions import DISTRIBUTIONS, NAMED
from avrgym.policies.names import CHOICES
from avrgym.tasks.registry import ENVIRONMENTS, find_environment, sizes


def envs(json_file: JsonFile = None) -> None:
    """List the environments."""
    from avrgym.doctor.installation import skipped_plugins
    from avrgym.policies.trained import packaged_policies

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
    steps: Annotated[int, typer.Option(help="Environment steps.", min=1)] = 1_000_000,
    out: Annotated[Path | None, typer.Option(help="A folder for policy, checkpoint and log.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the training in the folder, as it was configured.")
    ] = False,
    seed: Seed = 0,
    worlds: Annotated[
        int | None, typer.Option(help="Worlds of an update; without it the task's own number.", min=1)
    ] = None,
    cluster: Address = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            help="Workers of the cluster; without it one for each 64 worlds, and core. Changes no weight.",
            min=1,
        ),
    ] = None,
) -> None:
    """Train a policy with PPO. Needs the extra `train`."""
    with plain_errors():
        find_environment(env)
        if jobs is not None and cluster is None:
            raise ValueError(
                "--jobs goes with --cluster: without one, threads of this process step the worlds"
            )
        if resume and worlds is not None:
            raise ValueError("--worlds belongs to a new training: this one goes on as it was configured")
        try:
            from avrgym.learning import training
        except ModuleNotFoundError as error:
            raise RuntimeError(
                f"{error.name} is missing; `pip install avrgym[train]` brings what training needs"
            ) from error
        folder = out or Path("runs") / _run_name(env, people, impairment, seed)
        if resume:
            stored = training.stored_configuration(folder)
            if stored.environment != env:
                raise ValueError(f"{folder} holds a training of {stored.environment}, not of {env}")
            steps = stored.steps
        with on_cluster(cluster, jobs) as workers, progress_bar(env, steps) as bar:

            def tell(now: "training.Progress") -> None:
                words = f"{env}  reward {now.reward_mean:.1f}  success {now.success_rate:.1%}"
                bar.show(now.steps, words=words)

            if resume:
                training.resume(folder, tell, cluster=workers)
            else:
                configuration = training.configuration_for(env, people, steps, seed, impairment)
                if worlds is not None:
                    configuration = replace(configuration, worlds=worlds)
                training.train(configuration, folder, tell, cluster=workers)
    say(f"policy    {folder / 'policy.safetensors'}")


def _run_name(env: str, people: str, impairment: str, seed: int) -> str:
    whom = people.replace("/", "-") if people in NAMED else Path(people).stem
    limited = [] if impairment == "none" else [impairment]
    return "-".join([env.removeprefix("avrgym/"), whom, *limited, str(seed)])


def fit_people(
    study: Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")],
    out: Annotated[Path, typer.Option(help="A new file of people.", metavar="FILE")] = Path("people.toml"),
) -> None:
    """Fit people to a study's participants.

    For `train`, `evaluate` and `view --people FILE`.
    """
    from avrgym.analysis.fitting import fit_people, write_people

    with plain_errors():
        with progress_bar("recordings") as bar:
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
            f"{', '.join(DISTRIBUTIONS)}.",
        ),
    ] = False,
    episodes: Annotated[int, typer.Option(help="Episodes per environment.", min=1)] = 100,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Address = None,
    allow_other_environment: Annotated[
        bool,
        typer.Option(
            "--allow-other-environment", help="Run a policy that was trained for another environment."
        ),
    ] = False,
    force_guard: Annotated[
        bool, typer.Option("--force-guard", help="Draw back arms that press too hard, as live sessions do.")
    ] = False,
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
    from avrgym.tasks.task import EPISODE_STEPS

    with plain_errors():
        check_json(json_file)
        chosen = chosen_environments(env, all_environments)
        policies = policy or (["original", "revised"] if cross_play else ["revised"])
        groups = people or ([*DISTRIBUTIONS] if cross_play else ["revised"])
        steps = len(chosen) * len(policies) * len(groups) * episodes * EPISODE_STEPS
        with on_cluster(cluster, jobs) as workers, progress_bar(", ".join(policies), steps) as bar:
            metrics = evaluate_each(
                chosen,
                policies,
                groups,
                episodes,
                seed,
                bar.advance,
                impairment=impairment,
                jobs=jobs,
                cluster=workers,
                allow_other_environment=allow_other_environment,
                force_guard=force_guard,
            )
        rows = [asdict(each) for each in metrics]
        if cross_play:
            print_table(matrix(metrics))
        else:
            print_table([{name: row[name] for name in row if name != "force_regions"} for row in rows])
        if regions:
            print_regions({_whose(row): row["force_regions"] for row in rows})
        write_json(json_file, rows)


def _whose(row: dict[str, Any]) -> str:
    return f"{row['env']}, {row['policy']} with {row['people']}"
