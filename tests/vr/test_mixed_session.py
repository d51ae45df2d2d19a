"""Sessions of several environments: the experimenter's commands and the observer's events."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from avrgym.models import human
from avrgym.models.human import SEATED_POSE_RAD
from avrgym.tasks.constants import PAPER_ENVIRONMENTS
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, find_environment
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant
from avrgym.vr.live_world.arm_contact import ArmContactMonitor
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ExperimenterCommandName,
    HapticAndAudioFeedback,
    NextScene,
    ParticipantDisconnected,
    ParticipantReady,
    RecalibrationRequest,
    Scene,
    SceneLoaded,
    SessionStatus,
    TorsoHeightCorrection,
    VrEntered,
    VrLeft,
    WorldState,
)
from avrgym.vr.protocol.state_encoding import StateDecoder, StateEncoder
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session import trial_worlds
from avrgym.vr.session.plan import SessionPlan, plan_trials_with_practice
from avrgym.vr.session.session import Session
from helpers.simulation.initial_states import HAND_AT_ROBOT_RAD
from helpers.vr.visit import Visit, constant_policies, plan

FEEDING, SCRATCHING = "avrgym/FeedingJaco-v1", "avrgym/ScratchItchPR2-v1"


def attend(visit: Visit) -> None:
    """Complete a session: calibrate and answer all questions."""
    for _ in range(10_000):
        if visit.phase == "finished":
            return
        if visit.phase == "questionnaire":
            visit.answer(4, 4, 4, 4)
        elif visit.phase == "calibration":
            visit.tick(60)
            visit.send(ParticipantReady())
        visit.tick()
    raise AssertionError(f"still in {visit.phase}; problems: {visit.problems}")


def command(visit: Visit, name: ExperimenterCommandName) -> None:
    visit.send(ExperimenterCommand(name=name))


def happened(visit: Visit, kind: type) -> list:
    return [event for event in visit.observed if isinstance(event, kind)]


# Several environments ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_session_goes_through_all_environments(visit: Callable[..., Visit]) -> None:
    """Each recording is of its environment; the body keeps its size; a new posture is calibrated."""
    session = visit(environments=list(PAPER_ENVIRONMENTS), seeds=range(8), practice=True)
    session.send(VrEntered())
    attend(session)
    assert not session.problems
    recorded = session.recordings()
    assert [recording.configuration.environment for recording in recorded] == list(PAPER_ENVIRONMENTS)
    assert all(recording.is_complete for recording in recorded)
    sizes = {recording.configuration.person.torso_height_m for recording in recorded}
    assert sizes == {session.session.person.torso_height_m}
    lying = [environment.startswith("avrgym/BedBathing") for environment in PAPER_ENVIRONMENTS]
    changes = 1 + sum(a != b for a, b in pairwise(lying))
    assert session.phases.count("calibration") == changes
    assert [calibrated.measured for calibrated in happened(session, read_session_events.Calibrated)] == [
        True, *[False] * (changes - 1)
    ]  # fmt: skip
    check_states_fit_their_scenes(session)


def check_states_fit_their_scenes(session: Visit) -> None:
    """A connection sends states as changes and restarts at each scene. Their rows are constant between scenes."""
    encoder, decoder, rows = StateEncoder(), StateDecoder(), 0
    for message in session.inbox:
        if isinstance(message, Scene):
            rows = len(message.bodies) + message.marks
            encoder.reset()
            decoder.reset()
        elif isinstance(message, WorldState) and rows:
            assert len(decoder.decode(encoder.encode(message)).poses) == rows * 7 * 4


def test_the_next_scene_is_told_while_the_participant_answers(visit: Callable[..., Visit]) -> None:
    session = visit(environments=(FEEDING, SCRATCHING), seeds=(1, 2))
    session.go_to("questionnaire")
    (upcoming,) = session.received(NextScene)
    number = int(upcoming.url.removeprefix("/scenes/").removesuffix(".glb"))
    environment, person, _ = session.session.scenes[number]
    assert environment == SCRATCHING
    assert person.torso_height_m == session.session.person.torso_height_m
    assert session.received(Scene)[-1].url != upcoming.url
    session.answer(4, 4, 4, 4)
    session.tick(2)
    assert session.received(Scene)[-1].url == upcoming.url


def test_no_trial_begins_before_its_scene_is_shown(visit: Callable[..., Visit]) -> None:
    session = visit(environments=(FEEDING, SCRATCHING), seeds=(1, 2))
    session.go_to("questionnaire")
    session.loads_scenes = False
    session.answer(4, 4, 4, 4)
    session.tick(50)
    assert session.phase == "loading"
    session.send(SceneLoaded(url="/scenes/0.glb"))
    session.tick()
    assert session.phase == "loading"
    session.send(SceneLoaded(url=session.received(Scene)[-1].url))
    session.tick()
    assert session.phase == "ready"
    session.send(ParticipantReady())
    session.tick()
    assert session.phase == "free_before"


def test_time_never_jumps_back_between_worlds(visit: Callable[..., Visit]) -> None:
    session = visit(environments=(FEEDING, SCRATCHING), seeds=(1, 2))
    session.send(VrEntered())
    attend(session)
    for number in (lambda state: state.simulation_time_s, lambda state: state.sequence_number):
        told = [number(state) for state in session.received(WorldState)]
        assert told == sorted(set(told))


class Later(Executor):
    """Compiles nothing until released, as a slow machine would."""

    def __init__(self) -> None:
        self._waiting: list = []

    def submit(self, fn, /, *args, **kwargs) -> Future:
        future: Future = Future()
        self._waiting.append((future, fn, args))
        return future

    def work(self) -> None:
        for future, fn, args in self._waiting:
            if not future.cancelled():
                future.set_result(fn(*args))
        self._waiting.clear()


def test_the_session_ticks_on_while_a_world_is_made(tmp_path: Path) -> None:
    visit, workers = Visit(tmp_path, plan()), Later()
    visit.session = Session(
        plan(), constant_policies(plan()), tmp_path, visit.inbox.append, "slow", workers=workers
    )
    visit.calibrate()
    states = len(visit.received(WorldState))
    visit.tick(100)
    assert visit.phase == "loading"
    assert len(visit.received(WorldState)) == states + 100
    workers.work()
    visit.run_until("free_before")
    visit.leave()


def test_a_world_that_cannot_be_made_is_named_and_tried_again(
    visit: Callable[..., Visit], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = visit()
    with monkeypatch.context() as broken:
        broken.setattr(LiveWorld, "reset", lambda self, seed: 1 / 0)
        session.calibrate()
        session.run_until("paused")
        assert "cannot be created" in session.problems[-1]
    session.send(ParticipantReady())
    session.run_until("trial")


@pytest.mark.slow
def test_no_world_begins_with_the_robot_in_the_participant(visit: Callable[..., Visit]) -> None:
    """A hand that lies where the robot's arm is mounted is named; the trial goes on once the arms rest."""
    session = visit(seeds=(3, 4), free_movement_s=2.0)
    session.calibrate()
    session.pose_rad = HAND_AT_ROBOT_RAD
    session.run_until("questionnaire")
    session.answer(4, 4, 4, 4)
    session.run_until("paused")
    assert "the robot has no collision-free start" in session.problems[-1]
    assert "the person's right" in session.problems[-1]
    session.pose_rad = SEATED_POSE_RAD
    session.tick(300)
    session.send(ParticipantReady())
    session.run_until("trial")
    assert session.session.trial_index == 1


