"""Sessions over several days: breaks, the limit of the time in VR, and the same order afterwards."""

from dataclasses import replace
from pathlib import Path
from statistics import fmean

import pytest

from avrgym.analysis.report import write_report
from avrgym.analysis.study_analysis import analyse_study
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.study.sessions.dry_run import simulate_study
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.answers import AFTER_BREAK_MOMENT, find_answer_moments
from avrgym.study.storage.session_summary import summarise_sessions
from avrgym.study.storage.sessions import record_session_event
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    BreakRequest,
    ExperimenterCommand,
    ParticipantReady,
    Problem,
    Question,
    SessionStatus,
)
from avrgym.vr.session import events
from avrgym.vr.session.headset_time import HeadsetTime, SessionRules
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.vr.visit import Visit, plan

DESIGN = {
    "tasks": '["ScratchItch"]',
    "robots": '["Jaco"]',
    "trial_steps": "3",
    "free_movement_s": "0.1",
}
FATIGUE = """\
[[questionnaires]]
name = "fatigue"
when = "after_break"
items = [{ id = "fatigue", text = "How tired are you?", points = 11, low = "not at all", high = "extremely" }]

[goals]"""


@pytest.fixture(autouse=True)
def sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


def study_with_rules(folder: Path, break_every_minutes: float, max_headset_minutes: float) -> Path:
    rules = {"break_every_minutes": str(break_every_minutes), "max_headset_minutes": str(max_headset_minutes)}
    make_study(folder, **DESIGN, **rules)
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("[goals]", FATIGUE, 1))
    return folder


@pytest.mark.slow
def test_a_dry_run_goes_over_several_sessions(tmp_path: Path) -> None:
    """The trials keep their order; each session ends after the trial in which the limit is reached."""
    limited = study_with_rules(tmp_path / "limited", 0.1, 0.2)
    simulate_study(limited, participants=1, seed=3, jobs=1)
    with StudyStore(limited) as store:
        (name,) = (each.pseudonym for each in store.read_participants())
        assert store.read_participant(name).state == "completed"
        sessions = store.read_sessions(name)
        completed = {
            each.trial: each.session for each in store.read_attempts(name) if each.state == "completed"
        }
        assert len(sessions) > 1
        assert {each.state for each in sessions} == {"closed"}
        assert list(completed) == [trial.id for trial in store.read_trials(name)]
        assert list(completed.values()) == sorted(completed.values())
        assert set(completed.values()) == {each.id for each in sessions}
        summaries = summarise_sessions(store, name)
        assert all(each.minutes >= 0.2 for each in summaries[:-1])
        assert sum(each.trials for each in summaries) == len(completed)
        names = [each.name for each in store.read_events()]
        answers = store.read_answers(name)
        moments = find_answer_moments(store.design, answers, store.read_events())
        after_breaks = [each for each in answers if moments[each.id] == AFTER_BREAK_MOMENT]
        assert 0 < len(after_breaks) <= names.count("break begun") == names.count("break ended")
        assert sum(each.breaks for each in summaries) == names.count("break begun")
        assert {each.item for each in after_breaks} == {"fatigue"}
        analysis = analyse_study(store)
    assert [(row.day, row.breaks, row.trials) for row in analysis.sessions] == [
        (1, each.breaks, each.trials) for each in summaries
    ]
    (summary,) = [row for row in analysis.session_answers if row.moment == AFTER_BREAK_MOMENT]
    assert (summary.item, summary.n) == ("fatigue", 1)
    assert summary.mean == pytest.approx(fmean(each.value for each in after_breaks), abs=0.01)
    write_report(tmp_path / "report.html", analysis, [], "")
    report = (tmp_path / "report.html").read_text()
    assert "asked after breaks" in report
    assert "day 1 is the day of" in report


@pytest.mark.slow
def test_a_limit_below_one_trial_is_refused(tmp_path: Path) -> None:
    folder = study_with_rules(tmp_path / "study", 0.0, 0.01)
    with pytest.raises(StudyError, match=r"max_headset_minutes = 0\.01"):
        simulate_study(folder, participants=1, seed=3, jobs=1)


