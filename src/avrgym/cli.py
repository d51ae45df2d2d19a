"""The program ``avrgym``."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Column, Table

from avrgym.files import write_whole
from avrgym.models.human import SEXES
from avrgym.people import DISTRIBUTIONS
from avrgym.policies import packaged_policies
from avrgym.tasks import ENVIRONMENTS, TASKS, find_environment

if TYPE_CHECKING:
    from avrgym.vr.server import LiveServer

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Real people meet simulated assistive robots in virtual reality.",
)
bench = typer.Typer(no_args_is_help=True, help="Measure speeds on this machine.")
app.add_typer(bench, name="bench")
console = Console()
TABLE_WIDTH = 160

JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Write the figures to this file.", metavar="FILE")
]
Seed = Annotated[int, typer.Option(help="The same seed gives the same figures.", min=0)]


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Turn an error that the user can mend into one clear line and exit code 1."""
    try:
        yield
    except (ValueError, OSError, RuntimeError) as error:
        typer.echo(f"avrgym: {error}", err=True)
        raise typer.Exit(1) from error


def _check_folder(json_file: Path | None) -> None:
    """Raise ``ValueError`` before long work whose figures could not be written."""
    if json_file is not None and not json_file.parent.is_dir():
        raise ValueError(f"cannot write {json_file}: there is no folder {json_file.parent}")


def _write_json(path: Path | None, rows: list[dict[str, Any]]) -> None:
    if path is not None:
        write_whole(path, (json.dumps(rows, indent=2) + "\n").encode())


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="A folder for recordings, pictures and report.")] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Run a whole session of a simulated participant, then its report. Takes about a minute and a half."""
    from avrgym.demo import run_demo

    with _plain_errors():
        folder = _free_folder(out)
        result = run_demo(folder, seed, lambda text: _say(f"  {text}"))
    for recording in result.recordings:
        _say(f"recorded  {recording}")
    _say(f"report    {result.report}")
    if result.without_browser:
        _say("There was no browser, so the report has no pictures.")
    _say("Open the report in a browser. `avrgym serve` starts the live server for a headset.")


def _free_folder(wanted: Path) -> Path:
    """The wanted folder, or the first of wanted-2, wanted-3 and so on that holds nothing yet."""
    number, folder = 1, wanted
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder


@app.command()
def serve(
    study: Annotated[Path, typer.Option(help="The folder that recordings go into.", metavar="DIR")] = Path(
        "study"
    ),
    host: Annotated[str, typer.Option(help="The address to listen on: this machine only.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(help="The port to listen on; 0 takes a free one.", min=0, max=65535)
    ] = 8000,
    env: Annotated[str, typer.Option(help="The environment of the trials.")] = "avrgym/FeedingJaco-v1",
    policy: Annotated[str, typer.Option(help="A packaged policy or a policy file.")] = "revised",
    person: Annotated[str, typer.Option(help=f"The body model: {' or '.join(SEXES)}.")] = "woman",
    trials: Annotated[int, typer.Option(help="Trials after the practice trial.", min=1)] = 1,
    seed: Seed = 0,
) -> None:
    """Serve one participant's session to a headset: a practice trial, then trials with the questionnaire."""
    from avrgym.vr.server import LiveServer
    from avrgym.vr.session import Session, SessionPlan, TrialPlan, load_policies

    with _plain_errors():
        if person not in SEXES:
            raise ValueError(f"unknown person {person!r}; the body models are {' and '.join(SEXES)}")
        plans = [TrialPlan(env, policy, seed=seed + i, practice=i == 0) for i in range(trials + 1)]
        plan = SessionPlan(plans, person, free_movement_s=5.0, simulated=False)
        policies = load_policies(plan)
        with LiveServer(
            lambda send: Session(plan, policies, study / "recordings", send, identifier=study.name),
            host,
            port,
        ) as server:
            _explain(server)
            _wait(server)


def _explain(server: "LiveServer") -> None:
    _say(
        "Headset on a USB cable (Quest, Pico): run this first, then open the address in the headset's browser"
    )
    _say(f"    adb reverse tcp:{server.port} tcp:{server.port}")
    _say("Headset connected to this computer (SteamVR, Rift S): open the address in Chrome")
    _say(f"    {server.url}")
    _say("Stop with Ctrl+C.")


def _say(text: str) -> None:
    """Print a line as it is, so that paths and addresses can be copied."""
    console.print(text, soft_wrap=True, highlight=False)


@app.command()
def view(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    policy: Annotated[
        str, typer.Option(help="original, revised, oracle, random, zero, or a policy file.")
    ] = "oracle",
    people: Annotated[str, typer.Option(help=f"Whom to meet: {', '.join(DISTRIBUTIONS)}.")] = "revised",
    port: Annotated[
        int, typer.Option(help="The port to listen on; 0 takes a free one.", min=0, max=65535)
    ] = 8000,
    seed: Seed = 0,
) -> None:
    """Show an environment live in a browser, episode after episode."""
    from avrgym.vr.server import LiveServer
    from avrgym.vr.viewing import Viewing

    with (
        _plain_errors(),
        LiveServer(lambda send: Viewing(env, policy, people, seed, send), "127.0.0.1", port) as server,
    ):
        _say("Open this address in a browser; drag to look around. Stop with Ctrl+C.")
        _say(f"    {server.url}")
        _wait(server)


