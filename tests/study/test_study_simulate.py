"""Dry runs give the same study for the same seed, also after interruptions."""

import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.people.zoo.partners import PARTNER_PARAMETERS, PARTNERS
from avrgym.policies.trained_policies import PolicyError
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.participants import withdraw_participant
from avrgym.study.sessions import dry_run
from avrgym.study.sessions.dry_run import (
    DryRunSettings,
    find_or_enrol_participant,
    make_dry_run_settings,
    sample_dry_run_traits,
    simulate_study,
)
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.learning.random_networks import random_network, save_network
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.system.killed_processes import SEED, assert_same, compare_with_killed
from helpers.system.processes import AVRGYM, kill_with_parent

FITS = "y\ny\ny\ny\ny\ny\nn\n"
"""Answers to the inclusion questions of a participant who can take part."""
DESIGN = {
    "tasks": '["ScratchItch"]',
    "robots": '["Jaco"]',
    "trial_steps": "3",
    "free_movement_s": "0.1",
}
"""A practice trial and two trials for each participant, with random policies."""


@pytest.fixture(autouse=True)
def sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_study(tmp_path / "study", **DESIGN)


def study(*arguments: str | int | Path, answers: str = "") -> Result:
    return CliRunner().invoke(app, ["study", *(str(each) for each in arguments)], input=answers)


@pytest.mark.slow
def test_killed_dry_run_gives_the_same_study(folder: Path, tmp_path: Path) -> None:
    """Orders, seeds, answers and metrics equal those of an uninterrupted study."""
    whole = make_study(tmp_path / "whole", **DESIGN)
    print(compare_with_killed(whole, folder, tmp_path / "journal", kills=20))


@pytest.mark.slow
@pytest.mark.parametrize("trial", [1, 2])
def test_dry_run_continues_after_a_kill(trial: int, tmp_path: Path) -> None:
    """SIGKILL ends the program and its workers in the first or the last trial of a participant."""
    design = DESIGN | {"practice_policy": '""'}
    whole, killed = (make_study(tmp_path / name, **design) for name in ("whole", "killed"))
    arguments = "--participants", "1", "--seed", str(SEED)
    assert study("simulate", whole, *arguments).exit_code == 0
    command = [AVRGYM, "study", "simulate", killed, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, preexec_fn=kill_with_parent, start_new_session=True
    ) as running:
        while len(list(killed.rglob("*.mcap"))) < trial:
            assert running.poll() is None
            time.sleep(0.01)
        os.killpg(running.pid, signal.SIGKILL)
    resumed = study("simulate", killed, *arguments)
    assert resumed.exit_code == 0, resumed.output
    assert assert_same(whole, killed) >= 2


@pytest.mark.slow
def test_dry_run_is_complete_and_can_be_continued(folder: Path) -> None:
    with open(folder / "study.toml", "a") as file:
        for when in ("before_session", "after_session"):
            file.write(f'[[questionnaires]]\nname = "{when}"\nwhen = "{when}"\n')
            file.write(
                f'items = [{{ id = "{when}", text = "Sick?", points = 4, low = "no", high = "very" }}]\n'
            )
    told: list[tuple[int, int]] = []
    simulate_study(folder, 1, SEED, lambda completed, planned: told.append((completed, planned)))
    assert told[-1] == (3, 3)
    result = study("simulate", folder, "--participants", 2, "--seed", SEED)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "2 of 8 planned participants completed, 2 simulated" in result.stdout
    with StudyStore(folder) as store:
        assert {person.state for person in store.read_participants()} == {"completed"}
        assert all(person.simulated and person.consented_at for person in store.read_participants())
        assert {person.sex for person in store.read_participants()} == {"man", "woman"}
        assert [len(store.read_sessions(person.pseudonym)) for person in store.read_participants()] == [1, 1]
        assert [finding for finding in check_study(store) if finding.is_error] == []
        answers = store.read_answers("sub-001")
        assert [answer.item for answer in answers if answer.attempt is None] == [
            "before_session",
            "after_session",
        ]
        assert len(answers) == 10
        heights = {
            sample_dry_run_traits(person, DryRunSettings(SEED)).torso_height_m
            for person in store.read_participants()
        }
        assert len(heights) == 2


