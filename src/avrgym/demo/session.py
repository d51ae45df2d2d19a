"""One whole session of a simulated participant, and its report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avrgym.demo.report import write_report
from avrgym.vr.emulation.headset import BrowserAttendance, BrowserMissingError, EmulatedHeadset
from avrgym.vr.emulation.in_process import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, draw_traits
from avrgym.vr.protocol.messages import Message
from avrgym.vr.server.server import LiveServer
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session

ENVIRONMENT = "avrgym/FeedingJaco-v1"
FREE_MOVEMENT_S = 4.0


@dataclass(frozen=True)
class DemoResult:
    """What a demonstration left: the report, the recordings, and why no browser took part, if none did."""

    report: Path
    recordings: list[Path]
    without_browser: str | None


def run_demo(out: Path, seed: int, say: Callable[[str], None]) -> DemoResult:
    """Run a practice trial and a trial, answer the questionnaire, and write the report into ``out``."""
    plan = SessionPlan(
        trials=[
            TrialPlan(ENVIRONMENT, "revised", seed=2 * seed, practice=True),
            TrialPlan(ENVIRONMENT, "revised", seed=2 * seed + 1, practice=False),
        ],
        sex="woman",
        free_movement_s=FREE_MOVEMENT_S,
        simulated=True,
    )
    policies = load_policies(plan)
    participant = SimulatedParticipant(draw_traits(plan.sex, seed), seed)
    pictures = out / "pictures"
    pictures.mkdir(parents=True)

    def make_session(send: Callable[[Message], None]) -> Session:
        return Session(plan, policies, out / "recordings", send, identifier="demo")

    without_browser = None
    try:
        taken, recordings = _in_browser(make_session, participant, pictures, say)
    except BrowserMissingError as error:
        without_browser = str(error)
        say(f"no browser: {error}; running the same session in process")
        taken, recordings = [], _in_process(make_session, participant, say)
    report = write_report(out, recordings, taken, "Demonstration with a simulated participant")
    return DemoResult(report, recordings, without_browser)


def _in_browser(
    make_session: Callable[[Callable[[Message], None]], Session],
    participant: SimulatedParticipant,
    pictures: Path,
    say: Callable[[str], None],
) -> tuple[list[Path], list[Path]]:
    with LiveServer(make_session, "127.0.0.1", 0) as server, EmulatedHeadset(server.url) as headset:
        say(f"the server listens on http://{server.host}:{server.port}, a headset is emulated in Chromium")
        taken = BrowserAttendance(headset, server.session, participant, pictures, say).run()
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
