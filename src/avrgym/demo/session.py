"""One whole session of a simulated participant in all tasks, and its report."""

from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from avrgym.demo.report import telling_moment_s, write_report
from avrgym.recording.reader import read_recording
from avrgym.replay.pictures import draw_moment
from avrgym.replay.playback import ReplayError
from avrgym.vr.emulation.emulated_headset import (
    BrowserClient,
    BrowserMissingError,
    EmulatedHeadset,
)
from avrgym.vr.emulation.in_process_client import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, draw_traits
from avrgym.vr.protocol.messages import Message
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session

ENVIRONMENTS = (
    "avrgym/FeedingJaco-v1",
    "avrgym/DrinkingPR2-v1",
    "avrgym/ScratchItchJaco-v1",
    "avrgym/BedBathingPR2-v1",
)
"""Every task, with one robot or the other; who lies down does so last, since they are measured anew."""
FREE_MOVEMENT_S, COUNTDOWN_S, TRIAL_STEPS = 1.0, 2.0, 120
"""Short, so that all is over within two minutes."""


@dataclass(frozen=True)
class DemoResult:
    """What a demonstration left: the report, the recordings, and why no browser took part, if none did."""

    report: Path
    recordings: list[Path]
    without_browser: str | None


def run_demo(out: Path, seed: int, say: Callable[[str], None]) -> DemoResult:
    """Run a trial of each task, answer the questionnaire, and write the report into ``out``."""
    plan = SessionPlan(
        trials=[
            TrialPlan(environment, "adaptive", seed=len(ENVIRONMENTS) * seed + number, practice=False)
            for number, environment in enumerate(ENVIRONMENTS)
        ],
        sex="woman",
        free_movement_s=FREE_MOVEMENT_S,
        simulated=True,
        trial_steps=TRIAL_STEPS,
        countdown_s=COUNTDOWN_S,
    )
    policies = load_policies(plan)
    participant = SimulatedParticipant(draw_traits(plan.sex, seed), seed)
    pictures = out / "pictures"
    pictures.mkdir(parents=True)

    def make_session(send: Callable[[Message], None], workers: Executor | None = None) -> Session:
        return Session(plan, policies, out / "recordings", send, identifier="demo", workers=workers)

    without_browser = None
    try:
        taken, recordings = _in_browser(make_session, participant, pictures, say)
    except BrowserMissingError as error:
        without_browser = str(error)
        say(f"no browser: {error}; running the same session in process")
        taken, recordings = [], _in_process(make_session, participant, say)
    moments = _draw_moments(recordings, pictures, say)
    report = write_report(out, recordings, taken, "Demonstration with a simulated participant", moments)
    return DemoResult(report, recordings, without_browser)


def _draw_moments(recordings: list[Path], folder: Path, say: Callable[[str], None]) -> dict[Path, Path]:
    """A picture of each recording from beside, where pictures can be drawn."""
    drawn: dict[Path, Path] = {}
    for path in recordings:
        recording, out = read_recording(path), folder / f"{path.stem}-from-beside.jpg"
        try:
            draw_moment(recording, telling_moment_s(recording), out)
        except (ReplayError, RuntimeError) as error:
            say(f"no picture of {path.name} from beside: {error}")
            break
        drawn[path] = out
    return drawn


def _in_browser(
    make_session: Callable[[Callable[[Message], None], Executor], Session],
    participant: SimulatedParticipant,
    pictures: Path,
    say: Callable[[str], None],
) -> tuple[list[Path], list[Path]]:
    with (
        ThreadPoolExecutor(1) as workers,
        LiveServer(lambda send: make_session(send, workers), "127.0.0.1", 0) as server,
        EmulatedHeadset(server.url) as headset,
    ):
        say(f"the server listens on http://{server.host}:{server.port}, a headset is emulated in Chromium")
        taken = BrowserClient(headset, server.session, participant, pictures, say).run()
        return taken, list(server.session.recordings)


def _in_process(
    make_session: Callable[[Callable[[Message], None]], Session],
    participant: SimulatedParticipant,
    say: Callable[[str], None],
) -> list[Path]:
    """The same session without browser and server, as fast as it goes."""
    client = InProcessClient(participant, say)
    session = make_session(client.hear)
    client.run(session)
    return list(session.recordings)