@pytest.mark.slow
def test_withdrawal_during_a_dry_run_is_no_failure(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_trial = dry_run._run_trial  # pyright: ignore[reportPrivateUsage]

    def run_and_withdraw(visit: StudyVisit, cast: DryRunSettings) -> None:
        run_trial(visit, cast)
        if visit.store.read_participant(visit.pseudonym).state == "allocated":
            withdraw_participant(visit.store, visit.pseudonym, "felt sick")

    monkeypatch.setattr(dry_run, "_run_trial", run_and_withdraw)
    with StudyStore(folder) as store:
        find_or_enrol_participant(store, 0, DryRunSettings(SEED))
        dry_run.simulate_participant(folder, "sub-001", DryRunSettings(SEED))
        assert store.read_participant("sub-001").state == "withdrawn"
        assert [trial.state for trial in store.read_trials("sub-001")] == ["completed", "planned", "planned"]
        assert [finding for finding in check_study(store) if finding.is_error] == []


def test_other_seed_does_not_continue_earlier_participants(folder: Path) -> None:
    with StudyStore(folder) as store:
        find_or_enrol_participant(store, 0, DryRunSettings(SEED))
    with (
        StudyStore(folder) as store,
        pytest.raises(StudyError, match=r"'simulated with seed 5, motion 2', but .*allowed: the same seed"),
    ):
        find_or_enrol_participant(store, 0, DryRunSettings(SEED + 1))
    with StudyStore(folder) as store:
        enrol_with_consent(store, simulated=False)
        assert find_or_enrol_participant(store, 1, DryRunSettings(SEED)) == "sub-003"


def test_other_population_does_not_continue_earlier_participants(folder: Path) -> None:
    zoo = make_dry_run_settings(SEED, "zoo/unseen", "tremor")
    assert str(zoo) == f"simulated with seed {SEED}, motion 2, people zoo/unseen, impairment tremor"
    with StudyStore(folder) as store:
        find_or_enrol_participant(store, 0, zoo)
        with pytest.raises(StudyError, match="allowed: the same seed, people and motion"):
            find_or_enrol_participant(store, 0, DryRunSettings(SEED))


@pytest.mark.slow
def test_zoo_partners_take_part(tmp_path: Path) -> None:
    design = DESIGN | {"practice_policy": '""', "policies": '["revised"]'}
    folder = make_study(tmp_path / "study", **design)
    asked = "--participants", 1, "--seed", SEED, "--jobs", 1
    result = study("simulate", folder, *asked, "--people", "zoo/unseen", "--impairment", "limits")
    assert result.exit_code == 0, result.output
    with StudyStore(folder) as store:
        assert [finding for finding in check_study(store) if finding.is_error] == []
        (person,) = store.read_participants()
        traits = sample_dry_run_traits(person, make_dry_run_settings(SEED, "zoo/unseen", "limits"))
        assert traits.behaviour_parameters is not None
        zoo = [row for row, partner in enumerate(PARTNERS) if partner.zoo == "zoo/unseen"]
        assert (
            (
                PARTNER_PARAMETERS.select_partners(np.array(zoo)).to_table()
                == traits.behaviour_parameters.to_table()
            )
            .all(axis=1)
            .any()
        )
        assert 0.25 <= traits.range_share < 1.0
    refused = study("simulate", folder, *asked)
    assert refused.exit_code == 1
    assert "allowed: the same seed, people and motion" in refused.output


def test_missing_policy_prevents_a_dry_run(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", **DESIGN | {"policies": '["nobody", "revised"]'})
    with pytest.raises(PolicyError, match="no policy 'nobody' for avrgym/ScratchItchJaco-v1"):
        simulate_study(folder, 1, SEED)
    with StudyStore(folder) as store:
        assert store.read_participants() == []


# The commands about people


def test_enrolment_on_the_command_line(folder: Path) -> None:
    enrolled = study("enrol", folder, "--body", "woman", "--age", 23, "--name", "Ada Example")
    assert enrolled.exit_code == 0
    assert enrolled.stdout.startswith("enrolled  sub-001\n")
    refused = study("consent", folder, "sub-001", answers="n\n")
    assert refused.exit_code == 1
    assert "does not agree. Nothing was stored" in refused.stderr
    asked = study("consent", folder, "sub-001", answers=f"y\n{FITS}")
    assert asked.exit_code == 0
    assert "You take part in a study of virtual robots" in asked.stdout
    assert asked.stdout.endswith("sub-001 takes part\n")
    with StudyStore(folder) as store:
        person = store.read_participant("sub-001")
        assert (person.state, person.age_years, person.simulated) == ("allocated", 23, False)
    again = study("consent", folder, "sub-001", answers="y\n")
    assert (again.exit_code, again.stderr.count("cannot become consented")) == (1, 1)


def test_server_rejects_ineligible_participants(folder: Path) -> None:
    study("enrol", folder, "--body", "man")
    for pseudonym, why in (
        ("sub-001", "is enrolled; only allocated participants"),
        ("sub-002", "there is no sub-002"),
    ):
        served = CliRunner().invoke(
            app, ["serve", "--study", str(folder), "--participant", pseudonym, "--port", "0"]
        )
        assert (served.exit_code, served.stderr.count(why)) == (1, 1)
    assert not (folder / "recordings").exists()


def test_excluded_participant_cannot_take_part(folder: Path) -> None:
    study("enrol", folder, "--body", "man")
    asked = study("consent", folder, "sub-001", answers="y\nn\n" + FITS[2:])
    assert asked.stdout.endswith("sub-001 cannot take part\n")
    unknown = study("enrol", folder, "--body", "child")
    assert (unknown.exit_code, unknown.stderr) == (
        1,
        "avrgym: unknown body model 'child'; allowed: man, woman\n",
    )


@pytest.mark.slow
def test_trained_human_takes_part_in_its_environment(tmp_path: Path) -> None:
    """Trained humans are read from a folder; equal seeds give equal studies, marked as simulated."""
    design = DESIGN | {"practice_policy": '""', "policies": '["revised"]'}
    folder, again = (make_study(tmp_path / name, **design) for name in ("study", "again"))
    humans = [
        random_network("avrgym/ScratchItchJaco-v1", impairment="tremor", seed=number) for number in range(2)
    ]
    for number, human in enumerate(humans):
        save_network(tmp_path / "humans" / f"{number}.safetensors", human)
    asked = "--participants", 1, "--seed", SEED, "--jobs", 1, "--people", tmp_path / "humans"
    for each in (folder, again):
        result = study("simulate", each, *asked)
        assert result.exit_code == 0, result.output
    assert assert_same(folder, again) >= 1
    with StudyStore(folder) as store:
        (person,) = store.read_participants()
        assert person.simulated
        traits = sample_dry_run_traits(person, make_dry_run_settings(SEED, str(tmp_path / "humans"), "none"))
        assert traits.trained_policy is not None
        assert traits.trained_policy.parameters_sha256 in {each.parameters_sha256 for each in humans}
        assert (traits.tremor_amplitude_rad > 0.0).any(), "the impairment that the human was trained with"
    fed = make_study(tmp_path / "fed", **DESIGN | {"tasks": '["Feeding"]', "policies": '["revised"]'})
    refused = study("simulate", fed, *asked)
    assert refused.exit_code == 1
    assert "trained for avrgym/ScratchItchJaco-v1; for avrgym/FeedingJaco-v1" in " ".join(
        refused.output.split()
    )
    with StudyStore(fed) as store:
        assert store.read_participants() == []
