"""The commands that serve live pages: ``avrgym serve`` and ``avrgym view``."""

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.audit_log import log_start_and_end
from avrgym.cli.options import (
    ALLOWED_PEOPLE_TEXT,
    AllowOtherSettingsOption,
    EpisodeStepsOption,
    ForceGuardOption,
    ImpairmentOption,
    LanOption,
    PolicyOption,
    PortOption,
    SeedOption,
    SettingsOption,
)
from avrgym.cli.participant_names import unlock_identity_file
from avrgym.cli.terminal import print_line, print_warning, report_errors
from avrgym.models.body_names import SEXES, Sex
from avrgym.policies.policy_names import DEFAULT_POLICY_NAMES, OPERATOR_POLICY_NAME, POLICY_CHOICES_TEXT
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.vr.server.network_addresses import ALL_INTERFACES, DEFAULT_PORT, LOOPBACK_HOSTS

if TYPE_CHECKING:
    from avrgym.models.furniture.real_furniture import RealFurniture
    from avrgym.study.dashboard.request_log import LivePageLog
    from avrgym.study.sessions.study_sessions import StudySessions
    from avrgym.vr.lab_streaming.stream_settings import StreamSettings
    from avrgym.vr.protocol.messages import MessageSender
    from avrgym.vr.server.authentication import AuthenticatedClient
    from avrgym.vr.server.certificate import Certificate
    from avrgym.vr.server.live_server import LiveServer
    from avrgym.vr.session.device_streams import DeviceStreams
    from avrgym.vr.session.events import SessionEvent
    from avrgym.vr.session.session import Session


