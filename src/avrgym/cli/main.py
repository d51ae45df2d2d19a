"""The program ``avrgym``."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.analysis import analyze
from avrgym.cli.doctor import doctor
from avrgym.cli.new import app as new_commands
from avrgym.cli.program import Program
from avrgym.cli.replay import replay
from avrgym.cli.study import app as study_commands
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
from avrgym.models.human import SEXES, Sex
from avrgym.people.distributions import DISTRIBUTIONS
from avrgym.policies.names import CHOICES, OPERATOR
from avrgym.tasks.registry import ENVIRONMENTS, find_environment, sizes
from avrgym.vr.server.addresses import EVERY_ADDRESS, LOOPBACK, PORT

if TYPE_CHECKING:
    from avrgym.models.furniture.real import RealFurniture
    from avrgym.vr.protocol.messages import Send
    from avrgym.vr.server.certificate import Certificate
    from avrgym.vr.server.server import LiveServer
    from avrgym.vr.session.session import Session

app = Program(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Real people meet simulated assistive robots in virtual reality.",
)
bench = typer.Typer(no_args_is_help=True, help="Measure speeds on this machine.")
app.add_typer(bench, name="bench")
app.add_typer(study_commands, name="study")
app.add_typer(new_commands, name="new")
app.command()(analyze)
app.command()(replay)
app.command()(doctor)

Row = dict[str, Any]
PEOPLE = f"{', '.join(DISTRIBUTIONS)}, or a file of `avrgym fit-people`"
Policy = Annotated[str, typer.Option(help=f"Who drives: {CHOICES}.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same metrics.", min=0)]


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="A folder for recordings, pictures and report.")] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Run a session of a simulated participant, then its report.

    Takes about a minute and a half.
    """
    from avrgym.demo.session import run_demo

    with plain_errors():
        folder = _free_folder(out)
        result = run_demo(folder, seed, lambda text: say(f"  {text}"))
    for recording in result.recordings:
        say(f"recorded  {recording}")
    say(f"report    {result.report}")
    if result.without_browser:
        say("There was no browser, so the report has no pictures.")
    say("Open the report in a browser. `avrgym serve` starts the live server for a headset.")


def _free_folder(wanted: Path) -> Path:
    """The wanted folder, or the first of wanted-2, wanted-3 and so on that holds nothing yet."""
    number, folder = 1, wanted
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder


