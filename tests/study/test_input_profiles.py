"""Input profiles of participants: stored at enrolment and later, used by sessions, refused in words."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.presentation import PresentationPreferences
from avrgym.study.people.input_profiles import make_input_profile, set_input_profile
from avrgym.study.people.participants import enrol_participant
from avrgym.study.storage.attempts import begin_attempt
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, make_study

HEAD = InputProfile(
    "head", dwell_s=2.0, presentation=PresentationPreferences(text_deg=2.0, contrast="high", captions=True)
)


def test_profiles_are_stored_and_recorded_with_each_attempt(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path / "study", tasks='["Feeding"]')) as store:
        pseudonym = enrol_with_consent(store)
        assert store.read_participant(pseudonym).input_profile is None
        set_input_profile(store, pseudonym, HEAD)
        assert store.read_participant(pseudonym).input_profile == HEAD
        trial = store.read_remaining_trials(pseudonym)[0]
        begin_attempt(store, open_session(store, pseudonym).id, trial.position, input_profile=HEAD)
        assert [attempt.input_profile for attempt in store.read_attempts(pseudonym)] == [HEAD]
        assert [each.detail for each in store.read_events() if each.name == "input changed"] == [
            HEAD.describe()
        ]
        other = enrol_participant(store, "man", input_profile=HEAD)
        assert store.read_participant(other).input_profile == HEAD
        assert store.database.find_integrity_errors() == []


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"method": "head", "stops": []}, "no way to stop the robot; allowed for head: gaze, experimenter"),
        ({"dwell_s": 5}, "dwell_s is 5; allowed: 0.5 to 3"),
        ({"method": "left-hand", "absent_arms": ["left"]}, "left-hand needs an arm"),
        ({"presentation": {"text_deg": 5}}, "text_deg is 5; allowed: 1 to 3"),
        ({"presentation": {"position": "top"}}, "position is 'top'; allowed: centre, left, right"),
    ],
)
def test_impossible_profiles_are_refused(values: dict, words: str) -> None:
    with pytest.raises(StudyError, match=words):
        make_input_profile(values)


def test_an_arm_that_a_task_needs_cannot_be_absent(tmp_path: Path) -> None:
    armless = InputProfile("head", absent_arms=("right",))
    fault = "ScratchItch works on the right arm, which is absent; allowed: tasks that need no absent arm"
    with StudyStore(make_study(tmp_path / "study", tasks='["Feeding", "ScratchItch"]')) as store:
        with pytest.raises(StudyError, match=fault):
            enrol_participant(store, "man", input_profile=armless)
        assert store.read_participants() == []
        pseudonym = enrol_with_consent(store)
        with pytest.raises(StudyError, match=fault):
            set_input_profile(store, pseudonym, armless)
        assert store.read_participant(pseudonym).input_profile is None
        set_input_profile(store, pseudonym, InputProfile("head", absent_arms=("left",)))


@pytest.mark.slow
def test_commands_enrol_with_a_profile_and_change_it(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]')

    def run(*words: str) -> tuple[int, str]:
        ran = CliRunner().invoke(app, ["study", *words])
        return ran.exit_code, ran.output

    assert run("enrol", str(folder), "--body", "woman", "--input", "one-switch")[0] == 0
    assert "one-switch; scan 1.5 s" in run("input", str(folder), "sub-001")[1]
    code, said = run("input", str(folder), "sub-001", "--scan", "3", "--resting-arm", "left")
    assert (code, "scan 3 s; resting: left hand" in said) == (0, True)
    code, said = run("input", str(folder), "sub-001", "--method", "head", "--stop", "palm")
    assert (code, "cannot stop by palm" in said) == (1, True)
    assert run("input", str(folder), "sub-001", "--text", "2", "--read-aloud", "--position", "left")[0] == 0
    code, said = run("input", str(folder), "sub-001", "--no-read-aloud", "--captions")
    assert (code, "text 2°; panel on the left; captions" in said) == (0, True)
    with StudyStore(folder) as store:
        stored = store.read_participant("sub-001").input_profile
    presentation = PresentationPreferences(text_deg=2.0, position="left", captions=True)
    assert stored == InputProfile("one-switch", scan_s=3.0, resting_arms=("left",), presentation=presentation)
