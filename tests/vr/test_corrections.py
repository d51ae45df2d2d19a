"""An operator corrects a policy in a demonstration session: takeovers, marks in the dataset, failures."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from avrgym.learning.lerobot_dataset import PARQUET_FILE
from avrgym.policies.registry import resolve_session_policy
from avrgym.recording.reader import Recording, read_recording
from avrgym.replay.verification import verify_recording
from avrgym.vr.demonstration.dataset import write_lerobot_dataset
from avrgym.vr.demonstration.episode_worlds import DemonstrationPlan
from avrgym.vr.demonstration.session import DemonstrationSession
from avrgym.vr.demonstration.simulated_session import record_simulated_demonstrations
from avrgym.vr.demonstration.storage import DemonstrationFolder
from avrgym.vr.live_world.corrected_driver import CorrectedDriver
from avrgym.vr.protocol.messages import (
    TICK_S,
    ControllerPoseCommand,
    DemonstrationCommand,
    DemonstratorDisconnected,
    Message,
    Problem,
    ReceivedMessage,
    XRPose,
)
from avrgym.vr.session.world_preparation import ImmediateExecutor

ENVIRONMENT = "avrgym/FeedingJaco-v1"
LEVEL = 0.0, 0.0, 0.0, 1.0


def steer(tick: int, *, clutch: bool = True) -> ControllerPoseCommand:
    """The controller moves up by 1 mm per tick."""
    grip = XRPose((0.0, 1.0 + 0.001 * tick, 0.0), LEVEL)
    return ControllerPoseCommand(
        clutch=clutch, grip=grip, xr_from_world=XRPose((0.0, 0.0, 0.0), LEVEL), scale=1.0
    )


def correct(folder: Path, policy: str, messages: dict[int, ReceivedMessage], steps: int) -> list[Message]:
    """Run one episode with these messages at ticks of the episode, and a success mark in its last step."""
    received: list[Message] = []
    plan = DemonstrationPlan(ENVIRONMENT, ("participants",), episodes=1, steps=steps, policy=policy)
    driver = CorrectedDriver(resolve_session_policy(policy, ENVIRONMENT), policy, background=False)
    session = DemonstrationSession(
        plan, DemonstrationFolder(folder, ENVIRONMENT), received.append, ImmediateExecutor(), driver=driver
    )
    session.receive(DemonstrationCommand("start"), 0.0)
    for tick in range(1, 10 * steps + 1):
        now_s = tick * TICK_S
        if tick in messages:
            session.receive(messages[tick], now_s)
        if tick == 10 * steps - 5:
            session.receive(DemonstrationCommand("success"), now_s)
        session.tick(now_s)
    session.close(10 * steps * TICK_S)
    return received


def recording_in(folder: Path) -> Recording:
    (row,) = DemonstrationFolder(folder, ENVIRONMENT).episode_rows
    return read_recording(folder / row["recording"])


def test_a_policy_continues_one_second_after_a_release_and_the_dataset_marks_corrections(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "d"
    steering: dict[int, ReceivedMessage] = {tick: steer(tick) for tick in range(21, 45)}
    correct(folder, "revised", {**steering, 45: steer(45, clutch=False)}, steps=20)
    recording = recording_in(folder)
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    drivers = [(step.driver, step.idle) for step in steps]
    assert drivers[:2] == [("revised", False)] * 2
    assert drivers[2:4] == [("demonstrator", False)] * 2
    paused = [step.driver == "operator" and step.idle for step in steps]
    assert paused[5:14] == [True] * 9
    assert drivers[15:] == [("revised", False)] * 5
    commands = [command for _, command in recording.messages_by_topic["/commands"] if command.step == 1]
    assert len(commands) == 1
    assert np.any(commands[0].action)
    assert recording.configuration.policy == "revised"
    assert verify_recording(recording).is_identical
    assert write_lerobot_dataset(folder, tmp_path / "data") == []
    marks = [*pd.read_parquet(tmp_path / "data" / "data" / PARQUET_FILE)["intervention"]]
    assert marks == [2 <= number < 4 for number in range(20)]


@pytest.mark.parametrize("leaving", [DemonstratorDisconnected(), None])
def test_if_the_operator_leaves_the_policy_does_not_continue(
    tmp_path: Path, leaving: ReceivedMessage | None
) -> None:
    messages: dict[int, ReceivedMessage] = {tick: steer(tick) for tick in range(11, 20)}
    if leaving is not None:
        messages[20] = leaving
    correct(tmp_path, "revised", messages, steps=20)
    recording = recording_in(tmp_path)
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    assert steps[0].driver == "revised"
    assert all(step.idle and not np.any(step.action) for step in steps[5:])
    names = {event.name for _, event in recording.messages_by_topic["/events"]}
    assert ("driver_left" if leaving else "driver_stale") in names


def broken(observation: object) -> object:
    """A policy that always fails."""
    raise ValueError("no weights")


def test_a_failing_policy_holds_the_robot_and_the_operator_can_drive(tmp_path: Path) -> None:
    steering: dict[int, ReceivedMessage] = {tick: steer(tick) for tick in range(21, 50)}
    received = correct(tmp_path, "vr.test_corrections:broken", steering, steps=5)
    problems = [message.message for message in received if isinstance(message, Problem)]
    assert any(
        "its policy failed: exception: ValueError: no weights; drive it yourself" in each for each in problems
    )
    recording = recording_in(tmp_path)
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    assert [step.idle for step in steps] == [True, True, False, False, False]
    assert np.any(steps[-1].action)
    assert "controller_failed" in {event.name for _, event in recording.messages_by_topic["/events"]}


@pytest.mark.slow
def test_a_simulated_demonstrator_corrects_a_policy_that_does_not_move(tmp_path: Path) -> None:
    plan = DemonstrationPlan(ENVIRONMENT, ("participants",), episodes=1, policy="zero")
    folder = DemonstrationFolder(tmp_path, ENVIRONMENT)
    driver = CorrectedDriver(resolve_session_policy("zero", ENVIRONMENT), "zero", background=False)
    session = DemonstrationSession(
        plan, folder, lambda message: None, ImmediateExecutor(), driver=driver, driven_by="simulated"
    )
    record_simulated_demonstrations(session, seed=0)
    recording = recording_in(tmp_path)
    drivers = [step.driver for _, step in recording.messages_by_topic["/control"]]
    assert drivers[:10] == ["zero"] * 10
    assert drivers.count("demonstrator") > 20
    assert "zero" in drivers[drivers.index("demonstrator") :]