def serve(
    study: Annotated[
        Path, typer.Option(help="The study's folder, or a folder for recordings.", metavar="DIR")
    ] = Path("study"),
    participant: Annotated[
        str | None, typer.Option(help="The participant whose session starts or continues, such as sub-001.")
    ] = None,
    host: Annotated[
        str | None, typer.Option(help="The address to listen on: a loopback address; with --lan any address.")
    ] = None,
    port: PortOption = DEFAULT_PORT,
    lan: LanOption = False,
    env: Annotated[list[str] | None, typer.Option(help="An environment of the trials; repeatable.")] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            help=f"The policy that drives the robot: {POLICY_CHOICES_TEXT}; or {OPERATOR_POLICY_NAME}. By default the "
            "first of "
            f"{', '.join(DEFAULT_POLICY_NAMES)} that the environment has."
        ),
    ] = None,
    body: Annotated[
        str, typer.Option("--body", "--person", help=f"The body model: {' or '.join(SEXES)}.")
    ] = "woman",
    trials: Annotated[
        int, typer.Option(help="Number of trials after each environment's practice trial.", min=1)
    ] = 1,
    seed: SeedOption = 0,
    seat_height: Annotated[
        float | None,
        typer.Option(help="The height of the real seat, m; default: that of the study, or 0.485."),
    ] = None,
    seat_depth: Annotated[float | None, typer.Option(help="The real seat's depth, m.")] = None,
    seat_back: Annotated[
        float | None, typer.Option(help="The angle of the real seat's back from the horizontal, degrees.")
    ] = None,
    mattress_height: Annotated[float | None, typer.Option(help="The height of the real mattress, m.")] = None,
    mattress_back: Annotated[
        float | None, typer.Option(help="The angle of the real bed's back from the horizontal, degrees.")
    ] = None,
    language: Annotated[
        str,
        typer.Option(
            help="The participant's language. For a study, set this in study.toml and at enrolment."
        ),
    ] = "",
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Check the headset first, which takes a minute. study.toml can also require this check.",
        ),
    ] = False,
    reach: Annotated[
        bool,
        typer.Option(
            "--reach",
            help="Also measure the length of the participant's arms. For a study, set this in study.toml.",
        ),
    ] = False,
    force_guard: Annotated[
        bool | None,
        typer.Option(
            "--force-guard/--no-force-guard",
            help="Whether a force guard limits contact force and approach speed of the arms; "
            "default: on, except in studies that turn it off.",
            show_default=False,
        ),
    ] = None,
    send_streams: Annotated[
        bool,
        typer.Option(
            "--send-streams",
            help="Send events, poses and forces to Lab Streaming Layer. For a study, set this in study.toml.",
        ),
    ] = False,
    receive: Annotated[
        list[str] | None,
        typer.Option(
            help="A stream of Lab Streaming Layer to record, such as \"heart=type='ECG'\"; repeatable.",
            metavar="NAME=QUERY",
        ),
    ] = None,
    settings: SettingsOption = None,
    allow_other_settings: AllowOtherSettingsOption = False,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
) -> None:
    """Serve one participant's session to a headset.

    For each environment, the session has a practice trial, then trials with questions. For the folder of a study, the
    server also shows the experimenter's dashboard. Sessions are started there, or immediately with --participant.
    """
    from concurrent.futures import ThreadPoolExecutor

    from avrgym.models.furniture.real_furniture import DEFAULT_FURNITURE, change_furniture
    from avrgym.system.files import get_user_data_folder
    from avrgym.vr.lab_streaming.stream_settings import parse_stream_options
    from avrgym.vr.server.certificate import find_lan_host_names, load_or_create_certificate
    from avrgym.vr.server.live_server import LiveServer

    with report_errors(), ThreadPoolExecutor(1) as workers, ExitStack() as stack:
        if body not in SEXES:
            raise ValueError(f"unknown body model {body!r}; allowed: {', '.join(SEXES)}")
        furniture = partial(
            change_furniture,
            seat_height_m=seat_height,
            seat_depth_m=seat_depth,
            seat_back_deg=seat_back,
            mattress_height_m=mattress_height,
            mattress_back_deg=mattress_back,
        )
        choice = parse_stream_options(send_streams, receive or [])
        certificate = (
            load_or_create_certificate(find_lan_host_names(), get_user_data_folder()) if lan else None
        )
        address = host or (ALL_INTERFACES if lan else LOOPBACK_HOSTS[0])
        if participant is not None or (study / "study.toml").is_file():
            if force_guard is not None:
                raise ValueError(
                    f"options cannot set a study's force guard; set force_guard in {study / 'study.toml'}"
                )
            if choice != parse_stream_options(False, []):
                raise ValueError(
                    f"options cannot set a study's streams; set [streams] in {study / 'study.toml'}"
                )
            if settings or allow_other_settings or episode_steps != EPISODE_STEPS:
                raise ValueError(
                    f"options cannot set a study's settings; set [settings] in {study / 'study.toml'}"
                )
            if language:
                raise ValueError(
                    f"options cannot set a study's language; set languages in {study / 'study.toml'}, "
                    "and choose one at enrolment"
                )
            _serve_study(study, participant, furniture, workers, address, port, certificate, check=check)
            return
        streams = stack.enter_context(_streams(choice))
        make_session = _free_session(
            study,
            env or ["avrgym/FeedingJaco-v1"],
            policy,
            body,
            furniture(DEFAULT_FURNITURE),
            trials,
            seed,
            workers,
            streams,
            force_guard=force_guard is not False,
            language=language or "en",
            check=check,
            reach=reach,
            settings=settings,
            allow_other_settings=allow_other_settings,
            trial_steps=episode_steps,
        )
        with LiveServer(make_session, address, port, certificate) as server:
            server.export_newest_scene()
            _explain(server, "spectator", server.list_page_urls())
            wait_for_server(server)


