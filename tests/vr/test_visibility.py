"""The robot holds still while the participant does not see the scene or is not tracked; they continue themselves."""

from collections.abc import Callable
from typing import get_args

import numpy as np
import pytest

from avrgym.replay.verification import verify_recording
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.live_world.world import BRAKING_TICKS
from avrgym.vr.protocol.messages import (
    TICK_S,
    ExperimenterCommand,
    ExperimenterCommandName,
    ParticipantReady,
    PhaseDescription,
    SessionStatus,
    Stop,
    TrackingFrameMessage,
    Visibility,
    VisibilityChanged,
)
from avrgym.vr.server.inbox import MAX_MESSAGES_PER_TICK, Inbox
from avrgym.vr.session import events as read_session_events
from avrgym.vr.tracking.tracking_frames import STALE_POSE_AGE_S
from helpers.vr.visit import ENVIRONMENT, FRAME_EVERY_TICKS, Visit, events, result

UNSEEN = [visibility for visibility in get_args(Visibility) if visibility != "visible"]
VISIBLE = VisibilityChanged("visible")


def speed_m_s(visit: Visit) -> float:
    return float(np.linalg.norm(visit.session.world.simulation.get_state().tool_velocity_w))


# Before and while the robot helps ----------------------------------------------------------------------------


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("visibility", UNSEEN)
@pytest.mark.parametrize("phase", ["free_before", "countdown", "trial"])
def test_the_robot_holds_when_its_participant_no_longer_sees_the_scene(
    visit: Callable[..., Visit], phase: str, visibility: Visibility
) -> None:
    blocked = visit(
        free_movement_s=3.0 if phase == "free_before" else 0.1,
        countdown_s=3.0 if phase == "countdown" else 0.1,
        trial_steps=50,
    )
    blocked.go_to(phase)
    blocked.send(VisibilityChanged(visibility))
    assert blocked.phase == "paused"
    blocked.tick(10)
    assert speed_m_s(blocked) < 0.01
    (recording,) = blocked.recordings()
    assert result(recording) == "interrupted"
    assert events(recording)[-2:] == ["visibility_lost", "robot_holds"]
    (lost,) = (each for each in blocked.observed if isinstance(each, read_session_events.VisibilityLost))
    assert lost.visibility == visibility
    assert "does not see the scene" in blocked.problems[-1]
    assert "the trial is repeated" in blocked.problems[-1]
    blocked.tick(20)
    assert blocked.received(SessionStatus)[-1].visibility == visibility


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("visibility", UNSEEN)
def test_who_sees_the_scene_again_repeats_the_trial_with_the_trigger(
    visit: Callable[..., Visit], visibility: Visibility
) -> None:
    blocked = visit(trial_steps=5)
    blocked.go_to("trial")
    blocked.send(VisibilityChanged(visibility), ParticipantReady())
    blocked.tick(50)
    assert blocked.phase == "paused"
    blocked.send(VISIBLE)
    blocked.tick(200)
    assert blocked.phase == "paused"
    assert len(blocked.session.recordings) == 1
    assert any(isinstance(each, read_session_events.VisibilityFound) for each in blocked.observed)
    blocked.send(ParticipantReady())
    blocked.run_until("questionnaire")
    blocked.answer(4, 4, 4, 4)
    assert [result(each) for each in blocked.recordings()] == ["interrupted", "completed"]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", ["continue", "repeat", "skip"])
def test_the_experimenter_begins_no_trial_in_their_place(
    visit: Callable[..., Visit], name: ExperimenterCommandName
) -> None:
    blocked = visit(seeds=(3, 4, 5), trial_steps=50)
    blocked.go_to("trial")
    blocked.confirms = False
    blocked.send(VisibilityChanged("hidden"), ExperimenterCommand(name=name))
    blocked.tick(50)
    assert blocked.phase == "paused"
    blocked.send(VISIBLE, ExperimenterCommand(name=name))
    blocked.tick(200)
    assert blocked.phase in ("paused", "ready")
    assert len(blocked.session.recordings) == 1


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("phase", ["check", "ready"])
@pytest.mark.parametrize("visibility", UNSEEN)
def test_no_trial_begins_while_they_do_not_see_the_scene(
    visit: Callable[..., Visit], visibility: Visibility, phase: str
) -> None:
    blocked = visit(seeds=(3, 4))
    blocked.calibrate()
    blocked.confirms = False
    blocked.run_until("check")
    if phase == "ready":
        blocked.send(ExperimenterCommand(name="skip"))
        blocked.run_until("ready")
    blocked.send(VisibilityChanged(visibility))
    for _ in range(3):
        blocked.send(ParticipantReady())
        blocked.tick(50)
    assert blocked.phase == "paused"
    assert "You do not see the scene" in blocked.received(PhaseDescription)[-1].text
    assert blocked.session.recordings == []


def test_a_menu_that_opens_while_the_scene_loads_begins_no_trial(visit: Callable[..., Visit]) -> None:
    blocked = visit(trial_steps=50)
    blocked.go_to("trial")
    blocked.send(Stop())
    blocked.confirms = blocked.loads_scenes = False
    blocked.send(ParticipantReady(), VisibilityChanged("visible-blurred"), VISIBLE)
    blocked.loads_scenes = True
    blocked.tick(300)
    assert blocked.phase == "ready"
    assert len(blocked.session.recordings) == 1


def test_a_new_connection_sees_the_scene_until_it_reports_otherwise(visit: Callable[..., Visit]) -> None:
    back = visit()
    back.send(VisibilityChanged("hidden"))
    back.session.send_initial_state(back.inbox.append, "participant", back.now_s)
    back.calibrate()
    back.run_until("trial")


# Once it has finished ----------------------------------------------------------------------------------------


