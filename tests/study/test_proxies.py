"""Consent of a representative, assent of the participant, and answers by a proxy."""

import csv
from pathlib import Path

import pytest

from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.study_analysis import analyse_study
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.study.checking.study_checks import check_study
from avrgym.study.export import export_study
from avrgym.study.people.consents import find_missing_consent_role
from avrgym.study.people.participant_respondents import set_respondent
from avrgym.study.people.participants import (
    decline_consent,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
)
from avrgym.study.sessions.study_visit import plan_session
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import eligible_answers, enrol_with_consent, run_participant, small_study


@pytest.fixture(autouse=True)
def sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture
def store(tmp_path: Path) -> StudyStore:
    return StudyStore(small_study(tmp_path / "study"))


@pytest.mark.parametrize("order", [("proxy", "assent"), ("assent", "proxy")])
def test_proxy_consent_and_assent_are_two_records(store: StudyStore, order: tuple[str, str]) -> None:
    """The participant takes part only with both. The plan of the session contains both."""
    name = enrol_participant(store, "woman", simulated=True)
    assert not record_consent(store, name, order[0])
    assert store.read_participant(name).state == "enrolled"
    assert find_missing_consent_role(store.read_consents(name), "1") == order[1]
    with pytest.raises(StudyError):
        record_inclusion_answers(store, name, eligible_answers(store))
    assert record_consent(store, name, order[1])
    assert [each.role for each in store.read_consents(name)] == list(order)
    assert find_missing_consent_role(store.read_consents(name), "1") == ""
    record_inclusion_answers(store, name, eligible_answers(store))
    plan = plan_session(store, name)
    assert plan.consent is not None
    assert plan.proxy_consent is not None
    assert (plan.consent.role, plan.proxy_consent.role) == ("assent", "proxy")
    assert not [each for each in check_study(store) if each.is_error]


def test_a_participant_who_does_not_assent_withdraws(store: StudyStore) -> None:
    name = enrol_participant(store, "woman")
    record_consent(store, name, "proxy")
    with pytest.raises(StudyError):
        decline_consent(store, name)  # there is no new version to decline
    decline_consent(store, name, "assent")
    assert store.read_participant(name).state == "withdrawn"
    assert [(each.role, each.agreed) for each in store.read_consents(name)] == [
        ("proxy", True),
        ("assent", False),
    ]


def test_a_new_version_needs_both_again(store: StudyStore) -> None:
    name = enrol_participant(store, "woman")
    record_consent(store, name, "proxy")
    record_consent(store, name, "assent")
    design = store.folder / "study.toml"
    design.write_text(
        design.read_text().replace('version = "1"', 'version = "2"').replace("You take", "Now you take")
    )
    with StudyStore(store.folder) as again:
        assert not record_consent(again, name, "assent")
        assert again.read_participant(name).must_reconsent("2")
        assert record_consent(again, name, "proxy")
        assert not again.read_participant(name).must_reconsent("2")


def test_unknown_roles_and_respondents_are_refused(store: StudyStore) -> None:
    name = enrol_participant(store, "woman")
    with pytest.raises(StudyError, match="allowed: participant, proxy, assent"):
        record_consent(store, name, "mother")
    with pytest.raises(StudyError, match="allowed: participant, proxy"):
        set_respondent(store, name, "caregiver")
    assert store.read_consents(name) == []
    assert store.read_participant(name).respondent is None


@pytest.mark.slow
def test_answers_by_proxy_are_marked_in_every_table_and_in_the_report(
    store: StudyStore, tmp_path: Path
) -> None:
    """The first participant answers, a proxy answers half of the second participant's questions."""
    names = [enrol_with_consent(store) for _ in range(2)]
    run_participant(store, names[0])
    run_participant(store, names[1], trials=3)
    set_respondent(store, names[1], PROXY_RESPONDENT)
    run_participant(store, names[1], respondent=PROXY_RESPONDENT)
    given = store.read_answers(names[1])
    by_proxy = [each for each in given if each.respondent == PROXY_RESPONDENT]
    assert 0 < len(by_proxy) < len(given)
    assert all(each.respondent is None for each in store.read_answers(names[0]))
    analysis = analyse_study(store)
    assert sum(row.respondent == PROXY_RESPONDENT for row in analysis.study_data.answers) == len(by_proxy)
    whole = [row for row in analysis.answer_summaries if (row.task, row.robot) == ("all", "all")]
    assert sum(row.by_proxy for row in whole) == len(by_proxy)
    assert sum(row.by_proxy for row in analysis.answer_frequencies) == len(by_proxy)
    assert all(0 <= row.by_proxy <= row.count for row in analysis.answer_frequencies)
    out = tmp_path / "analysis"
    write_analysis(analysis, store.folder, out)
    assert f"A proxy gave {len(by_proxy)} of" in (out / "report" / "index.html").read_text()
    assert f"{len(by_proxy)} of" in (out / "figures" / "likert-simulated.svg").read_text()
    for table in ("answers", "subjective", "likert"):
        with (out / "tables" / f"{table}.csv").open() as file:
            assert {"respondent", "by_proxy"} & set(next(csv.reader(file)))
    export_study(store, "csv", tmp_path / "csv")
    with (tmp_path / "csv" / "answers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert sum(row["respondent"] == PROXY_RESPONDENT for row in rows) == len(by_proxy)
