"""Laws of the demonstrator: the tool follows their controller while the clutch is held, and only one person drives."""

from pathlib import Path

import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.replay.verification import verify_recording
from avrgym.vr.live_world.drivers import OPERATOR_COMMAND_TIMEOUT_S, OperatorDriver
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import (
    TICK_S,
    ControllerPoseCommand,
    DemonstratorDisconnected,
    Problem,
    SessionStatus,
    ToolForce,
    VelocityCommand,
    XRPose,
)
from avrgym.vr.protocol.webxr import Pose, Registration
from avrgym.vr.session.plan import load_policies
from helpers.vr.visit import Visit, events, plan
from vr.test_operator import UP, operated

LEVEL = (0.0, 0.0, 0.0, 1.0)
FLOOR = Registration(np.array([0.4, -1.1, 0.0]), 0.7)
"""The demonstrator's own floor in the world."""


def steer(
    pos_w: np.ndarray, *, clutch: bool = True, floor: Registration = FLOOR, scale: float = 1.0
) -> ControllerPoseCommand:
    grip = floor.from_world(Pose(np.asarray(pos_w, float), transforms.IDENTITY_QUATERNION))
    return ControllerPoseCommand(clutch=clutch, grip=grip, xr_from_world=floor.xr_from_world(), scale=scale)


def in_trial(folder: Path, steps: int = 40) -> Visit:
    visit = Visit(folder, operated(steps), load_policies(operated(steps)))
    visit.go_to("trial")
    return visit


def tool_pos_w(world: LiveWorld) -> np.ndarray:
    return world.simulation.get_body_poses(0)[world.bodies.index(SCENE_TOOL_BODY), :3].copy()


def steer_along(visit: Visit, start: np.ndarray, step: np.ndarray, ticks: int, **how: object) -> np.ndarray:
    """Move the controller by ``step`` per tick. Returns its last position."""
    for _ in range(ticks):
        start = start + step
        visit.send(steer(start, **how))  # type: ignore[arg-type]
        visit.tick()
    return start


def test_the_tool_follows_in_the_world_wherever_the_demonstrator_stands(tmp_path: Path) -> None:
    """The direction in the world counts, not that in the demonstrator's room."""
    visit = in_trial(tmp_path)
    before = tool_pos_w(visit.session.world)
    visit.send(steer(np.zeros(3)))
    steer_along(visit, np.zeros(3), np.array([0.0, -0.001, 0.0005]), 60)
    moved = tool_pos_w(visit.session.world) - before
    assert -0.08 < moved[1] < -0.02
    assert 0.005 < moved[2] < 0.04
    assert abs(moved[0]) < 0.01


def test_a_pressed_clutch_and_a_moved_viewpoint_do_not_move_the_tool(tmp_path: Path) -> None:
    visit = in_trial(tmp_path)
    before = tool_pos_w(visit.session.world)
    elsewhere = Registration(np.array([-1.0, 0.5, 0.0]), -2.0)
    for pos_w, floor in ((np.zeros(3), FLOOR), (np.ones(3), FLOOR), (np.ones(3), elsewhere)):
        visit.send(steer(pos_w, clutch=floor is elsewhere, floor=floor), steer(pos_w, floor=floor))
        visit.tick(10)
    assert np.linalg.norm(tool_pos_w(visit.session.world) - before) < 2e-3


def test_without_fresh_poses_the_robot_holds_and_continues_without_a_jump(tmp_path: Path) -> None:
    visit = in_trial(tmp_path)
    visit.send(steer(np.zeros(3)))
    end = steer_along(visit, np.zeros(3), np.array([0.0, -0.002, 0.0]), 30)
    visit.tick(round(OPERATOR_COMMAND_TIMEOUT_S / TICK_S) + 2)
    driver = visit.session._state.driver
    assert isinstance(driver, OperatorDriver)
    assert driver.is_idle
    held = tool_pos_w(visit.session.world)
    visit.send(steer(end + 0.5))
    visit.tick(10)
    assert np.linalg.norm(tool_pos_w(visit.session.world) - held) < 5e-3
    lost = ControllerPoseCommand(clutch=True, grip=None, xr_from_world=FLOOR.xr_from_world(), scale=1.0)
    visit.send(steer(end + 0.5), lost)
    assert driver.is_idle


def test_invalid_poses_hold_the_robot(tmp_path: Path) -> None:
    visit = in_trial(tmp_path)
    far, flat = XRPose((0.0, 1e6, 0.0), LEVEL), XRPose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    nowhere = XRPose((float("nan"), 0.0, 0.0), LEVEL)
    for grip, view in (
        (far, FLOOR.xr_from_world()),
        (flat, FLOOR.xr_from_world()),
        (XRPose((0, 1, 0), LEVEL), nowhere),
    ):
        visit.send(
            steer(np.zeros(3)), ControllerPoseCommand(clutch=True, grip=grip, xr_from_world=view, scale=1.0)
        )
        assert visit.session._state.driver.is_idle
    visit.tick(5)


def test_only_one_person_drives_and_every_step_records_who(tmp_path: Path) -> None:
    visit = in_trial(tmp_path, steps=12)
    drive = VelocityCommand(engaged=True, linear=UP, angular=(0.0, 0.0, 0.0))
    for _ in range(30):
        visit.send(steer(np.zeros(3)), drive)
        visit.tick()
    assert visit.problems == ["the demonstrator drives the robot; wait until they release it"]
    visit.send(steer(np.zeros(3), clutch=False))
    for _ in range(30):
        visit.send(drive, steer(np.zeros(3)))
        visit.tick()
    assert visit.problems[1:] == ["the operator drives the robot; wait until they release it"]
    assert [problem.role for problem in visit.received(Problem)] == ["experimenter", "demonstrator"]
    assert visit.received(SessionStatus)[-1].operated
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recording,) = visit.recordings()
    drivers = [step.driver for _, step in recording.messages_by_topic["/control"]]
    assert drivers[:3] == ["demonstrator"] * 3
    assert drivers[4:6] == ["operator"] * 2
    assert verify_recording(recording).is_identical


def test_a_demonstrator_who_leaves_in_contact_holds_the_robot(tmp_path: Path) -> None:
    visit = in_trial(tmp_path, steps=60)
    world = visit.session.world
    pos_w = np.zeros(3)
    visit.send(steer(pos_w))
    for _ in range(400):
        head = world.simulation.get_state().mouth_pos_w[0]
        to_person = head - tool_pos_w(world)
        pos_w = pos_w + 0.002 * to_person / np.linalg.norm(to_person)
        visit.send(steer(pos_w))
        visit.tick()
        if world.simulation.get_tool_net_force_n()[0] > 0.5:
            break
    assert world.simulation.get_tool_net_force_n()[0] > 0.5
    visit.send(DemonstratorDisconnected())
    visit.tick()
    assert visit.session._state.driver.is_idle
    assert "the demonstrator left and does not drive the robot any more" in " ".join(visit.problems)
    visit.tick(20)
    assert max(message.force_n for message in visit.received(ToolForce)) > 0.0
    visit.leave()
    (recording,) = visit.recordings()
    assert "driver_left" in events(recording)
    assert verify_recording(recording).is_identical


@pytest.mark.parametrize("steered", [True, False])
def test_where_a_policy_drives_the_clutch_has_no_effect(tmp_path: Path, *, steered: bool) -> None:
    visit = Visit(tmp_path, plan(trial_steps=10))
    visit.go_to("trial")
    for _ in range(20):
        visit.send(steer(np.zeros(3), clutch=steered))
        visit.tick()
    assert visit.problems == ["in this trial no operator drives the robot"] * steered
