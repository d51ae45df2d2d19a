"""The force guard in a live session: it retracts the arm, records its reason, and the recording replays."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from avrgym.analysis.reading.study_data import count_guard_interventions
from avrgym.cli.main import app
from avrgym.recording.reader import Recording, read_recording
from avrgym.replay.playback import compute_region_loads
from avrgym.replay.verification import verify_recording
from avrgym.safety.force_guard import INTERVENTION_EVENT, INTERVENTION_FORCE_LIMIT_FRACTION, RELEASE_EVENT
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.tasks.registry import TASKS
from avrgym.vr.protocol.messages import SessionStatus
from helpers.vr.visit import Visit, constant_policy, plan

SCRATCHING = "avrgym/ScratchItchJaco-v1"
TOWARDS_THE_HAND = np.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0, 0.0])
"""Joint speeds with which the Jaco's arm reaches the person after one and a half seconds."""
TRIAL_STEPS = 24


class Trial(NamedTuple):
    path: Path
    recording: Recording
    statuses: list[SessionStatus]


def recorded(folder: Path, *, force_guard: bool) -> Trial:
    """A trial whose robot is driven at a person who keeps still."""
    driven = replace(constant_policy(SCRATCHING), biases=(TOWARDS_THE_HAND,))
    trial = replace(plan(environments=[SCRATCHING], trial_steps=TRIAL_STEPS), has_force_guard=force_guard)
    visit = Visit(folder, trial, {(SCRATCHING, "drive"): driven})
    visit.pose_rad = TASKS["ScratchItch"].pose_distribution.rest_angles_rad
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (path,) = visit.session.recordings
    return Trial(path, read_recording(path), visit.received(SessionStatus))


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return recorded(tmp_path_factory.mktemp("guarded"), force_guard=True)


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return recorded(tmp_path_factory.mktemp("unguarded"), force_guard=False)


def happened(trial: Trial) -> list[tuple[str, str]]:
    return [
        (event.name, event.detail)
        for _, event in trial.recording.messages_by_topic["/events"]
        if event.name in (INTERVENTION_EVENT, RELEASE_EVENT)
    ]


@pytest.mark.slow
def test_a_session_is_guarded_unless_it_says_otherwise(guarded: Trial, unguarded: Trial) -> None:
    assert plan().has_force_guard
    assert guarded.recording.configuration.force_guard is True
    assert unguarded.recording.configuration.force_guard is False


@pytest.mark.slow
def test_every_intervention_is_an_event_with_region_and_force(guarded: Trial, unguarded: Trial) -> None:
    assert happened(unguarded) == []
    found = happened(guarded)
    assert [name for name, _ in found] == [INTERVENTION_EVENT, RELEASE_EVENT] * (len(found) // 2) + [
        INTERVENTION_EVENT
    ] * (len(found) % 2)
    assert count_guard_interventions(unguarded.recording) is None
    assert (
        count_guard_interventions(guarded.recording)
        == [name for name, _ in found].count(INTERVENTION_EVENT)
        > 0
    )
    limits = {region.name: region.quasi_static_limit_n for region in BODY_REGIONS}
    for name, detail in found:
        if name == INTERVENTION_EVENT:
            region, force, unit, *_, limit, _ = detail.split()
            assert unit == "N,"
            assert float(force) > INTERVENTION_FORCE_LIMIT_FRACTION * limits[region]
            assert float(limit) == limits[region]


def test_who_watches_sees_which_region_bears_most(guarded: Trial, unguarded: Trial) -> None:
    names = [region.name for region in BODY_REGIONS]
    for trial in (guarded, unguarded):
        pressed = [status for status in trial.statuses if status.force_share]
        assert pressed
        assert all(status.force_region in names for status in pressed)
        rest = [status for status in trial.statuses if not status.force_share]
        assert {(status.force_region, status.retracting) for status in rest} <= {("", False), ("", True)}
    assert max(status.force_share for status in unguarded.statuses) > INTERVENTION_FORCE_LIMIT_FRACTION
    assert all(status.phase == "trial" for status in guarded.statuses if status.retracting)


def test_a_participant_bears_less_with_it(guarded: Trial, unguarded: Trial) -> None:
    peaks = [
        (compute_region_loads(trial.recording).peak_force_n / QUASI_STATIC_LIMIT_N).max()
        for trial in (guarded, unguarded)
    ]
    assert INTERVENTION_FORCE_LIMIT_FRACTION < peaks[0] < peaks[1]


def test_what_the_guard_makes_of_an_action_is_what_is_recorded(guarded: Trial, unguarded: Trial) -> None:
    given, asked_for = (
        [each for _, each in trial.recording.messages_by_topic["/commands"] if each.step <= TRIAL_STEPS]
        for trial in (guarded, unguarded)
    )
    control = [step for _, step in guarded.recording.messages_by_topic["/control"]]
    assert len(control) == TRIAL_STEPS < len(given)
    for step in control:
        last = [command.action for command in given if command.step == step.step][-1]
        assert_array_equal(step.action, last)
    assert len(asked_for) == TRIAL_STEPS
    asked = TOWARDS_THE_HAND.tolist()
    assert all(step.action == asked for _, step in unguarded.recording.messages_by_topic["/control"])
    assert any(step.action != asked for step in control)


def test_both_replay_bit_by_bit(guarded: Trial, unguarded: Trial) -> None:
    for trial in (guarded, unguarded):
        found = verify_recording(trial.recording)
        assert found.is_complete
        assert found.is_identical
        assert found.num_steps == TRIAL_STEPS


def test_replay_shows_forces_by_region(guarded: Trial, tmp_path: Path) -> None:
    file = tmp_path / "regions.json"
    shown = CliRunner().invoke(app, ["replay", str(guarded.path), "--regions", "--json", str(file)])
    assert shown.exit_code == 0, shown.output
    loads = compute_region_loads(guarded.recording)
    for index, region in enumerate(BODY_REGIONS):
        assert (f" {region.name} " in shown.stdout) == bool(loads.peak_force_n[0, index])
    assert f'"peak_n": {loads.peak_force_n.max()}' in file.read_text()
