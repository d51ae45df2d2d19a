"""The commands ``avrgym bench``."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from avrgym.cli.options import EngineOption, select_environments
from avrgym.cli.progress import format_duration, show_progress_bar
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_skipped_item,
    print_table,
    report_errors,
    write_json,
)
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME, POLICY_CHOICES_TEXT
from avrgym.system.engine_names import THREADS
from avrgym.tasks.constants import list_skippable_errors

MetricsRow = dict[str, Any]
app = typer.Typer(no_args_is_help=True, help="Measure speeds on this computer.")


@app.command("sim")
def benchmark_simulation(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; default: all environments.")
    ] = None,
    num_envs: Annotated[int, typer.Option(help="Number of worlds that are stepped together.", min=1)] = 64,
    engine: EngineOption = THREADS,
    json_file: JsonFileOption = None,
) -> None:
    """Measure the speed of episodes and of physics alone.

    The results are medians of five runs. Run no other programs at the same time.
    """
    from avrgym.envs.benchmark import NUM_RUNS, measure_simulation_speed

    def row(environment: str) -> MetricsRow:
        with show_progress_bar(f"measuring {environment}", NUM_RUNS, "runs") as bar:
            return asdict(measure_simulation_speed(environment, num_envs, bar.advance, engine))

    with report_errors():
        _tabulate(env, not env, row, json_file)


@app.command("cameras")
def benchmark_cameras(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; default: FeedingJaco.")
    ] = None,
    json_file: JsonFileOption = None,
) -> None:
    """Measure images per second, by kind and size.

    Run no other programs at the same time.
    """
    from avrgym.envs.benchmark import measure_camera_speed

    with report_errors():
        check_json_file(json_file)
        chosen = select_environments(env or ["avrgym/FeedingJaco-v1"], every=False)
        rows = [asdict(row) for environment in chosen for row in measure_camera_speed(environment)]
        print_table(rows)
        write_json(json_file, rows)


@app.command("vr")
def benchmark_vr(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id; repeatable; default: all environments.")
    ] = None,
    seconds: Annotated[
        float, typer.Option(help="Duration of each environment's measurement.", min=1.0)
    ] = 60.0,
    policy: Annotated[
        str | None,
        typer.Option(
            help=f"The policy that drives the robot, by default an untrained network: {POLICY_CHOICES_TEXT}; or "
            f"{OPERATOR_POLICY_NAME}: a demonstrator steers with a second headset."
        ),
    ] = None,
    json_file: JsonFileOption = None,
) -> None:
    """Measure tick durations and round-trip times of the live server.

    The connection is over loopback, and trials are recorded. Run no other programs at the same time.
    """
    from avrgym.vr.benchmark.live_latency import measure_live_latency

    def row(environment: str) -> MetricsRow:
        print_line(f"measuring {environment} for {format_duration(seconds)}")
        with show_progress_bar(environment):
            return asdict(measure_live_latency(environment, seconds, policy))

    with report_errors():
        rows = _tabulate(env, not env, row, json_file, shown=_brief)
        print_table([stage for each in rows for stage in _stages(each)])


def _brief(row: MetricsRow) -> MetricsRow:
    """Returns the columns of ``row`` that ``bench vr`` prints."""
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
    if row["steering_ms"]:
        p99s["steering\np99, ms"] = row["steering_ms"]["p99"]
    missed = {"missed": row["missed_deadlines"], "missed\nrunning": row["missed_running"]}
    return {"env": row["env"], **p99s, **missed, "stolen, s": row["stolen_s"]}


def _stages(row: MetricsRow) -> list[MetricsRow]:
    """Returns a table row for each stage of the round trip."""
    return [
        {"env": row["env"], "stage": name.replace("_", " "), **{f"{p}, ms": ms for p, ms in spread.items()}}
        for name, spread in {**row["stages_ms"], "round_trip": row["round_trip_ms"]}.items()
    ]


def _tabulate(
    environments: list[str] | None,
    every: bool,
    row: Callable[[str], MetricsRow],
    json_file: Path | None,
    shown: Callable[[MetricsRow], MetricsRow] = lambda row: row,
) -> list[MetricsRow]:
    """Measure each environment. Returns a row with the results of each environment.

    Prints the columns that ``shown`` returns as a table, and writes all columns to ``json_file``. If ``every`` is true,
    environments with an error are omitted with a message.
    """
    check_json_file(json_file)
    rows: list[MetricsRow] = []
    failed: list[Exception] = []
    for environment in select_environments(environments, every):
        try:
            rows.append(row(environment))
        except list_skippable_errors(environment) as error:
            if not every:
                raise
            failed.append(error)
            print_skipped_item(environment, error)
    if not rows:
        raise failed[0]
    print_table([shown(each) for each in rows])
    write_json(json_file, rows)
    return rows
