"""Conditions of a study with the same policy: autonomous, and paced by participants with their own preferences."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.analysis.study import analyse
from avrgym.cli.main import app
from avrgym.commands.preferences import Preferences
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify
from avrgym.study.people.preferences import preferences_of, record_preferences
from avrgym.study.sessions.simulation import simulate_study
from avrgym.study.sessions.visit import plan_session
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from helpers.studies.known_results import enrol_included
from helpers.studies.small_studies import make_study

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
    with Store(study_with_conditions(tmp_path)) as store:
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
            StudyError, match="contradict the condition participant_paced: commands without stop"
        ):
            record_preferences(store, pseudonym, Preferences(commands=("ready",)))
        assert preferences_of(store, pseudonym) == paced.preferences


def test_the_command_line_shows_and_changes_preferences_in_words(tmp_path: Path) -> None:
    with Store(study_with_conditions(tmp_path)) as store:
        pseudonym = enrol_included(store)
    run = ["study", "preferences", str(tmp_path), pseudonym]
    changed = CliRunner().invoke(app, [*run, "--set", "speed=0.5", "--set", "sources=key,nod"])
    assert changed.exit_code == 0, changed.output
    assert "50% of its usual speed" in CliRunner().invoke(app, run).output
    for change, message in (
        ("mood=good", "unknown preference 'mood'"),
        ("force_share=0.9", "can only lower the force limits"),
        ("speed=fast", "Expected `float`"),
        ("sources=switch", "allowed in this condition: key, nod"),
    ):
        refused = CliRunner().invoke(app, [*run, "--set", change])
        assert refused.exit_code != 0
        assert message in " ".join(refused.output.split())


@pytest.mark.slow
def test_simulated_participants_command_only_the_paced_robot(tmp_path: Path) -> None:
    folder = study_with_conditions(tmp_path, trial_steps="60", free_movement_s="0.2")
    simulate_study(folder, 1, seed=1, jobs=1)
    with Store(folder) as store:
        found = analyse(store)
        recordings = [store.path(row.recording) for row in found.observed.trials if row.recording]
    for path in recordings:
        recording = read_recording(path)
        paced = recording.configuration.policy == "participant_paced"
        assert bool(recording.topics["/robot_commands"]) == bool(recording.topics["/pacing"]) == paced
        checked = verify(recording)
        assert (checked.identical_states, checked.identical_steps) == (checked.states, 60)
    (row,) = found.observed.commands
    assert (row.policy, row.commands > 0, row.waiting_s > 0.0) == ("participant_paced", True, True)
    assert row.agreement_share == 1.0
