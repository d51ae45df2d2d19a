"""Conditions of a study with the same policy: autonomous, and paced by participants with their own preferences."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from typer.testing import CliRunner

from avrgym.analysis.commands import describe_condition, render_commands_section
from avrgym.analysis.study_analysis import analyse_study
from avrgym.cli.main import app
from avrgym.commands.preferences import Preferences
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.study.checking.study_checks import check_study
from avrgym.study.dashboard.application import PARTICIPANT_ACTIONS, Dashboard, PreferencesRequest
from avrgym.study.dashboard.displayed_data import make_displayed_participant
from avrgym.study.design.design import DesignError
from avrgym.study.people.preferences import read_latest_preferences, record_preferences
from avrgym.study.sessions.dry_run import simulate_study
from avrgym.study.sessions.study_visit import StudyVisit, plan_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.settings import Settings
from avrgym.vr.protocol.messages import Answer, PreferenceChangeRequest
from avrgym.vr.session.phases.setup_phases import make_trial_text
from avrgym.vr.session.preference_questions import PREFERENCE_QUESTIONS
from helpers.studies.known_results import enrol_included
from helpers.studies.small_studies import make_study
from helpers.vr.visit import Visit

CONDITIONS = """
[conditions.autonomous]
policy = "revised"

[conditions.participant_paced]
policy = "revised"
commands = ["ready", "wait", "slower", "faster", "stop"]
sources = ["key", "nod"]
preferences = true
"""


def study_with_conditions(folder: Path, **changes: str) -> Path:
    values = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "policies": '["autonomous", "participant_paced"]'}
    make_study(folder, practice_policy='""', **values, **changes)
    with (folder / "study.toml").open("a") as file:
        file.write(CONDITIONS)
    return folder


def test_preferences_apply_in_the_trials_of_the_conditions_that_say_so(tmp_path: Path) -> None:
    with StudyStore(study_with_conditions(tmp_path)) as store:
        pseudonym = enrol_included(store)
        record_preferences(store, pseudonym, Preferences(speed=0.5))
        record_preferences(store, pseudonym, Preferences(speed=0.75, sources=("key",), force_share=0.2))
        rules = {trial.policy: trial.rules for trial in plan_session(store, pseudonym).trials}
        assert rules["autonomous"] is None
        paced = rules["participant_paced"]
        assert paced is not None
        assert (paced.policy, paced.sources) == ("revised", ("key",))
        assert (paced.preferences.speed, paced.preferences.force_share) == (0.75, 0.2)
        with pytest.raises(
            StudyError, match="contradict the condition participant_paced: the commands do not contain stop"
        ):
            record_preferences(store, pseudonym, Preferences(commands=("ready",)))
        assert read_latest_preferences(store, pseudonym) == paced.preferences


def test_participants_read_their_preferences_before_a_trial(tmp_path: Path) -> None:
    """The text before a trial and the dashboard have the same sentences; a change on the dashboard is checked."""
    with StudyStore(study_with_conditions(tmp_path / "study")) as store:
        pseudonym = enrol_included(store)
        dashboard, act = Dashboard(store, None), PARTICIPANT_ACTIONS["preferences"][1]
        act(dashboard, pseudonym, PreferencesRequest(["speed=0.5", "side=left"]))
        with pytest.raises(StudyError, match="speed"):
            act(dashboard, pseudonym, PreferencesRequest(["speed=9"]))
        shown = make_displayed_participant(store, pseudonym)
        assert "50%" in shown.preferences_words
        assert "on your left" in shown.preferences_words
        planned = plan_session(store, pseudonym)
        texts = {
            trial.policy: make_trial_text(
                "ready",
                cast("Any", SimpleNamespace(plan=planned, current_trial=trial, trial_index=0)),
                with_preferences=True,
            )
            for trial in planned.trials
        }
        assert shown.preferences_words in str(texts["participant_paced"].placeholder_values["goal"])
        assert "speed" not in str(texts["autonomous"].placeholder_values["goal"])


def test_a_change_by_the_participant_is_stored_for_later_sessions(tmp_path: Path) -> None:
    with StudyStore(
        study_with_conditions(tmp_path / "study", trial_steps="3", free_movement_s="0.1")
    ) as store:
        pseudonym = enrol_included(store)
        with StudyVisit(store, pseudonym) as visit:
            plan = visit.plan_remaining_trials()
            first = next(each for each in plan.trials if each.allow_preference_changes)
            plan = replace(plan, trials=[first])
            attended = Visit(tmp_path, plan, make=lambda send: visit.create_session(plan, send))
            attended.calibrate()
            attended.confirms = False
            attended.run_until("check")
            attended.send(PreferenceChangeRequest())
            asked = [
                each.preference_name for each in PREFERENCE_QUESTIONS if each.preference_name != "pause_s"
            ]
            for name, answer in zip(asked, (2, 4, 3, 2, 1), strict=True):
                attended.send(Answer(name, answer, 1.0))
            attended.leave()
        changed = Preferences(
            speed=0.5, distance_m=0.2, side="right", bite_timing="after_swallowing", force_share=0.1
        )
        assert read_latest_preferences(store, pseudonym) == changed
        assert "preferences changed" in [event.name for event in store.read_events()]
        rules = [
            each.rules for each in plan_session(store, pseudonym).trials if each.allow_preference_changes
        ]
        assert {each and each.preferences for each in rules} == {changed}


def test_the_command_line_shows_and_changes_preferences_in_words(tmp_path: Path) -> None:
    with StudyStore(study_with_conditions(tmp_path)) as store:
        pseudonym = enrol_included(store)
    run = ["study", "preferences", str(tmp_path), pseudonym]
    changed = CliRunner().invoke(app, [*run, "--set", "speed=0.5", "--set", "sources=key,nod"])
    assert changed.exit_code == 0, changed.output
    assert "50% of its usual speed" in CliRunner().invoke(app, run).output
    for change, message in (
        ("mood=good", "unknown preference 'mood'"),
        ("force_share=0.9", "can only lower the force limits"),
        ("speed=fast", "speed is 'fast'; allowed: 0.25 to 1.25"),
        ("sources=switch", "allowed in this condition: key, nod"),
    ):
        refused = CliRunner().invoke(app, [*run, "--set", change])
        assert refused.exit_code != 0
        assert message in " ".join(refused.output.split())


@pytest.mark.slow
def test_simulated_participants_command_only_the_paced_robot(tmp_path: Path) -> None:
    folder = study_with_conditions(tmp_path, trial_steps="60", free_movement_s="0.2")
    simulate_study(folder, 1, seed=1, jobs=1)
    with StudyStore(folder) as store:
        found = analyse_study(store)
        recordings = [store.resolve_path(row.recording) for row in found.study_data.trials if row.recording]
    for path in recordings:
        recording = read_recording(path)
        paced = recording.configuration.policy == "participant_paced"
        assert (
            bool(recording.messages_by_topic["/robot_commands"])
            == bool(recording.messages_by_topic["/pacing"])
            == paced
        )
        checked = verify_recording(recording)
        assert (checked.num_identical_states, checked.num_identical_steps) == (checked.num_states, 60)
    (row,) = found.study_data.commands
    assert (row.policy, row.commands > 0, row.waiting_s > 0.0) == ("participant_paced", True, True)
    assert row.agreement_share == 1.0
    section = str(
        render_commands_section(found.design, found.study_data.trials, found.study_data.commands, True)
    )
    cells = ("participant_paced", "100%", "15", "any", "on cue", "–", "50%", "1", "1")
    assert re.findall(r"<td[^>]*>([^<]*)</td>", section)[-len(cells) :] == list(cells)
    notes = {row.policy: row.simulation_note for row in found.objective_outcomes if row.task == "Feeding"}
    assert "no commands" not in notes["autonomous"]
    assert (
        notes["participant_paced"]
        == f"{notes['autonomous']}; the episodes have no commands and no preferences"
    )


SCENES = """
[conditions.low]
policy = "oracle"
settings = { bed_height_m = 0.5, served_arm = "left" }

