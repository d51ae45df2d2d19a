"""Invitations: single-use links and links with several places, their expiry, and what the study stores of them."""

import csv
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.hosting.public_links import parse_public_address
from avrgym.study.people.invitations import (
    InvitationError,
    RecruitmentServiceIds,
    close_invitation,
    create_invitations,
    enrol_with_invitation,
    find_valid_invitation,
    list_invitations,
    read_pseudonyms_by_token_sha256,
)
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.storage import identity_file
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.server.session_links import compute_token_sha256
from helpers.studies.small_studies import small_study


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(small_study(tmp_path / "study")) as opened:
        yield opened


def reason(store: StudyStore, token: str) -> str:
    with pytest.raises(InvitationError) as raised:
        find_valid_invitation(store, token)
    return raised.value.reason


def test_single_use_link_admits_one_participant(store: StudyStore) -> None:
    (invitation,) = create_invitations(store, ["row-1"], days=1)
    pseudonym, own = enrol_with_invitation(store, invitation.token, "woman", age_years=40)
    assert (
        read_pseudonyms_by_token_sha256(store)
        == {compute_token_sha256(own): pseudonym}
        == {compute_token_sha256(own): "sub-001"}
    )
    assert reason(store, invitation.token) == "full"
    with pytest.raises(InvitationError, match="has been used"):
        enrol_with_invitation(store, invitation.token, "man")
    assert [each.pseudonym for each in store.read_participants()] == ["sub-001"]
    assert store.database.find_integrity_errors() == []


def test_places_are_not_exceeded_by_concurrent_enrolments(store: StudyStore) -> None:
    (invitation,) = create_invitations(store, [""], days=1, places=3)

    def take(_: int) -> str:
        try:
            return enrol_with_invitation(store, invitation.token, "man")[0]
        except InvitationError as error:
            return error.reason

    with ThreadPoolExecutor(6) as threads:
        taken = sorted(threads.map(take, range(6)))
    assert taken == ["full"] * 3 + ["sub-001", "sub-002", "sub-003"]
    assert list_invitations(store)[0].used == 3


def test_expired_closed_and_unknown_invitations_are_rejected(store: StudyStore) -> None:
    (expired,) = create_invitations(store, [""], days=1e-9)
    (closed,) = create_invitations(store, [""], days=1)
    close_invitation(store, closed.id)
    assert [reason(store, token) for token in (expired.token, closed.token, "other", "")] == [
        "expired",
        "closed",
        "unknown",
        "unknown",
    ]
    assert [each.state for each in list_invitations(store)] == ["expired", "closed"]
    with pytest.raises(StudyError, match="there is no invitation 9"):
        close_invitation(store, 9)


def test_id_of_a_recruitment_service_is_encrypted_and_takes_part_once(store: StudyStore) -> None:
    (invitation,) = create_invitations(store, [""], days=1, places=5)
    service = RecruitmentServiceIds("5f0e1d2c3b4a", "study-7", "session-9")
    pseudonym, _ = enrol_with_invitation(store, invitation.token, "woman", service=service)
    assert identity_file.read_identities(store.folder)[pseudonym].contact == service.participant_id
    with pytest.raises(InvitationError) as raised:
        enrol_with_invitation(store, invitation.token, "woman", service=service)
    assert raised.value.reason == "duplicate"
    assert list_invitations(store)[0].used == 1
    stored = b"".join(path.read_bytes() for path in store.folder.rglob("*") if path.is_file())
    assert service.participant_id.encode() not in stored
    assert invitation.token.encode() not in stored


def test_new_token_replaces_the_earlier_one(store: StudyStore) -> None:
    (invitation,) = create_invitations(store, [""], days=1)
    pseudonym, first = enrol_with_invitation(store, invitation.token, "woman")
    command = ["study", "invitations", str(store.folder), "--address", "https://study.example", "--new-link"]
    printed = CliRunner().invoke(app, [*command, pseudonym]).stdout.split()
    second = printed[0].removeprefix("https://study.example/#participant=")
    assert first != second
    assert read_pseudonyms_by_token_sha256(store) == {compute_token_sha256(second): pseudonym}
    assert CliRunner().invoke(app, [*command, "sub-002"]).exit_code == 1
    delete_participant(store, pseudonym)
    assert read_pseudonyms_by_token_sha256(store) == {}
    assert reason(store, invitation.token) == "full"
    assert store.database.find_integrity_errors() == []


@pytest.mark.parametrize(
    ("labels", "days", "places", "message"),
    [
        (["a", "a"], 1.0, 1, "used twice"),
        (["Ann Lee"], 1.0, 1, "not a valid label"),
        ([""], 0.0, 1, "valid for 0 days"),
        ([""], 1.0, 0, "has 0 places"),
    ],
)
def test_invalid_invitations_are_rejected(
    store: StudyStore, labels: list[str], days: float, places: int, message: str
) -> None:
    with pytest.raises(StudyError, match=message):
        create_invitations(store, labels, days=days, places=places)
    assert list_invitations(store) == []


def test_links_are_written_to_a_new_file(store: StudyStore, tmp_path: Path) -> None:
    (tmp_path / "in.csv").write_text("label,site\nrow-1,a\nrow-2,b\n")
    out = tmp_path / "out.csv"
    options = ["--address", "https://Study.example", "--out", str(out), "--labels", str(tmp_path / "in.csv")]
    invite = ["study", "invite", str(store.folder), *options]
    assert CliRunner().invoke(app, invite).exit_code == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["label"] for row in rows] == ["row-1", "row-2"]
    for row in rows:
        origin, _, token = row["link"].partition("/#invitation=")
        assert origin == "https://study.example"
        assert find_valid_invitation(store, token).label == row["label"]
    again = CliRunner().invoke(app, invite)
    assert again.exit_code == 1
    assert "file exists" in again.stderr
    assert len(list_invitations(store)) == 2
    listed = CliRunner().invoke(app, ["study", "invitations", str(store.folder), "--close", "1"])
    assert [word in listed.stdout for word in ("row-1", "closed", "open")] == [True] * 3


@pytest.mark.parametrize(
    "address",
    ["study.example", "http://study.example", "https://study.example/path", "https://a@b", "https://a:b", ""],
)
def test_other_addresses_are_rejected(address: str) -> None:
    with pytest.raises(ValueError, match=r"is not a public address|has no TLS"):
        parse_public_address(address)
    assert parse_public_address("http://localhost:8000/") == "http://localhost:8000"
