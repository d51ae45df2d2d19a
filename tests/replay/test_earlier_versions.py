"""What earlier versions left opens, checks, verifies and goes on."""

from pathlib import Path

import pytest

from avrgym.recording.files import read_recording
from avrgym.replay.verification import verify
from avrgym.tasks.registry import TASKS, find_environment, find_task, terms_ever
from places import DATA

RECORDINGS = sorted(DATA.rglob("*.mcap"))


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_recordings_of_earlier_versions_verify(path: Path) -> None:
    found = verify(read_recording(path))
    assert found.complete
    assert found.steps > 0
    assert found.agrees


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_recordings_of_earlier_versions_keep_the_rewards_of_their_time(path: Path) -> None:
    """Terms and weights are those that this release has for that version of the world; tables have room for them."""
    recording = read_recording(path)
    task, _ = find_environment(recording.metadata["environment"])
    then = find_task(task, recording.metadata.get("world_version", 1))
    assert recording.metadata["reward_weights"] == then.weights
    for _, control in recording.topics["/control"]:
        assert set(control.reward_terms) == set(then.weights) <= terms_ever(task)
        reward = sum(weight * control.reward_terms[name] for name, weight in then.weights.items())
        assert control.reward == pytest.approx(reward)


def test_all_tasks_of_version_1_are_among_the_recordings() -> None:
    """And each judges otherwise than today's."""
    recorded = {find_environment(read_recording(path).metadata["environment"])[0] for path in RECORDINGS}
    assert recorded == set(TASKS)
    for task in TASKS:
        assert find_task(task, 1).weights != find_task(task, 2).weights