def test_a_session_may_begin_with_a_later_trial(tmp_path: Path) -> None:
    trials = plan_trials_with_practice([FEEDING, SCRATCHING], "drive", trials=1, seed=7)
    assert [(t.environment, t.seed, t.practice) for t in trials] == [
        (FEEDING, 7, True), (FEEDING, 8, False), (SCRATCHING, 9, True), (SCRATCHING, 10, False)
    ]  # fmt: skip
    late = SessionPlan(
        trials, "woman", 0.1, is_simulated=True, trial_steps=2, countdown_s=0.1, first_trial_number=3
    )
    visit = Visit(tmp_path, late)
    visit.send(VrEntered())
    attend(visit)
    assert [path.name for path in visit.session.recordings] == [
        "trial-03_attempt-1.mcap", "trial-04_attempt-1.mcap"
    ]  # fmt: skip
    with pytest.raises(ValueError, match="allowed: 1 to 4"):
        SessionPlan(trials, "woman", 0.1, is_simulated=True, first_trial_number=5)


# The observer ------------------------------------------------------------------------------------------------


def test_the_observer_is_told_all_in_order(visit: Callable[..., Visit]) -> None:
    session = visit(seeds=(1,))
    session.session.send_initial_state(session.inbox.append, "participant", 0.0)
    session.go_to("questionnaire")
    session.answer(7, 6, 5, 4)
    names = [
        type(each).__name__
        for each in session.observed
        if not isinstance(each, read_session_events.PhaseEntered)
    ]
    assert [name for name in names if name != "HeadsetUsed"] == [
        "ConnectionFound", "Calibrated", "TrialBegun", *["Answered"] * 4, "TrialEnded"
    ]  # fmt: skip
    entered = [each.phase for each in happened(session, read_session_events.PhaseEntered)]
    assert entered == session.phases[1:]
    times = [each.time_s for each in session.observed]
    assert times == sorted(times)
    assert [(each.answer.item, each.answer.value) for each in happened(session, read_session_events.Answered)] == [
        ("L1", 7), ("L2", 6), ("L3", 5), ("L4", 4)
    ]  # fmt: skip
    (ended,) = happened(session, read_session_events.TrialEnded)
    assert (ended.result, ended.complete, ended.steps, ended.attempt) == ("completed", True, 3, 1)
    assert ended.recording == session.session.recordings[0]


