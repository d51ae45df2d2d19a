"""Consent: the archive of texts, changed texts, and re-consent to a new version."""

import csv
import hashlib
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from playwright.sync_api import expect, sync_playwright
from typer.testing import CliRunner, Result

from avrgym.analysis.participant_flow import compute_participant_flows
from avrgym.analysis.reading.study_data import StudyData
from avrgym.cli.main import app
from avrgym.recording.configuration import RecordedConsent
from avrgym.recording.reader import read_recording
from avrgym.study.checking.database_rebuild import rebuild_study_database
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.study_checks import check_study
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.export import export_study
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people.consents import find_latest_consent
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import (
    confirm_participation,
    decline_consent,
    enrol_participant,
    read_participant_texts,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.sessions.dry_run import DryRunSettings, find_or_enrol_participant
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.studies.small_studies import (
    eligible_answers,
    enrol_with_consent,
    make_study,
    run_participant,
    small_study,
)
from helpers.vr.visit import Visit, constant_policies, plan

PATIENCE_MS = 120_000
GERMAN = "Ich bin einverstanden."


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return small_study(tmp_path / "study")


@pytest.fixture
def store(folder: Path) -> Iterator[StudyStore]:
    with StudyStore(folder) as opened:
        yield opened


def study(*arguments: str | Path, answers: str = "") -> Result:
    return CliRunner().invoke(app, ["study", *map(str, arguments)], input=answers)


def reword(folder: Path, old: str, new: str, version: str = "1") -> None:
    """Change the consent text and its version."""
    path = folder / "study.toml"
    text = path.read_text()
    assert old in text
    text = re.sub(r'(?m)^version = ".*"', f'version = "{version}"', text.replace(old, new, 1), count=1)
    path.write_text(text)


def raise_version(folder: Path, version: str = "2") -> None:
    reword(folder, "You take part", "You fully take part", version)


def about_consent(folder: Path) -> list[Finding]:
    with StudyStore(folder) as store:
        return [each for each in check_study(store) if "consent" in f"{each.where} {each.message}"]


def wrong_about_consent(folder: Path) -> list[str]:
    return [each.message for each in about_consent(folder) if each.is_error]


def decisions(store: StudyStore, pseudonym: str) -> list[tuple[bool, str | None]]:
    return [(each.agreed, each.version) for each in store.read_consents(pseudonym)]


# The archive -------------------------------------------------------------------------------------------------


def test_consent_text_is_archived_once(store: StudyStore) -> None:
    first, second = enrol_with_consent(store), enrol_with_consent(store)
    (kept,) = store.read_consent_texts()
    assert kept.text == store.design.consent.text
    assert kept.sha256 == hashlib.sha256(kept.text.encode()).hexdigest()
    assert (kept.version, kept.language) == ("1", "en")
    for pseudonym in (first, second):
        (given,) = store.read_consents(pseudonym)
        assert (given.agreed, given.version, given.language, given.sha256) == (True, "1", "en", kept.sha256)
        assert given.decided_at == store.read_participant(pseudonym).consented_at
    assert about_consent(store.folder) == []


def test_consent_text_depends_on_language(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', languages='["en", "de"]')
    with StudyStore(folder) as store:
        for language in ("en", "de"):
            record_consent(store, enrol_participant(store, "man", language=language))
        texts = {kept.language: kept.text for kept in store.read_consent_texts()}
        for person in store.read_participants():
            assert texts[str(person.language)] == read_participant_texts(store, person).translate(
                store.design.consent.text
            )
        assert texts["de"] != texts["en"]
    assert about_consent(folder) == []


def test_changed_text_with_the_same_version_is_an_error(folder: Path) -> None:
    with StudyStore(folder) as store:
        first, second = enrol_with_consent(store), enrol_with_consent(store)
    reword(folder, "You take part", "You do not take part")
    (wrong,) = wrong_about_consent(folder)
    assert f"{first}, {second} read as version 1" in wrong
    assert study("check", folder).exit_code == 1
    with StudyStore(folder) as store:
        pseudonym = enrol_participant(store, "woman")
        with pytest.raises(StudyError, match=f"{first}, {second} read another consent text with version 1"):
            record_consent(store, pseudonym)
        assert store.read_participant(pseudonym).state == "enrolled"
        assert len(store.read_consent_texts()) == 1
    reword(folder, "You do not take part", "You take part")
    assert about_consent(folder) == []


def test_changed_translation_concerns_only_its_readers(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', languages='["en", "de"]')
    with StudyStore(folder) as store:
        enrol_with_consent(store)
        german = enrol_participant(store, "man", language="de")
        record_consent(store, german)
        text = " ".join(store.design.consent.text.split())
    (folder / "texts").mkdir()
    (folder / "texts" / "de.toml").write_text(f"[sentences]\n{json.dumps(text)} = {json.dumps(GERMAN)}\n")
    (wrong,) = wrong_about_consent(folder)
    assert wrong.startswith(f"[consent] in de differs from the text that {german} read")


def test_line_breaks_do_not_change_a_text(folder: Path) -> None:
    with StudyStore(folder) as store:
        enrol_with_consent(store)
    reword(folder, "You take part", "You\ntake part")
    assert about_consent(folder) == []
    with StudyStore(folder) as store:
        enrol_with_consent(store)
        assert (
            len(
                {
                    each.sha256
                    for person in store.read_participants()
                    for each in store.read_consents(str(person))
                }
            )
            == 1
        )


def test_changed_text_with_a_new_version_is_valid(folder: Path) -> None:
    with StudyStore(folder) as store:
        enrol_with_consent(store)
    raise_version(folder)
    assert about_consent(folder) == []
    with StudyStore(folder) as store:
        enrol_with_consent(store)
        assert [kept.version for kept in store.read_consent_texts()] == ["1", "2"]
    assert about_consent(folder) == []


def test_changed_archive_is_found(store: StudyStore) -> None:
    enrol_with_consent(store)
    with store.database.write_transaction() as connection:
        hash_chain.update_row(connection, schema.CONSENT_TEXT_TABLE, 1, text="I agree to everything")
    assert "was changed: its checksum differs from the stored checksum" in [
        each.message for each in about_consent(store.folder) if each.where == "consent_text 1"
    ]


# Asking again ------------------------------------------------------------------------------------------------


def test_allocated_participant_must_reconsent(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
        run_participant(store, pseudonym, trials=2)
        before = store.read_participant(pseudonym)
    raise_version(folder)
    with StudyStore(folder) as store:
        for begin in (open_session, StudyVisit):
            with pytest.raises(
                StudyError, match=r"agreed to version 1 .*; the current version is 2: re-consent"
            ):
                begin(store, pseudonym)
        assert len(store.read_sessions(pseudonym)) == 1
        record_consent(store, pseudonym)
        after = store.read_participant(pseudonym)
        assert (after.state, after.cell, after.consent_version) == ("allocated", before.cell, "2")
        assert decisions(store, pseudonym) == [(True, "1"), (True, "2")]
        assert [each.text for each in store.read_consent_texts()][1] == store.design.consent.text
        run_participant(store, pseudonym)
        assert store.read_participant(pseudonym).state == "completed"
        with pytest.raises(StudyError, match="is completed and cannot become consented"):
            record_consent(store, pseudonym)
        assert [
            (
                flow.participants_by_consent_version,
                flow.reconsented_participant_count,
                flow.declined_consent_count,
            )
            for flow in compute_participant_flows(store, StudyData())
        ] == [({"2": 1}, 1, 0)]
    assert about_consent(folder) == []


def test_declined_reconsent_withdraws(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
        run_participant(store, pseudonym, trials=2)
    raise_version(folder)
    with StudyStore(folder) as store:
        decline_consent(store, pseudonym)
        assert store.read_participant(pseudonym).state == "withdrawn"
        assert store.read_participant(pseudonym).consent_version == "1"
        assert decisions(store, pseudonym) == [(True, "1"), (False, "2")]
        assert len(store.read_attempts(pseudonym)) == 2
        assert store.read_events()[-1].detail == "does not agree to version 2"
        (flow,) = compute_participant_flows(store, StudyData())
        assert (
            flow.participants_by_consent_version,
            flow.reconsented_participant_count,
            flow.declined_consent_count,
        ) == ({"1": 1}, 0, 1)
        delete_participant(store, pseudonym)
        assert store.read_consents(pseudonym) == []
        assert len(store.read_consent_texts()) == 2
    assert about_consent(folder) == []


def test_no_reconsent_without_a_new_version(store: StudyStore) -> None:
    enrolled, allocated = enrol_participant(store, "man"), enrol_with_consent(store)
    for pseudonym in (enrolled, allocated):
        with pytest.raises(StudyError, match="needs no re-consent"):
            decline_consent(store, pseudonym)
    with pytest.raises(StudyError, match="is allocated and cannot become consented"):
        record_consent(store, allocated)


def test_consented_participant_must_reconsent_before_allocation(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_participant(store, "woman")
        record_consent(store, pseudonym)
    raise_version(folder)
    with StudyStore(folder) as store:
        with pytest.raises(StudyError, match="re-consent"):
            record_inclusion_answers(store, pseudonym, eligible_answers(store))
        record_consent(store, pseudonym)
        assert record_inclusion_answers(store, pseudonym, eligible_answers(store))


@pytest.mark.slow
def test_command_requests_reconsent(folder: Path) -> None:
    with StudyStore(folder) as store:
        agreeing, declining = (
            enrol_with_consent(store, simulated=False),
            enrol_with_consent(store, simulated=False),
        )
    raise_version(folder)
    agreed = study("consent", folder, agreeing, answers="y\n")
    assert agreed.exit_code == 0
    assert "You fully take part" in agreed.stdout
    assert f"{agreeing} agrees to version 2" in agreed.stdout
    undecided = study("consent", folder, declining, answers="n\nn\n")
    assert (undecided.exit_code, undecided.stderr.count("Nothing was stored")) == (1, 1)
    declined = study("consent", folder, declining, answers="n\ny\n")
    assert declined.exit_code == 0
    with StudyStore(folder) as store:
        assert [person.state for person in store.read_participants()] == ["allocated", "withdrawn"]


def test_command_shows_text_in_the_language_of_the_participant(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', languages='["en", "de"]')
    with StudyStore(folder) as store:
        german = enrol_participant(store, "man", language="de")
        texts, design = read_participant_texts(store, store.read_participant(german)), store.design
    asked = study("consent", folder, german, answers="y\n" * (1 + len(design.inclusion)))
    assert texts.translate(design.consent.text).strip().splitlines()[0] in asked.stdout
    assert all(texts.translate(question.text) in asked.stdout for question in design.inclusion)


def test_dry_run_continues_with_a_new_version(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = find_or_enrol_participant(store, 0, DryRunSettings(1))
    raise_version(folder)
    with StudyStore(folder) as store:
        assert find_or_enrol_participant(store, 0, DryRunSettings(1)) == pseudonym
        assert decisions(store, pseudonym) == [(True, "1"), (True, "2")]
        open_session(store, pseudonym)


# Where consents go -------------------------------------------------------------------------------------------


def test_exports_contain_all_decisions_and_texts(folder: Path, tmp_path: Path) -> None:
    with StudyStore(folder) as store:
        again, declining = enrol_with_consent(store), enrol_with_consent(store)
    raise_version(folder)
    with StudyStore(folder) as store:
        record_consent(store, again)
        decline_consent(store, declining)
        export_study(store, "csv", tmp_path / "csv")
        kept = {each.sha256: each.text for each in store.read_consent_texts()}
    with open(tmp_path / "csv" / "consents.csv", encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["participant"], row["decision"], row["version"], row["agreed"]) for row in rows] == [
        (again, "1", "1", "true"),
        (again, "2", "2", "true"),
        (declining, "1", "1", "true"),
        (declining, "2", "2", "false"),
    ]
    for row in rows:
        data = (tmp_path / "csv" / row["text"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == row["sha256"]
        assert data.decode() == kept[row["sha256"]]


def before_the_archive(store: StudyStore) -> None:
    """Convert a study to an earlier version that stored no consent texts."""
    with store.database.write_transaction() as connection:
        hash_chain.delete_rows(connection, schema.CONSENT_TEXT_TABLE)
        hash_chain.delete_rows(connection, schema.CONSENT_TABLE)
        hash_chain.delete_rows(connection, schema.DESIGN_TABLE)
    with store.database.write_transaction() as connection:
        for table in ("invitation_use", "invitation", "link", "consent", "consent_text", "design"):
            connection.execute(sa.text(f"DROP TABLE {table}"))
        for table in ("participant", "attempt"):
            connection.execute(sa.text(f"ALTER TABLE {table} DROP COLUMN input_profile"))
        for table in ("participant", "answer"):
            connection.execute(sa.text(f"ALTER TABLE {table} DROP COLUMN respondent"))
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '0008_log'"))
    store.close()


def test_consents_of_earlier_versions_are_notes(folder: Path) -> None:
    store = StudyStore(folder)
    pseudonym = enrol_with_consent(store)
    given = store.read_consents(pseudonym)
    before_the_archive(store)
    with StudyStore(folder) as store:
        assert store.read_consents(pseudonym) == given
        (found,) = [each for each in check_study(store) if each.where == "consent"]
        assert (found.message, found.is_error) == (
            f"the archive lacks the consent text of {pseudonym}",
            False,
        )
        record_consent(store, enrol_participant(store, "man"))
    assert about_consent(folder) == []
    reword(folder, "You take part", "You never take part")
    assert pseudonym in wrong_about_consent(folder)[0]


def test_unarchived_consent_to_a_different_text_is_an_error(folder: Path) -> None:
    store = StudyStore(folder)
    pseudonym = enrol_with_consent(store)
    before_the_archive(store)
    reword(folder, "You take part", "You never take part")
    assert [each.is_error for each in about_consent(folder)] == [True, False]
    assert pseudonym in wrong_about_consent(folder)[0]
    with (
        StudyStore(folder) as store,
        pytest.raises(StudyError, match=f"{pseudonym} read another consent text"),
    ):
        record_consent(store, enrol_participant(store, "man"))


@pytest.mark.slow
def test_recordings_contain_the_consent(folder: Path) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
    raise_version(folder)
    with StudyStore(folder) as store:
        record_consent(store, pseudonym)
        latest = store.read_consents(pseudonym)[-1]
        with StudyVisit(store, pseudonym) as visit:
            attended = Visit(
                Path(),
                visit.plan_remaining_trials(),
                make=lambda send: visit.create_session(visit.plan_remaining_trials(), send),
            )
            attended.go_to("trial")
            attended.leave()
    (recording,) = sorted(folder.rglob("*.mcap"))
    consent = read_recording(recording).configuration.consent
    assert consent == RecordedConsent(latest.decided_at, "2", "en", latest.sha256)


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.fast_cases(1)
def test_rebuild_restores_consents_from_recordings(folder: Path, recorded: bool) -> None:
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
        before = store.read_consents(pseudonym)
        run_participant(store, pseudonym, trials=4, consent=find_latest_consent(before) if recorded else None)
    for name in ("study.db", "study.db.sha256", "participation.jsonl"):
        (folder / name).unlink()
    rebuild_study_database(folder)
    with StudyStore(folder) as store:
        assert len(store.read_consents(pseudonym)) == recorded
        confirm_participation(store, pseudonym, "consent form in folder 2")
        (again,) = store.read_consents(pseudonym)
        if recorded:
            assert [again] == before
            assert store.read_participant(pseudonym).consent_version == "1"
            assert [kept.text for kept in store.read_consent_texts()] == [store.design.consent.text]
        else:
            assert (again.agreed, again.version, again.sha256) == (True, None, None)
        run_participant(store, pseudonym)
    not_archived = f"the archive lacks the consent text of {pseudonym}"
    assert [each.message for each in about_consent(folder) if each.where == "consent"] == (
        [] if recorded else [not_archived]
    )
    assert wrong_about_consent(folder) == []


def test_merged_study_contains_consents_of_sites(tmp_path: Path) -> None:
    folders = [
        make_study(tmp_path / site, tasks='["Feeding"]', site=f'"{site}"') for site in ("here", "there")
    ]
    reword(folders[1], "You take part", "You gladly take part")
    for folder in folders:
        with StudyStore(folder) as store:
            enrol_with_consent(store)
    merge_studies(folders, tmp_path / "all", accept_differences=True)
    with StudyStore(tmp_path / "all") as merged, StudyStore(folders[1]) as there:
        (given,) = merged.read_consents("sub-2001")
        assert given.sha256 == there.read_consents("sub-001")[0].sha256
        assert len(merged.read_consent_texts()) == 2
        assert [each for each in check_study(merged) if each.where == "consent"] == []


def test_different_texts_of_one_site_are_an_error(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "here", tasks='["Feeding"]', site='"here"')
    other = make_study(tmp_path / "there", tasks='["Feeding"]', site='"there"')
    with StudyStore(other) as store:
        enrol_with_consent(store)
    with StudyStore(folder) as store:
        first = enrol_with_consent(store)
        second = enrol_with_consent(store)
        withdraw_participant(store, second)
        with store.database.write_transaction() as connection:
            text = {"version": "1", "language": "en", "text": "Another", "first_used_at": "2026-01-01"}
            sha256 = hashlib.sha256(b"Another").hexdigest()
            hash_chain.insert_row(connection, schema.CONSENT_TEXT_TABLE, sha256=sha256, **text)
            hash_chain.update_row(
                connection, schema.CONSENT_TABLE, store.read_consents(second)[0].id, sha256=sha256
            )
    assert first
    merge_studies([folder, other], tmp_path / "all")
    (wrong,) = wrong_about_consent(tmp_path / "all")
    assert wrong == "sub-1001 and sub-1002 read different texts with the same version 1"


# In the browser ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_dashboard_requests_reconsent(folder: Path, tmp_path: Path) -> None:
    with StudyStore(folder) as store:
        agreeing, declining = (
            enrol_with_consent(store, simulated=False),
            enrol_with_consent(store, simulated=False),
        )
    raise_version(folder)
    with (
        StudyStore(folder) as store,
        LiveServer(
            lambda send: Session(plan(), constant_policies(plan()), tmp_path / "r", send, "test"),
            "127.0.0.1",
            0,
            study=lambda tokens, _session: make_dashboard_app(store, tokens),
        ) as server,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page(viewport={"width": 900, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        page.goto(server.list_page_urls("dashboard?detail=light", server.tokens.experimenter)[0])
        page.get_by_role("button", name=agreeing).click()
        expect(page.locator("#participant-words")).to_contain_text("new version of the text")
        expect(page.locator("#consent-text")).to_contain_text("You fully take part")
        expect(page.locator("#begin")).to_be_hidden()
        page.get_by_label("They have read version 2 and agree").check()
        page.get_by_role("button", name="Record consent").click()
        expect(page.locator("#begin")).to_be_visible()
        page.get_by_role("button", name=declining).click()
        page.get_by_label("do not agree").check()
        page.get_by_role("button", name="Withdraw them").click()
        expect(page.get_by_role("row", name=declining)).to_contain_text("withdrawn")
        assert decisions(store, agreeing) == [(True, "1"), (True, "2")]
        assert decisions(store, declining) == [(True, "1"), (False, "2")]
        browser.close()