def _serve_study(
    folder: Path,
    participant: str | None,
    furniture: "Callable[[RealFurniture], RealFurniture]",
    workers: Executor,
    host: str,
    port: int,
    certificate: "Certificate | None",
    *,
    check: bool,
) -> None:
    """Serve the dashboard and the sessions of a study.

    If ``participant`` is given, start this participant's session.
    """
    from avrgym.study.dashboard.application import make_dashboard_app
    from avrgym.study.dashboard.request_log import LivePageLog
    from avrgym.study.dashboard.study_tokens import StudyTokens
    from avrgym.study.people.experimenters import ExperimenterTokens
    from avrgym.study.sessions.session_threads import StorageThread
    from avrgym.study.sessions.stored_session_links import load_session_links
    from avrgym.study.sessions.study_sessions import StudySessions
    from avrgym.study.storage.identity_file import IDENTITY_FOLDER as PRIVATE
    from avrgym.study.storage.remote_recordings import RecordingUploader
    from avrgym.study.storage.store import StudyStore
    from avrgym.vr.server.live_server import LiveServer
    from avrgym.vr.server.session_links import SessionLinks
    from avrgym.vr.server.sound_files import SOUNDS_FOLDER

    unlock_identity_file(folder)
    with (
        StudyStore(folder) as store,
        nullcontext(load_session_links(store)) as links,
        nullcontext(SessionLinks()) as caregiver_links,
        log_start_and_end(store, "start server", "stop server"),
        RecordingUploader(store, print_warning),
        StorageThread() as storing,
        ExperimenterTokens(store) as experimenters,
        _streams(store.design.streams) as streams,
        LiveServer(
            lambda send: StudySessions(
                store,
                send,
                workers,
                first=participant,
                furniture=furniture(store.design.furniture),
                storing=storing,
                streams=streams,
                headset_check=check,
                links=links,
                caregiver_links=caregiver_links,
            ),
            host,
            port,
            certificate,
            study=lambda tokens, sessions: make_dashboard_app(
                store,
                tokens,
                sessions,
                lambda link: server.list_page_urls(token=link),
                lambda link: server.list_page_urls("caregiver", link),
            ),
            tokens=StudyTokens.load_for_study(
                folder / PRIVATE / "tokens.json", experimenters, links, caregiver_links
            ),
            sounds=folder / SOUNDS_FOLDER,
            record=partial(_record, LivePageLog(store, storing, print_warning)),
            links=links,
        ) as server,
    ):
        server.export_newest_scene()
        _explain(
            server,
            "dashboard",
            server.list_page_urls(token=links.current_link_token)
            if links.current_link_token
            else server.list_participant_urls_without_token(),
        )
        if links.current_link_token is None:
            print_line(
                "Each session has its own link. Start a session on the dashboard, and enter its code on the headset."
            )
        wait_for_server(server)


def _record(
    log: "LivePageLog", sessions: "StudySessions", caller: "AuthenticatedClient", message: Any
) -> None:
    log.log_message(caller, message, sessions.running_participant)


def _streams(choice: "StreamSettings") -> "AbstractContextManager[DeviceStreams | None]":
    """Context manager: yields the selected streams of other devices; ``None`` if no stream is selected."""
    if not choice.send and not choice.receive:
        return nullcontext()
    try:
        from avrgym.vr.lab_streaming.streams import open_lab_streams
    except (ModuleNotFoundError, RuntimeError) as error:  # a RuntimeError if its library cannot be loaded
        raise ValueError(
            f"Lab Streaming Layer is missing ({error}); `pip install avrgym[lsl]` installs it"
        ) from error
    return open_lab_streams(choice)


def _free_session(
    folder: Path,
    environments: list[str],
    policy: str | None,
    person: Sex,
    furniture: "RealFurniture",
    trials: int,
    seed: int,
    workers: Executor,
    streams: "DeviceStreams | None",
    *,
    force_guard: bool,
    language: str,
    check: bool,
    reach: bool,
    settings: list[str] | None,
    allow_other_settings: bool,
    trial_steps: int,
) -> "Callable[[MessageSender], Session]":
    """Returns a function that starts a session without a study."""
    from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, translate_items
    from avrgym.tasks.settings import parse_settings
    from avrgym.texts.interface_texts import read_texts
    from avrgym.vr.session.plan import HeadsetCheckPlan, SessionPlan, load_policies, plan_trials_with_practice
    from avrgym.vr.session.session import Session

    texts = read_texts(language)
    planned = plan_trials_with_practice(environments, policy, trials, seed)
    plan = SessionPlan(
        planned,
        person,
        free_movement_s=5.0,
        is_simulated=False,
        questionnaire_items=translate_items(LIKERT_ITEMS, texts),
        furniture=furniture,
        has_force_guard=force_guard,
        texts=texts,
        headset_check=HeadsetCheckPlan() if check else None,
        reach_measurement_enabled=reach,
        settings=parse_settings(settings or []),
        allow_other_settings=allow_other_settings,
        trial_steps=trial_steps,
    )
    policies = load_policies(plan)
    for environment, name in policies if policy is None else ():
        if name != DEFAULT_POLICY_NAMES[0]:
            print_warning(
                f"{environment} has no policy {DEFAULT_POLICY_NAMES[0]}; its robot is driven by {name}"
            )
    recordings, name = folder / "recordings", folder.name
    return lambda send: Session(
        plan,
        policies,
        recordings,
        send,
        identifier=name,
        workers=workers,
        observe=_tell_check,
        streams=streams,
    )