def test_the_observer_is_told_of_losses(visit: Callable[..., Visit]) -> None:
    session = visit(free_movement_s=1.0)
    session.go_to("free_before")
    session.tracking = False
    session.tick(40)
    session.tracking = True
    session.tick(10)
    session.send(ParticipantDisconnected())
    names = [type(each).__name__ for each in session.observed]
    assert names.count("TrackingLost") == names.count("TrackingFound") == names.count("ConnectionLost") == 1
    assert happened(session, read_session_events.TrialEnded)[0].result == "interrupted"


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    "kind", [read_session_events.TrialBegun, read_session_events.Answered, read_session_events.TrialEnded]
)
def test_what_an_observer_cannot_keep_is_repeated(tmp_path: Path, kind: type) -> None:
    """A study's database that fails costs the attempt, never a wrong entry."""
    failures = [1]

    def fail_once(event: read_session_events.SessionEvent) -> None:
        if isinstance(event, kind) and failures:
            failures.pop()
            raise OSError("the database is gone")

    visit = Visit(tmp_path, plan())
    visit.session = Session(
        plan(), constant_policies(plan()), tmp_path / "again", visit.inbox.append, "x", observe=fail_once
    )
    visit.calibrate()
    for _ in range(2000):
        if visit.phase == "questionnaire":
            visit.answer(4)
        visit.tick()
        if visit.phase in ("paused", "finished"):
            break
    assert visit.phase == "paused"
    assert "the database is gone" in visit.problems[-1]
    visit.send(ParticipantReady())
    attend(visit)
    assert len(visit.session.recordings) == 2
    visit.leave()


# The experimenter --------------------------------------------------------------------------------------------


