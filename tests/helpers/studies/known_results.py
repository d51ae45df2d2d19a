"""Small studies with known answers, rewards and bodies, for tests of the analysis."""

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import asdict

from avrgym.analysis import output_files
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.models import human
from avrgym.models.human import Sex
from avrgym.recording.configuration import BodyModel
from avrgym.recording.schema import Answer, BodyTargets, Control, Latency, Metrics, Outcome, TrackingFrame
from avrgym.recording.writer import RecordingWriter
from avrgym.study.design.design import Design
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.storage.answers import record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt, end_incomplete_attempt
from avrgym.study.storage.database_rows import Participant, Trial, TrialAttempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.store import StudyStore
from avrgym.vr.latency import LATENCY_STAGES
from helpers.studies.configurations import trial_configuration
from helpers.studies.small_studies import eligible_answers

STEPS = 5
ITEMS = ("L1", "L2", "L3", "L4")
Rate = Callable[[Participant, Trial, str], int]


def enrol_included(store: StudyStore, sex: Sex = "woman", *, simulated: bool = True, site: str = "") -> str:
    """Enrol a participant with consent, inclusion and an order."""
    pseudonym = enrol_participant(store, sex, age_years=22, simulated=simulated, site=site)
    record_consent(store, pseudonym)
    record_inclusion_answers(store, pseudonym, eligible_answers(store))
    return pseudonym


def random_answer(participant: Participant, trial: Trial, item: str) -> int:
    """A random answer that is the same in every run."""
    seed = [participant.number, trial.position, ITEMS.index(item)]
    return int(np.random.default_rng(seed).integers(1, 8))


def torso_height_m(participant: Participant) -> float:
    """Return a participant's torso height: 0.51, 0.52, … m."""
    return 0.50 + 0.01 * participant.number


def run_trials(
    store: StudyStore,
    pseudonym: str,
    count: int | None = None,
    rate: Rate = random_answer,
    held: Mapping[int, int] | None = None,
) -> None:
    """Run a participant's next trials. ``held``: number of rejected last frames, by position of the trial."""
    participant = store.read_participant(pseudonym)
    session = open_session(store, pseudonym)
    for trial in store.read_remaining_trials(pseudonym)[:count]:
        attempt = begin_attempt(store, session.id, trial.position)
        frames_held = (held or {}).get(trial.position, 0)
        metrics = record_trial(
            store.resolve_path(attempt.recording), store.design, participant, trial, held=frames_held
        )
        if not trial.practice:
            for item in ITEMS:
                record_trial_answer(store, attempt.id, Answer(item, rate(participant, trial, item), 1.0))
        complete_attempt(store, attempt.id, metrics)
    close_session(store, session.id)


def interrupt_trial(store: StudyStore, pseudonym: str) -> TrialAttempt:
    """Run a session that stops in the first remaining trial."""
    session = open_session(store, pseudonym)
    attempt = begin_attempt(store, session.id, store.read_remaining_trials(pseudonym)[0].position)
    end_incomplete_attempt(store, attempt.id, "stopped")
    close_session(store, session.id)
    return attempt


def record_trial(
    path: Path,
    design: Design,
    participant: Participant,
    trial: Trial,
    *,
    other_course: int = 0,
    held: int = 0,
    **changes: Any,
) -> Metrics:
    """Write a trial's recording with ``changes`` to its configuration. Returns the metrics.

    The last ``held`` frames are rejected. ``other_course`` is an additional seed of the random course.
    """
    values = {
        "simulated": participant.simulated,
        "person": BodyModel(participant.sex, torso_height_m(participant), "fair"),
    }
    writer = RecordingWriter(path, trial_configuration(design, trial, **values | changes))
    rng = np.random.default_rng([participant.number, trial.position, other_course])
    lean_deg, reward = rng.uniform(-5.0, 15.0), 0.0
    for step in range(1, STEPS + 1):
        time_ns = step * 100_000_000
        angles = human.make_seated_joint_angles(waist_x=lean_deg + step, head_z=5.0 * step)
        holds = step > STEPS - held
        writer.write(
            "/tracking",
            time_ns,
            TrackingFrame(step, 10.0 * step, step / 10, moved_person=not holds, rejected=holds),
        )
        writer.write("/body_targets", time_ns - 1, BodyTargets(angles.tolist()))
        control = _control(step, float(rng.normal()))
        reward += control.reward
        writer.write("/control", time_ns, control)
    if not participant.simulated:
        writer.write("/latency", 500_000_000, latency_of(participant))
    writer.write("/answers", 900_000_000, Answer("L1", 4, 1.0))
    metrics = Metrics(STEPS, reward, success=bool(rng.random() < 0.5), seconds=4.0)
    writer.close(Outcome(result="completed", **asdict(metrics)))
    return metrics


def latency_of(participant: Participant) -> Latency:
    """Return the latency of three frames: 10, 20 and 30 ms plus the participant's number."""
    waits_ms = [participant.number + 10.0 * each for each in (1, 2, 3)]
    even = [1.0] * len(waits_ms)
    stages = dict.fromkeys(LATENCY_STAGES, even) | {LATENCY_STAGES[-1]: waits_ms}
    return Latency([1, 2, 3], **stages)


def _control(step: int, reward: float) -> Control:
    terms = {"distance_m": 0.5 / step, "action_squared": 0.25}
    return Control(step, [0.0], [0.0] * 7, reward, terms, step == STEPS, 0.5 / step, 2.0 * step)


def write_without_figures(analysis: StudyAnalysis, study: Path, out: Path) -> Path:
    """Write report, tables and results, which takes a third of the time with figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(output_files, "draw_figures", lambda _: [])
        return output_files.write_analysis(analysis, study, out)


def read_table(folder: Path, name: str) -> list[Mapping[str, str]]:
    """Read the rows of a table."""
    with open(folder / "tables" / f"{name}.csv", encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))
