"""One whole session of a simulated participant, and its report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avrgym.analysis.report import write_report
from avrgym.envs import ACTIONS
from avrgym.participants import SimulatedParticipant, draw_traits
from avrgym.policies import Policy, load_policy
from avrgym.tasks import TASKS, find_environment
from avrgym.vr import messages
from avrgym.vr.emulation import CALIBRATION_S, Attendance, BrowserMissingError, EmulatedHeadset
from avrgym.vr.messages import Message
from avrgym.vr.server import LiveServer
from avrgym.vr.session import Session, SessionPlan, TrialPlan
from avrgym.vr.world import TICK_S

ENVIRONMENT = "avrgym/FeedingJaco-v1"
FREE_MOVEMENT_S = 4.0
TRACKING_EVERY_TICKS = 2
ANSWER_AFTER_S = 1.5


@dataclass(frozen=True)
class DemoResult:
    """What a demonstration left: the report, the recordings, and why no browser took part, if none did."""

    report: Path
    recordings: list[Path]
    without_browser: str | None


def load_policies(plan: SessionPlan) -> dict[str, Policy]:
    """Every policy that a plan names.

    Raises:
        ValueError: for an unknown environment or a policy that cannot be loaded.
    """
    policies = {}
    for trial in plan.trials:
        task, _ = find_environment(trial.environment)
        size = TASKS[task].observation_size
        policies[trial.policy] = load_policy(trial.policy, trial.environment, size, ACTIONS)
    return policies


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
        taken = Attendance(headset, server.session, participant, pictures, say).run()
        return taken, list(server.session.recordings)


def _in_process(
    make_session: Callable[[Callable[[Message], None]], Session],
    participant: SimulatedParticipant,
    say: Callable[[str], None],
) -> list[Path]:
    """The same session without browser and server, as fast as it goes."""
    driver = InProcessParticipant(participant, say)
    session = make_session(driver.hear)
    driver.attend(session)
    return list(session.recordings)


class InProcessParticipant:
    """A simulated participant who speaks to a session directly, in simulated time."""

    def __init__(self, participant: SimulatedParticipant, say: Callable[[str], None]) -> None:
        self._participant, self._say = participant, say
        self._question: messages.Question | None = None
        self._scene_url = ""
        self._heard_s = 0.0
        self._now_s = 0.0

    def hear(self, message: Message) -> None:
        """Take a message that the session sends."""
        if isinstance(message, messages.Phase):
            self._heard_s, self._question = self._now_s, None
            self._say(f"{message.name.replace('_', ' ')} (trial {message.trial} of {message.trials})")
        elif isinstance(message, messages.Question):
            self._heard_s, self._question = self._now_s, message
        elif isinstance(message, messages.Scene):
            self._scene_url = message.url

    def attend(self, session: Session) -> None:
        """Sit through the session until it is finished."""
        session.receive(messages.Entered(), self._now_s)
        tick = 0
        while session.phase != "finished":
            self._now_s = tick * TICK_S
            if tick % TRACKING_EVERY_TICKS == 0:
                frame = self._participant.frame(self._now_s, moving=session.phase != "calibration")
                session.receive(frame, self._now_s)
            self._respond(session)
            session.tick(self._now_s)
            tick += 1
        session.close(self._now_s)

    def _respond(self, session: Session) -> None:
        waited_s = self._now_s - self._heard_s
        if session.phase == "calibration" and waited_s > CALIBRATION_S:
            session.receive(messages.Ready(), self._now_s)
        if session.phase == "loading":
            session.receive(messages.SceneLoaded(url=self._scene_url), self._now_s)
        question = self._question
        if question is not None and waited_s > ANSWER_AFTER_S:
            self._question = None
            value = self._participant.answer(session.succeeded, question.points)
            answer = messages.Answer(item=question.item, value=value, response_time_s=waited_s)
            session.receive(answer, self._now_s)