def test_an_interrupted_session_counts_towards_the_limit(tmp_path: Path) -> None:
    folder = study_with_rules(tmp_path / "study", 0.0, 10.0)
    with StudyStore(folder) as store:
        name = enrol_with_consent(store)
        for seconds in (100.0, 200.0):
            with StudyVisit(store, name, take_over=True) as visit:
                record_session_event(store, visit.stored_session.id, "headset used", f"seconds {seconds}")
                visit.end_session = lambda: visit.storage_queue.submit(lambda: None)  # the program dies
        with StudyVisit(store, name, take_over=True) as visit:
            assert visit.headset_time.total_s == 300.0
        with StudyVisit(store, name) as visit:
            assert visit.headset_time.total_s == 0.0  # another day


def test_breaks_are_due_by_time_and_on_request() -> None:
    time = HeadsetTime(SessionRules(break_every_minutes=1.0, max_headset_minutes=10.0))
    time.add_time(59.0)
    assert not time.is_break_due
    time.request_break()
    assert time.is_break_due
    time.begin_break()
    assert not time.is_break_due
    time.add_time(120.0)  # in the break
    time.end_break()
    assert not time.is_break_due
    assert (time.pop_warning(), time.is_limit_reached) == ("", False)
    time.add_time(130.0)
    assert time.is_break_due
    assert "5 min of 10 min" in time.pop_warning()
    assert time.pop_warning() == ""
    time.add_time(300.0)
    assert time.is_limit_reached
    assert time.pop_unstored_time_s() == time.total_s
    assert time.pop_unstored_time_s() == 0.0


@pytest.fixture
def visit(tmp_path: Path) -> Visit:
    """Two trials with a question after breaks."""
    return Visit(tmp_path, replace(plan(seeds=(3, 4)), break_items=LIKERT_ITEMS[:1]))


def test_a_break_on_request_is_followed_by_its_questions(visit: Visit) -> None:
    visit.go_to("check")
    visit.send(BreakRequest())
    assert visit.phase == "break"
    visit.tick(200)
    assert visit.phase == "break"
    visit.send(ParticipantReady())
    assert visit.phase == "questionnaire"
    asked: Question = visit.received(Question)[-1]
    assert asked.item == "L1"
    visit.answer(9)
    assert "not accepted" in "".join(visit.problems)
    visit.answer(6)
    given = [each.answer for each in visit.observed if isinstance(each, events.AnsweredAfterBreak)]
    assert [(each.item, each.value) for each in given] == [("L1", 6)]
    visit.confirms = True
    visit.run_until("trial")
    visit.send(BreakRequest())
    assert visit.phase == "trial"
    assert "break before the next trial" in visit.problems[-1]
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    assert visit.phase == "break"
    visit.leave()


def test_no_trial_begins_after_the_limit(tmp_path: Path) -> None:
    limited = replace(plan(seeds=(3, 4)), session_rules=SessionRules(max_headset_minutes=0.03))
    visit = Visit(tmp_path, limited)
    visit.go_to("questionnaire")
    visit.tick(200)
    visit.answer(1, 2, 3, 4)
    assert visit.phase == "finished"
    assert "another day" in visit.session._message.text
    assert len(visit.session.recordings) == 1
    visit.tick(30)
    status: SessionStatus = visit.received(SessionStatus)[-1]
    assert status.headset_s > 0.03 * 60.0
    assert status.headset_limit_s == pytest.approx(1.8)
    assert any("of 0.03 min" in each.message for each in visit.received(Problem))
    used = [each.seconds for each in visit.observed if isinstance(each, events.HeadsetUsed)]
    assert sum(used) == pytest.approx(visit.session._state.headset_time.total_s, abs=0.5)
    visit.leave()


def test_an_experimenter_requests_a_break(visit: Visit) -> None:
    visit.go_to("questionnaire")
    visit.send(ExperimenterCommand("break"))
    visit.answer(1, 2, 3, 4)
    assert visit.phase == "break"
    visit.send(ExperimenterCommand("pause"), ParticipantReady())
    visit.answer(5)
    visit.run_until("paused")
    visit.leave()