@app.command()
def serve(
    study: Annotated[
        Path, typer.Option(help="A study's folder, or one that recordings go into.", metavar="DIR")
    ] = Path("study"),
    participant: Annotated[
        str | None, typer.Option(help="Whose session in the study begins or goes on, such as sub-001.")
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="The address to listen on: this machine's own, or with --lan any.")
    ] = None,
    port: Annotated[
        int, typer.Option(help="The port to listen on; 0 takes a free one.", min=0, max=65535)
    ] = PORT,
    lan: Annotated[
        bool,
        typer.Option("--lan", help="Serve the local network too, over TLS with a certificate of our own."),
    ] = False,
    env: Annotated[
        list[str] | None, typer.Option(help="An environment of the trials, again for more.")
    ] = None,
    policy: Annotated[str, typer.Option(help=f"Who drives: {CHOICES}; or {OPERATOR}.")] = "revised",
    body: Annotated[
        str, typer.Option("--body", "--person", help=f"The body model: {' or '.join(SEXES)}.")
    ] = "woman",
    trials: Annotated[int, typer.Option(help="Trials after each environment's practice trial.", min=1)] = 1,
    seed: Seed = 0,
    seat_height: Annotated[
        float | None,
        typer.Option(help="The real seat above the floor, m; 0.485 unless the study says otherwise."),
    ] = None,
    seat_depth: Annotated[float | None, typer.Option(help="The real seat's depth, m.")] = None,
    seat_back: Annotated[
        float | None, typer.Option(help="The angle of the real seat's back from the horizontal, degrees.")
    ] = None,
    mattress_height: Annotated[
        float | None, typer.Option(help="The real mattress above the floor, m.")
    ] = None,
    mattress_back: Annotated[
        float | None, typer.Option(help="The angle of the real bed's back from the horizontal, degrees.")
    ] = None,
    force_guard: Annotated[
        bool | None,
        typer.Option(
            "--force-guard/--no-force-guard",
            help="Whether arms that press too hard draw back; they do, and in a study as study.toml says.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Serve one participant's session to a headset.

    For each environment there is practice, then trials with questions. A study's folder is served with the
    experimenter's dashboard, which begins its sessions; with --participant theirs begins at once.
    """
    from concurrent.futures import ThreadPoolExecutor

    from avrgym.models.furniture.real import REAL_AS_VIRTUAL, real_furniture
    from avrgym.vr.server.certificate import certificate_for, data_folder, lan_names
    from avrgym.vr.server.server import LiveServer

    with plain_errors(), ThreadPoolExecutor(1) as workers:
        if body not in SEXES:
            raise ValueError(f"unknown body {body!r}; the body models are {' and '.join(SEXES)}")
        furniture = partial(
            real_furniture,
            seat_height_m=seat_height,
            seat_depth_m=seat_depth,
            seat_back_deg=seat_back,
            mattress_height_m=mattress_height,
            mattress_back_deg=mattress_back,
        )
        certificate = certificate_for(lan_names(), data_folder()) if lan else None
        address = host or (EVERY_ADDRESS if lan else LOOPBACK[0])
        if participant is not None or (study / "study.toml").is_file():
            if force_guard is not None:
                raise ValueError(f"in a study force_guard in {study / 'study.toml'} says it, and no option")
            _serve_study(study, participant, furniture, workers, address, port, certificate)
            return
        make_session = _free_session(
            study,
            env or ["avrgym/FeedingJaco-v1"],
            policy,
            body,
            furniture(REAL_AS_VIRTUAL),
            trials,
            seed,
            workers,
            force_guard=force_guard is not False,
        )
        with LiveServer(make_session, address, port, certificate) as server:
            _explain(server, "spectator")
            _wait(server)


def _serve_study(
    folder: Path,
    participant: str | None,
    furniture: "Callable[[RealFurniture], RealFurniture]",
    workers: Executor,
    host: str,
    port: int,
    certificate: "Certificate | None",
) -> None:
    """Serve a study's dashboard, and one after another the sessions that it begins, a participant's at once."""
    from avrgym.study.dashboard.application import dashboard_app
    from avrgym.study.sessions.serving import StudySessions
    from avrgym.study.sessions.storing import StoringThread
    from avrgym.study.storage.store import Store
    from avrgym.vr.server.server import LiveServer

    with (
        Store(folder) as store,
        StoringThread() as storing,
        LiveServer(
            lambda send: StudySessions(
                store,
                send,
                workers,
                first=participant,
                furniture=furniture(store.design.furniture),
                storing=storing,
            ),
            host,
            port,
            certificate,
            study=lambda tokens, sessions: dashboard_app(store, tokens, sessions),
        ) as server,
    ):
        _explain(server, "dashboard")
        _wait(server)


def _free_session(
    folder: Path,
    environments: list[str],
    policy: str,
    person: Sex,
    furniture: "RealFurniture",
    trials: int,
    seed: int,
    workers: Executor,
    *,
    force_guard: bool,
) -> "Callable[[Send], Session]":
    """What makes a session outside of any study."""
    from avrgym.vr.session.plan import SessionPlan, load_policies, practised_trials
    from avrgym.vr.session.session import Session

    planned = practised_trials(environments, policy, trials, seed)
    plan = SessionPlan(
        planned, person, free_movement_s=5.0, simulated=False, furniture=furniture, force_guard=force_guard
    )
    policies = load_policies(plan)
    recordings, name = folder / "recordings", folder.name
    return lambda send: Session(plan, policies, recordings, send, identifier=name, workers=workers)


def _explain(server: "LiveServer[Any]", experimenters_page: str) -> None:
    """Say which addresses to open."""
    own, *in_network = server.urls()
    say(
        "Headset on a USB cable (Quest, Pico): run this first, then open the address in the headset's browser"
    )
    say(f"    adb reverse tcp:{server.port} tcp:{server.port}")
    say(f"    {own}")
    say("Headset connected to this computer (SteamVR, Rift S), or none at all: open it in Chrome here")
    if in_network:
        _explain_network(in_network)
    say("Experimenter: watch and command here; this address is not for the participant")
    say(f"    {server.urls(experimenters_page, server.tokens.experimenter)[0]}")
    say("Spectators: watch here")
    say(f"    {server.urls('spectator', server.tokens.spectator)[0]}")
    say("Stop with Ctrl+C.")


def _explain_network(urls: list[str]) -> None:
    import segno

    say("Headset in this network: open one of these; its browser asks once whether to trust the certificate")
    for url in urls:
        say(f"    {url}")
    segno.make(urls[0]).terminal(compact=True)


@app.command()
def view(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    policy: Policy = "oracle",
    people: Annotated[str, typer.Option(help=f"Whom to meet: {PEOPLE}.")] = "revised",
    port: Annotated[
        int, typer.Option(help="The port to listen on; 0 takes a free one.", min=0, max=65535)
    ] = PORT,
    seed: Seed = 0,
) -> None:
    """Show an environment live in a browser, episode after episode."""
    from avrgym.vr.server.server import LiveServer
    from avrgym.vr.server.viewing import Viewing

    with (
        plain_errors(),
        LiveServer(lambda send: Viewing(env, policy, people, seed, send), "127.0.0.1", port) as server,
    ):
        say("Open this address in a browser; drag to look around. Stop with Ctrl+C.")
        say(f"    {server.url}")
        _wait(server)


def _wait(server: "LiveServer[Any]") -> None:
    try:
        server.wait()
    except KeyboardInterrupt:
        say("stopped")
    if server.loop.error is not None:
        raise RuntimeError(f"the simulation failed: {server.loop.error!r}")


@app.command()
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


@app.command()
def train(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    people: Annotated[str, typer.Option(help=f"Whom to train with: {PEOPLE}.")] = "original",
    steps: Annotated[int, typer.Option(help="Environment steps.", min=1)] = 1_000_000,
    out: Annotated[Path | None, typer.Option(help="A folder for policy, checkpoint and log.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the training in the folder, as it was configured.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Train a policy with PPO. Needs the extra `train`."""
    with plain_errors():
        find_environment(env)
        try:
            from avrgym.learning import training
        except ModuleNotFoundError as error:
            raise RuntimeError(
                f"{error.name} is missing; `pip install avrgym[train]` brings what training needs"
            ) from error
        folder = out or Path("runs") / f"{env.removeprefix('avrgym/')}-{Path(people).stem}-{seed}"
        if resume:
            stored = training.stored_configuration(folder)
            if stored.environment != env:
                raise ValueError(f"{folder} holds a training of {stored.environment}, not of {env}")
            steps = stored.steps
        with progress_bar(env, steps) as bar:

            def tell(now: "training.Progress") -> None:
                words = f"{env}  reward {now.reward_mean:.1f}  success {now.success_rate:.1%}"
                bar.show(now.steps, words=words)

            if resume:
                training.resume(folder, tell)
            else:
                training.train(training.configuration_for(env, people, steps, seed), folder, tell)
    say(f"policy    {folder / 'policy.safetensors'}")


@app.command("fit-people")
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


@app.command()
def evaluate(
    env: Annotated[
        list[str] | None, typer.Argument(help="Environment ids; `avrgym envs` lists them.")
    ] = None,
    all_environments: Annotated[bool, typer.Option("--all", help="Every environment.")] = False,
    policy: Policy = "revised",
    people: Annotated[str, typer.Option(help=f"Whom to meet: {PEOPLE}.")] = "revised",
    episodes: Annotated[int, typer.Option(help="Episodes per environment.", min=1)] = 100,
    seed: Seed = 0,
    jobs: Jobs = None,
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
    """Measure reward, success and force over many episodes."""
    from avrgym.learning.evaluation import evaluate_all
    from avrgym.tasks.task import EPISODE_STEPS

    with plain_errors():
        check_json(json_file)
        chosen = _chosen(env, all_environments)
        with progress_bar(policy, len(chosen) * episodes * EPISODE_STEPS) as bar:
            metrics = evaluate_all(
                chosen,
                policy,
                people,
                episodes,
                seed,
                bar.advance,
                jobs=jobs,
                allow_other_environment=allow_other_environment,
                force_guard=force_guard,
            )
        rows = [asdict(each) for each in metrics]
        print_table([{name: row[name] for name in row if name != "force_regions"} for row in rows])
        if regions:
            print_regions({row["env"]: row["force_regions"] for row in rows})
        write_json(json_file, rows)


@bench.command("sim")
def bench_sim(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id, again for more; without one, all.")
    ] = None,
    num_envs: Annotated[int, typer.Option(help="Worlds stepped together.", min=1)] = 64,
    json_file: JsonFile = None,
) -> None:
    """Measure whole episodes against their bare physics.

    Medians of five runs. Best on an idle machine.
    """
    from avrgym.envs.benchmark import RUNS, measure_simulation

    def row(environment: str) -> Row:
        with progress_bar(environment, RUNS) as bar:
            return asdict(measure_simulation(environment, num_envs, bar.advance))

    with plain_errors():
        _tabulate(env, not env, row, json_file)


@bench.command("vr")
def bench_vr(
    env: Annotated[
        list[str] | None, typer.Option(help="An environment id, again for more; without one, all.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long each environment is measured.", min=1.0)] = 60.0,
    policy: Annotated[
        str | None, typer.Option(help=f"Who drives: {CHOICES}; without it an untrained network.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure the live server's ticks and round trips.

    Over loopback, with recording. Best on an idle machine.
    """
    from avrgym.vr.benchmark.measuring import measure_vr

    def row(environment: str) -> Row:
        with progress_bar(environment):
            return asdict(measure_vr(environment, seconds, policy))

    with plain_errors():
        _tabulate(env, not env, row, json_file, shown=_brief)


def _brief(row: Row) -> Row:
    """What of a row of ``bench vr`` fits a table."""
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


def _tabulate(
    environments: list[str] | None,
    every: bool,
    row: Callable[[str], Row],
    json_file: Path | None,
    shown: Callable[[Row], Row] = lambda row: row,
) -> None:
    """Measure a row for each environment that was named, or all; print what is ``shown`` of them, write them whole."""
    check_json(json_file)
    rows = [row(environment) for environment in _chosen(environments, every)]
    print_table([shown(each) for each in rows])
    write_json(json_file, rows)


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
