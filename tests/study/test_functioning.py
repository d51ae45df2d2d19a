"""Functioning, devices and diagnosis: optional answers, translations, and exports without small groups."""

import csv
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.study.design.functioning import (
    ASSISTIVE_DEVICES,
    DECLINED_ANSWER,
    DIFFICULTY_LEVELS,
    FUNCTIONING_QUESTIONS,
    list_functioning_sentences,
)
from avrgym.study.export import export_study
from avrgym.study.export.event_tables import ExportOptions
from avrgym.study.export.functioning import MIN_GROUP_SIZE, count_functioning_answers, suppress_small_counts
from avrgym.study.people.functioning import FunctioningAnswers, record_functioning_answers
from avrgym.study.people.participants import enrol_participant
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import list_included_languages, read_texts
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant, small_study

ANSWERS = FunctioningAnswers(
    dict.fromkeys(FUNCTIONING_QUESTIONS, "none"), ("12", "24"), "Unverwechselbar-Syndrom"
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    """Seven people with a trial; the last has some difficulty walking."""
    with StudyStore(make_study(tmp_path / "study", tasks='["Feeding"]', ask_functioning="true")) as opened:
        for number in range(7):
            pseudonym = enrol_with_consent(opened, simulated=False)
            run_participant(opened, pseudonym, trials=2, simulated=False)
            walking = "some" if number == 6 else "none"
            record_functioning_answers(
                opened, pseudonym, changed(levels=ANSWERS.levels | {"walking": walking})
            )
        yield opened


def changed(**changes: Any) -> FunctioningAnswers:
    return FunctioningAnswers(
        **{"levels": ANSWERS.levels, "devices": ANSWERS.devices, "diagnosis": ANSWERS.diagnosis} | changes
    )


def read(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("language", list_included_languages())
def test_all_languages_have_all_sentences(language: str) -> None:
    texts = read_texts(language)
    assert language == "en" or texts.find_untranslated_sentences(list(list_functioning_sentences())) == []


@pytest.mark.slow
def test_all_questions_can_be_declined(store: StudyStore) -> None:
    record_functioning_answers(
        store,
        "sub-001",
        FunctioningAnswers(dict.fromkeys(FUNCTIONING_QUESTIONS, DECLINED_ANSWER), (DECLINED_ANSWER,)),
    )
    said = store.read_participant("sub-001").functioning
    assert said == {
        "levels": dict.fromkeys(FUNCTIONING_QUESTIONS, DECLINED_ANSWER),
        "devices": [DECLINED_ANSWER],
        "diagnosis": "",
    }
    assert store.database.find_integrity_errors() == []


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"levels": {"seeing": "none"}}, "each question needs an answer or 'declined'"),
        (
            {"levels": ANSWERS.levels | {"walking": "badly"}},
            "walking is 'badly'; allowed: none, some",
        ),
        ({"devices": ("13",)}, "unknown device class '13'; allowed: 04, 05"),
        ({"devices": ("none", "12")}, "devices contains 'none' and other answers"),
        ({"diagnosis": "x" * 201}, "the diagnosis is 201 characters long"),
    ],
)
def test_invalid_answers_are_rejected(store: StudyStore, changes: dict[str, Any], words: str) -> None:
    before = store.read_participant("sub-001")
    with pytest.raises(StudyError, match=words):
        record_functioning_answers(store, "sub-001", changed(**changes))
    assert store.read_participant("sub-001") == before


def test_answers_require_consent_and_the_design(store: StudyStore, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="record the consent first"):
        record_functioning_answers(store, enrol_participant(store, "man"), ANSWERS)
    with pytest.raises(StudyError, match="is a simulated participant; allowed: a person"):
        record_functioning_answers(store, enrol_with_consent(store), ANSWERS)
    with StudyStore(small_study(tmp_path / "without")) as without:
        pseudonym = enrol_with_consent(without, simulated=False)
        with pytest.raises(StudyError, match="ask_functioning = true in study"):
            record_functioning_answers(without, pseudonym, ANSWERS)


# Small groups


@pytest.mark.parametrize(
    ("counts", "shown"),
    [
        ([12, 0, 0], [12, 0, 0]),
        ([12, 6, 0], [12, 6, 0]),
        ([12, 6, 4], [12, None, None]),
        ([20, 3, 2], [20, None, None]),
        ([20, 2, 1, 6], [20, None, None, None]),
        ([7, 1], [None, None]),
        ([4], [None]),
        ([0, 0], [0, 0]),
    ],
)
def test_small_groups_are_suppressed(counts: list[int], shown: list[int | None]) -> None:
    assert suppress_small_counts(counts) == shown


def test_suppressed_groups_cannot_be_computed_from_the_total() -> None:
    for a in range(12):
        for b in range(12):
            for c in range(12):
                shown = suppress_small_counts([a, b, c])
                hidden = [number for number, seen in zip((a, b, c), shown, strict=True) if seen is None]
                assert not any(seen is not None and 0 < seen < MIN_GROUP_SIZE for seen in shown)
                assert not hidden or sum(hidden) >= MIN_GROUP_SIZE or all(seen is None for seen in shown)


@pytest.mark.slow
def test_export_contains_individual_answers_only_on_request(store: StudyStore, tmp_path: Path) -> None:
    rows = {(row.question, row.answer): row.people for row in count_functioning_answers(store)}
    assert rows["seeing", "none"] == "7"
    assert rows["walking", "some"] == rows["walking", "none"] == "suppressed"
    assert rows["devices", f"12: {ASSISTIVE_DEVICES['12']}"] == "7"
    export_study(store, "csv", tmp_path / "public")
    files = [path.read_bytes() for path in (tmp_path / "public").rglob("*") if path.is_file()]
    assert not any(b"Unverwechselbar" in data for data in files)
    assert not (tmp_path / "public" / "functioning_by_person.csv").exists()
    assert len(read(tmp_path / "public" / "functioning.csv")) == 6 * (len(DIFFICULTY_LEVELS) + 1) + len(
        ASSISTIVE_DEVICES
    )
    export_study(store, "csv", tmp_path / "health", extras=ExportOptions(include_health_data=True))
    *_, last = read(tmp_path / "health" / "functioning_by_person.csv")
    assert (last["walking"], last["devices"], last["diagnosis"]) == ("some", "12, 24", "")
    export_study(
        store, "csv", tmp_path / "all", extras=ExportOptions(include_free_text=True, include_health_data=True)
    )
    assert read(tmp_path / "all" / "functioning_by_person.csv")[0]["diagnosis"] == ANSWERS.diagnosis
    assert {each.name for each in fields(ExportOptions)} == {"free_text", "health"}


def test_command_uses_the_language_of_the_participant(tmp_path: Path) -> None:
    folder = make_study(
        tmp_path / "study", tasks='["Feeding"]', ask_functioning="true", languages='["en", "de"]'
    )
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store, simulated=False)
        english = enrol_participant(store, "man", language="de")
    answers = "\n".join(["none"] * len(FUNCTIONING_QUESTIONS) + ["12, 24", ""]) + "\n"
    result = CliRunner().invoke(app, ["study", "functioning", str(folder), pseudonym], input=answers)
    assert result.exit_code == 0, result.output
    assert "no difficulty" in result.output
    with StudyStore(folder) as store:
        assert store.read_participant(pseudonym).functioning is not None
    result = CliRunner().invoke(app, ["study", "functioning", str(folder), english], input=answers)
    assert "keine Schwierigkeiten" in result.output
    assert "record the consent first" in result.output
