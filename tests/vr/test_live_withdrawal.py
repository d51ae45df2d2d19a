"""Withdrawal after success in a session: it is recorded and replayed to the same bits; studies can turn it off."""

from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control
from avrgym.replay.verification import verify_recording
from avrgym.safety.force_guard import INTERVENTION_EVENT
from avrgym.safety.withdrawal import SETTLING_TIME_S, WITHDRAWAL_DRIVER, WITHDRAWAL_EVENT
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.sessions.study_visit import plan_session
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import SessionStatus
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.studies.known_results import enrol_included
from helpers.studies.small_studies import make_study
from helpers.vr.visit import ENVIRONMENT, Visit, plan

STEPS = 100
LINE = "withdraw_after_success = true\n"


def trial(folder: Path, *, withdraws: bool, policy: str = "revised") -> tuple[Recording, list[SessionStatus]]:
    """A trial in which a participant who keeps still is fed."""
    session: SessionPlan = replace(
        plan(trial_steps=STEPS),
        trials=[TrialPlan(ENVIRONMENT, policy, 3, practice=False)],
        withdraw_tool_after_success=withdraws,
    )
    visit = Visit(folder, session, load_policies(session))
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recording,) = visit.recordings()
    return recording, visit.received(SessionStatus)


def steps_of(recording: Recording) -> list[Control]:
    return [step for _, step in recording.messages_by_topic["/control"]]


def times(recording: Recording, name: str) -> list[float]:
    return [time_ns / 1e9 for time_ns, event in recording.messages_by_topic["/events"] if event.name == name]


@pytest.mark.slow
def test_the_robot_withdraws_waits_and_replays(tmp_path: Path) -> None:
    recording, statuses = trial(tmp_path, withdraws=True)
    steps = steps_of(recording)
    first = next(number for number, step in enumerate(steps) if step.success)
    drivers = [step.driver for step in steps]
    begins = drivers.index(WITHDRAWAL_DRIVER)
    assert begins > first + 10 * SETTLING_TIME_S
    assert set(drivers[:begins]) == {"revised"}
    assert set(drivers[begins:]) == {WITHDRAWAL_DRIVER}
    assert all(step.force_on_person_n == 0.0 for step in steps[begins + 20 :])
    (began_s,) = times(recording, WITHDRAWAL_EVENT)
    assert not [time_s for time_s in times(recording, INTERVENTION_EVENT) if time_s > began_s + 1.0]
    assert recording.configuration.withdraw_after_success is True
    assert {status.withdrawing for status in statuses if status.success and status.phase == "trial"} == {
        False,
        True,
    }
    assert not any(status.withdrawing for status in statuses if status.phase != "trial")
    found = verify_recording(recording)
    assert (found.num_identical_states, found.num_identical_steps) == (found.num_states, STEPS)


@pytest.mark.slow
def test_without_it_the_policy_goes_on(tmp_path: Path) -> None:
    recording, statuses = trial(tmp_path, withdraws=False)
    steps = steps_of(recording)
    assert {step.driver for step in steps} == {"revised"}
    assert any(step.success and step.force_on_person_n > 0.0 for step in steps[-40:])
    assert not times(recording, WITHDRAWAL_EVENT)
    assert recording.configuration.withdraw_after_success is False
    assert not any(status.withdrawing for status in statuses)


def test_a_robot_that_an_operator_drives_does_not_withdraw(tmp_path: Path) -> None:
    session = replace(plan(), trials=[TrialPlan(ENVIRONMENT, OPERATOR_POLICY_NAME, 3, practice=False)])
    visit = Visit(tmp_path, session, load_policies(session))
    visit.calibrate()
    visit.run_until("trial")
    assert session.withdraw_tool_after_success
    assert visit.session.world._loop.withdrawal is None


def test_new_studies_withdraw_and_those_that_do_not_say_go_on(tmp_path: Path) -> None:
    assert parse_design(read_default_design_text()).withdraw_after_success
    assert not parse_design(read_default_design_text().replace(LINE, "")).withdraw_after_success
    with pytest.raises(DesignError, match="withdraw_after_success"):
        parse_design(read_default_design_text().replace(LINE, 'withdraw_after_success = "yes"\n'))


@pytest.mark.parametrize("withdraws", [True, False])
def test_sessions_withdraw_as_the_design_says(tmp_path: Path, withdraws: bool) -> None:
    value = "true" if withdraws else "false"
    with StudyStore(make_study(tmp_path / "study", withdraw_after_success=value)) as store:
        session = plan_session(store, enrol_included(store))
    assert session.withdraw_tool_after_success == withdraws
