"""Laws of the operator: the hand follows commands within its speed limits, and only while the key is pressed."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect, sync_playwright

from avrgym.geometry.kinematics import compute_jacobian
from avrgym.models import robot
from avrgym.policies.cartesian_control import (
    HAND_ANGULAR_SPEED_LIMIT_RAD_S,
    HAND_SPEED_LIMIT_M_S,
    CartesianController,
)
from avrgym.replay.verification import verify_recording
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.episodes import Episodes
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.live_world.drivers import OPERATOR_COMMAND_TIMEOUT_S
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import (
    TICK_S,
    ParticipantReady,
    Problem,
    SceneLoaded,
    SessionStatus,
    VelocityCommand,
    VrEntered,
)
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.plan import SessionPlan, load_policies
from avrgym.vr.session.session import Session
from helpers.studies.small_studies import make_study
from helpers.vr.visit import Visit, plan

STILL = (0.0, 0.0, 0.0)
UP = (0.0, 0.0, 1.0)
RELEASED = VelocityCommand(engaged=False, linear=STILL, angular=STILL)
PATIENCE_MS = 120_000


def operated(steps: int) -> SessionPlan:
    """One trial of so many control steps that the experimenter drives."""
    planned = plan(trial_steps=steps)
    return replace(planned, trials=[replace(planned.trials[0], policy="operator")])


def in_trial(folder: Path, steps: int) -> Visit:
    visit = Visit(folder, operated(steps), load_policies(operated(steps)))
    visit.go_to("trial")
    return visit


def hand_pos_w(world: LiveWorld) -> np.ndarray:
    body = world.bodies.index(robot.ROBOT_NAME_PREFIX + world.scene_config.arm.end_effector)
    return world.simulation.get_body_poses(0)[body, :3]


@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", "avrgym/FeedingPR2-v1"])
@pytest.mark.fast_cases(1)
def test_the_hand_never_exceeds_its_limits_nor_do_the_joints(environment: str) -> None:
    """From any start, for any command, also with a nearly stretched arm."""
    episodes, rng = Episodes(environment, 1, num_threads=1), np.random.default_rng(0)
    for _ in range(4):
        episodes.reset(np.array([0]), [rng])
        hand = CartesianController(episodes.simulation)
        for _ in range(40):
            action = hand.compute_action(*rng.choice([-1.0, 0.0, 1.0], (2, 3)))
            assert np.abs(action).max() <= 1.0 + 1e-12
            j = compute_jacobian(hand.arm_chain, episodes.simulation.get_joint_positions())[2][0]
            velocity = j @ (action * episodes.scene.arm.speed_limit)
            assert np.linalg.norm(velocity[:3]) <= HAND_SPEED_LIMIT_M_S + 1e-9
            assert np.linalg.norm(velocity[3:]) <= HAND_ANGULAR_SPEED_LIMIT_RAD_S + 1e-9
            episodes.step(action[None])


@pytest.mark.parametrize(
    ("linear", "direction_w"),
    [((1.0, 0.0, 0.0), (0, -1, 0)), ((0.0, 1.0, 0.0), (1, 0, 0)), ((0.0, 0.0, 1.0), (0, 0, 1))],
)
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.fast_cases(2)
def test_the_hand_goes_where_the_operator_says(
    tmp_path: Path, linear: tuple[float, float, float], direction_w: tuple[float, float, float], way: float
) -> None:
    """Ahead of the person, to their left, up, and back again, before it meets anything."""
    visit = in_trial(tmp_path, 30)
    before = hand_pos_w(visit.session.world)
    asked = VelocityCommand(engaged=True, linear=tuple(way * share for share in linear), angular=STILL)  # type: ignore[arg-type]
    for _ in range(4):
        visit.send(asked)
        visit.tick(5)
    moved = hand_pos_w(visit.session.world) - before
    along = float(moved @ np.array(direction_w)) * way
    assert 0.01 < along < HAND_SPEED_LIMIT_M_S * 0.2
    assert np.linalg.norm(moved - along * way * np.array(direction_w)) < 0.3 * along


def test_who_lets_go_or_falls_silent_holds_the_robot_and_every_step_says_who_drove(tmp_path: Path) -> None:
    visit = in_trial(tmp_path, 20)
    for _ in range(9):
        visit.send(VelocityCommand(engaged=True, linear=UP, angular=STILL))
        visit.tick(5)
    visit.send(RELEASED)
    visit.tick(1)
    assert visit.session.world.applied_action is not None, "the very next tick tells the robot"
    assert not visit.session.world.applied_action.any()
    visit.tick(44)
    visit.send(VelocityCommand(engaged=True, linear=UP, angular=STILL))
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recording,) = visit.recordings()
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    assert {step.driver for step in steps} == {"operator"}
    assert [step.idle for step in steps[5:9]] == [True] * 4
    assert not any(step.idle for step in steps[1:4])
    driven = [time_ns for time_ns, command in recording.messages_by_topic["/commands"] if any(command.action)]
    stopped = [
        time_ns for time_ns, command in recording.messages_by_topic["/commands"] if not any(command.action)
    ]
    last = max(driven)
    assert (min(time_ns for time_ns in stopped if time_ns > last) - last) / 1e9 <= 0.1 + TICK_S
    told = min(time_ns for time_ns in driven if time_ns > stopped[1])
    assert (last - told) / 1e9 <= OPERATOR_COMMAND_TIMEOUT_S + TICK_S
    assert all(step.idle for step in steps[-5:])
    assert verify_recording(recording).is_identical


def test_who_watches_is_told_whether_somebody_drives(tmp_path: Path) -> None:
    visit = in_trial(tmp_path, 30)
    visit.tick(20)
    assert (visit.received(SessionStatus)[-1].operated, visit.received(SessionStatus)[-1].idle) == (
        True,
        True,
    )
    for _ in range(10):
        visit.send(VelocityCommand(engaged=True, linear=UP, angular=STILL))
        visit.tick(5)
    assert not visit.received(SessionStatus)[-1].idle


def test_where_a_policy_drives_nobody_else_does(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(trial_steps=10))
    visit.go_to("trial")
    visit.send(VelocityCommand(engaged=True, linear=UP, angular=STILL))
    visit.tick(20)
    (problem,) = visit.received(Problem)
    assert (problem.role, problem.message) == ("experimenter", "in this trial no operator drives the robot")
    assert visit.received(SessionStatus)[-1].operated is False


def after(world: LiveWorld, seconds: float) -> np.ndarray:
    """Where the hand is once so much more is simulated, however long that takes here."""
    until_s, give_up_s = world.time_s + seconds, time.monotonic() + PATIENCE_MS / 1000
    while world.time_s < until_s:
        assert time.monotonic() < give_up_s
        time.sleep(TICK_S)
    return hand_pos_w(world)


def is_at_rest(world: LiveWorld) -> np.ndarray:
    """Where the hand comes to rest."""
    give_up_s = time.monotonic() + PATIENCE_MS / 1000
    before, now = hand_pos_w(world), after(world, 0.3)
    while np.abs(now - before).max() > 1e-3:
        assert time.monotonic() < give_up_s
        before, now = now, after(world, 0.3)
    return now


@contextmanager
def attended(server: LiveServer[Session]) -> Iterator[None]:
    """Somebody takes part in a server's session, in this process."""
    participant, over = SimulatedParticipant(sample_participant_traits("woman", 1), 1), threading.Event()
    session, post = server.session, server.loop.post

    def attend() -> None:
        post(VrEntered())
        began_s = time.monotonic()
        while not over.wait(0.02):
            post(
                participant.make_tracking_frame(
                    time.monotonic() - began_s, moving=session.phase_name != "calibration"
                )
            )
            if session.phase_name == "loading":
                post(SceneLoaded(url=f"/scenes/{len(session.scenes) - 1}.glb"))
            if session.phase_name in ("calibration", "check") and time.monotonic() - began_s > 1.0:
                post(ParticipantReady())

    participant.adopt_posture(session.world.environment_id)
    thread = threading.Thread(target=attend)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.slow
