"""Stop rules: symptoms pause or end the session, and the experimenter sees the reason."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.questionnaires.stop_rules import StopDecision
from avrgym.recording.reader import read_recording
from avrgym.study.checking.study_checks import check_study
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    ExperimenterCommand,
    ParticipantReady,
    PhaseDescription,
    Problem,
    SentMessage,
    SessionStatus,
)
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.vr.visit import Visit

NAUSEA = '{ id = "nausea", text = "How sick do you feel?", points = 4, low = "not at all", high = "very" }'
TABLES = f"""
[[questionnaires]]
name = "symptoms"
when = ["before_session", "after_trial"]
items = [{NAUSEA}]

[[stop_rules]]
item = "nausea"
at_least = 3
then = "pause"

[[stop_rules]]
item = "nausea"
at_least = 4
then = "end"
"""
WHY = "'How sick do you feel?' was answered '3 of 4'; the limit of its stop rule is 3"
FIRST_RULE = (read_default_design_text() + TABLES).split("[[stop_rules]]")[0].count("\n") + 1


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    changes = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "practice_policy": '""'}
    folder = make_study(tmp_path / "study", trial_steps="3", free_movement_s="0.1", **changes)
    with open(folder / "study.toml", "a") as file:
        file.write(TABLES)
    with StudyStore(folder) as opened:
        yield opened


# The design


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ('"nausea"\nat', '"sickness"\nat', 1, "unknown name 'sickness'; allowed: L1, L2, L3, L4, nausea"),
        (
            "at_least = 3",
            "at_least = 5",
            2,
            "at_least = 5 is out of range for nausea; allowed: above 1, at most 4",
        ),
        (
            "at_least = 3",
            "at_least = 1",
            2,
            "at_least = 1 is out of range for nausea; allowed: above 1, at most 4",
        ),
        ('then = "pause"', 'then = "stop"', 3, "unknown value 'stop'; allowed: pause, end"),
        ('then = "pause"', 'then = "pause"\nof = 3', 4, "unknown name 'of'; allowed: item, at_least, then"),
    ],
)
def test_error_of_an_invalid_rule_has_its_line(old: str, new: str, line: int, words: str) -> None:
    text = read_default_design_text() + TABLES.replace(old, new, 1)
    with pytest.raises(DesignError, match=rf"study\.toml:{FIRST_RULE + line}: {re.escape(words)}"):
        parse_design(text)


def test_strongest_met_rule_applies() -> None:
    rules = parse_design(read_default_design_text() + TABLES).stop_rule_set
    then = [rules.decide("nausea", value) for value in (1, 2, 3, 4)]
    assert then[:3] == [None, None, StopDecision("pause", WHY)]
    assert then[3] is not None
    assert then[3].action == "end"
    assert rules.decide("L1", 7) is None


def test_rules_use_the_scale_of_the_instrument() -> None:
    used = '\n[[questionnaires]]\nuse = "ssq"\nwhen = "after_trial"\n'
    rule = '\n[[stop_rules]]\nitem = "ssq_nausea"\nat_least = 2\nthen = "pause"\n'
    rules = parse_design(read_default_design_text() + used + rule).stop_rule_set
    assert rules.decide("ssq_nausea", 2) is None
    decision = rules.decide("ssq_nausea", 3)
    assert decision == StopDecision(
        "pause", "'Nausea' was answered 'moderate'; the limit of its stop rule is 2"
    )


# In VR


def attend(visit: StudyVisit) -> Visit:
    plan = replace(visit.plan_remaining_trials(), countdown_s=0.1)
    return Visit(Path(), plan, make=lambda send: visit.create_session(plan, send))


def rate(attended: Visit, nausea: int) -> None:
    """Run the next trial and answer its questions."""
    attended.run_until("questionnaire")
    attended.answer(5, 5, 5, 5, nausea)
    attended.tick(25)


def told(attended: Visit) -> list[str]:
    return [each.message for each in attended.received(Problem) if each.role == "experimenter"]


@pytest.mark.slow
def test_symptoms_pause_the_session(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        rate(attended, nausea=3)
        attended.run_until("paused")
        assert told(attended) == [f"the session pauses: {WHY}"]
        status: SessionStatus = attended.received(SessionStatus)[-1]
        assert (status.paused, status.pause_reason) == (True, WHY)
        words: PhaseDescription = attended.received(PhaseDescription)[-1]
        assert "take a break" in words.text
        assert "sick" not in words.text
        attended.tick(300)
        assert attended.phase == "paused"
        attended.send(ExperimenterCommand(name="continue"))
        rate(attended, nausea=2)
        assert attended.phase == "finished"
    assert store.read_participant(pseudonym).state == "completed"
    assert [attempt.state for attempt in store.read_attempts(pseudonym)] == ["completed", "completed"]
    (met,) = [event for event in store.read_events() if event.name == "stop rule met"]
    assert met.detail == f"then pause, why {WHY}"
    recording = read_recording(store.resolve_path(store.read_attempts(pseudonym)[0].recording))
    assert WHY in [event.detail for _, event in recording.messages_by_topic["/events"]]
    assert not [finding for finding in check_study(store) if finding.is_error]


def test_stronger_symptoms_end_the_session(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        rate(attended, nausea=4)
        assert attended.phase == "finished"
        assert told(attended)[0].startswith("the session ends: 'How sick do you feel?' was answered '4 of 4'")
    assert [attempt.state for attempt in store.read_attempts(pseudonym)] == ["completed"]
    assert len(store.read_remaining_trials(pseudonym)) == 1
    assert store.read_participant(pseudonym).state == "allocated"


# Before the session


@pytest.mark.parametrize(("nausea", "runs"), [(2, True), (3, True), (4, False)])
def test_symptoms_before_the_session_pause_or_end_it(store: StudyStore, nausea: int, runs: bool) -> None:
    pseudonym, heard = enrol_with_consent(store), list[SentMessage]()
    sessions = StudySessions(store, heard.append, first=pseudonym)
    sessions.receive(Answer(item="nausea", value=nausea, response_time_s=1.0), 0.0)
    sessions.receive(ParticipantReady(), 0.0)
    for tick in range(30):
        sessions.tick(tick * TICK_S)
    problems = [each.message for each in heard if isinstance(each, Problem)]
    assert (sessions.running_participant == pseudonym) is runs
    assert len(problems) == (nausea > 2)
    if runs:
        status = [each for each in heard if isinstance(each, SessionStatus)][-1]
        assert (status.paused, status.pause_reason) == (nausea == 3, WHY if nausea == 3 else "")
    assert [event.name for event in store.read_events()].count("stop rule met") == (nausea > 2)
    sessions.close(1.0)