def test_a_retreat_is_held_and_what_the_robot_gave_is_kept(visit: Callable[..., Visit]) -> None:
    finished = visit()
    finished.go_to("retreat")
    finished.tick(BRAKING_TICKS)
    finished.send(VisibilityChanged("visible-blurred"))
    assert finished.phase == "free_after"
    finished.tick(10)
    assert speed_m_s(finished) < 0.01
    finished.run_until("questionnaire")
    finished.send(VISIBLE)
    finished.answer(4, 4, 4, 4)
    (recording,) = finished.recordings()
    assert result(recording) == "completed"
    assert {"visibility_lost", "visibility_found"} <= set(events(recording))
    assert verify_recording(recording).is_identical


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("phase", ["free_after", "questionnaire"])
def test_afterwards_nothing_is_lost(visit: Callable[..., Visit], phase: str) -> None:
    finished = visit(free_movement_s=1.0)
    finished.go_to(phase)
    finished.send(VisibilityChanged("hidden"), VISIBLE)
    assert finished.phase == phase
    finished.run_until("questionnaire")
    finished.answer(4, 4, 4, 4)
    (recording,) = finished.recordings()
    assert result(recording) == "completed"
    assert "visibility_lost" in events(recording)


def test_who_takes_off_the_headset_at_the_end_troubles_nobody(visit: Callable[..., Visit]) -> None:
    over = visit()
    over.go_to("finished")
    before = len(over.problems)
    over.send(VisibilityChanged("hidden"))
    assert len(over.problems) == before


# While frames are stale --------------------------------------------------------------------------------------


FEW = pytest.param(ENVIRONMENT)
OTHERS = [pytest.param(each, marks=pytest.mark.slow) for each in ENVIRONMENTS if each != ENVIRONMENT]


@pytest.mark.parametrize("environment", [FEW, *OTHERS])
def test_the_robot_holds_within_a_tick_once_tracking_is_stale_and_goes_on_with_it(
    visit: Callable[..., Visit], environment: str
) -> None:
    away = visit(trial_steps=20, environments=(environment,))
    away.participant.adopt_posture(environment)
    away.go_to("trial")
    away.tick(FRAME_EVERY_TICKS - away._ticks % FRAME_EVERY_TICKS + 1)
    away.tracking = False
    ticks = 0
    while away.session.world._loop.is_moving:
        away.tick()
        ticks += 1
    print(f"\nthe robot holds {ticks * TICK_S:.2f} s after the last frame")
    assert (
        ticks * TICK_S <= STALE_POSE_AGE_S + 2 * TICK_S
    )  # the last frame came in the tick before the first of these
    driven_m_s = speed_m_s(away)
    away.tick(30)
    assert speed_m_s(away) < 0.1 * driven_m_s
    assert away.phase == "trial"
    away.tracking = True
    away.tick(15)
    assert speed_m_s(away) > 0.2 * driven_m_s
    away.run_until("questionnaire")
    away.answer(4, 4, 4, 4)
    (recording,) = away.recordings()
    assert result(recording) == "completed"
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    idle = [step for step in steps if step.idle]
    assert len(idle) >= 3
    assert not any(any(step.action) for step in idle)
    assert verify_recording(recording).is_identical


def way_to_rest_m(stopping: Visit, lose: Callable[[Visit], None]) -> float:
    """The distance that the tool of a robot at full speed travels after the tick in which the robot is held."""
    stopping.go_to("trial")
    stopping.tick(FRAME_EVERY_TICKS * 20 - stopping._ticks % FRAME_EVERY_TICKS + 1)
    stopping.tracking = False
    stopping.tick(round(STALE_POSE_AGE_S / TICK_S) - 1)
    assert speed_m_s(stopping) > 0.1
    lose(stopping)
    simulation = stopping.session.world.simulation
    places_w = [simulation.get_state().tool_pos_w[0].copy()]
    for _ in range(30):
        stopping.tick()
        places_w.append(simulation.get_state().tool_pos_w[0].copy())
    assert speed_m_s(stopping) < 0.005
    return float(np.linalg.norm(np.diff(places_w, axis=0), axis=1).sum())


@pytest.mark.parametrize("environment", [FEW, *OTHERS])
def test_stale_tracking_stops_the_robot_as_its_brakes_do(
    visit: Callable[..., Visit], environment: str
) -> None:
    """In free motion at full speed; a stop of the participant is the measure."""

    def stop(stopping: Visit) -> None:
        stopping.send(Stop())

    def wait(stopping: Visit) -> None:
        while not stopping.session.world._loop.is_braked:
            stopping.tick()

    def in_posture() -> Visit:
        stopping = visit(trial_steps=60, environments=(environment,))
        stopping.participant.adopt_posture(environment)
        return stopping

    stopped, stale = (way_to_rest_m(in_posture(), lose) for lose in (stop, wait))
    print(f"\nstopped after {1000 * stopped:.1f} mm, with stale tracking after {1000 * stale:.1f} mm")
    assert stale < stopped + 0.003


# On its way through the server -------------------------------------------------------------------------------


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("visibility", UNSEEN)
def test_nothing_that_waits_delays_it(visibility: Visibility) -> None:
    inbox, lost = Inbox(), VisibilityChanged(visibility)
    for number in range(5 * MAX_MESSAGES_PER_TICK):
        inbox.put(TrackingFrameMessage(number, 0.0, None, None, None, "none", "none"))
    inbox.put(VISIBLE)
    inbox.put(lost)
    assert inbox.get() == lost
    taken = []
    while (message := inbox.get()) is not None:
        taken.append(message)
    assert [each for each in taken if isinstance(each, VisibilityChanged)] == [VISIBLE, lost]