def _wait(server: "LiveServer") -> None:
    try:
        server.wait()
    except KeyboardInterrupt:
        _say("stopped")
    if server.loop.error is not None:
        raise RuntimeError(f"the simulation failed: {server.loop.error!r}")


@app.command()
def envs(json_file: JsonFile = None) -> None:
    """List the environments."""
    rows = [
        {
            "env": environment,
            "task": task,
            "robot": robot,
            "observation_size": TASKS[task].observation_size,
            "policies": sorted(packaged_policies(environment)),
        }
        for environment, (task, robot) in ENVIRONMENTS.items()
    ]
    _print_table(rows)
    with _plain_errors():
        _write_json(json_file, rows)


@app.command()
def train(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    people: Annotated[
        str, typer.Option(help=f"Whom to train with: {', '.join(DISTRIBUTIONS)}.")
    ] = "original",
    steps: Annotated[int, typer.Option(help="Environment steps.", min=1)] = 1_000_000,
    out: Annotated[Path | None, typer.Option(help="A folder for policy, checkpoint and log.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the training in the folder, as it was configured.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Train a policy with PPO. Needs the extra `train`."""
    with _plain_errors():
        find_environment(env)
        try:
            from avrgym import training
        except ModuleNotFoundError as error:
            raise RuntimeError(
                f"{error.name} is missing; `pip install avrgym[train]` brings what training needs"
            ) from error
        folder = out or Path("runs") / f"{env.removeprefix('avrgym/')}-{people}-{seed}"
        if resume:
            stored = training.stored_configuration(folder)
            if stored.environment != env:
                raise ValueError(f"{folder} holds a training of {stored.environment}, not of {env}")
            steps = stored.steps
        with Progress(
            "{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console
        ) as progress:
            bar = progress.add_task(env, total=steps)

            def tell(now: "training.Progress") -> None:
                words = f"{env}  reward {now.reward_mean:.1f}  success {now.success_rate:.1%}"
                progress.update(bar, completed=now.steps, description=words)

            if resume:
                training.resume(folder, tell)
            else:
                training.train(training.TrainingConfiguration(env, people, steps, seed), folder, tell)
    _say(f"policy    {folder / 'policy.safetensors'}")


@app.command()
def evaluate(
    env: Annotated[
        list[str] | None, typer.Argument(help="Environment ids; `avrgym envs` lists them.")
    ] = None,
    all_environments: Annotated[bool, typer.Option("--all", help="Every environment.")] = False,
    policy: Annotated[
        str, typer.Option(help="original, revised, oracle, random, zero, or a policy file.")
    ] = "revised",
    people: Annotated[str, typer.Option(help=f"Whom to meet: {', '.join(DISTRIBUTIONS)}.")] = "revised",
    episodes: Annotated[int, typer.Option(help="Episodes per environment.", min=1)] = 100,
    seed: Seed = 0,
    json_file: JsonFile = None,
) -> None:
    """Measure a policy's reward, success and force over many episodes."""
    from avrgym.episodes import EPISODE_STEPS
    from avrgym.evaluation import evaluate as measure

    rows = []
    with _plain_errors():
        _check_folder(json_file)
        for environment in _chosen(env, all_environments):
            with Progress(console=console, transient=True) as progress:
                bar = progress.add_task(environment, total=episodes * EPISODE_STEPS)
                result = measure(
                    environment, policy, people, episodes, seed, lambda n, b=bar: progress.advance(b, n)
                )
            rows.append(asdict(result))
    _print_table(rows)
    with _plain_errors():
        _write_json(json_file, rows)


@bench.command("sim")
def bench_sim(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id, again for more; without one, all.")
    ] = None,
    num_envs: Annotated[int, typer.Option(help="Worlds stepped together.", min=1)] = 64,
    json_file: JsonFile = None,
) -> None:
    """Measure whole episodes against their bare physics: medians of five runs. Best on an idle machine."""
    from avrgym.benchmark import RUNS, measure_simulation

    rows = []
    with _plain_errors():
        _check_folder(json_file)
        for environment in _chosen(env, not env):
            with Progress(console=console, transient=True) as progress:
                bar = progress.add_task(environment, total=RUNS)
                speed = measure_simulation(environment, num_envs, lambda b=bar: progress.advance(b))
            rows.append(asdict(speed))
    _print_table(rows)
    with _plain_errors():
        _write_json(json_file, rows)


def _chosen(environments: list[str] | None, every: bool) -> list[str]:
    """The environments that were named, or all.

    Raises:
        ValueError: when none was named or one does not exist, naming those that do.
    """
    if every:
        return list(ENVIRONMENTS)
    if not environments:
        raise ValueError(f"name an environment or --all; the environments are {', '.join(ENVIRONMENTS)}")
    for environment in environments:
        find_environment(environment)
    return environments


def _print_table(rows: list[dict[str, Any]]) -> None:
    table = Table(*(Column(name, no_wrap=True) for name in rows[0]), box=SIMPLE)
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    Console(width=max(console.width, TABLE_WIDTH)).print(table)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return ", ".join(_cell(item) for item in value)
    return str(value)
