"""Laws of demonstration sessions: episodes with other people, marks and counts, recordings that replay bit by bit."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from avrgym.learning.lerobot_dataset import PARQUET_FILE
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.vr.demonstration.dataset import write_lerobot_dataset
from avrgym.vr.demonstration.episode_worlds import DemonstrationPlan
from avrgym.vr.demonstration.session import DemonstrationSession
from avrgym.vr.demonstration.simulated_session import record_simulated_demonstrations
from avrgym.vr.demonstration.storage import RECORDINGS_FOLDER, DemonstrationFolder, EpisodeRow
from avrgym.vr.protocol.messages import (
    TICK_S,
    ControllerPoseCommand,
    DemonstrationButton,
    DemonstrationCommand,
    DemonstrationProgress,
    DemonstratorDisconnected,
    Message,
    Problem,
    Scene,
    VelocityCommand,
    XRPose,
)
from avrgym.vr.session.world_preparation import ImmediateExecutor

ENVIRONMENT = "avrgym/FeedingJaco-v1"


def row(episode: int, **changes: object) -> EpisodeRow:
    values: dict[str, object] = {
        **{"episode": episode, "attempt": 1, "recording": "r.mcap", "environment": ENVIRONMENT},
        **{"people": "revised", "impairment": "none", "sample": episode, "seed": 1, "sex": "man"},
        **{"torso_height_m": 0.6, "result": "completed", "success": True, "task_success": True, "steps": 5},
        **{"driven_by": "demonstrator"},
    }
    return EpisodeRow(**{**values, **changes})  # type: ignore[arg-type]


def test_a_folder_is_continued_and_counts_marks(tmp_path: Path) -> None:
    folder = DemonstrationFolder(tmp_path / "d", ENVIRONMENT)
    for each in (row(1), row(2, success=False), row(3, result="discarded", success=False)):
        folder.append_episode(each)
    again = DemonstrationFolder(tmp_path / "d", ENVIRONMENT)
    assert (again.count_episodes("completed"), again.count_episodes("completed", success=True)) == (2, 1)
    assert (again.count_episodes("discarded"), again.num_samples) == (1, 4)


def test_a_folder_with_other_contents_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="contains other files; give --out an empty or new folder"):
        DemonstrationFolder(tmp_path, ENVIRONMENT)
    DemonstrationFolder(tmp_path / "d", ENVIRONMENT).append_episode(row(1))
    with pytest.raises(ValueError, match="demonstrations of avrgym/FeedingJaco-v1; give --out another"):
        DemonstrationFolder(tmp_path / "d", "avrgym/FeedingPR2-v1")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d", "notes.txt"]


@pytest.mark.parametrize(
    "wrong", [{"population_names": ("nobody",)}, {"environment": "avrgym/No-v1"}, {"impairment": "no"}]
)
def test_unknown_names_are_refused_with_the_allowed_ones(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="allowed"):
        DemonstrationPlan(**{"environment": ENVIRONMENT, **wrong})  # type: ignore[arg-type]


@pytest.mark.slow
def test_buttons_start_discard_and_end_episodes_with_other_people(tmp_path: Path) -> None:
    received: list[Message] = []
    folder = DemonstrationFolder(tmp_path, ENVIRONMENT)
    plan = DemonstrationPlan(ENVIRONMENT, ("zoo/train", "participants"), episodes=1, steps=3)
    session = DemonstrationSession(plan, folder, received.append, ImmediateExecutor())
    now_s = 0.0

    def press(button: DemonstrationButton, ticks: int) -> None:
        nonlocal now_s
        session.receive(DemonstrationCommand(button), now_s)
        for _ in range(ticks):
            now_s += TICK_S
            session.tick(now_s)

    press("success", 5)
    assert (session.stage, folder.episode_rows) == ("ready", [])
    press("start", 15)
    press("discard", 5)
    assert session.stage == "ready"
    press("start", 12)
    press("success", 20)
    assert session.stage == "finished"
    session.close(now_s)
    assert [
        (each["episode"], each["attempt"], each["result"], each["success"]) for each in folder.episode_rows
    ] == [
        ("1", "1", "discarded", "False"),
        ("1", "2", "completed", "True"),
    ]
    assert [each["people"] for each in folder.episode_rows] == ["zoo/train", "participants"]
    assert len([message for message in received if isinstance(message, Scene)]) == 2
    progress = [message for message in received if isinstance(message, DemonstrationProgress)][-1]
    assert (progress.stage, progress.completed, progress.successes, progress.discarded) == (
        "finished",
        1,
        1,
        1,
    )
    for each, result in zip(folder.episode_rows, ("repeated", "completed"), strict=True):
        recording = read_recording(tmp_path / each["recording"])
        assert recording.outcome is not None
        assert recording.outcome.result == result
        assert verify_recording(recording).is_identical
    assert write_lerobot_dataset(tmp_path, tmp_path / "dataset") == []
    frames = pd.read_parquet(tmp_path / "dataset" / "data" / PARQUET_FILE)
    control = [step for _, step in recording.messages_by_topic["/control"]]
    np.testing.assert_array_equal(
        np.stack([*frames["action"]]), np.array([step.action for step in control], np.float32)
    )
    (about,) = pd.read_parquet(tmp_path / "dataset" / "meta" / "episodes" / PARQUET_FILE).to_dict("records")
    assert (about["demonstration/attempt"], about["length"]) == ("2", len(control))


def test_folders_that_cannot_be_exported_are_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"contains no demonstrations\.csv; allowed: a folder of `avrgym demonstrate`"
    ):
        write_lerobot_dataset(tmp_path, tmp_path / "out")
    folder = DemonstrationFolder(tmp_path / "d", ENVIRONMENT)
    folder.append_episode(row(1, success=False))
    with pytest.raises(ValueError, match="no completed episode with a success mark; press A or Success"):
        write_lerobot_dataset(tmp_path / "d", tmp_path / "out")
    folder.append_episode(row(2))
    with pytest.raises(ValueError, match=r"no recording can be read: r\.mcap: .*; restore a backup"):
        write_lerobot_dataset(tmp_path / "d", tmp_path / "out")
    assert [each.name for each in tmp_path.iterdir()] == ["d"]


@pytest.mark.slow
def test_one_person_drives_and_after_they_leave_the_robot_holds_and_the_episode_is_stored(
    tmp_path: Path,
) -> None:
    received: list[Message] = []
    folder = DemonstrationFolder(tmp_path, ENVIRONMENT)
    plan = DemonstrationPlan(ENVIRONMENT, episodes=1, steps=5)
    session = DemonstrationSession(plan, folder, received.append, ImmediateExecutor())
    level = XRPose((0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    steer = ControllerPoseCommand(clutch=True, grip=level, xr_from_world=level, scale=1.0)
    drive = VelocityCommand(engaged=True, linear=(0.0, 0.0, 1.0), angular=(0.0, 0.0, 0.0))
    leaves = DemonstratorDisconnected()
    (tmp_path / RECORDINGS_FOLDER).touch()
    session.receive(DemonstrationCommand("start"), 0.0)
    assert session.stage == "ready"
    (tmp_path / RECORDINGS_FOLDER).unlink()
    session.receive(DemonstrationCommand("start"), 0.0)
    for tick in range(1, 60):
        for message in {5: [steer, drive], 15: [leaves], 25: [drive]}.get(tick, []):
            session.receive(message, tick * TICK_S)
        session.tick(tick * TICK_S)
    session.close(0.6)
    problems = [(each.role, each.message) for each in received if isinstance(each, Problem)]
    assert problems[0][1].startswith("the episode cannot be recorded: ")
    assert problems[1:] == [("experimenter", "the demonstrator drives the robot; wait until they release it")]
    (only,) = folder.episode_rows
    assert (only["result"], only["success"], only["driven_by"]) == ("completed", "False", "operator")
    recording = read_recording(tmp_path / only["recording"])
    names = [event.name for _, event in recording.messages_by_topic["/events"]]
    assert [name for name in names if name.startswith("driver_")] == ["driver_left", "driver_stale"]
    control = [(step.driver, step.idle) for _, step in recording.messages_by_topic["/control"]]
    assert control == [
        ("demonstrator", False),
        ("demonstrator", True),
        ("operator", False),
        ("operator", False),
        ("operator", True),
    ]
    assert verify_recording(recording).is_identical


@pytest.mark.slow
def test_a_simulated_demonstrator_succeeds_with_a_headsets_messages(tmp_path: Path) -> None:
    folder = DemonstrationFolder(tmp_path, ENVIRONMENT)
    plan = DemonstrationPlan(ENVIRONMENT, ("participants",), episodes=1)
    session = DemonstrationSession(
        plan, folder, lambda message: None, ImmediateExecutor(), driven_by="simulated"
    )
    record_simulated_demonstrations(session, seed=0)
    (only,) = folder.episode_rows
    assert (only["success"], only["task_success"], only["driven_by"]) == ("True", "True", "simulated")
    recording = read_recording(tmp_path / only["recording"])
    control = [step for _, step in recording.messages_by_topic["/control"]]
    assert {step.driver for step in control[1:]} <= {"demonstrator", "operator"}
    assert sum(step.driver == "demonstrator" for step in control) > 0.8 * len(control)
    assert np.abs([step.action for step in control]).max() <= 1.0
    assert verify_recording(recording).is_identical