[conditions.high]
policy = "oracle"
settings = { bed_height_m = 0.65 }
"""


def study_of_scenes(folder: Path, scenes: str = SCENES, **changes: str) -> Path:
    values = {"tasks": '["BedBathing"]', "robots": '["PR2"]', "policies": '["low", "high"]'} | changes
    make_study(folder, practice_policy='""', **values)
    text = (
        (folder / "study.toml").read_text().replace("\n[settings]\n", "\n[settings]\nbody_mass_kg = 90.0\n")
    )
    (folder / "study.toml").write_text(text + scenes)
    return folder


def test_a_condition_changes_the_settings_of_its_trials(tmp_path: Path) -> None:
    with StudyStore(study_of_scenes(tmp_path)) as store:
        plan = plan_session(store, enrol_included(store))
        found = {
            trial.policy: (plan.find_trial_settings(trial), plan.find_goal_text(trial))
            for trial in plan.trials
        }
        assert found == {
            "low": (
                Settings(body_mass_kg=90.0, bed_height_m=0.5, served_arm="left"),
                "Get your left arm washed.",
            ),
            "high": (Settings(body_mass_kg=90.0, bed_height_m=0.65), "Get your right arm washed."),
        }
        assert "settings bed_height_m=0.65" in describe_condition(store.design.conditions["high"])


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ("seat_height_m = 0.5", "no furniture for the setting seat_height_m"),
        ("control_hz = 20", "the same control rate"),
        ("range_share = 0.5", "participants have their own bodies"),
    ],
)
def test_an_impossible_setting_of_a_condition_is_refused(settings: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(DesignError, match=problem):
        StudyStore(study_of_scenes(tmp_path, SCENES.replace("bed_height_m = 0.65", settings)))


@pytest.mark.slow
def test_trials_of_conditions_with_settings_are_recorded_and_verified(tmp_path: Path) -> None:
    folder = study_of_scenes(tmp_path, trial_steps="20", free_movement_s="0.2")
    simulate_study(folder, 1, seed=1, jobs=1)
    with StudyStore(folder) as store:
        found = analyse_study(store)
        for row in found.study_data.trials:
            recording = read_recording(store.resolve_path(str(row.recording)))
            assert recording.configuration.settings == store.design.find_condition_settings(row.policy)
            checked = verify_recording(recording)
            assert (checked.num_identical_states, checked.num_identical_steps) == (checked.num_states, 20)
        assert not [finding for finding in check_study(store) if finding.is_error]