def test_the_experimenter_stops_the_robot(visit: Callable[..., Visit]) -> None:
    session = visit()
    session.go_to("trial")
    command(session, "stop")
    assert session.phase == "paused"
    assert [each.by for each in happened(session, read_session_events.Stopped)] == ["experimenter"]
    session.send(ParticipantReady())
    session.run_until("trial")


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    "phase", ["check", "free_before", "countdown", "trial", "free_after", "questionnaire"]
)
def test_while_the_experimenter_pauses_no_trial_begins(visit: Callable[..., Visit], phase: str) -> None:
    session = visit(seeds=(1, 2))
    session.go_to(phase)
    session.confirms = True
    command(session, "pause")
    session.tick(30)
    if session.phase == "questionnaire":
        session.answer(4, 4, 4, 4)
    session.tick(30)
    assert session.phase == "paused"
    assert session.received(SessionStatus)[-1].paused
    session.send(ParticipantReady())
    assert session.phase == "paused"
    assert "experimenter" in session.problems[-1]
    command(session, "continue")
    session.run_until("trial")
    running = phase in ("free_before", "countdown", "trial")
    ended = happened(session, read_session_events.TrialEnded)
    assert [each.result for each in ended] == (
        ["paused"] if running else [] if phase == "check" else ["completed"]
    )


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("phase", ["check", "free_before", "trial", "questionnaire", "paused"])
def test_a_trial_is_repeated_or_skipped(visit: Callable[..., Visit], phase: str) -> None:
    session = visit(seeds=(1, 2))
    session.go_to(phase)
    session.confirms = True
    command(session, "repeat")
    session.run_until("trial")
    first = session.session.recordings
    assert {path.name[:8] for path in first} == {"trial-01"}
    command(session, "skip")
    session.run_until("trial")
    assert session.session.recordings[-1].name == "trial-02_attempt-1.mcap"
    assert [each.trial for each in happened(session, read_session_events.TrialSkipped)] == [1]
    command(session, "skip")
    assert session.phase == "finished"
    results = [each.result for each in happened(session, read_session_events.TrialEnded)]
    assert results[-2:] == ["skipped", "skipped"]
    assert "completed" not in results


def test_the_experimenter_ends_the_session_once(visit: Callable[..., Visit]) -> None:
    session = visit(seeds=(1, 2))
    session.go_to("trial")
    command(session, "end")
    assert session.phase == "finished"
    assert session.recordings()[0].outcome is not None
    names: tuple[ExperimenterCommandName, ...] = (
        "end",
        "pause",
        "repeat",
        "skip",
        "recalibrate",
        "stop",
        "continue",
    )
    for name in names:
        problems = len(session.problems)
        command(session, name)
        assert session.phase == "finished"
        assert len(session.problems) == problems + 1


@pytest.mark.parametrize("who", ["participant", "experimenter"])
def test_a_wrong_measure_is_taken_again(visit: Callable[..., Visit], who: str) -> None:
    session = visit()
    session.go_to("check")
    measured_m = session.session.person.torso_height_m
    taller = replace(session.participant.traits, torso_height_m=0.60)
    session.participant = SimulatedParticipant(taller, 3)
    session.send(RecalibrationRequest() if who == "participant" else ExperimenterCommand(name="recalibrate"))
    assert session.phase == "calibration"
    session.tracking = False
    for number in range(10_000, 10_020):
        frame = session.participant.make_tracking_frame(session.now_s, moving=False)
        session.send(msgspec.structs.replace(frame, sequence=number))
        session.tick()
    session.send(ParticipantReady())
    session.run_until("check")
    assert session.session.person.torso_height_m == pytest.approx(0.60, abs=0.005)
    assert session.session.person.torso_height_m != measured_m


def test_who_comes_back_keeps_their_torso_height(visit: Callable[..., Visit]) -> None:
    session = visit()
    session.go_to("trial")
    height_m = session.session.person.torso_height_m
    session.send(VrLeft())
    session.calibrate()
    session.run_until("trial")
    assert session.session.person.torso_height_m == height_m
    assert [each.measured for each in happened(session, read_session_events.Calibrated)] == [True, False]


