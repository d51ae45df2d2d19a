"""Transitions between phases: those of their annotations and no others; no session gets stuck."""

import random
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, get_args, get_type_hints

import pytest

from avrgym.commands.preferences import ConditionRules, apply_preferences
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.vr.protocol.messages import (
    Answer,
    BodyChoice,
    BreakRequest,
    ExperimenterCommand,
    ExperimenterCommandName,
    Hello,
    OriginReset,
    ParticipantBodyChoice,
    ParticipantDisconnected,
    ParticipantReady,
    PreferenceChangeRequest,
    PreviousQuestionRequest,
    Question,
    RecalibrationRequest,
    ReceivedMessage,
    Scene,
    SceneLoaded,
    Stop,
    TorsoHeightCorrection,
    VisibilityChanged,
    VrEntered,
    VrLeft,
)
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.phases import PHASES
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.phases.setup_phases import ReachMeasurement
from avrgym.vr.session.plan import HeadsetCheckPlan
from avrgym.vr.session.session import Session
from helpers.vr.visit import Visit, constant_policies, plan

SEEDS = (2, 3, 5, 6)
"""Their walks see every phase."""
SITTING, LYING = "avrgym/FeedingJaco-v1", "avrgym/BedBathingJaco-v1"

STEPS = [
    name
    for name, method in vars(Phase).items()
    if callable(method) and not name.startswith("_") and get_type_hints(method).get("return") is Phase
]
"""The methods that return the phase that follows."""


def owner(phase: type[Phase], step: str) -> type[Phase]:
    """The class whose method it is."""
    return next(cls for cls in phase.__mro__ if step in vars(cls))


def followers(phase: type[Phase], step: str) -> set[type[Phase]]:
    """The phases that may follow by the method's annotation."""
    cls = owner(phase, step)
    if cls is Phase:
        return {phase}
    named = get_type_hints(vars(cls)[step])["return"]
    return {phase if kind is Self else kind for kind in get_args(named) or (named,)}


@pytest.mark.parametrize("phase", PHASES)
def test_every_annotation_names_phases(phase: type[Phase]) -> None:
    assert len(STEPS) > 20
    for step in STEPS:
        assert followers(phase, step) <= set(PHASES)


@pytest.mark.parametrize(
    ("flag", "step"),
    [
        ("can_be_stopped", "stop"),
        ("participant_located", "repeat"),
        ("awaits_confirmation", "on_ready"),
        ("can_recalibrate", "recalibrate"),
        ("can_choose_body", "choose_body"),
    ],
)
def test_a_phase_says_what_it_can_do(flag: str, step: str) -> None:
    for phase in PHASES:
        assert getattr(phase, flag) == (owner(phase, step) is not Phase)


class Walk:
    """A session of sitting and lying trials in a random world: a slow disk, a failing observer, a moody participant."""

    COMMANDS: tuple[ExperimenterCommandName, ...] = (
        "stop",
        "pause",
        "continue",
        "continue",
        "repeat",
        "skip",
        "recalibrate",
        "break",
    )
    DISRUPTIONS: Sequence[ReceivedMessage] = (
        VrEntered(), VrLeft(), ParticipantDisconnected(), OriginReset(), RecalibrationRequest(), BreakRequest(),
        Stop(), ParticipantReady(),
        PreferenceChangeRequest(), PreferenceChangeRequest(),
        Hello(4, "", "", True),
        BodyChoice("woman", "fair"), BodyChoice("man", "dark"), ParticipantBodyChoice("woman", "blue"),
        Answer("L1", 4, 1.0),
        VisibilityChanged("visible-blurred"), VisibilityChanged("visible"), VisibilityChanged("visible"),
        PreviousQuestionRequest(),
        TorsoHeightCorrection(0.55), TorsoHeightCorrection(5.0), *(ExperimenterCommand(name) for name in COMMANDS),
    )  # fmt: skip

    def __init__(self, folder: Path, seed: int) -> None:
        self.messages = 0
        self._chance, self._world = random.Random(seed), random.Random(seed + 1000)
        self._busy = 0
        checked = HeadsetCheckPlan(
            rest_duration_s=0.05, stretch_duration_s=0.05, motion_duration_s=0.05, test_stop_limit_s=2.0
        )
        trials = plan(seeds=range(7), practice=True, environments=(SITTING, SITTING, LYING))
        paced = apply_preferences(ConditionRules(policy="drive", preferences=True), None)
        session = replace(
            trials,
            trials=[replace(each, rules=paced, allow_preference_changes=True) for each in trials.trials],
            headset_check=checked,
            reach_measurement_enabled=True,
            break_items=LIKERT_ITEMS[:1],
        )
        how: dict[str, Any] = {"observe": self._observe, "is_stored": self._is_stored}
        self.visit = Visit(
            folder,
            session,
            make=lambda send: Session(session, constant_policies(session), folder, send, "walk", **how),
        )
        self.visit.loads_scenes = self.visit.confirms = False

    def _observe(self, _event: read_session_events.SessionEvent) -> None:
        if self._world.random() < 0.01:
            raise OSError("the observer fails")
        self._busy = self._world.choice([0, 0, 0, 3, 20])

    def _is_stored(self) -> bool:
        self._busy = max(0, self._busy - 1)
        return self._busy == 0

    def step(self) -> None:
        """Go on as the session wants it, disturb it, or let time pass."""
        drawn = self._chance.random()
        if drawn < 0.05:
            self._tell(self._chance.choice(self.DISRUPTIONS))
        elif drawn < 0.052:
            self.visit.tracking = not self.visit.tracking
        elif drawn < 0.054:
            self.visit._ticks += 60
        elif drawn < 0.5:
            self._go_on()
        else:
            self.visit.participant.adopt_posture(self._environment())
            self.visit.tick(self._chance.choice([1, 1, 2, 10]))

    def _environment(self) -> str:
        trials = self.visit.session.plan.trials
        return trials[min(self.visit.session.trial_index, len(trials) - 1)].environment

    def _go_on(self) -> None:
        if self.visit.phase == "waiting":
            self._tell(VrEntered())
        elif self.visit.phase == "headset":
            shown = (
                SceneLoaded(self.visit.received(Scene)[-1].url)
                if self.visit.received(Scene)
                else ParticipantReady()
            )
            self._tell(
                self._chance.choice(
                    [ParticipantReady(), ParticipantReady(), shown, shown, ExperimenterCommand("skip")]
                )
            )
        elif self.visit.phase in ("calibration", "check", "ready", "break", "paused"):
            self._tell(
                self._chance.choice([ParticipantReady(), ParticipantReady(), ExperimenterCommand("continue")])
            )
        elif self.visit.phase == "loading" and self.visit.received(Scene):
            shown = SceneLoaded(self.visit.received(Scene)[-1].url)
            self._tell(self._chance.choice([shown, shown, shown, OriginReset()]))
        elif self.visit.phase in ("questionnaire", "headset_check") and self.visit.received(Question):
            asked = self.visit.received(Question)[-1]
            self._tell(Answer(asked.item, self._chance.randint(1, asked.points), 1.0))
        elif self.visit.phase == "headset_stop":
            self._tell(Stop(method="palm"))
        elif self.visit.phase == "confirm":
            self._tell(
                self._chance.choice([ParticipantReady(), ParticipantReady(), PreviousQuestionRequest()])
            )

    def _tell(self, message: ReceivedMessage) -> None:
        self.messages += 1
        self.visit.send(message)


