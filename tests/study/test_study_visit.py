"""Visits of participants: stored data, admission, and continuation after interruptions."""

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec.structs import asdict
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.policies.trained_policies import PolicyError
from avrgym.recording.reader import read_recording
from avrgym.recording.schema import Outcome
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.participants import enrol_participant, record_consent, withdraw_participant
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ExperimenterCommandName,
    ParticipantReady,
    VrEntered,
)
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.vr.visit import Visit

PATIENCE_S = 60.0
ITEMS = ("L1", "L2", "L3", "L4")


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    """A study with a practice trial and two trials of 1 s."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(
        tmp_path / "study",
        tasks='["Feeding"]',
        robots='["Jaco"]',
        trial_steps="3",
        free_movement_s="0.1",
    )
    with StudyStore(folder) as opened:
        yield opened


def attend(visit: StudyVisit) -> Visit:
    """Attend a visit with a short countdown."""
    plan = replace(visit.plan_remaining_trials(), countdown_s=0.1)
    return Visit(Path(), plan, make=lambda send: visit.create_session(plan, send))


def finish_trial(attended: Visit, limit_s: float = 30.0) -> None:
    """Finish the present or next trial and answer its questions."""
    trial, ends_s = attended.session.trial_index, attended.now_s + limit_s
    while attended.session.trial_index == trial:
        assert attended.now_s < ends_s, f"still in {attended.phase}; problems: {attended.problems}"
        if attended.phase == "questionnaire":
            attended.answer(2, 3, 4, 5)
        else:
            attended.tick()


def command(attended: Visit, name: ExperimenterCommandName) -> None:
    attended.send(ExperimenterCommand(name=name))


def go_to_trial(attended: Visit) -> None:
    attended.calibrate()
    attended.run_until("trial")


def states(store: StudyStore) -> list[str]:
    return [attempt.state for attempt in store.read_attempts("sub-001")]


def wrong(store: StudyStore) -> list[str]:
    return [f"{finding.where}: {finding.message}" for finding in check_study(store) if finding.is_error]


def digests(folder: Path) -> dict[str, str]:
    """The checksums of all recordings."""
    files = sorted(folder.rglob("*.mcap"))
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_complete_visit_is_stored(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    planned = store.read_trials(pseudonym)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        for _ in planned:
            finish_trial(attended)
        assert attended.phase == "finished"
    assert store.read_participant(pseudonym).state == "completed"
    assert wrong(store) == []
    attempts = store.read_attempts(pseudonym)
    for trial, attempt in zip(planned, attempts, strict=True):
        recording = read_recording(store.resolve_path(attempt.recording))
        run = recording.configuration
        assert (run.environment, run.policy) == (trial.environment, trial.policy)
        assert (run.seed, run.trial_number, run.attempt_number) == (
            trial.seed,
            trial.position,
            attempt.number,
        )
        assert recording.outcome == Outcome(result="completed", **asdict(attempt.metrics))
        controls = [control for _, control in recording.messages_by_topic["/control"]]
        assert attempt.metrics.reward == sum(control.reward for control in controls)
        assert len(controls) == attempt.metrics.steps == store.design.trial_steps
    given = [(answer.item, answer.value) for answer in store.read_answers(pseudonym)]
    assert given == 2 * list(zip(ITEMS, (2, 3, 4, 5), strict=True))
    events = Counter(event.name for event in store.read_events())
    assert events["calibrated"] == 1
    assert events["attempt completed"] == events["trial completed"] == 3
    moments = [event.recorded_at for event in store.read_events()]
    assert moments == sorted(moments)
    phases = [
        event.detail.partition(",")[0] for event in store.read_events() if event.name == "phase entered"
    ]
    assert phases == [f"phase {name}" for name in attended.phases]


def test_visit_requires_consent(store: StudyStore) -> None:
    pseudonym = enrol_participant(store, "woman")
    for prepare in (lambda: None, lambda: record_consent(store, pseudonym)):
        prepare()
        with pytest.raises(StudyError, match="only allocated participants"):
            StudyVisit(store, pseudonym)
    assert (store.read_sessions(pseudonym), digests(store.folder)) == ([], {})


def test_missing_policy_prevents_a_session(
    store: StudyStore, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pseudonym = enrol_with_consent(store)
    monkeypatch.setattr("avrgym.policies.trained_policies.PACKAGED_POLICY_FOLDER", tmp_path)
    with pytest.raises(
        PolicyError, match=r"no policy .* for avrgym/FeedingJaco-v1; allowed: oracle, random, zero, "
    ):
        StudyVisit(store, pseudonym)
    assert store.read_sessions(pseudonym) == []


@pytest.mark.slow
def test_next_visit_continues_order_seeds_and_attempts(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    planned = [(trial.environment, trial.policy, trial.seed) for trial in store.read_trials(pseudonym)]
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        finish_trial(attended)
        attended.run_until("trial")
        command(attended, "stop")
        attended.leave()
    with StudyVisit(store, pseudonym) as visit:
        plan = visit.plan_remaining_trials()
        assert [(trial.environment, trial.policy, trial.seed) for trial in plan.trials] == planned
        assert plan.first_trial_number == 2
        attended = attend(visit)
        attended.calibrate()
        finish_trial(attended)
        finish_trial(attended)
    names = [
        attempt.recording.removeprefix("recordings/sub-001/") for attempt in store.read_attempts(pseudonym)
    ]
    assert names == [
        "ses-01/trial-01_attempt-1.mcap",
        "ses-01/trial-02_attempt-1.mcap",
        "ses-02/trial-02_attempt-2.mcap",
        "ses-02/trial-03_attempt-1.mcap",
    ]
    assert states(store) == ["completed", "stopped", "completed", "completed"]
    assert [attempt.number for attempt in store.read_attempts(pseudonym)] == [1, 1, 2, 1]
    assert wrong(store) == []
    with pytest.raises(StudyError, match="is completed; only allocated participants"):
        StudyVisit(store, pseudonym)


@pytest.mark.slow
def test_commands_are_stored(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        go_to_trial(attended)
        command(attended, "stop")
        attended.send(ParticipantReady())
        attended.run_until("trial")
        command(attended, "pause")
        command(attended, "continue")
        attended.run_until("trial")
        command(attended, "repeat")
        attended.run_until("trial")
        command(attended, "skip")
        attended.run_until("trial")
        command(attended, "end")
        assert attended.phase == "finished"
    assert states(store) == ["stopped", "paused", "repeated", "skipped", "ended"]
    assert [trial.position for trial in store.read_remaining_trials(pseudonym)] == [2, 3, 1]
    names = [event.name for event in store.read_events()]
    assert {"stopped", "paused", "continued", "trial skipped"} <= set(names)
    assert wrong(store) == []
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        for _ in range(3):
            finish_trial(attended)
    assert store.read_participant(pseudonym).state == "completed"


def test_withdrawal_stops_robot_and_recording(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        go_to_trial(attended)
        attended.tick(12)
        visit.withdraw_participant(attended.session, attended.now_s, "felt sick")
        (path,) = attended.session.recordings
        ended = digests(store.folder)
        attended.tick(30)
        assert attended.phase == "finished"
        assert digests(store.folder) == ended
    assert states(store) == ["ended"]
    recording = read_recording(path)
    assert recording.is_complete
    assert [event.name for _, event in recording.messages_by_topic["/events"]][-1] == "robot_holds"
    assert store.read_participant(pseudonym).state == "withdrawn"
    assert [session.state for session in store.read_sessions(pseudonym)] == ["closed"]
    assert "felt sick" in [event.detail for event in store.read_events()]
    with pytest.raises(StudyError, match="is withdrawn"):
        StudyVisit(store, pseudonym)
    assert wrong(store) == []


def await_word(visit: StudyVisit) -> None:
    """Wait until the visit has noticed that another process ended it."""
    ends_s = time.monotonic() + PATIENCE_S
    while not visit.is_ended_elsewhere:
        assert time.monotonic() < ends_s
        time.sleep(0.01)


def test_withdrawal_by_another_process_stops_robot_and_recording(store: StudyStore) -> None:
    """The command line of another process withdraws the participant."""
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        go_to_trial(attended)
        attended.tick(12)
        withdrawn = CliRunner().invoke(app, ["study", "withdraw", str(store.folder), pseudonym])
        assert (withdrawn.exit_code, withdrawn.stdout) == (0, "sub-001 has withdrawn\n")
        await_word(visit)
        attended.tick()
        assert attended.phase == "finished"
        ended = digests(store.folder)
        attended.tick(30)
        assert digests(store.folder) == ended
        (path,) = attended.session.recordings
    assert attended.problems == []
    recording = read_recording(path)
    assert recording.is_complete
    assert [event.name for _, event in recording.messages_by_topic["/events"]][-1] == "robot_holds"
    assert states(store) == ["stopped"]
    assert wrong(store) == []


def test_nothing_is_stored_after_withdrawal_by_another_process(
    store: StudyStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("avrgym.study.sessions.session_threads.SESSION_POLL_INTERVAL_S", 3600.0)
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        go_to_trial(attended)
        withdraw_participant(store, pseudonym)
        attended.run_until("paused")
        attended.send(ParticipantReady())
        attended.tick(5)
        assert attended.phase == "paused"
        assert "is closed; allowed: an open session" in attended.problems[-1]
    assert states(store) == ["stopped"]


def test_session_ends_when_taken_over(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        go_to_trial(attended)
        with StudyStore(store.folder) as other, StudyVisit(other, pseudonym, take_over=True) as elsewhere:
            await_word(visit)
            attended.tick()
            assert attended.phase == "finished"
            assert not elsewhere.is_ended_elsewhere
            assert [session.state for session in store.read_sessions(pseudonym)] == ["interrupted", "open"]
    assert [session.state for session in store.read_sessions(pseudonym)] == ["interrupted", "closed"]


# What cannot be written


@pytest.mark.slow
def test_full_disk_completes_no_trial(store: StudyStore, small_files: Callable[[int], None]) -> None:
    """Recordings and database cannot grow; when they can, the trial is repeated."""
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.calibrate()
        finish_trial(attended)
        before = digests(store.folder)
        attended.run_until("free_before")
        small_files(60_000)
        attended.run_until("paused")
        small_files(0)
        assert "cannot be recorded" in attended.problems[-1]
        assert [trial.state for trial in store.read_trials(pseudonym)].count("completed") == 1
        assert before.items() <= digests(store.folder).items()
        attended.send(ParticipantReady())
        finish_trial(attended)
        finish_trial(attended)
        assert attended.phase == "finished"
    assert store.read_participant(pseudonym).state == "completed"
    assert before.items() <= digests(store.folder).items()
    assert Counter(states(store)) == {"completed": 3, "failed": 1}
    assert wrong(store) == []


def test_trial_does_not_begin_without_a_file(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    with StudyVisit(store, pseudonym) as visit:
        blocked = store.resolve_path(visit.stored_session.recordings_folder)
        blocked.parent.mkdir(parents=True)
        blocked.write_text("")
        attended = attend(visit)
        attended.calibrate()
        attended.run_until("paused")
        assert "cannot be recorded" in attended.problems[-1]
        assert store.read_attempts(pseudonym) == []
        blocked.unlink()
        attended.send(ParticipantReady())
        finish_trial(attended)
    assert states(store)[0] == "completed"


@pytest.mark.slow
def test_trial_is_repeated_after_a_storage_error(store: StudyStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """If the end of a trial cannot be stored, the trial is repeated."""
    pseudonym = enrol_with_consent(store)

    def fail(*_: object) -> None:
        raise StudyError("the study's database: disk I/O error")

    with StudyVisit(store, pseudonym) as visit:
        attended = attend(visit)
        attended.send(VrEntered())
        attended.calibrate()
        with monkeypatch.context() as broken:
            broken.setattr("avrgym.study.sessions.study_visit.complete_attempt", fail)
            attended.run_until("paused")
        assert "disk I/O error" in attended.problems[-1]
        attended.send(ParticipantReady())
        finish_trial(attended)
    assert states(store)[:2] == ["failed", "completed"]
    assert wrong(store) == []