@pytest.mark.parametrize("phase", ["waiting", "calibration", "check", "trial", "questionnaire"])
@pytest.mark.fast_cases(2)
def test_a_torso_height_is_corrected(visit: Callable[..., Visit], phase: str) -> None:
    """A trial whose questions are open counts: the next one has the corrected height."""
    session = visit(seeds=(3, 4))
    session.go_to(phase)
    session.send(TorsoHeightCorrection(torso_height_m=0.61))
    if phase == "questionnaire":
        session.answer(4, 4, 4, 4)
    if phase == "waiting":
        session.send(VrEntered())
    if phase in ("waiting", "calibration"):
        session.tick(60)
        session.send(ParticipantReady())
    session.confirms = True
    session.run_until("trial")
    session.leave()
    assert session.recordings()[-1].configuration.person.torso_height_m == 0.61
    assert session.received(SessionStatus)[-1].torso_height_m == 0.61


@pytest.mark.parametrize("height_m", [0.0, -1.0, 2.0, float("nan"), float("inf")])
def test_a_torso_height_that_nobody_has_is_refused(visit: Callable[..., Visit], height_m: float) -> None:
    session = visit()
    session.go_to("trial")
    before = session.session.person
    session.send(TorsoHeightCorrection(torso_height_m=height_m))
    assert session.phase == "trial"
    assert session.session.person is before
    assert "torso height" in session.problems[-1]


# Feedback ----------------------------------------------------------------------------------------------------


def test_touches_are_felt_on_the_arm_that_is_touched() -> None:
    """The tool is put onto one hand after the other."""
    world = LiveWorld(FEEDING, human.Person())
    touch, simulation = ArmContactMonitor(world.simulation), world.simulation
    assert touch.detect_touched_arms() == (False, False)
    model = simulation.batch.get_model(0)
    base = model.body("robot/" + world.scene_config.robot.base).id
    body_pos, _ = simulation.batch.expand("body_pos"), None
    for side, felt in (("left", (True, False)), ("right", (False, True))):
        poses = dict(zip(simulation.bodies, simulation.get_body_poses(0), strict=True))
        body_pos[0, base] += poses[f"person/{side}_hand"][:3] - poses["robot/tool"][:3]
        simulation.batch.forward([0])
        assert touch.detect_touched_arms() == felt


def test_feedback_is_told_when_something_changes(visit: Callable[..., Visit], monkeypatch) -> None:
    session = visit()
    session.go_to("free_before")
    told = len(session.received(HapticAndAudioFeedback))
    with monkeypatch.context() as touched:
        touched.setattr(ArmContactMonitor, "detect_touched_arms", lambda self: (True, False))
        session.tick(40)
    session.tick(40)
    assert session.received(HapticAndAudioFeedback)[told:] == [
        HapticAndAudioFeedback(True, False, 0),
        HapticAndAudioFeedback(False, False, 0),
    ]


def test_scenes_are_shared_by_trials_that_look_alike(visit: Callable[..., Visit]) -> None:
    session = visit(environments=(FEEDING, SCRATCHING), seeds=range(4))
    session.send(VrEntered())
    attend(session)
    assert [environment for environment, *_ in session.session.scenes] == [FEEDING, FEEDING, SCRATCHING]


def test_people_rest_as_their_task_finds_them() -> None:
    person = human.Person("man", 0.6)
    for environment in ENVIRONMENTS:
        resting = trial_worlds.make_resting_person(environment, person)
        pose = TASKS[find_environment(environment)[0]].pose_distribution
        assert np.array_equal(resting.joint_angles_rad, pose.rest_angles_rad)
        assert (resting.sex, resting.torso_height_m) == ("man", 0.6)
