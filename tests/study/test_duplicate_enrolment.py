"""Duplicate enrolment is detected for any spelling of name and contact."""

import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.identities import PossibleDuplicateError
from avrgym.study.people.participants import enrol_participant, set_identity, withdraw_participant
from avrgym.study.storage.identity_file import read_identities
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import small_study

NAME, CONTACT = "Zoë  Straßer", "zoe@example.org"
SAME = (
    (NAME, CONTACT),
    ("zoë straßer", "ZOE@EXAMPLE.ORG"),
    ("  ZOË STRASSER ", " zoe@example.org"),
    (unicodedata.normalize("NFD", NAME), CONTACT),
    ("Zoë\u00a0Straßer", "zoe @example.org"),
    ("Ｚｏë Straßer", "zoe@example\u200b.org"),
    (NAME, ""),
    ("", CONTACT),
)
OTHERS = (("Zoe Straßer", CONTACT), (NAME, "zoe2@example.org"), ("", ""), ("Ada Example", ""))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(small_study(tmp_path / "study")) as opened:
        enrol_participant(opened, "woman", name=NAME, contact=CONTACT)
        yield opened


def contents(store: StudyStore) -> tuple[object, ...]:
    return store.read_participants(), store.read_events(), read_identities(store.folder)


def named(store: StudyStore) -> list[str]:
    return [f"{each.where} {each.message}" for each in check_study(store) if "same person" in each.message]


@pytest.mark.parametrize(("name", "contact"), SAME)
def test_duplicate_enrolment_is_rejected(store: StudyStore, name: str, contact: str) -> None:
    before = contents(store)
    with pytest.raises(PossibleDuplicateError, match=r"sub-001.*--confirm-duplicate") as refused:
        enrol_participant(store, "woman", name=name, contact=contact)
    assert "stra" not in str(refused.value).lower()
    assert "zo" not in str(refused.value).lower()
    assert contents(store) == before


@pytest.mark.parametrize(("name", "contact"), OTHERS)
def test_other_people_are_enrolled(store: StudyStore, name: str, contact: str) -> None:
    assert enrol_participant(store, "woman", name=name, contact=contact) == "sub-002"
    assert named(store) == []


def test_confirmed_duplicate_is_enrolled(store: StudyStore) -> None:
    enrol_participant(store, "man", name=NAME.upper(), contact=CONTACT, confirm_duplicate=True)
    (warning,) = named(store)
    assert warning.startswith("sub-002 may be the same person as sub-001")
    assert not any(part.lower() in warning.lower() for part in (*NAME.split(), CONTACT))
    assert "another person than sub-001" in store.read_events()[-1].detail
    assert not any(each.is_error for each in check_study(store) if "same person" in each.message)


def test_withdrawn_participant_counts_as_duplicate_at_enrolment(store: StudyStore) -> None:
    withdraw_participant(store, "sub-001")
    with pytest.raises(PossibleDuplicateError, match="sub-001"):
        enrol_participant(store, "woman", name=NAME, contact=CONTACT)
    enrol_participant(store, "woman", name=NAME, contact=CONTACT, confirm_duplicate=True)
    assert named(store) == []


def test_corrected_name_is_checked_for_duplicates(store: StudyStore) -> None:
    set_identity(store, "sub-001", NAME.lower(), CONTACT)
    enrol_participant(store, "man", name="Ada Example")
    with pytest.raises(PossibleDuplicateError, match="sub-001"):
        set_identity(store, "sub-002", NAME, CONTACT)
    assert read_identities(store.folder)["sub-002"].name == "Ada Example"
    set_identity(store, "sub-002", NAME, CONTACT, confirm_duplicate=True)
    assert len(named(store)) == 1


def test_command_accepts_confirmed_duplicates(store: StudyStore) -> None:
    command = ["study", "enrol", str(store.folder), "--body", "woman", "--name", "ZOË STRASSER"]
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code == 1
    assert "sub-001" in refused.output
    confirmed = CliRunner().invoke(app, [*command, "--confirm-duplicate"])
    assert confirmed.exit_code == 0, confirmed.output
    assert "sub-002" in confirmed.output
