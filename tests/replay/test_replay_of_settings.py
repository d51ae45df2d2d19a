"""Recordings contain the settings of their environment, and replay uses them."""

from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.tasks.settings import Settings
from helpers.vr.visit import Visit, plan

CHANGED = {
    "avrgym/FeedingJaco-v1": Settings(
        control_hz=50, tool="large", particles=5, table_offset_m=(0.1, 0.0, 0.0), body_mass_kg=90.0
    ),
    "avrgym/DrinkingJaco-v1": Settings(tool="mug", particles=20, standing_by=(("PR2", 1.5, -1.0, 90.0),)),
    "avrgym/ScratchItchPR2-v1": Settings(control_hz=5, robot_pose=(-0.8, -0.3, 5.0)),
}
"""Settings by environment."""


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", CHANGED)
def test_a_trial_with_settings_is_replayed_to_the_same_bits(tmp_path: Path, environment: str) -> None:
    visit = Visit(
        tmp_path, replace(plan(environments=[environment], trial_steps=4), settings=CHANGED[environment])
    )
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (path,) = visit.session.recordings
    recording = read_recording(path)
    assert recording.configuration.settings == CHANGED[environment]
    found = verify_recording(recording)
    assert found.differences == []
    assert found.num_states == found.num_identical_states == len(recording.messages_by_topic["/physics"])
    assert found.num_steps == found.num_identical_steps == 4
