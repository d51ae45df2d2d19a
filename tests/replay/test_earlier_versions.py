"""Recordings of earlier versions."""

from pathlib import Path

import pytest

from avrgym.recording.reader import read_recording
from avrgym.replay.playback import ReplayError
from avrgym.replay.verification import verify_recording
from avrgym.tasks.registry import TASKS, find_environment
from helpers.studies.configurations import with_configuration
from helpers.system.paths import DATA, OLD_RECORDING

RECORDINGS = sorted((DATA / "study-of-0.2.0").rglob("*.mcap"))


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_a_recording_of_an_earlier_version_verifies(path: Path) -> None:
    found = verify_recording(read_recording(path))
    assert found.is_complete
    assert found.num_steps > 0
    assert found.agrees_within_rounding


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_recorded_rewards_are_the_weighted_sum_of_their_terms(path: Path) -> None:
    recording = read_recording(path)
    task, _ = find_environment(recording.configuration.environment)
    weights = recording.configuration.reward_weights
    assert weights == TASKS[task].reward_weights
    for _, control in recording.messages_by_topic["/control"]:
        assert set(control.reward_terms) == set(weights)
        reward = sum(weight * control.reward_terms[name] for name, weight in weights.items())
        assert control.reward == pytest.approx(reward)


@pytest.mark.parametrize("version", [1, 3])
def test_a_recording_of_another_world_version_is_refused(version: int) -> None:
    recording = read_recording(OLD_RECORDING)
    other = with_configuration(recording, world_version=version)
    with pytest.raises(
        ReplayError, match=f"has version {version} of the simulated world; this release simulates"
    ):
        verify_recording(other)