def _tell_check(happened: "SessionEvent") -> None:
    """Print the result of a headset check; ignore other events."""
    from avrgym.vr.headset_check import format_measurements, format_result
    from avrgym.vr.session.events import HeadsetChecked

    if isinstance(happened, HeadsetChecked):
        print_line(f"Headset check: {format_result(happened.check)}")
        print_line(f"    {format_measurements(happened.check)}")


def _explain(server: "LiveServer[Any]", experimenters_page: str, participants: list[str]) -> None:
    """Print the addresses of all pages. ``participants`` contains the addresses of the participant's page."""
    own, *in_network = participants
    print_line(
        "Without a headset, or with one connected to this computer (SteamVR, Rift S): open this "
        "address in Chrome on this computer"
    )
    print_line(f"    {own}")
    print_line(
        "Headset on a USB cable (Quest, Pico): run this first, then open the same address in its browser"
    )
    print_line(f"    adb reverse tcp:{server.port} tcp:{server.port}")
    if in_network:
        _explain_network(in_network)
    print_line("Experimenter (do not give this address to the participant)")
    print_line(f"    {server.list_page_urls(experimenters_page, server.tokens.experimenter)[0]}")
    print_line("Demonstrator, who drives the robot in trials with the policy operator")
    print_line(f"    {server.list_page_urls('demonstrator', server.tokens.demonstrator)[0]}")
    print_line("Spectators")
    print_line(f"    {server.list_page_urls('spectator', server.tokens.spectator)[0]}")
    print_line("Stop with Ctrl+C.")


def _explain_network(urls: list[str]) -> None:
    import segno

    print_line(
        "Headset in this network: open one of these; its browser asks once whether to trust the certificate"
    )
    for url in urls:
        print_line(f"    {url}")
    segno.make(urls[0]).terminal(compact=True)


def view(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    policy: PolicyOption = "oracle",
    people: Annotated[str, typer.Option(help=f"The population: {ALLOWED_PEOPLE_TEXT}.")] = "revised",
    impairment: ImpairmentOption = "none",
    port: PortOption = DEFAULT_PORT,
    seed: SeedOption = 0,
    force_guard: ForceGuardOption = False,
    settings: SettingsOption = None,
    allow_other_settings: AllowOtherSettingsOption = False,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
) -> None:
    """Show episodes of an environment in a browser.

    The page shows reward, success and force, and can pause or skip an episode. With `--policy operator`, you drive the
    robot on this page.
    """
    from avrgym.tasks.settings import parse_settings
    from avrgym.vr.server.environment_viewer import EnvironmentViewer
    from avrgym.vr.server.live_server import LiveServer

    with (
        report_errors(),
        LiveServer(
            lambda send: EnvironmentViewer(
                env,
                policy,
                people,
                seed,
                send,
                impairment,
                force_guard=force_guard,
                settings=parse_settings(settings or []),
                allow_other_settings=allow_other_settings,
                steps=episode_steps,
            ),
            "127.0.0.1",
            port,
        ) as server,
    ):
        server.export_newest_scene()
        print_line("Open this address in a browser; drag to look around. Stop with Ctrl+C.")
        print_line(f"    {server.list_page_urls('spectator', server.tokens.experimenter)[0]}")
        wait_for_server(server)


def wait_for_server(server: "LiveServer[Any]") -> None:
    """Wait until the server stops or is interrupted. Raises ``RuntimeError`` if the simulation failed."""
    try:
        server.wait()
    except KeyboardInterrupt:
        print_line("stopped")
    if server.loop.error is not None:
        raise RuntimeError(f"the simulation failed: {server.loop.error!r}; restart the server")
