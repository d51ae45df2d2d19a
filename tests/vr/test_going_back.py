"""Answers can be changed until they are confirmed; the last answer counts."""

from pathlib import Path

import pytest

from avrgym.recording.reader import Recording
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ParticipantDisconnected,
    ParticipantReady,
    PreviousQuestionRequest,
    Question,
    VrLeft,
)
from avrgym.vr.session.events import AnswerChanged, Answered
from helpers.vr.visit import Visit, plan


@pytest.fixture
def asked(tmp_path: Path) -> Visit:
    """Somebody who has moved on to the first question, and confirms nothing by themselves."""
    visit = Visit(tmp_path, plan(seeds=(3, 4)))
    visit.go_to("questionnaire")
    visit.confirms = False
    return visit


def recorded(recording: Recording) -> list[tuple[str, int]]:
    return [(answer.item, answer.value) for _, answer in recording.messages_by_topic["/answers"]]


def test_answers_are_changed_until_they_are_confirmed(asked: Visit) -> None:
    asked.send(PreviousQuestionRequest())
    assert "no earlier question" in asked.problems[-1]
    asked.answer(1, 2)
    asked.send(PreviousQuestionRequest())
    question: Question = asked.received(Question)[-1]
    assert (question.item, question.number, question.previous_answer) == ("L2", 2, 2)
    asked.answer(5, 3, 4)
    assert asked.phase == "confirm"
    asked.send(PreviousQuestionRequest(), PreviousQuestionRequest())
    assert (asked.phase, asked.received(Question)[-1].item) == ("questionnaire", "L3")
    asked.answer(3, 6)  # the first as before
    changed = [each.answer for each in asked.observed if isinstance(each, AnswerChanged)]
    assert [(each.item, each.value) for each in changed] == [("L2", 5), ("L4", 6)]
    assert sum(isinstance(each, Answered) for each in asked.observed) == 6
    asked.send(ParticipantReady())
    asked.run_until("ready")
    asked.tick(200)
    assert (asked.phase, asked.session.trial_index) == ("ready", 1)
    first = asked.recordings()[0]
    assert first.is_complete
    assert recorded(first) == [("L1", 1), ("L2", 2), ("L2", 5), ("L3", 3), ("L4", 4), ("L4", 6)]
    asked.leave()


@pytest.mark.parametrize(
    ("how", "phase"),
    [
        (VrLeft(), "waiting"),
        (ParticipantDisconnected(), "waiting"),
        (ExperimenterCommand("skip"), "ready"),
        (ExperimenterCommand("end"), "finished"),
    ],
    ids=["left", "disconnected", "skip", "end"],
)
def test_who_does_not_confirm_loses_nothing(
    asked: Visit, how: VrLeft | ParticipantDisconnected | ExperimenterCommand, phase: str
) -> None:
    asked.answer(1, 2, 3, 4)
    asked.send(how)
    asked.tick()
    assert asked.phase == phase
    (recording,) = asked.recordings()
    assert recording.outcome is not None
    assert (recording.outcome.result, len(recorded(recording))) == ("completed", 4)
    asked.leave()


def test_who_repeats_a_trial_gives_its_answers_anew(asked: Visit) -> None:
    asked.answer(1, 2, 3, 4)
    asked.send(ExperimenterCommand("repeat"))
    assert asked.recordings()[0].outcome is not None
    asked.confirms = True
    asked.run_until("questionnaire")
    assert asked.received(Question)[-1].previous_answer is None
    asked.leave()


def test_no_trial_begins_before_its_participant_is_ready(tmp_path: Path) -> None:
    """After practice too; what the trial is about is read before it begins."""
    visit = Visit(tmp_path, plan(seeds=(3, 4), practice=True))
    visit.go_to("trial")
    visit.confirms = False
    visit.run_until("ready")
    visit.tick(300)
    assert (visit.phase, len(visit.session.recordings)) == ("ready", 1)
    visit.send(ParticipantReady())
    visit.run_until("trial")
    visit.leave()
