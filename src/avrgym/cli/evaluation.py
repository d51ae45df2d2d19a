"""The commands ``envs``, ``fit-people`` and ``evaluate``."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from avrgym.cli.options import (
    ALLOWED_PEOPLE_TEXT,
    AllowOtherSettingsOption,
    ClusterOption,
    EngineOption,
    EpisodeStepsOption,
    ForceGuardOption,
    ImpairmentOption,
    SeedOption,
    SettingsOption,
    WithdrawAfterSuccessOption,
    connect_cluster,
    select_environments,
)
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    JobsOption,
    JsonFileOption,
    check_json_file,
    print_line,
    print_region_forces,
    print_skipped_item,
    print_table,
    print_warning,
    report_errors,
    write_json,
)
from avrgym.people.population_names import POPULATION_NAMES
from avrgym.policies.policy_names import POLICY_CHOICES_TEXT
from avrgym.system.engine_names import THREADS
from avrgym.tasks.constants import EPISODE_STEPS

OMITTED_METRICS = (
    "force_regions",
    "settings",
    "steps",
    "plugin_differences",
    "trained_with_force_guard",
    "start_draws_mean",
    "start_draws_max",
    "starts_refused",
)
"""Metrics of `evaluate` that only the JSON file contains, not the printed table."""


def envs(json_file: JsonFileOption = None) -> None:
    """List the environments: task, robot and trained policies."""
    from avrgym.policies.registry import collect_skipped_plugin_errors
    from avrgym.policies.trained_policies import find_packaged_policies
    from avrgym.tasks.registry import ENVIRONMENTS, get_observation_and_action_size

    rows = [
        {
            "env": environment,
            "task": task,
            "robot": robot,
            "observation_size": get_observation_and_action_size(environment)[0],
            "policies": sorted(find_packaged_policies(environment)),
        }
        for environment, (task, robot) in ENVIRONMENTS.items()
    ]
    print_table(rows)
    for reason in collect_skipped_plugin_errors():
        print_line(f"skipped {reason}")
    with report_errors():
        write_json(json_file, rows)


def fit_people(
    study: Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")],
    out: Annotated[Path, typer.Option(help="A new people file.", metavar="FILE")] = Path("people.toml"),
) -> None:
    """Fit simulated people to a study's participants.

    The command writes a people file. `train`, `evaluate` and `view` accept it as `--people FILE`.
    """
    from avrgym.analysis.fit_people import fit_people, write_people_file

    with report_errors():
        with show_progress_bar("reading recordings", unit="recordings") as bar:
            fit = fit_people(study, bar.update)
        write_people_file(fit, out)
    for recording in fit.omitted_recordings:
        print_line(f"left out  {recording}")
    print_line(fit.remarks)
    print_line(f"people    {out}")


def evaluate(
    env: Annotated[
        list[str] | None, typer.Argument(help="Environment ids; `avrgym envs` lists them.")
    ] = None,
    all_environments: Annotated[bool, typer.Option("--all", help="Evaluate in all environments.")] = False,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help=f"The policy that drives the robot, by default revised: {POLICY_CHOICES_TEXT}. Repeatable."
        ),
    ] = None,
    people: Annotated[
        list[str] | None,
        typer.Option(
            help=f"The people in the episodes, by default revised: {ALLOWED_PEOPLE_TEXT}. Repeatable."
        ),
    ] = None,
    impairment: ImpairmentOption = "none",
    cross_play: Annotated[
        bool,
        typer.Option(
            "--cross-play",
            help="Show success as a matrix of policies and people; by default original and revised policies with "
            f"{', '.join(POPULATION_NAMES)}.",
        ),
    ] = False,
    episodes: Annotated[int, typer.Option(help="Number of episodes per environment.", min=1)] = 100,
    seed: SeedOption = 0,
    split: Annotated[
        str,
        typer.Option(
            help="The episodes: test, for reported results; validation, for choices such as hyperparameters and "
            "checkpoints."
        ),
    ] = "test",
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    allow_other_environment: Annotated[
        bool,
        typer.Option(
            "--allow-other-environment", help="Allow a policy that was trained for another environment."
        ),
    ] = False,
    force_guard: ForceGuardOption = False,
    withdraw_after_success: WithdrawAfterSuccessOption = False,
    settings: SettingsOption = None,
    allow_other_settings: AllowOtherSettingsOption = False,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
    engine: EngineOption = THREADS,
    regions: Annotated[
        bool, typer.Option("--regions", help="Also show the contact forces by body region.")
    ] = False,
    json_file: JsonFileOption = None,
) -> None:
    """Measure reward, success and contact force of policies.

    The printed table has a row for each environment, policy and population.
    """
    from avrgym.learning.cross_play import make_success_table
    from avrgym.learning.cross_play import run_cross_play as evaluate_each
    from avrgym.system.random_streams import parse_split
    from avrgym.tasks.placement_check import describe_excess_samples
    from avrgym.tasks.settings import parse_settings

    with report_errors():
        check_json_file(json_file)
        chosen = select_environments(env, all_environments)
        policies = policy or (["original", "revised"] if cross_play else ["revised"])
        groups = people or ([*POPULATION_NAMES] if cross_play else ["revised"])
        steps = len(chosen) * len(policies) * len(groups) * episodes * episode_steps
        with (
            connect_cluster(cluster, jobs) as workers,
            show_progress_bar(f"evaluating {', '.join(policies)}", steps, "steps") as bar,
        ):
            metrics = evaluate_each(
                chosen,
                policies,
                groups,
                episodes,
                seed,
                bar.advance,
                impairment=impairment,
                split=parse_split(split),
                jobs=jobs,
                cluster=workers,
                allow_other_environment=allow_other_environment,
                force_guard=force_guard,
                withdraw_after_success=withdraw_after_success,
                engine=engine,
                settings=parse_settings(settings or []),
                allow_other_settings=allow_other_settings,
                steps=episode_steps,
                leave_out=print_skipped_item if all_environments else None,
            )
        rows = [asdict(each) for each in metrics]
        if cross_play:
            print_table(make_success_table(metrics))
        else:
            print_table([{name: row[name] for name in row if name not in OMITTED_METRICS} for row in rows])
        if regions:
            print_region_forces({_title(row): row["force_regions"] for row in rows})
        write_json(json_file, rows)
        for row in rows:
            for difference in row["plugin_differences"]:
                print_warning(f"{_title(row)}: differs from the policy's training: {difference}")
            if row["trained_with_force_guard"] and not force_guard:
                print_warning(
                    f"{_title(row)}: was trained with the force guard; evaluate it with --force-guard"
                )
            crowded = describe_excess_samples(row["start_draws_mean"], row["start_draws_max"])
            if crowded:
                print_warning(f"{_title(row)}: {crowded}; {row['starts_refused']} people were omitted")


def _title(row: dict[str, Any]) -> str:
    return f"{row['env']}, {row['policy']} with {row['people']}"
