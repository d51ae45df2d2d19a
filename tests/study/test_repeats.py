"""Repeated trials by reason, person and outcome, and repeats of one policy until success."""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from msgspec.structs import replace as with_values
from typer.testing import CliRunner

from avrgym.analysis.study_analysis import analyse_study
from avrgym.cli.main import app
from avrgym.recording.schema import AttemptEnd, Metrics
from avrgym.study.checking.repeat_checks import (
    REPEATS_LOCATION,
    check_repeats,
    check_trial_repeats,
    compute_selection_p_value,
)
from avrgym.study.checking.repeats import (
    EXPERIMENTER_REASON,
    PARTICIPANT_REASON,
    TECHNICAL_REASON,
    UNKNOWN_EXPERIMENTER_NAME,
    UNKNOWN_REASON,
    AttemptedTrial,
    ReplacedAttempt,
    list_attempted_trials,
)
from avrgym.study.design.design import Design, parse_design, read_default_design_text
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.attempts import begin_attempt, complete_attempt, end_incomplete_attempt
from avrgym.study.storage.audit_log import PERSONAL_TOKEN_METHOD, AuditActor, add_log_entry
from avrgym.study.storage.database_rows import Participant, Trial, TrialAttempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ExperimenterCommand, ExperimenterCommandName, ParticipantDisconnected
from helpers.browser.html_page import Page
from helpers.studies.known_results import write_without_figures
from helpers.studies.small_studies import enrol_with_consent, make_study, record
from helpers.vr.visit import Visit

ADA = AuditActor("ada", PERSONAL_TOKEN_METHOD)
STEPS = 3
Ends = list[tuple[AttemptEnd, bool]]
"""How attempts before the completed one ended, and whether the robot had succeeded by then."""


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


def run(store: StudyStore, pseudonym: str, ends: Callable[[Trial], Ends], *, complete: bool = True) -> None:
    """A participant goes through all trials, each after the attempts that ``ends`` lists; repeats are in the log.

    Without ``complete`` the last attempt at each trial fails, and nothing is recorded.
    """
    session = open_session(store, pseudonym)
    for trial in store.read_remaining_trials(pseudonym):
        for state, success in ends(trial):
            attempt = begin_attempt(store, session.id, trial.position)
            if state == "repeated":
                add_log_entry(store, ADA, "repeat", pseudonym)
            end_incomplete_attempt(store, attempt.id, state, Metrics(STEPS, -9.0, success, 4.0))
        attempt = begin_attempt(store, session.id, trial.position)
        if not complete:
            end_incomplete_attempt(store, attempt.id, "failed")
            continue
        record(store, attempt, trial)
        complete_attempt(store, attempt.id, Metrics(STEPS, -1.5, True, 4.0))
    close_session(store, session.id)


