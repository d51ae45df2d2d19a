"""A study in several languages: texts of participants, and stored data."""

import csv
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.study.checking.study_checks import check_study
from avrgym.study.dashboard import displayed_data
from avrgym.study.dashboard.displayed_data import make_displayed_participant, make_study_overview
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text, read_design
from avrgym.study.export import export_study
from avrgym.study.people.participants import (
    add_note,
    edit_note,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
)
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import InvalidTextsError, ParticipantText, normalize_whitespace, read_texts
from avrgym.vr.protocol.messages import (
    Language,
    ParticipantReady,
    PhaseDescription,
    PreviousQuestionRequest,
    Question,
)
from helpers.studies.small_studies import eligible_answers, make_study
from helpers.vr.visit import Visit

GERMAN = read_texts("de")
BOTH = '["en", "de"]'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    quick = {"trial_steps": "3", "free_movement_s": "0.1", "practice_policy": '""'}
    return make_study(tmp_path / "study", tasks='["Feeding"]', languages=BOTH, **quick)


def take_in_german(store: StudyStore) -> str:
    pseudonym = enrol_participant(store, "woman", language="de", simulated=True)
    record_consent(store, pseudonym)
    record_inclusion_answers(store, pseudonym, eligible_answers(store))
    return pseudonym


def test_default_study_has_all_packaged_languages(folder: Path) -> None:
    assert read_design(folder / "study.toml").languages == ("en", "de")
    for only in ("de", "en"):
        text = read_default_design_text().replace('languages = ["en"]', f'languages = ["{only}"]')
        assert parse_design(text).languages == (only,)


@pytest.mark.parametrize(
    ("languages", "change", "words"),
    [
        ('["en", "fr"]', {}, "no texts in 'fr'"),
        ('["en", "en"]', {}, "en"),
        ("[]", {}, "languages"),
        ('["e n"]', {}, "is not a language tag"),
        (
            BOTH,
            {"Eat the food": "Taste the food"},
            'of "Taste the food from the spoon."; allowed: a line for each',
        ),
        (BOTH, {"strongly": "very strongly"}, '"very strongly disagree"'),
        (
            '["de"]',
            {"[database]": '[[questionnaires]]\nuse = "ssq"\nwhen = "after_session"\n[database]'},
            "and 17 more",
        ),
    ],
    ids=["unknown", "twice", "none", "no tag", "goal", "ends", "instrument"],
)
def test_error_of_a_missing_translation_has_its_line(
    tmp_path: Path, languages: str, change: dict[str, str], words: str
) -> None:
    text = read_default_design_text().replace('languages = ["en"]', f"languages = {languages}")
    for before, after in change.items():
        text = text.replace(before, after)
    line = next(n for n, each in enumerate(text.splitlines(), 1) if each.startswith("languages"))
    with pytest.raises(DesignError, match=re.escape(words)) as refused:
        parse_design(text, folder=tmp_path)
    assert str(refused.value).startswith(f"study.toml:{line}: ")


def test_study_may_translate_only_the_page(tmp_path: Path) -> None:
    own = tmp_path / "texts" / "de.toml"
    own.parent.mkdir()
    own.write_text('[session]\nreach_ahead_page = "Strecken Sie beide Arme."\n')
    texts, ahead = read_texts("de", tmp_path), ParticipantText("reach_ahead")
    assert (texts.format_for_vr(ahead), texts.format_for_page(ahead)) == (
        GERMAN.format_for_vr(ahead),
        "Strecken Sie beide Arme.",
    )
    for wrong, words in (
        ("reach_ahead_page = '{hand}'", "other placeholders"),
        ("ahead_page = ''", "unknown"),
    ):
        own.write_text(f"[session]\n{wrong}\n")
        with pytest.raises(InvalidTextsError, match=words):
            read_texts("de", tmp_path)


def test_participant_reads_one_language(folder: Path, tmp_path: Path) -> None:
    with StudyStore(folder) as store:
        with pytest.raises(StudyError, match="allowed in this study: en, de"):
            enrol_participant(store, "woman", language="fr")
        pseudonym = take_in_german(store)
        read = GERMAN.translate(store.design.consent.text)
        assert store.read_participant(pseudonym).consent_sha256 == hashlib.sha256(read.encode()).hexdigest()
        with StudyVisit(store, pseudonym) as visit:
            plan = replace(visit.plan_remaining_trials(), countdown_s=0.1)
            attended = Visit(Path(), plan, make=lambda send: visit.create_session(plan, send))
            attended.session.send_initial_state(attended.inbox.append, "participant", 0.0)
            attended.go_to("questionnaire")
            attended.confirms = False
            attended.answer(2)
            attended.send(PreviousQuestionRequest())
            attended.answer(3, 4, 5, 6)
            attended.send(ParticipantReady())
            attended.run_until("ready")
            attended.leave()
        assert attended.received(Language)[-1].language == "de"
        asked = {question.text for question in attended.received(Question)}
        assert asked == {GERMAN.translate(item.text) for item in store.design.items_by_id.values()}
        assert not asked & {item.text for item in store.design.items_by_id.values()}
        assert attended.received(PhaseDescription)[-1].text.startswith("Durchgang 2 von 4: Essen Sie")
        answers = [(each.item, each.value) for each in store.read_answers(pseudonym)]
        assert answers == [("L1", 3), ("L2", 4), ("L3", 5), ("L4", 6)]
        changes = [event.detail for event in store.read_events() if event.name == "answer changed"]
        assert changes == ["L1 from 2 to 3"]
        assert not [each for each in check_study(store) if each.is_error]
        export_study(store, "csv", tmp_path / "csv")
    with open(tmp_path / "csv" / "participants.csv", encoding="utf-8-sig", newline="") as file:
        assert [row["language"] for row in csv.DictReader(file)] == ["de"]


def test_dashboard_shows_consent_in_the_language_of_the_participant(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The dashboard also warns about a full disk."""
    with StudyStore(folder) as store:
        pseudonym = take_in_german(store)
        seen = make_displayed_participant(store, pseudonym)
        assert (seen.language, seen.direction) == ("de", "ltr")
        assert seen.consent == GERMAN.sentences[normalize_whitespace(store.design.consent.text)]
        assert seen.inclusion["epilepsy"] == "Hatten Sie schon einmal Epilepsie?"
        whole = make_study_overview(store, None, store.design.furniture)
        assert (whole.languages, whole.warnings) == ({"en": "English", "de": "Deutsch"}, ())
        monkeypatch.setattr(displayed_data, "MIN_FREE_DISK_BYTES", 1 << 60)
        (warning,) = make_study_overview(store, None, store.design.furniture).warnings
        assert "GB left" in warning


def test_edited_note_leaves_no_earlier_text(folder: Path) -> None:
    with StudyStore(folder) as store:
        first, second = take_in_german(store), take_in_german(store)
        add_note(store, first, "Ada looked left")
        (note,) = store.read_notes(first)
        for whose, number, text in ((second, note.id, "x"), (first, note.id + 1, "x"), (first, note.id, "")):
            with pytest.raises(StudyError):
                edit_note(store, whose, number, text)
        edit_note(store, first, note.id, "They looked left")
        assert [each.text for each in store.read_notes(first)] == ["They looked left"]
        assert "Ada" not in json.dumps([event.detail for event in store.read_events()])
        assert not [each for each in check_study(store) if each.is_error]
