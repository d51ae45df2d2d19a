"""A whole short session in a real browser with each input profile, in the wheelchair and in the bed."""

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from avrgym.commands.preferences import ConditionRules, apply_preferences
from avrgym.models.human import SKIN_TONES
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.reader import read_recording
from avrgym.vr.emulation.emulated_headset import (
    AGAIN_BUTTON_VALUE,
    BACK_BUTTON_VALUE,
    CONTINUE_BUTTON_VALUE,
    DONE_BUTTON_VALUE,
    _plain,
)
from avrgym.vr.protocol import messages
from avrgym.vr.session import events
from avrgym.vr.session.plan import HeadsetCheckPlan, SessionPlan, TrialPlan, load_policies
from helpers.browser.choosers import Chooser, ExperimenterClient
from helpers.browser.journey import Journey, wait_until
from helpers.vr.visit import ENVIRONMENT, constant_policies, result

pytestmark = pytest.mark.usefixtures("relaxed_limits")

LINE = Item("line", "How hard was it?", points=21, low="very low", high="very high")
WORDS = Item("sick", "Nausea", 4, "none", "severe", ("none", "slight", "moderate", "severe"))
SEGMENT = -102
"""The segment of the line that contains 14."""
FIRST_TONE = 3
REST_BUTTON = -5
PROFILES = {
    "controllers": InputProfile(),
    "hands": InputProfile("hands"),
    "left hand": InputProfile("left-hand", resting_arms=("right",)),
    "head": InputProfile("head", dwell_s=0.6, absent_arms=("left",)),
    "one switch": InputProfile("one-switch", scan_s=1.0),
    "two switches": InputProfile("two-switches"),
    "experimenter": InputProfile("experimenter"),
}


@dataclass
class Participation:
    """A participant who answers each phase until the session is over. ``done``: what they selected, in order."""

    journey: Journey
    chooser: Chooser
    experimenter: ExperimenterClient
    profile: InputProfile
    done: list[tuple[str, int]] = field(default_factory=list)

    def choose(self, item: str, *values: int) -> None:
        for value in values:
            self.chooser.choose(value)
            self.done.append((item, value))

    def take_part(self) -> None:
        stopped, phase = 0, ""
        while phase != "finished":
            shown, question = self.journey.headset.call_emulator("phaseAndQuestion")
            phase = shown["name"]
            buttons = self.journey.headset.call_emulator("buttons")
            if phase in ("headset_stop", "trial") and stopped < 1 + (phase == "trial"):
                self.chooser.stop()
                stopped += 1
                wait_until(lambda left=phase: self.journey.headset.call_emulator("phase")["name"] != left)
                self.lie_back()
            elif buttons and question and buttons[0]["item"] == question["item"]:
                self.answer(question)
            elif buttons and not question and phase != "questionnaire":
                self.go_on(phase)
            self.journey.headset.wait_for_frames(3)

    def answer(self, question: dict) -> None:
        before = [value for item, value in self.done if item == question["item"]]
        staged = self.profile.method not in ("controllers", "hands", "left-hand")
        if question["item"] != LINE.id:
            self.choose(question["item"], 1 if question["points"] == 2 else min(question["points"], 6))
        elif before:
            self.choose(LINE.id, *((SEGMENT, 15) if staged else (15,)))
        else:
            self.choose(LINE.id, *((SEGMENT, BACK_BUTTON_VALUE, SEGMENT, 14) if staged else (14,)))

    def go_on(self, phase: str) -> None:
        """Select the button with which the phase continues, once also each other one."""
        if phase == "headset" and ("headset", CONTINUE_BUTTON_VALUE) in self.done:
            self.experimenter.send(messages.ExperimenterCommand("skip"))
            wait_until(lambda: self.journey.session.phase_name != "headset")
        elif phase == "calibration" and ("calibration", FIRST_TONE) not in self.done:
            self.chooser.choose(FIRST_TONE, lambda: self.tone == next(iter(SKIN_TONES)))
            self.done.append((phase, FIRST_TONE))
        elif phase == "check" and ("check", AGAIN_BUTTON_VALUE) not in self.done:
            self.choose(phase, AGAIN_BUTTON_VALUE)
        elif "break" not in [item for item, _ in self.done] and REST_BUTTON in self.offered:
            self.choose("break", REST_BUTTON)
        elif phase == "confirm":
            self.choose(
                phase,
                BACK_BUTTON_VALUE if ("confirm", BACK_BUTTON_VALUE) not in self.done else DONE_BUTTON_VALUE,
            )
        else:
            self.lie_back()
            self.choose(phase, CONTINUE_BUTTON_VALUE)

    @property
    def offered(self) -> list[int]:
        return [button["value"] for button in self.journey.headset.call_emulator("buttons")]

    @property
    def tone(self) -> str:
        return self.journey.session.person.skin_tone

    def lie_back(self) -> None:
        """Rest in the seat or bed."""
        participant, session = self.journey.participant, self.journey.session
        participant.adopt_posture(session.world.environment_id)
        frame = participant.make_tracking_frame(time.monotonic(), moving=False)
        poses = {"head": _plain(frame.head), "left": _plain(frame.left), "right": _plain(frame.right)}
        self.journey.headset.call_emulator("setPoses", self.chooser.rest(poses))


