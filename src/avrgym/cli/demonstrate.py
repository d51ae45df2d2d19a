"""The command ``avrgym demonstrate``: record demonstrations of a human operator with simulated people."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.options import (
    ALLOWED_PEOPLE_TEXT,
    EpisodeStepsOption,
    ImpairmentOption,
    LanOption,
    PortOption,
    SeedOption,
    SettingsOption,
)
from avrgym.cli.progress import CONTINUE_HINT, show_progress_bar
from avrgym.cli.serve import wait_for_server
from avrgym.cli.terminal import print_line, report_errors
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME, POLICY_CHOICES_TEXT
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.vr.server.network_addresses import ALL_INTERFACES, DEFAULT_PORT, LOOPBACK_HOSTS

if TYPE_CHECKING:
    from avrgym.vr.demonstration.episode_worlds import DemonstrationPlan
    from avrgym.vr.demonstration.storage import DemonstrationFolder
    from avrgym.vr.live_world.drivers import OperatorDriver


def demonstrate(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    episodes: Annotated[
        int,
        typer.Option(help="Total number of recorded episodes, including those in an existing folder.", min=1),
    ] = 20,
    people: Annotated[
        list[str] | None,
        typer.Option(
            help=f"A population; repeatable: the people alternate. Default: participants. {ALLOWED_PEOPLE_TEXT}."
        ),
    ] = None,
    impairment: ImpairmentOption = "none",
    out: Annotated[
        Path,
        typer.Option(
            help="The folder of recordings and success marks; the command adds to an existing folder."
        ),
    ] = Path("demonstrations"),
    policy: Annotated[
        str,
        typer.Option(
            help=f"The policy that drives until you take over to correct it: {POLICY_CHOICES_TEXT}. Default: you drive."
        ),
    ] = OPERATOR_POLICY_NAME,
    simulated: Annotated[
        bool,
        typer.Option(
            "--simulated",
            help="A simulated operator drives, in simulated time: the task's expert with human delay and noise.",
        ),
    ] = False,
    force_guard: Annotated[
        bool,
        typer.Option(
            "--force-guard/--no-force-guard", help="Limit contact force and approach speed of the arms."
        ),
    ] = True,
    port: PortOption = DEFAULT_PORT,
    lan: LanOption = False,
    seed: SeedOption = 0,
    settings: SettingsOption = None,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
) -> None:
    """Record demonstrations with simulated people.

    You drive the robot in VR, or by keyboard or gamepad. With --policy, a policy drives, and you correct it.

    Each episode has another simulated person. Buttons start an episode, end it as a success, or discard it.
    """
    from avrgym.tasks.settings import parse_settings
    from avrgym.vr.demonstration.episode_worlds import DemonstrationPlan
    from avrgym.vr.demonstration.storage import DemonstrationFolder

    with report_errors():
        plan = DemonstrationPlan(
            env,
            tuple(people or ["participants"]),
            impairment,
            episodes,
            episode_steps,
            seed,
            force_guard,
            parse_settings(settings or []),
            policy,
        )
        driver = _make_driver(plan, background=not simulated)
        folder = DemonstrationFolder(out, env)
        if simulated:
            _simulate(plan, folder, driver)
        else:
            _serve(plan, folder, driver, port, lan=lan)
        recorded, successes = (
            folder.count_episodes("completed"),
            folder.count_episodes("completed", success=True),
        )
        print_line(
            f"{out}: {recorded} episodes, {successes} successes, {folder.count_episodes('discarded')} discarded"
        )
        if successes:
            print_line("Write them as a LeRobot dataset")
            print_line(f"    avrgym export demonstrations {out} dataset")


def _make_driver(plan: "DemonstrationPlan", *, background: bool) -> "OperatorDriver":
    """Returns the driver of the robot. Raises ``ValueError`` if the policy cannot be loaded."""
    from avrgym.policies.registry import resolve_session_policy
    from avrgym.vr.live_world.corrected_driver import CorrectedDriver
    from avrgym.vr.live_world.drivers import OperatorDriver

    if plan.policy == OPERATOR_POLICY_NAME:
        return OperatorDriver()
    policy = resolve_session_policy(plan.policy, plan.environment, plan.settings)
    return CorrectedDriver(policy, plan.policy, background=background)


def _simulate(plan: "DemonstrationPlan", folder: "DemonstrationFolder", driver: "OperatorDriver") -> None:
    from avrgym.vr.demonstration.session import DemonstrationSession
    from avrgym.vr.demonstration.simulated_session import (
        record_simulated_demonstrations as record_simulated_demonstrations,
    )
    from avrgym.vr.session.world_preparation import ImmediateExecutor

    session = DemonstrationSession(
        plan, folder, lambda message: None, ImmediateExecutor(), driver=driver, driven_by="simulated"
    )
    with show_progress_bar("demonstrations", plan.episodes, "episodes", CONTINUE_HINT) as bar:
        record_simulated_demonstrations(
            session, plan.seed, progress=lambda: bar.update(folder.count_episodes("completed"))
        )


def _serve(
    plan: "DemonstrationPlan",
    folder: "DemonstrationFolder",
    driver: "OperatorDriver",
    port: int,
    *,
    lan: bool,
) -> None:
    from concurrent.futures import ThreadPoolExecutor

    from avrgym.system.files import get_user_data_folder
    from avrgym.vr.demonstration.session import DemonstrationSession
    from avrgym.vr.server.certificate import find_lan_host_names, load_or_create_certificate
    from avrgym.vr.server.live_server import LiveServer

    certificate = load_or_create_certificate(find_lan_host_names(), get_user_data_folder()) if lan else None
    host = ALL_INTERFACES if lan else LOOPBACK_HOSTS[0]
    with (
        ThreadPoolExecutor(1) as workers,
        LiveServer(
            lambda send: DemonstrationSession(plan, folder, send, workers, driver=driver),
            host,
            port,
            certificate,
        ) as server,
    ):
        server.export_newest_scene()
        print_line(
            "Open this address in the headset's browser, or in Chrome on this computer. Stop with Ctrl+C."
        )
        for url in server.list_page_urls("demonstrator", server.tokens.demonstrator):
            print_line(f"    {url}")
        print_line("Headset on a USB cable (Quest, Pico): run this first")
        print_line(f"    adb reverse tcp:{server.port} tcp:{server.port}")
        print_line("Spectators")
        print_line(f"    {server.list_page_urls('spectator', server.tokens.spectator)[0]}")
        wait_for_server(server)
