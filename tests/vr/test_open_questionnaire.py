"""Once the robot has helped, the trial counts; a returning participant sees only unanswered questions."""

from collections.abc import Callable
from pathlib import Path

import pytest

from avrgym.recording import answers_file
from avrgym.recording.reader import Recording, read_recording
from avrgym.vr.protocol.messages import (
    Answer,
    ExperimenterCommand,
    OriginReset,
    ParticipantDisconnected,
    ParticipantReady,
    PhaseDescription,
    PreviousQuestionRequest,
    Question,
    VrEntered,
    VrLeft,
    Welcome,
)
from avrgym.vr.session import events
from helpers.vr.visit import Visit, plan

ITEMS = ["L1", "L2", "L3", "L4"]


def asked(folder: Path, **how) -> Visit:
    """Somebody who has given two of four answers."""
    visit = Visit(folder, plan(seeds=(3, 4), **how))
    visit.go_to("questionnaire")
    visit.answer(1, 2)
    return visit


def result(recording: Recording) -> str | None:
    return recording.outcome.result if recording.outcome else None


def recorded(recording: Recording) -> list[tuple[str, int]]:
    return [(answer.item, answer.value) for _, answer in recording.messages_by_topic["/answers"]]


def blink(visit: Visit) -> None:
    """The connection breaks, and the page comes back by itself."""
    visit.send(ParticipantDisconnected())
    visit.tick(300)
    visit.session.send_initial_state(visit.inbox.append, "participant", visit.now_s)
    visit.send(VrEntered())


def reload(visit: Visit) -> None:
    """The page is reloaded, perhaps in another browser, and nobody enters VR."""
    visit.send(ParticipantDisconnected())
    visit.session.send_initial_state(visit.inbox.append, "participant", visit.now_s)


def take_off(visit: Visit) -> None:
    visit.send(VrLeft())


def recentre(visit: Visit) -> None:
    visit.send(OriginReset())


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("happens", [blink, reload, take_off, recentre], ids=lambda each: each.__name__)
def test_only_what_is_unanswered_is_asked(tmp_path: Path, happens: Callable[[Visit], None]) -> None:
    visit = asked(tmp_path)
    phases = len(visit.phases)
    happens(visit)
    visit.tick(100)
    assert visit.phase == "questionnaire"
    question = visit.received(Question)[-1]
    assert (question.item, question.number, question.previous_answer) == ("L3", 3, None)
    visit.send(PreviousQuestionRequest())
    assert visit.received(Question)[-1].previous_answer == 2
    visit.answer(5, 3, 4)
    assert set(visit.phases[phases:]) <= {"questionnaire", "confirm", "loading", "waiting", "calibration"}
    recording = read_recording(visit.session.recordings[0])
    assert (result(recording), recording.is_complete) == ("completed", True)
    assert dict(recorded(recording)) == {"L1": 1, "L2": 5, "L3": 3, "L4": 4}
    assert [each.result for each in visit.observed if isinstance(each, events.TrialEnded)] == ["completed"]
    assert visit.session.trial_index == 1
    if happens is not blink and happens is not recentre:
        visit.tick(50)
        assert visit.phase == "waiting"
        visit.send(VrEntered())
    visit.run_until("calibration")
    visit.tick(80)
    visit.send(ParticipantReady())
    visit.run_until("questionnaire")
    visit.answer(4, 4, 4, 4)
    assert [result(each) for each in visit.recordings()] == ["completed", "completed"]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("happens", [blink, reload, take_off, recentre], ids=lambda each: each.__name__)
@pytest.mark.parametrize("phase", ["retreat", "free_after"])
def test_the_questions_come_when_somebody_goes_before_them(
    tmp_path: Path, phase: str, happens: Callable[[Visit], None]
) -> None:
    visit = Visit(tmp_path, plan(free_movement_s=1.0))
    visit.go_to(phase)
    happens(visit)
    assert visit.phase == "questionnaire"
    visit.answer(1, 2, 3, 4)
    assert visit.phase == "finished"
    assert [result(each) for each in visit.recordings()] == ["completed"]
    assert dict(recorded(visit.recordings()[0])) == dict(zip(ITEMS, (1, 2, 3, 4), strict=True))


def test_after_practice_nobody_is_asked(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(seeds=(3, 4), practice=True, free_movement_s=1.0))
    visit.go_to("free_after")
    visit.send(ParticipantDisconnected())
    visit.tick(5)
    assert (visit.phase, visit.session.trial_index) == ("waiting", 1)
    assert [result(each) for each in visit.recordings()] == ["completed"]


@pytest.mark.parametrize("phase", ["retreat", "free_after", "questionnaire"])
@pytest.mark.fast_cases(1)
def test_a_server_that_stops_completes_the_trial(tmp_path: Path, phase: str) -> None:
    visit = Visit(tmp_path, plan(free_movement_s=1.0))
    visit.go_to(phase)
    visit.leave()
    assert [result(each) for each in visit.recordings()] == ["completed"]


def test_who_skips_the_questions_goes_on_without_answers(tmp_path: Path) -> None:
    visit = asked(tmp_path)
    visit.send(ExperimenterCommand("skip"))
    visit.tick(5)
    assert visit.session.trial_index == 1
    (left,) = (each for each in visit.observed if isinstance(each, events.QuestionsLeft))
    assert left.items == ("L3", "L4")
    assert not any(isinstance(each, events.TrialSkipped) for each in visit.observed)
    assert result(read_recording(visit.session.recordings[0])) == "completed"
    visit.leave()


def test_a_complete_trial_is_not_repeated(tmp_path: Path) -> None:
    visit = asked(tmp_path)
    visit.send(VrLeft(), ExperimenterCommand("repeat"))
    assert visit.phase == "questionnaire"
    assert "the trial is complete" in visit.problems[-1]


def test_an_answer_that_cannot_be_stored_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    visit = asked(tmp_path)
    visit.send(VrLeft())

    def fail(*_: object) -> None:
        raise OSError("the disk is full")

    with monkeypatch.context() as broken:
        broken.setattr(answers_file, "append_answer", fail)
        visit.send(Answer("L3", 4, 1.0))
    assert "the disk is full" in visit.problems[-1]
    assert visit.received(Question)[-1].item == "L3"
    visit.answer(3, 4)
    assert dict(recorded(read_recording(visit.session.recordings[0]))) == dict(
        zip(ITEMS, (1, 2, 3, 4), strict=True)
    )


def test_a_page_that_comes_back_shows_the_question(tmp_path: Path) -> None:
    visit = asked(tmp_path)
    reload(visit)
    last = [type(each) for each in visit.inbox[-7:]]
    assert last[0] is Welcome
    assert last[-2:] == [PhaseDescription, Question]


def test_a_line_that_a_crash_cut_off_is_left_out(tmp_path: Path) -> None:
    recording = tmp_path / "trial.mcap"
    for value in (3, 5):
        answers_file.append_answer(recording, Answer("L1", value, 1.0))
    with open(answers_file.get_answers_path(recording), "ab") as file:
        file.write(b'{"item":"L2","val')
    assert [answer.value for answer in answers_file.read_answers(recording)] == [3, 5]