@pytest.mark.usefixtures("relaxed_limits")
def test_an_experimenter_drives_with_the_keyboard_in_the_dashboard(tmp_path: Path) -> None:
    planned = operated(steps=3000)
    with (
        StudyStore(make_study(tmp_path / "study")) as store,
        LiveServer(
            lambda send: Session(planned, load_policies(planned), tmp_path / "recordings", send, "operated"),
            "127.0.0.1",
            0,
            study=lambda tokens, _session: make_dashboard_app(store, tokens),
        ) as server,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page()
        page.goto(server.list_page_urls("dashboard", server.tokens.experimenter)[0])
        with attended(server):
            panel, words = page.get_by_role("group", name="Drive the robot"), page.locator("#drive-words")
            expect(panel).to_be_visible(timeout=PATIENCE_MS)
            expect(words).to_have_text("The robot holds still.", timeout=PATIENCE_MS)
            world = server.session.world
            before = is_at_rest(world)
            page.keyboard.down("KeyE")
            np.testing.assert_allclose(after(world, 0.3), before, atol=1e-3)
            page.keyboard.down("Space")
            expect(words).to_have_text("You drive the robot.", timeout=PATIENCE_MS)
            page.keyboard.down("KeyK")
            while hand_pos_w(world)[2] < before[2] + 0.02:
                after(world, TICK_S)
            page.keyboard.up("Space")
            expect(words).to_have_text("The robot holds still.", timeout=PATIENCE_MS)
            assert is_at_rest(world)[2] > before[2] + 0.01
            assert server.session.phase_name == "trial", "K skips no trial while the hand is driven"
        browser.close()