@pytest.mark.slow
def test_no_message_and_no_tick_leads_where_no_annotation_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Thousands of messages at random; every phase is seen, and every method's outcome compared."""
    monkeypatch.setattr(ReachMeasurement, "time_limit_s", 0.1)
    allowed = {(phase, step): followers(phase, step) for phase in PHASES for step in STEPS}
    seen: set[type[Phase]] = set()

    def watch(cls: type[Phase], step: str) -> None:
        method = vars(cls)[step]

        def watched(phase: Phase, *given: Any) -> Phase:
            follows = method(phase, *given)
            assert follows is phase or type(follows) in allowed[type(phase), step]
            seen.update((type(phase), type(follows)))
            return follows

        monkeypatch.setattr(cls, step, watched)

    for cls in {cls for phase in PHASES for cls in phase.__mro__ if issubclass(cls, Phase)}:
        for step in STEPS:
            if step in vars(cls):
                watch(cls, step)
    messages = 0
    for seed in SEEDS:
        walk = Walk(tmp_path / str(seed), seed)
        for _ in range(2600):
            walk.step()
        walk.visit.leave()
        messages += walk.messages
    print(f"\n{messages} messages")
    assert messages > 2000
    assert seen == set(PHASES)


# What must not leave a session stuck -------------------------------------------------------------------------


def test_a_session_whose_end_cannot_be_stored_stays_finished(tmp_path: Path) -> None:
    def fail(event: read_session_events.SessionEvent) -> None:
        if isinstance(event, read_session_events.PhaseEntered) and event.phase == "finished":
            raise OSError("the database is gone")

    short = plan()
    visit = Visit(
        tmp_path,
        short,
        make=lambda send: Session(short, constant_policies(short), tmp_path, send, "x", observe=fail),
    )
    visit.go_to("finished")
    visit.tick()
    visit.send(ParticipantReady())
    visit.tick()
    assert visit.phase == "finished"
    assert any("the database is gone" in problem for problem in visit.problems)
    visit.leave()


def test_a_torso_height_may_be_corrected_while_the_scene_loads(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan())
    visit.go_to("loading")
    visit.send(TorsoHeightCorrection(torso_height_m=0.61))
    visit.tick(3)
    visit.loads_scenes = True
    visit.run_until("trial")
    assert visit.session.world.person.torso_height_m == 0.61
    visit.leave()


def test_a_failure_while_the_scene_loads_is_forgotten_when_a_trial_is_stored_late(tmp_path: Path) -> None:
    stored, failures, trials = [True], [OSError("the database is gone")], plan(seeds=(1, 2))

    def kept() -> bool:
        if visit.phase == "loading" and visit.loads_scenes and failures:
            raise failures.pop()
        return stored[0]

    visit = Visit(tmp_path, trials)
    visit.session = Session(
        trials, constant_policies(trials), tmp_path, visit.inbox.append, "x", is_stored=kept
    )
    visit.go_to("loading")
    visit.loads_scenes = True
    visit.run_until("paused")
    visit.send(ParticipantReady())
    visit.run_until("questionnaire")
    stored[0] = False
    visit.answer(4, 4, 4, 4)
    visit.tick(5)
    assert visit.phase == "loading"
    stored[0] = True
    entered = len(visit.phases)
    visit.run_until("trial")
    assert visit.phases[entered:] == ["loading", "ready", "free_before", "countdown", "trial"]
    visit.leave()