@pytest.mark.slow
@pytest.mark.parametrize("name", PROFILES)
def test_each_profile_completes_a_session(name: str, tmp_path: Path) -> None:
    """Headset check, body, calibration, reach, practice with a stop, break, trial in bed, all item types, back."""
    profile = PROFILES[name]
    trials = [
        TrialPlan("avrgym/ScratchItchJaco-v1", "drive", 0, practice=True),
        TrialPlan("avrgym/ScratchItchJaco-v1", "drive", 2, practice=True),
        TrialPlan("avrgym/BedBathingJaco-v1", "drive", 1, practice=False),
    ]
    plan = SessionPlan(
        trials, "woman", 0.3, is_simulated=True, questionnaire_items=(LIKERT_ITEMS[0], WORDS, LINE), trial_steps=200,
        countdown_s=0.3,
        input_profile=profile, haptics=False, reach_measurement_enabled=True,
        headset_check=HeadsetCheckPlan(rest_duration_s=0.5, stretch_duration_s=0.5, motion_duration_s=0.5),
    )  # fmt: skip
    began = time.monotonic()
    query = "&headset=hands" if name == "hands" else ""
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, constant_policies(plan), opened, query=query)
        experimenter = opened.enter_context(ExperimenterClient(journey.server))
        chooser = Chooser(journey.headset, profile, experimenter)
        person = Participation(journey, chooser, experimenter, profile)
        person.lie_back()
        journey.headset.enter_vr()
        person.take_part()
        session, observed = journey.session, journey.observed
        assert session.person.skin_tone == next(iter(SKIN_TONES))
    print(f"{name}: {(time.monotonic() - began) / 60:.1f} min, {len(person.done)} selections")
    lost = {each.part for each in observed if isinstance(each, events.TrackingLost | events.TrackingTimedOut)}
    assert lost <= {"head", *profile.tracked_arms}
    recordings = [read_recording(path) for path in session.recordings]
    assert [result(each) for each in recordings] == ["stopped", "completed", "completed", "completed"]
    assert {each.configuration.input_profile for each in recordings} == {profile}
    assert len([each for each in observed if isinstance(each, events.BreakEnded)]) == 1
    values = [(record.item, record.value) for _, record in recordings[-1].messages_by_topic["/answers"]]
    assert values == [(LIKERT_ITEMS[0].id, 6), (WORDS.id, 4), (LINE.id, 14), (LINE.id, 15)]


@pytest.mark.slow
def test_a_participant_commands_by_a_look_at_an_icon(tmp_path: Path) -> None:
    """The icons are next to the robot. Only the commands and the source that the condition allows exist."""
    rules = ConditionRules(policy="revised", commands=("ready", "wait", "stop"), sources=("dwell",))
    trial = TrialPlan(ENVIRONMENT, "revised", 3, practice=False, rules=apply_preferences(rules, None))
    profile = InputProfile("head", dwell_s=0.6)
    plan = SessionPlan([trial], "woman", 0.1, is_simulated=True, countdown_s=0.3, input_profile=profile)
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        experimenter = opened.enter_context(ExperimenterClient(journey.server))
        person = Participation(
            journey, Chooser(journey.headset, profile, experimenter), experimenter, profile
        )
        person.lie_back()
        journey.headset.enter_vr()
        while journey.headset.call_emulator("phase")["name"] != "trial":
            if CONTINUE_BUTTON_VALUE in person.offered:
                person.lie_back()
                person.chooser.choose(CONTINUE_BUTTON_VALUE)
            journey.headset.wait_for_frames(3)
        person.lie_back()
        wait_until(lambda: len(journey.headset.call_emulator("buttons")) == 3)
        icons = {button["item"]: button["value"] for button in journey.headset.call_emulator("buttons")}
        assert list(icons) == ["ready", "wait", "stop"]
        for name in ("wait", "stop"):
            journey.headset.look_at_button(icons[name])
            wait_until(lambda name=name: name in [each for each, _ in commands(journey)])
        wait_until(lambda: journey.session.phase_name == "paused")
    assert commands(journey) == [("wait", "dwell"), ("stop", "dwell")]


def commands(journey: Journey) -> list[tuple[str, str]]:
    """Return the commands of the participant, with their sources."""
    return [(each.name, each.source) for each in journey.observed if isinstance(each, events.RobotCommanded)]
