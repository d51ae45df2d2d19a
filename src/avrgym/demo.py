"""Demonstration: a simulated participant performs each task. A web page replays each trial."""

from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from avrgym.recording.reader import read_recording
from avrgym.replay.page import ReplayedTrial, write_page
from avrgym.replay.timeline import build_timeline
from avrgym.vr.emulation.emulated_headset import BrowserClient, BrowserMissingError, EmulatedHeadset
from avrgym.vr.emulation.in_process_client import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import Message
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session

DEMO_ENVIRONMENTS = (
    "avrgym/FeedingJaco-v1",
    "avrgym/DrinkingPR2-v1",
    "avrgym/ScratchItchJaco-v1",
    "avrgym/BedBathingPR2-v1",
)
"""Environments of the demonstration, one for each task. The task in bed is last, because it needs a new calibration of
the headset."""
FREE_MOVEMENT_S, COUNTDOWN_S, TRIAL_STEPS = 1.0, 2.0, 90


@dataclass(frozen=True)
class DemoResult:
    """The paths of the files that a demonstration has written.

    ``pages``: paths of the replay pages. ``recordings``: paths of the recordings. ``browser_error``: the reason why no
    browser was used; ``None`` if a browser was used.
    """

    pages: list[Path]
    recordings: list[Path]
    browser_error: str | None


def run_demo(out: Path, seed: int, log: Callable[[str], None]) -> DemoResult:
    """Run one trial of each task with its questionnaire. Write recordings, screenshots and pages to the folder ``out``.

    ``seed`` determines the simulated participant and the trials. ``log`` is called with each progress message. Returns
    the paths of the files.
    """
    plan = SessionPlan(
        trials=[
            TrialPlan(environment, "adaptive", seed=len(DEMO_ENVIRONMENTS) * seed + number, practice=False)
            for number, environment in enumerate(DEMO_ENVIRONMENTS)
        ],
        sex="woman",
        free_movement_s=FREE_MOVEMENT_S,
        is_simulated=True,
        trial_steps=TRIAL_STEPS,
        countdown_s=COUNTDOWN_S,
    )
    policies = load_policies(plan)
    participant = SimulatedParticipant(sample_participant_traits(plan.sex, seed), seed)
    pictures = out / "pictures"
    pictures.mkdir(parents=True)

    def make_session(send: Callable[[Message], None], workers: Executor | None = None) -> Session:
        return Session(plan, policies, out / "recordings", send, identifier="demo", workers=workers)

    without_browser = None
    try:
        recordings = _in_browser(make_session, participant, pictures, log)
    except BrowserMissingError as error:
        without_browser = str(error)
        log(f"no browser is available: {error}; the session runs in one process without a browser")
        recordings = _in_process(make_session, participant, log)
    return DemoResult(_write_pages(recordings, out), recordings, without_browser)


def _in_browser(
    make_session: Callable[[Callable[[Message], None], Executor], Session],
    participant: SimulatedParticipant,
    pictures: Path,
    log: Callable[[str], None],
) -> list[Path]:
    with (
        ThreadPoolExecutor(1) as workers,
        LiveServer(lambda send: make_session(send, workers), "127.0.0.1", 0) as server,
        EmulatedHeadset(server.participant_url) as headset,
    ):
        log(f"the server listens on http://{server.host}:{server.port}; Chromium emulates a headset")
        BrowserClient(headset, server.session, participant, pictures, log).run()
        return list(server.session.recordings)


def _in_process(
    make_session: Callable[[Callable[[Message], None]], Session],
    participant: SimulatedParticipant,
    log: Callable[[str], None],
) -> list[Path]:
    """Run the session without browser and server, faster than real time. Returns the paths of the recordings."""
    client = InProcessClient(participant, log)
    session = make_session(client.receive)
    client.run(session)
    return list(session.recordings)


def _write_pages(recordings: list[Path], out: Path) -> list[Path]:
    """Write a replay page for the last attempt at each trial. Returns the paths of the pages."""
    attempts = [read_recording(path) for path in recordings]
    pages: list[Path] = []
    for environment in DEMO_ENVIRONMENTS:
        own = [recording for recording in attempts if recording.configuration.environment == environment]
        page = out / f"{environment.removeprefix('avrgym/').removesuffix('-v1')}.html"
        write_page([ReplayedTrial(own[-1], *build_timeline(own[-1], lambda: None))], page)
        pages.append(page)
    return pages
