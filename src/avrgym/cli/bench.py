"""The commands ``avrgym bench``."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from avrgym.cli.options import Engine, select_environments
from avrgym.cli.progress import duration, progress_bar
from avrgym.cli.terminal import (
    JsonFile,
    check_json,
    print_line,
    print_skipped,
    print_table,
    report_errors,
    write_json,
)
from avrgym.policies.names import POLICY_CHOICES
from avrgym.system.engines import THREADS
from avrgym.tasks.constants import expected_errors

Row = dict[str, Any]
app = typer.Typer(no_args_is_help=True, help="Measure speeds on this computer.")


@app.command("sim")
def bench_sim(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; by default all.")
    ] = None,
    num_envs: Annotated[int, typer.Option(help="Number of worlds that are stepped together.", min=1)] = 64,
    engine: Engine = THREADS,
    json_file: JsonFile = None,
) -> None:
    """Measure the speed of whole episodes and of their physics alone.

    The results are medians of five runs. Use an idle computer.
    """
    from avrgym.envs.benchmark import RUNS, measure_simulation

    def row(environment: str) -> Row:
        with progress_bar(f"measuring {environment}", RUNS, "runs") as bar:
            return asdict(measure_simulation(environment, num_envs, bar.advance, engine))

    with report_errors():
        _tabulate(env, not env, row, json_file)


@app.command("cameras")
def bench_cameras(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; by default FeedingJaco.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure images per second of the wrist camera, by kind and size. Use an idle computer."""
    from avrgym.envs.benchmark import measure_cameras

    with report_errors():
        check_json(json_file)
        chosen = select_environments(env or ["avrgym/FeedingJaco-v1"], every=False)
        rows = [asdict(row) for environment in chosen for row in measure_cameras(environment)]
        print_table(rows)
        write_json(json_file, rows)


@app.command("vr")
def bench_vr(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; by default all.")
    ] = None,
    seconds: Annotated[
        float, typer.Option(help="Duration of each environment's measurement.", min=1.0)
    ] = 60.0,
    policy: Annotated[
        str | None,
        typer.Option(
            help=f"The policy that drives the robot, by default an untrained network: {POLICY_CHOICES}."
        ),
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure the live server's ticks and round trips.

    The connection is over loopback, and trials are recorded. Use an idle computer.
    """
    from avrgym.vr.benchmark.live_latency import measure_vr

    def row(environment: str) -> Row:
        print_line(f"measuring {environment} for {duration(seconds)}")
        with progress_bar(environment):
            return asdict(measure_vr(environment, seconds, policy))

    with report_errors():
        rows = _tabulate(env, not env, row, json_file, shown=_brief)
        print_table([stage for each in rows for stage in _stages(each)])


def _brief(row: Row) -> Row:
    """Returns the columns of ``bench vr`` that the terminal shows."""
    p99s = {
        f"{name}\np99, ms": row[key] and row[key]["p99"]
        for name, key in (
            ("tick", "tick_ms"),
            ("undisturbed tick", "undisturbed_tick_ms"),
            ("processor", "processor_ms"),
            ("round trip", "round_trip_ms"),
            ("undisturbed trip", "undisturbed_round_trip_ms"),
        )
    }
    missed = {"missed": row["missed_deadlines"], "missed\nrunning": row["missed_running"]}
    return {"env": row["env"], **p99s, **missed, "stolen, s": row["stolen_s"]}


def _stages(row: Row) -> list[Row]:
    """Returns a row for each stage of the round trip."""
    return [
        {"env": row["env"], "stage": name.replace("_", " "), **{f"{p}, ms": ms for p, ms in spread.items()}}
        for name, spread in {**row["stages_ms"], "round_trip": row["round_trip_ms"]}.items()
    ]


def _tabulate(
    environments: list[str] | None,
    every: bool,
    row: Callable[[str], Row],
    json_file: Path | None,
    shown: Callable[[Row], Row] = lambda row: row,
) -> list[Row]:
    """Measure each environment. Returns a row for each.

    Prints the columns ``shown`` as a table, and writes all columns to ``json_file``. If ``every`` is true, environments
    that fail are omitted with a message.
    """
    check_json(json_file)
    rows: list[Row] = []
    failed: list[Exception] = []
    for environment in select_environments(environments, every):
        try:
            rows.append(row(environment))
        except expected_errors(environment) as error:
            if not every:
                raise
            failed.append(error)
            print_skipped(environment, error)
    if not rows:
        raise failed[0]
    print_table([shown(each) for each in rows])
    write_json(json_file, rows)
    return rows
