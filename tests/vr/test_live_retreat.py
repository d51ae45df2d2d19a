"""Retreat after a trial in a session: it is recorded, can be stopped, and is not part of the trial."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from avrgym.recording.reader import Recording
from avrgym.replay.verification import verify_recording
from avrgym.safety.retreat import MAX_RETREAT_DURATION_S
from avrgym.vr.live_world.world import BRAKING_TICKS
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ParticipantMessage,
    Question,
    Stop,
    WatcherMessage,
)
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.vr.visit import ENVIRONMENT, Visit, plan

STEPS = 110
"""By then the spoon is in the mouth."""


def helping(folder: Path) -> Visit:
    """A visit in whose only trial a trained robot has just fed the participant."""
    session: SessionPlan = replace(
        plan(trial_steps=STEPS),
        trials=[TrialPlan(ENVIRONMENT, "revised", 3, practice=False)],
        withdraw_tool_after_success=False,
    )
    visit = Visit(folder, session, load_policies(session))
    visit.calibrate()
    visit.run_until("retreat")
    return visit


def far_m(visit: Visit) -> float:
    """How far the tool is from the head's centre."""
    state = visit.session.world.simulation.get_state()
    return float(np.linalg.norm(state.tool_pos_w - state.head_pos_w))


def speed_m_s(visit: Visit) -> float:
    return float(np.linalg.norm(visit.session.world.simulation.get_state().tool_velocity_w))


def ended(visit: Visit) -> Recording:
    """The recording, after all questions."""
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recording,) = visit.recordings()
    assert recording.outcome is not None
    assert (recording.is_complete, recording.outcome.result, recording.outcome.steps) == (
        True,
        "completed",
        STEPS,
    )
    return recording


@pytest.mark.slow
def test_the_tool_is_away_before_questions_come_and_replay_takes_it_away_alike(tmp_path: Path) -> None:
    visit = helping(tmp_path)
    assert far_m(visit) < 0.2
    assert not visit.received(Question)
    visit.run_until("free_after", limit_s=MAX_RETREAT_DURATION_S + 0.5)
    assert far_m(visit) > 0.3
    recording = ended(visit)
    assert len(recording.messages_by_topic["/control"]) == STEPS
    assert len(recording.messages_by_topic["/commands"]) > STEPS + 20
    found = verify_recording(recording)
    assert found.num_identical_states == found.num_states
    assert found.num_identical_steps == found.num_steps == STEPS


@pytest.mark.slow
@pytest.mark.parametrize("told", [Stop(), ExperimenterCommand(name="pause")], ids=str)
def test_a_retreat_can_be_stopped_and_the_trial_counts(
    tmp_path: Path, told: ParticipantMessage | WatcherMessage
) -> None:
    visit = helping(tmp_path)
    visit.tick(BRAKING_TICKS + 100)
    assert speed_m_s(visit) > 0.05
    visit.send(told)
    assert visit.phase == "free_after"
    visit.tick(10)
    assert speed_m_s(visit) < 0.005
    stopped = [event for event in visit.observed if isinstance(event, events.Stopped)]
    assert len(stopped) == (told != ExperimenterCommand(name="pause"))
    found = verify_recording(ended(visit))
    assert found.is_identical


@pytest.mark.slow
def test_a_retreat_waits_for_tracking_and_goes_on(tmp_path: Path) -> None:
    visit = helping(tmp_path)
    visit.tick(BRAKING_TICKS + 50)
    visit.tracking = False
    visit.tick(40)
    assert speed_m_s(visit) < 0.01
    assert visit.phase == "retreat"
    visit.tracking = True
    visit.run_until("free_after", limit_s=MAX_RETREAT_DURATION_S + 0.5)
    assert far_m(visit) > 0.3
    recording = ended(visit)
    assert "tracking_found" in [event.name for _, event in recording.messages_by_topic["/events"]]
    assert verify_recording(recording).is_identical


@pytest.mark.slow
def test_nobody_is_left_who_is_not_tracked(tmp_path: Path) -> None:
    """The robot holds still, as during a trial; what it gave is kept."""
    visit = helping(tmp_path)
    visit.tracking = False
    visit.run_until("free_after", limit_s=1.2)
    visit.tick(10)
    assert speed_m_s(visit) < 0.005
    visit.tracking = True
    ended(visit)
