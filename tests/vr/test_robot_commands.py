"""A participant commands the robot in a session: commands are executed, recorded and replayed; others are ignored."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from avrgym.commands.preferences import ConditionRules, Preferences, apply_preferences
from avrgym.commands.vocabulary import CommandName
from avrgym.replay.verification import verify_recording
from avrgym.vr.emulation.simulated_commands import GESTURE_DURATION_S
from avrgym.vr.protocol.messages import (
    Answer,
    AvailableRobotCommands,
    OtherPersonRobotCommand,
    PhaseDescription,
    PreferenceChangeRequest,
    Question,
    RobotCommand,
    decode_participant_message,
    encode_message,
)
from avrgym.vr.server.inbox import is_emergency_stop
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.vr.visit import ENVIRONMENT, Visit, events, plan, result

STEPS = 40
COMMANDS: tuple[CommandName, ...] = ("ready", "wait", "slower", "stop")


def paced_session() -> SessionPlan:
    condition = ConditionRules(
        policy="revised", commands=COMMANDS, sources=("key", "nod", "shake", "caregiver")
    )
    trial = TrialPlan(ENVIRONMENT, "revised", 3, practice=False, rules=apply_preferences(condition, None))
    return replace(plan(trial_steps=STEPS), trials=[trial])


def visit_at_waiting_pose(folder: Path) -> Visit:
    session = paced_session()
    visit = Visit(folder, session, load_policies(session))
    visit.calibrate()
    visit.run_until("trial")
    visit.tick()
    while visit.received(AvailableRobotCommands)[-1].mode != "waiting":
        visit.tick()
    return visit


def press(visit: Visit, name: CommandName) -> None:
    visit.send(RobotCommand(name, "key", 1000.0 * visit.now_s))
    visit.tick(10)


@pytest.mark.slow
def test_commands_are_executed_recorded_and_replayed(tmp_path: Path) -> None:
    visit = visit_at_waiting_pose(tmp_path)
    offered = visit.received(AvailableRobotCommands)[-1]
    assert [(each.name, each.label) for each in offered.commands][:2] == [
        ("ready", "Ready"),
        ("wait", "Wait"),
    ]
    press(visit, "slower")
    press(visit, "faster")
    visit.send(RobotCommand("ready", "switch", 0.0))
    visit.send(OtherPersonRobotCommand("ready", "caregiver", 0.0))
    visit.tick(20)
    assert visit.received(AvailableRobotCommands)[-1].mode == "continuing"
    visit.participant.begin_gesture("shake", visit.now_s)
    visit.tick(round(100 * GESTURE_DURATION_S) + 20)
    assert visit.received(AvailableRobotCommands)[-1].mode == "backing_off"
    visit.run_until("questionnaire")
    assert visit.received(AvailableRobotCommands)[-1].commands == []
    press(visit, "ready")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recording,) = visit.recordings()
    records = [record for _, record in recording.messages_by_topic["/robot_commands"]]
    assert [(each.name, each.source, each.had_effect, bool(each.refusal_reason)) for each in records] == [
        ("slower", "key", True, False),
        ("faster", "key", False, True),
        ("ready", "switch", False, True),
        ("ready", "caregiver", True, False),
        ("wait", "shake", True, False),
        ("ready", "key", False, True),
    ]
    assert events(recording).count("command_ignored") == 3
    ignored = [each for each in visit.observed if isinstance(each, read_session_events.CommandIgnored)]
    assert [each.reason for each in ignored][-1] == "no trial runs"
    pacing = [record for _, record in recording.messages_by_topic["/pacing"]]
    assert [record.step for record in pacing] == list(range(1, STEPS + 1))
    assert pacing[-1].speed_factor == 0.75
    assert recording.configuration.trial_rules == visit.session.plan.trials[0].rules
    found = verify_recording(recording)
    assert (found.num_identical_states, found.num_identical_steps) == (found.num_states, STEPS)


def test_the_command_stop_is_the_emergency_stop_from_every_source(tmp_path: Path) -> None:
    visit = visit_at_waiting_pose(tmp_path)
    visit.send(RobotCommand("stop", "switch", 0.0))
    assert visit.phase == "paused"
    visit.leave()
    (recording,) = visit.recordings()
    assert result(recording) == "stopped"
    assert [record.name for _, record in recording.messages_by_topic["/robot_commands"]] == ["stop"]
    assert is_emergency_stop(RobotCommand("stop", "switch", 0.0))
    assert not is_emergency_stop(RobotCommand("ready", "switch", 0.0))


@pytest.mark.parametrize("change", [{"name": "jump"}, {"source": "nod"}, {"source": "experimenter"}])
def test_unknown_commands_and_sources_of_others_are_refused(change: dict[str, str]) -> None:
    sent = msgspec.msgpack.decode(encode_message(RobotCommand("ready", "key", 0.0)))
    with pytest.raises(msgspec.DecodeError, match="Invalid enum value"):
        decode_participant_message(msgspec.msgpack.encode(sent | change))


def test_a_participant_changes_their_preferences_between_trials(tmp_path: Path) -> None:
    """Answers that contradict the condition are not possible. The change applies from the next trial on."""
    condition = ConditionRules(
        policy="drive",
        commands=("wait", "stop"),
        sources=("key",),
        preferences=True,
        defaults=Preferences(bite_timing="after_swallowing", speed=0.8),
    )
    rules = apply_preferences(condition, None)
    session = plan(seeds=(1, 2))
    own = [replace(each, rules=rules, allow_preference_changes=True) for each in session.trials]
    visit = Visit(
        tmp_path, replace(session, trials=[own[0], replace(own[1], allow_preference_changes=False)])
    )
    visit.send(PreferenceChangeRequest())
    assert visit.problems[-1] == "You cannot change now how the robot helps."
    visit.calibrate()
    visit.confirms = False
    visit.run_until("check")
    assert visit.received(PhaseDescription)[-1].preferences
    visit.send(PreferenceChangeRequest())
    assert [each.item for each in asked(visit, 3, 5, 1)] == ["speed", "distance_m", "side", "bite_timing"]
    last = visit.received(Question)[-1]
    assert (last.labels, last.previous_answer) == (["by itself after a pause", "by itself when I face it"], 1)
    assert [each.item for each in asked(visit, 2, 3, 2)[-2:]] == ["pause_s", "force_share"]
    assert visit.phase == "ready"
    assert "waits 30 cm away from you, on your left" in visit.received(PhaseDescription)[-1].text
    changed = Preferences(
        speed=0.8, distance_m=0.3, side="left", bite_timing="with_company", pause_s=8.0, force_share=0.2
    )
    assert [each.rules and each.rules.preferences for each in visit.session.plan.trials] == [
        changed,
        rules.preferences,
    ]
    (event,) = [each for each in visit.observed if isinstance(each, read_session_events.PreferencesChanged)]
    assert event.preferences == changed
    visit.leave()


def asked(visit: Visit, *answers: int) -> list[Question]:
    """Answer the questions so far. Returns all questions, with the next one."""
    for answer in answers:
        visit.send(Answer(visit.received(Question)[-1].item, answer, 1.0))
    return visit.received(Question)
