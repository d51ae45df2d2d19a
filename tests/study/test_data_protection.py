"""Drafts for data protection contain facts of the design, and edited drafts are not overwritten."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.study.plan.data_protection import DATA_PROTECTION_FOLDER, write_data_protection_drafts
from avrgym.study.plan.hosted_assessment import (
    HOST_SETTINGS_FILE,
    HOSTED_STUDY_DATA,
    HOSTED_STUDY_RISKS,
    HOSTED_STUDY_SAFEGUARDS,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import small_study


def written(folder: Path) -> dict[str, str]:
    with StudyStore(folder) as store:
        return {path.name: path.read_text() for path in write_data_protection_drafts(store)}


def test_drafts_contain_each_article_and_facts_of_the_design(tmp_path: Path) -> None:
    drafts = written(small_study(tmp_path / "study"))
    assessment, record = drafts["impact-assessment.md"], drafts["record-of-processing.md"]
    for letter in "abcd":
        assert f"Article 35(7)({letter})" in assessment
    for letter in "abcdefg":
        assert f"### ({letter}) " in record
    for text in (assessment, record):
        assert "likert" in text
        assert "8 participants" in text
        assert "[TO FILL IN: period" in text
        assert "Signals of other devices" not in text
    assert "You take part in a study" in assessment
    assert "`study.db`" in assessment


def test_drafts_follow_the_design(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    path = folder / "study.toml"
    text = path.read_text().replace("[retention]\n", "[retention]\nidentities_months = 7\ndata_years = 12\n")
    path.write_text(text.replace("receive = {}", """receive = { heart = "type='ECG'" }"""))
    for draft in written(folder).values():
        assert "Names and contacts: 7 months after the study's end." in draft
        assert "All data of participants: 12 years after" in draft
        assert "Recordings: **[TO FILL IN" in draft
        assert "Signals of other devices: heart." in draft


def test_edited_drafts_are_not_overwritten(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    command = ["study", "data-protection", str(folder)]
    assert CliRunner().invoke(app, command).exit_code == 0
    assert CliRunner().invoke(app, command).exit_code == 0
    path = folder / DATA_PROTECTION_FOLDER / "impact-assessment.md"
    path.write_text("filled in")
    with StudyStore(folder) as store, pytest.raises(StudyError, match="exists already with another text"):
        write_data_protection_drafts(store)
    assert path.read_text() == "filled in"
    assert path.stat().st_mode & 0o077 == 0 or path.parent.stat().st_mode & 0o077 == 0


def test_drafts_of_a_hosted_study_contain_its_data_measures_and_risks(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    (folder / HOST_SETTINGS_FILE).write_text("")
    drafts = written(folder)
    for draft in drafts.values():
        assert all(each in draft for each in (*HOSTED_STUDY_DATA, *HOSTED_STUDY_SAFEGUARDS))
    assert all(f"### {heading}" in drafts["impact-assessment.md"] for heading in HOSTED_STUDY_RISKS)
