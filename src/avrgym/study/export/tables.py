"""A study as tables of comma-separated values, one row per thing."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from msgspec.structs import asdict

from avrgym.study.design.design import Design
from avrgym.study.export import NOTICE
from avrgym.study.export.codebook import OF_INSTRUMENTS, RECORDS, TABLES, codebook, most_joints, reward_terms
from avrgym.study.export.consents import consent_rows, write_consent_texts
from avrgym.study.export.log import log_rows
from avrgym.study.export.records import WITHOUT, Extras, records_of
from avrgym.study.export.scores import scales, scores_of, uses_instruments
from avrgym.study.export.separated import neutral
from avrgym.study.export.trials import ExportedAttempt, all_attempts, answers_of
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.system.files import open_new_csv


def write(store: Store, completed: Sequence[ExportedAttempt], folder: Path, extras: Extras = WITHOUT) -> None:
    """Write all tables into a folder, with the control steps of completed attempts."""
    (folder / "README.txt").write_text(NOTICE + "\n", encoding="utf-8")
    attempts = list(all_attempts(store))
    heights = {exported.attempt.id: exported.torso_height_m() for exported in completed}
    asked = AnsweredItems(store)
    for name, rows in tables_of_people(store, attempts, completed, heights, asked).items():
        write_csv(folder / f"{name}.csv", rows)
    write_consent_texts(store, folder)
    write_csv(folder / "items.csv", items_of(asked.design))
    records = records_of(store, extras)
    for name, rows in records.items():
        write_csv(folder / f"{name}.csv", rows, TABLES[name])
    left_out = {"left_out", *RECORDS} - set(records)
    if uses_instruments(asked.design):
        write_csv(folder / "scales.csv", scales(asked.design))
    else:
        left_out |= set(OF_INSTRUMENTS)
    if store.log():
        write_csv(folder / "log.csv", log_rows(store, extras))
    else:
        left_out |= {"log"}
    write_csv(folder / "control_steps.csv", _control_steps(store, completed))
    tables = [table for table in TABLES if table not in left_out]
    write_csv(folder / "codebook.csv", codebook(tables, store.design))


def tables_of_people(
    store: Store,
    attempts: list[ExportedAttempt],
    completed: Sequence[ExportedAttempt],
    heights: Mapping[int, float | None],
    asked: AnsweredItems,
) -> dict[str, Iterable[Mapping[str, Any]]]:
    """The tables whose rows are each about one participant, by name."""
    tables: dict[str, Iterable[Mapping[str, Any]]] = {
        "participants": _participants(store, _medians(completed, heights)),
        "consents": consent_rows(store),
        "trials": _trials(store, attempts),
        "attempts": (_attempt(exported, heights) for exported in attempts),
        "answers": _answers(store, attempts, asked),
    }
    return tables | ({"scores": _scores(store, attempts, asked)} if uses_instruments(asked.design) else {})


def write_csv(path: Path, rows: Iterable[Mapping[str, Any]], columns: Iterable[str] = ()) -> None:
    """Write rows of equal keys; text that a spreadsheet would run as a formula gets an apostrophe in front.

    A table without rows has a heading only if its ``columns`` are given.
    """
    heads = list(columns)
    with open_new_csv(path) as file:
        writer = csv.writer(file)
        for number, row in enumerate(rows):
            if number == 0:
                heads = []
                writer.writerow(row)
            writer.writerow(neutral(value) for value in row.values())
        if heads:
            writer.writerow(heads)


def _medians(completed: Sequence[ExportedAttempt], heights: Mapping[int, float | None]) -> dict[str, float]:
    """The median torso height of each participant whose recordings tell it."""
    known: dict[str, list[float]] = {}
    for exported in completed:
        height = heights[exported.attempt.id]
        if height is not None:
            known.setdefault(exported.participant.pseudonym, []).append(height)
    return {pseudonym: median(values) for pseudonym, values in known.items()}


def items_of(design: Design) -> Iterator[dict[str, Any]]:
    for questionnaire in design.questionnaires:
        for item in questionnaire.items:
            yield {
                "questionnaire": questionnaire.name,
                "when": ", ".join(questionnaire.moments),
                "order": questionnaire.order,
                "item": item.id,
                "text": item.text,
                "least": questionnaire.scale_of(item).lowest,
                "most": questionnaire.scale_of(item).highest,
                "points": item.points,
                "low": item.low,
                "high": item.high,
            }


def _participants(store: Store, heights: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    for participant in store.participants():
        yield {
            "participant": participant.pseudonym,
            "site": participant.site,
            "site_participant": participant.site_pseudonym,
            "simulated": participant.simulated,
            "state": participant.state,
            "sex": participant.sex,
            "age_years": participant.age_years,
            "language": participant.language or store.design.languages[0],
            "torso_height_m": heights.get(participant.pseudonym),
            "cell": participant.cell,
            "consent_version": participant.consent_version,
            "consented_at": participant.consented_at,
        }


def _trials(store: Store, attempts: list[ExportedAttempt]) -> Iterator[dict[str, Any]]:
    tries: dict[int, list[ExportedAttempt]] = {}
    for exported in attempts:
        tries.setdefault(exported.trial.id, []).append(exported)
    for participant in store.participants():
        for trial in store.trials(participant.pseudonym):
            own = tries.get(trial.id, [])
            completed = [exported.attempt for exported in own if exported.attempt.state == "completed"]
            yield {
                "participant": participant.pseudonym,
                "site": participant.site,
                "simulated": participant.simulated,
                "position": trial.position,
                "practice": trial.practice,
                "environment": trial.environment,
                "policy": trial.policy,
                "seed": trial.seed,
                "state": trial.state,
                "attempts": len(own),
                "recording": completed[0].recording if completed else None,
            }


def _attempt(exported: ExportedAttempt, heights: Mapping[int, float | None]) -> dict[str, Any]:
    attempt = exported.attempt
    return exported.labels() | {
        "state": attempt.state,
        "started_at": attempt.started_at,
        "ended_at": attempt.ended_at,
        **asdict(attempt.metrics),
        "torso_height_m": heights.get(attempt.id),
        "recording": attempt.recording,
        "sha256": attempt.sha256,
    }


def _answers(store: Store, attempts: list[ExportedAttempt], asked: AnsweredItems) -> Iterator[dict[str, Any]]:
    """Every answer; those about a whole session have no trial."""
    for participant in store.participants():
        yield from (answer.columns() for answer in answers_of(store, participant, attempts, asked))


def _scores(store: Store, attempts: list[ExportedAttempt], asked: AnsweredItems) -> Iterator[dict[str, Any]]:
    for participant in store.participants():
        answers = answers_of(store, participant, attempts, asked)
        yield from (score.columns() for score in scores_of(store, participant, answers, asked))


def _control_steps(store: Store, completed: Sequence[ExportedAttempt]) -> Iterator[dict[str, Any]]:
    terms, joints = reward_terms(store.design), range(most_joints(store.design))
    for exported in completed:
        labels = exported.labels()
        for time_s, control in exported.control_steps():
            unknown = set(control.reward_terms) - set(terms)
            if unknown:
                raise StudyError(
                    f"{exported.attempt.recording}: unknown reward terms {', '.join(sorted(unknown))}"
                )
            yield {
                **labels,
                "step": control.step,
                "time_s": time_s,
                "reward": control.reward,
                "success": control.success,
                "distance_m": control.distance_m,
                "force_on_person_n": control.force_on_person_n,
                **{f"term_{term}": control.reward_terms.get(term) for term in terms},
                **{f"action_{joint + 1}": _at(control.action, joint) for joint in joints},
            }


def _at(action: Sequence[float], joint: int) -> float | None:
    """The number for a joint, nothing for an arm that has fewer."""
    return action[joint] if joint < len(action) else None