def study(*arguments: str | Path) -> str:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)]).stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study of eight participants with a frozen plan."""
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', trial_steps=str(STEPS))
    study("freeze", folder)
    assert "frozen" in study("freeze", folder)
    return folder


def of_repeats(text: str) -> list[str]:
    return [line for line in text.splitlines() if f" {REPEATS_LOCATION}: " in line]


# The whole study


@pytest.mark.slow
def test_policy_repeated_until_success_is_reported(folder: Path) -> None:
    """``check``, ``status``, report and methods list 24 extra attempts with one policy."""

    def until_success(trial: Trial) -> Ends:
        return [("repeated", False)] * (1 + trial.position % 2) if trial.policy == "original" else []

    with StudyStore(folder) as store:
        while sum(len(each.replaced_attempts) for each in list_attempted_trials(store)) < 24:
            run(store, enrol_with_consent(store), until_success)
        extra = sum(len(each.replaced_attempts) for each in list_attempted_trials(store))
        analysis = analyse_study(store)
    named = f"depend on the policy: original {extra} extra attempts in "
    listed = of_repeats(study("check", folder))
    assert [line for line in listed if named in line]
    assert all("deviates from the plan" in line for line in listed)
    assert [
        line
        for line in listed
        if "more often than max_repeats = 1 allows" in line and "requested by ada" in line
    ]
    assert [line for line in listed if "depend on the outcome" in line and "(exact test" in line]
    assert named in study("status", folder)
    assert analysis.plan_with_deviations is not None
    assert named in " ".join(each.message for each in analysis.plan_with_deviations.deviations)
    page = " ".join(Page(write_without_figures(analysis, folder, folder / "analysis")).text.split())
    assert page.count(named) == 2  # in the plan's deviations and in the section about repeats
    assert (
        f"{extra} attempts were replaced by repeats: experimenter {extra}. Requested by: ada {extra}." in page
    )
    assert named in (folder / "analysis" / "reporting" / "methods.md").read_text()
    rows = json.loads((folder / "analysis" / "results.json").read_text())["repeats"]
    assert {row["policy"] for row in rows} == {"original"}
    assert sum(row["replaced_attempts"] for row in rows) == extra
    assert sum(row["replaced_successes"] for row in rows) == 0


@pytest.mark.slow
def test_technical_repeats_are_no_finding(folder: Path) -> None:
    with StudyStore(folder) as store:
        for _ in range(4):
            run(
                store,
                enrol_with_consent(store),
                lambda trial: [("failed", False)] * (2 * (trial.policy == "original")),
            )
        assert list(check_repeats(store)) == []
        assert {row.reason for row in analyse_study(store).repeated_trials} == {TECHNICAL_REASON}
    assert of_repeats(study("check", folder)) == []


@pytest.mark.slow
def test_balanced_requested_repeats_are_no_finding(folder: Path) -> None:
    """One repeat of each policy for each participant, with varying robot and outcome."""
    with StudyStore(folder) as store:
        for number in range(4):
            robot = "Jaco" if number % 2 else "PR2"
            run(
                store,
                enrol_with_consent(store),
                lambda trial, robot=robot, good=number > 1: (
                    [("repeated", good)] * (robot in trial.environment)
                ),
            )
        assert list(check_repeats(store)) == []
        page = " ".join(
            Page(write_without_figures(analyse_study(store), folder, folder / "analysis")).text.split()
        )
    assert "8 attempts were replaced by repeats: experimenter 8. Requested by: ada 8." in page


def test_limit_of_the_frozen_plan_applies(folder: Path) -> None:
    with StudyStore(folder) as store:
        run(
            store,
            enrol_with_consent(store),
            lambda trial: [("repeated", False)] * (2 * (trial.position == 3)),
            complete=False,
        )
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("max_repeats = 1", "max_repeats = 5"))
    assert "1 trial was repeated more often than max_repeats = 1 allows: sub-001 trial 3 (2)" in study(
        "status", folder
    )


def test_design_without_a_limit(tmp_path: Path) -> None:
    folder = make_study(tmp_path, tasks='["Feeding"]')
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("max_repeats = 1\n", ""))
    with StudyStore(folder) as store:
        run(
            store,
            enrol_with_consent(store),
            lambda trial: [("repeated", False)] * (9 * (trial.position == 3)),
            complete=False,
        )
        assert list(check_repeats(store)) == []


def test_blinded_experimenter_sees_policy_codes(tmp_path: Path) -> None:
    folder = make_study(tmp_path, tasks='["Feeding"]', blind_experimenter="true")
    with StudyStore(folder) as store:
        for _ in range(4):
            run(
                store,
                enrol_with_consent(store),
                lambda trial: [("repeated", False)] * (trial.policy == "original"),
                complete=False,
            )
        (found,) = check_repeats(store)
        assert "original" not in found.message
        letter = store.design.make_blinded_policy_letters()["original"]
        assert f"{letter} 8 extra attempts in 8 of 8 trials" in found.message


# Reasons


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    changes = {"robots": '["Jaco"]', "practice_policy": '""', "free_movement_s": "0.1"}
    with StudyStore(
        make_study(tmp_path / "live", tasks='["Feeding"]', trial_steps="30", **changes)
    ) as opened:
        yield opened


def by_command(name: ExperimenterCommandName) -> Callable[[StudyStore, Visit], None]:
    def give(store: StudyStore, visit: Visit) -> None:
        add_log_entry(store, ADA, name, "sub-001")
        visit.send(ExperimenterCommand(name=name))

    return give


def tell(
    message: messages.ParticipantMessage | messages.WatcherMessage | ParticipantDisconnected,
) -> Callable[[StudyStore, Visit], None]:
    return lambda _, visit: visit.send(message)


ENDINGS: dict[str, tuple[Callable[[StudyStore, Visit], None], str, str, str]] = {
    "repeat": (by_command("repeat"), EXPERIMENTER_REASON, "repeated", "ada"),
    "stop": (by_command("stop"), EXPERIMENTER_REASON, "stopped", "ada"),
    "pause": (by_command("pause"), EXPERIMENTER_REASON, "paused", "ada"),
    "measure again": (by_command("recalibrate"), EXPERIMENTER_REASON, "measured again", "ada"),
    "not logged": (
        tell(ExperimenterCommand(name="repeat")),
        EXPERIMENTER_REASON,
        "repeated",
        UNKNOWN_EXPERIMENTER_NAME,
    ),
    "participant's stop": (tell(messages.Stop()), PARTICIPANT_REASON, "stopped", ""),
    "left VR": (tell(messages.VrLeft()), PARTICIPANT_REASON, "left VR", ""),
    "network": (tell(ParticipantDisconnected()), TECHNICAL_REASON, "network", ""),
    "menu": (tell(messages.VisibilityChanged("hidden")), TECHNICAL_REASON, "scene not visible", ""),
    "recentred": (tell(messages.OriginReset()), UNKNOWN_REASON, "measured again", ""),
    "another height": (
        tell(messages.TorsoHeightCorrection(0.55)),
        EXPERIMENTER_REASON,
        "torso height corrected",
        UNKNOWN_EXPERIMENTER_NAME,
    ),
}


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("ending", ENDINGS)
def test_repeat_has_reason_and_person(store: StudyStore, ending: str) -> None:
    end, *expected = ENDINGS[ending]
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        plan = replace(visit.plan_remaining_trials(), countdown_s=0.1)
        attended = Visit(Path(), plan, make=lambda send: visit.create_session(plan, send))
        attended.calibrate()
        attended.run_until("trial")
        end(store, attended)
        attended.tick()
    assert repeat_after(store) == [*expected]


def repeat_after(store: StudyStore) -> list[str]:
    """Reason, cause and person of the first repeat after another attempt."""
    session = open_session(store, "sub-001", take_over=True)
    begin_attempt(store, session.id, store.read_remaining_trials("sub-001")[0].position)
    repeat = list_attempted_trials(store)[0].replaced_attempts[0]
    return [repeat.repeat_reason, repeat.cause_text, repeat.requested_by]


def test_attempt_open_after_a_crash_is_a_restart(store: StudyStore) -> None:
    session = open_session(store, enrol_with_consent(store))
    begin_attempt(store, session.id, store.read_remaining_trials("sub-001")[0].position)
    open_session(store, "sub-001", take_over=True)
    assert repeat_after(store) == [TECHNICAL_REASON, "restart", ""]


# The tests


@pytest.mark.parametrize("alpha", [0.0025, 0.005, 0.05])
def test_exact_test_keeps_its_level(alpha: float) -> None:
    """The rejected outcomes have a total probability up to the level, for any blocks."""
    for blocks in (
        [(4, 2, 2)] * 8,
        [(4, 2, 1), (4, 1, 3), (2, 1, 1)] * 4,
        [(4, 4, 2), (3, 0, 1)],
        [(16, 8, 5)],
    ):
        probabilities = np.ones(1)
        for units, members, drawn in blocks:
            draws = list(product([0, 1], repeat=units))
            hits = Counter(sum(draw[:members]) for draw in draws if sum(draw) == drawn)
            probabilities = np.convolve(
                probabilities, [hits[n] / sum(hits.values()) for n in range(drawn + 1)]
            )
        rejected = [
            share
            for n, share in enumerate(probabilities)
            if share > 0 and compute_selection_p_value(blocks, n) <= alpha
        ]
        assert sum(rejected) <= alpha + 1e-12
        assert compute_selection_p_value(blocks, int(probabilities.argmax())) == pytest.approx(1.0)


@pytest.mark.slow
def test_random_repeats_cause_at_most_1_percent_findings() -> None:
    """2 000 studies of 8 people and 16 trials; 10 % of trials are repeated, and success differs by policy."""
    design, generator = parse_design(read_default_design_text()), np.random.default_rng(0)
    found = sum(
        bool(list(check_trial_repeats(imagined(design, generator, 0.1, 0.1), design, None)))
        for _ in range(2000)
    )
    assert found <= 20 + 3 * np.sqrt(20)


@pytest.mark.slow
def test_repeats_after_failures_are_found() -> None:
    """Half of the failed first attempts are repeated, and no successful ones, for both policies."""
    design, generator = parse_design(read_default_design_text()), np.random.default_rng(0)
    found = [
        any(
            "outcome" in each.message
            for each in check_trial_repeats(imagined(design, generator, 0.5, 0.0), design, None)
        )
        for _ in range(100)
    ]
    assert sum(found) > 90


def imagined(
    design: Design, generator: np.random.Generator, after_failure: float, after_success: float
) -> list[AttemptedTrial]:
    """The trials of eight people with random repeats after the first attempt."""
    tried: list[AttemptedTrial] = []
    conditions = list(product(design.tasks, design.robots, design.policies))
    for number in range(1, 9):
        person = cast(Participant, SimpleNamespace(number=number, is_simulated=False))
        for position, (task, robot, policy) in enumerate(conditions, start=1):
            trial = Trial(
                position, number, position, f"avrgym/{task}{robot}-v1", policy, 0, False, "completed"
            )
            success = bool(generator.random() < (0.8 if policy == "revised" else 0.4))
            metrics = Metrics(design.trial_steps, -1.0, success, 20.0)
            first = TrialAttempt(1, position, 1, 1, "repeated", "", None, metrics, None, None, "", "")
            again = generator.random() < (after_success if success else after_failure)
            repeats = (
                [ReplacedAttempt(person, trial, first, EXPERIMENTER_REASON, "repeated", "ada")]
                if again
                else []
            )
            last = replace(first, number=2, state="completed", metrics=with_values(metrics, success=True))
            tried.append(AttemptedTrial(person, trial, [first, last] if again else [first], repeats))
    return tried
