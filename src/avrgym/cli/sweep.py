"""The command ``avrgym sweep``: many training runs on a cluster."""

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import ClusterOption, connect_cluster
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    JobsOption,
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)


def sweep(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="A TOML file with environments, steps, seeds, people and recipes.", metavar="[FILE]"
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A folder for the training runs; default: runs/NAME for NAME.toml.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the sweep in the folder of --out, without FILE.")
    ] = False,
    cluster: ClusterOption = "local",
    jobs: JobsOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Run many training runs on a Ray cluster.

    The command trains a policy for every combination of seeds, recipes, people and environments. Install
    `avrgym[train,cluster]` first.
    """
    with report_errors():
        check_json_file(json_file)
        if resume == (file is not None) or (resume and out is None):
            raise ValueError(
                "a new sweep needs FILE; --resume needs --out DIR, the folder of the sweep, and no FILE"
            )
        from avrgym.learning.sweep import create_sweep, read_planned_runs, run_sweep

        folder = out or Path("runs") / (file or Path()).stem
        if file is not None:
            create_sweep(file, folder)
        groups = read_planned_runs(folder)
        steps = sum(each.configuration.total_steps for group in groups.values() for each in group)
        again = f"`avrgym sweep --resume --out {shlex.quote(str(folder))}` continues it"
        made: dict[str, int] = {}
        with (
            connect_cluster(cluster, jobs),
            show_progress_bar("training runs", steps, "steps", stopped=again) as bar,
        ):

            def report(name: str, steps_made: int) -> None:
                made[name] = steps_made
                bar.update(sum(made.values()), label=f"{len(made)} training runs started")

            rows = [asdict(each) for each in run_sweep(folder, jobs, report)]
        print_table([{name: row[name] for name in row if name != "policy"} for row in rows])
        write_json(json_file, rows)
    print_line(f"sweep     {folder}")
