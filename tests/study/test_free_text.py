"""Limits of names, contacts, reasons and notes."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.study.people.participants import add_note, enrol_participant, set_identity, withdraw_participant
from avrgym.study.storage.free_text import MAX_LINE_LENGTH, MAX_NOTE_LENGTH
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import make_study

ENTRANCES: dict[str, tuple[int, Callable[[StudyStore, str], object]]] = {
    "name": (MAX_LINE_LENGTH, lambda store, text: enrol_participant(store, "man", name=text)),
    "contact": (MAX_LINE_LENGTH, lambda store, text: enrol_participant(store, "man", contact=text)),
    "corrected name": (MAX_LINE_LENGTH, lambda store, text: set_identity(store, "sub-001", text, "")),
    "corrected contact": (MAX_LINE_LENGTH, lambda store, text: set_identity(store, "sub-001", "", text)),
    "note": (MAX_NOTE_LENGTH, lambda store, text: add_note(store, "sub-001", text)),
    "reason": (MAX_LINE_LENGTH, lambda store, text: withdraw_participant(store, "sub-001", text)),
}
NO_TEXT = ("\x00", "a\x00b", "\x1b[2J", "\x7f", "\x9b", "\ud800", "\udcff")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(make_study(tmp_path, tasks='["Feeding"]')) as store:
        enrol_participant(store, "woman")
        yield store


def contents(store: StudyStore) -> tuple[object, ...]:
    key = store.folder / "private" / "identities.json"
    return store.read_participants(), store.read_events(), key.read_bytes() if key.exists() else b""


@pytest.mark.parametrize("entrance", ENTRANCES)
def test_invalid_texts_are_rejected(store: StudyStore, entrance: str) -> None:
    most, enter = ENTRANCES[entrance]
    before = contents(store)
    for wrong in ("n" * (most + 1), *NO_TEXT):
        with pytest.raises(StudyError, match="allowed") as refused:
            enter(store, wrong)
        assert wrong not in str(refused.value)
    assert contents(store) == before
    enter(store, "Ünal–Ōé 姓名 👩‍🔬 " + "n" * (most - 20))


def test_notes_have_lines_and_are_not_empty(store: StudyStore) -> None:
    add_note(store, "sub-001", "looked left,\n\tthen right")
    with pytest.raises(StudyError, match="empty"):
        add_note(store, "sub-001", "")
    with pytest.raises(StudyError, match="allowed"):
        enrol_participant(store, "man", name="two\nlines")


@pytest.mark.parametrize("option", ["--name", "--contact"])
def test_command_rejects_invalid_texts(store: StudyStore, option: str) -> None:
    said = CliRunner().invoke(app, ["study", "enrol", str(store.folder), "--body", "man", option, "n" * 201])
    assert said.exit_code != 0
    assert "201 characters" in said.output
    assert "Traceback" not in said.output
    assert len(store.read_participants()) == 1
