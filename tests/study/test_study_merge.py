"""Merges of studies are complete, contain each participant once, and continue after interruptions."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from avrgym.analysis.plan import list_required_tests, suggest_hypotheses
from avrgym.study.checking.design_checks import check_design
from avrgym.study.checking.study_checks import check_study
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people import participant_deletion
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import (
    add_note,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.plan.frozen_plan import adopt_frozen_plan, freeze_analysis_plan, read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import find_deviations
from avrgym.study.plan.plan_template import write_plan_template
from avrgym.study.storage import database
from avrgym.study.storage.attempts import begin_attempt, end_incomplete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.sites import (
    add_participant,
    check_errors,
    files_in,
    kill_merge,
    make_site,
    set_in_design,
    study_contents,
)
from helpers.studies.small_studies import (
    eligible_answers,
    new_postgresql_database,
    record,
    small_study,
)
from helpers.system.paths import DATA


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sites: atlanta with two participants, and berlin with one and no name in its design."""
    folder = tmp_path_factory.mktemp("sites")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        make_site(folder / "a", "atlanta", trials=(None, 2))
        make_site(folder / "berlin", trials=(1,))
    return folder


@pytest.fixture
def sites(made: Path, tmp_path: Path) -> list[Path]:
    return [Path(shutil.copytree(made / name, tmp_path / name)) for name in ("a", "berlin")]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "all"


def without_keys(store: StudyStore, pseudonym: str) -> list:
    """The data of a participant without ids."""
    trials = [
        (each.position, each.environment, each.seed, each.state) for each in store.read_trials(pseudonym)
    ]
    attempts = [
        (each.number, each.state, each.sha256, each.metrics, store.resolve_path(each.recording).read_bytes())
        for each in store.read_attempts(pseudonym)
    ]
    answers = [(each.item, each.value, each.answered_at) for each in store.read_answers(pseudonym)]
    number = store.read_participant(pseudonym).number
    events = [(each.recorded_at, each.name) for each in store.read_events() if each.participant == number]
    return [trials, attempts, answers, events, [note.text for note in store.read_notes(pseudonym)]]


@pytest.mark.slow
def test_merge_contains_each_participant_once(sites: list[Path], out: Path) -> None:
    before = [files_in(site) for site in sites]
    found = merge_studies(sites, out)
    assert [(each.site_name, each.pseudonym_range) for each in found] == [
        ("atlanta", "sub-1001 to sub-1002"),
        ("berlin", "sub-2001"),
    ]
    with StudyStore(out) as store, StudyStore(sites[0]) as atlanta, StudyStore(sites[1]) as berlin:
        people = [(each.pseudonym, each.site, each.pseudonym_at_site) for each in store.read_participants()]
        assert people == [
            ("sub-1001", "atlanta", "sub-001"),
            ("sub-1002", "atlanta", "sub-002"),
            ("sub-2001", "berlin", "sub-001"),
        ]
        for pseudonym, site, there in people:
            source = atlanta if site == "atlanta" else berlin
            assert there is not None
            assert without_keys(store, pseudonym) == without_keys(source, there)
    assert check_errors(out) == []
    assert [files_in(site) for site in sites] == before


def test_names_stay_at_the_sites(sites: list[Path], out: Path) -> None:
    merge_studies(sites, out)
    assert not (out / "private").exists()
    assert [name for name, data in files_in(out).items() if b"Unverwechselbar" in data] == []


def test_merging_again_changes_nothing(sites: list[Path], out: Path) -> None:
    merge_studies(sites, out)
    before = files_in(out)
    again = merge_studies(sites[::-1], out)
    assert [(each.written_row_count, each.copied_recording_count) for each in again] == [(0, 0), (0, 0)]
    assert files_in(out) == before


@pytest.mark.slow
def test_second_merge_adds_new_data(sites: list[Path], out: Path, tmp_path: Path) -> None:
    merge_studies(sites, out)
    before = study_contents(out)
    merge_studies([make_site(tmp_path / "c", "cairo")], out)
    after = study_contents(out)
    assert sorted(after) == [*sorted(before), "sub-3001"]
    assert {name: after[name] for name in before} == before
    add_participant(sites[0], 1)
    with StudyStore(sites[1]) as store:
        withdraw_participant(store, "sub-001", "felt sick")
    merge_studies(sites, out)
    with StudyStore(out) as store:
        states = {each.pseudonym: each.state for each in store.read_participants()}
    assert states == {
        "sub-1001": "completed",
        "sub-1002": "allocated",
        "sub-1003": "allocated",
        "sub-2001": "withdrawn",
        "sub-3001": "allocated",
    }
    assert check_errors(out) == []


def test_merge_deletes_participants_deleted_at_a_site(sites: list[Path], out: Path) -> None:
    with StudyStore(sites[0]) as store:
        add_note(store, "sub-001", "she-laughed-out-loud")
    merge_studies(sites, out)
    with StudyStore(sites[0]) as store:
        delete_participant(store, "sub-001")
    assert merge_studies(sites, out)[0].deleted_participant_count == 1
    assert "sub-1001" not in study_contents(out)
    assert [name for name, data in files_in(out).items() if b"laughed" in data or "sub-1001" in name] == []
    assert check_errors(out) == []


@pytest.mark.slow
def test_interrupted_deletion_is_completed_by_the_next_merge(
    sites: list[Path], out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    merge_studies(sites, out)
    with StudyStore(sites[0]) as store:
        delete_participant(store, "sub-001")
    with monkeypatch.context() as broken:
        broken.setattr(participant_deletion, "remove_recordings", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            merge_studies(sites, out)
    merge_studies(sites, out)
    assert [name for name in files_in(out) if "sub-1001" in name] == []
    assert check_errors(out) == []


def test_deletion_in_a_merged_study_is_permanent(sites: list[Path], out: Path) -> None:
    merge_studies(sites, out)
    with StudyStore(out) as store:
        delete_participant(store, "sub-2001")
    merge_studies(sites, out)
    assert sorted(study_contents(out)) == ["sub-1001", "sub-1002"]
    assert not (out / "recordings" / "sub-2001").exists()
    assert check_errors(out) == []


def test_merged_study_has_no_sessions_of_its_own(sites: list[Path], out: Path) -> None:
    merge_studies(sites, out)
    before = study_contents(out)
    with StudyStore(out) as store:
        for action in (
            lambda: enrol_participant(store, "man"),
            lambda: open_session(store, "sub-1002"),
            lambda: withdraw_participant(store, "sub-1002"),
            lambda: add_note(store, "sub-1002", "x"),
        ):
            with pytest.raises(
                StudyError, match="merged from sites: change the study of the site, then merge again"
            ):
                action()
    assert study_contents(out) == before


def test_open_session_is_updated_by_the_next_merge(sites: list[Path], out: Path) -> None:
    with StudyStore(sites[0]) as store:
        session = open_session(store, "sub-002")
        trial = store.read_remaining_trials("sub-002")[0]
        attempt = begin_attempt(store, session.id, trial.position)
        store.resolve_path(attempt.recording).write_bytes(b"the beginning")
        merge_studies(sites, out)
        assert study_contents(out)["sub-1002"][3][-1].state == "running"
        assert check_errors(out) == []
        store.resolve_path(attempt.recording).unlink()
        record(store, attempt, trial, simulated=False)
        end_incomplete_attempt(store, attempt.id, "stopped")
        close_session(store, session.id)
    merge_studies(sites, out)
    with StudyStore(out) as merged, StudyStore(sites[0]) as site:
        assert without_keys(merged, "sub-1002") == without_keys(site, "sub-002")
    assert check_errors(out) == []


def test_study_of_an_earlier_version_is_merged(tmp_path: Path, out: Path) -> None:
    old = Path(shutil.copytree(DATA / "study-of-0.2.0", tmp_path / "old"))
    merge_studies([old], out)
    with StudyStore(old) as store, StudyStore(out) as merged:
        for person in store.read_participants():
            there = f"sub-1{person.pseudonym.removeprefix('sub-')}"
            assert without_keys(merged, there) == without_keys(store, person.pseudonym)
    assert check_errors(out) == []


def test_sites_with_a_shared_database_are_blocks(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "study")) as store:
        for number in range(8):
            pseudonym = enrol_participant(store, "woman", site="berlin" if number % 2 else "atlanta")
            record_consent(store, pseudonym)
            record_inclusion_answers(store, pseudonym, eligible_answers(store))
        cells = [(each.site, each.cell) for each in store.read_participants()]
        assert sorted(cells) == [(site, cell) for site in ("atlanta", "berlin") for cell in range(4)]
        with pytest.raises(StudyError, match="'a b' is not a valid site; allowed: at most 40 letters"):
            enrol_participant(store, "man", site="a b")


def test_translations_are_merged_and_must_agree(tmp_path: Path, out: Path) -> None:
    sites = [make_site(tmp_path / name, name, trials=()) for name in ("a", "b")]
    for site, german in zip(sites, ("Probieren Sie.", "Kosten Sie."), strict=True):
        set_in_design(site, 'languages = ["en"]', 'languages = ["en", "de"]')
        design = site / "study.toml"
        design.write_text(design.read_text().replace("Eat the food from the spoon.", "Taste it."))
        (site / "texts").mkdir()
        (site / "texts" / "de.toml").write_text(f'[sentences]\n"Taste it." = "{german}"\n')
    words = 'texts in de.sentences.Taste it. is "Probieren Sie." at a, "Kosten Sie." at b; use --accept-differences'
    with pytest.raises(StudyError, match=re.escape(words)):
        merge_studies(sites, out)
    shutil.copy(sites[0] / "texts" / "de.toml", sites[1] / "texts")
    merge_studies(sites, out)
    with StudyStore(out) as store:
        assert store.design.goals["Feeding"] == "Taste it."
    assert (out / "texts" / "de.toml").read_bytes() == (sites[0] / "texts" / "de.toml").read_bytes()


# What is refused


def _twice(sites: list[Path]) -> list[Path]:
    return [sites[0], sites[0]]


def _copied(sites: list[Path]) -> list[Path]:
    copy = Path(shutil.copytree(sites[1], sites[1].with_name("boston")))
    return [sites[1], copy]


def _same_name(sites: list[Path]) -> list[Path]:
    set_in_design(sites[1], 'site = ""', 'site = "atlanta"')
    return sites


def _no_name(sites: list[Path]) -> list[Path]:
    return [sites[1].rename(sites[1].with_name("our site"))]


def _nothing(sites: list[Path]) -> list[Path]:
    (sites[0].parent / "empty").mkdir()
    return [sites[0], sites[0].parent / "empty"]


def _longer_trials(sites: list[Path]) -> list[Path]:
    shutil.rmtree(sites[1])
    make_site(sites[1], trials=())
    set_in_design(sites[1], "trial_steps = 200", "trial_steps = 100")
    StudyStore(sites[1]).close()
    return sites


def _other_policies(sites: list[Path]) -> list[Path]:
    shutil.rmtree(sites[1])
    make_site(sites[1], trials=())
    set_in_design(sites[1], 'policies = ["original", "revised"]', 'policies = ["revised"]')
    StudyStore(sites[1]).close()
    return sites


def _edited(sites: list[Path]) -> list[Path]:
    with StudyStore(sites[1]) as store, store.database._engine.begin() as connection:
        connection.exec_driver_sql("UPDATE trial SET seed = 1")
    return sites


REFUSED: list[tuple[Callable[[list[Path]], list[Path]], str]] = [
    (_twice, "are the same site; list each site once"),
    (_copied, "are the same site; list each site once"),
    (_same_name, "have the same site 'atlanta'; set different values"),
    (_no_name, "'our site' is not a valid site name; set `site`"),
    (_nothing, "empty contains no study.toml"),
    (
        _longer_trials,
        r"trial_steps is 200 at atlanta \(line 25\), 100 at berlin \(line 25\); use --accept-differences",
    ),
    (_other_policies, "tasks, robots and policies of all sites must be equal"),
    (_edited, "was changed by another program: .*; run `avrgym study check"),
]


@pytest.mark.fast_cases(4)
@pytest.mark.parametrize(("prepare", "words"), REFUSED)
def test_invalid_sites_are_rejected(
    sites: list[Path], out: Path, prepare: Callable[[list[Path]], list[Path]], words: str
) -> None:
    given = prepare(sites)
    before = [files_in(site) for site in given]
    with pytest.raises(StudyError, match=words) as refused:
        merge_studies(given, out)
    assert "\n" not in str(refused.value)
    assert not out.exists()
    assert [files_in(site) for site in given] == before


def test_other_output_folders_are_rejected(sites: list[Path], tmp_path: Path) -> None:
    for name, out in {
        "another study": make_site(tmp_path / "another", "delhi"),
        "a design": small_study(tmp_path / "design"),
        "a site": sites[0],
        "in a site": sites[0] / "all",
        "a file": sites[0] / "study.toml",
    }.items():
        before = files_in(tmp_path)
        with pytest.raises(StudyError, match=r"contains other files|in the folder of a site|is a file"):
            merge_studies(sites, out)
        assert files_in(tmp_path) == before, name


def test_merged_study_is_not_accepted_as_a_site(sites: list[Path], out: Path, tmp_path: Path) -> None:
    merge_studies(sites, out)
    with pytest.raises(StudyError, match="was merged from sites; merge these sites instead"):
        merge_studies([out], tmp_path / "more")


def test_restored_or_renamed_site_is_rejected(sites: list[Path], out: Path, tmp_path: Path) -> None:
    older = Path(shutil.copytree(sites[1], tmp_path / "older" / "berlin"))
    add_participant(sites[1], 1)
    merge_studies(sites, out)
    before = files_in(out)
    with pytest.raises(StudyError, match="'berlin' differs from the merged study, or is an older copy"):
        merge_studies([older], out)
    with pytest.raises(StudyError, match="contains its participant sub-001 under another site"):
        merge_studies([sites[1].rename(tmp_path / "bonn")], out)
    other = make_site(tmp_path / "another" / "berlin")
    with pytest.raises(StudyError, match="'berlin' differs from the merged study"):
        merge_studies([other], out)
    assert files_in(out) == before


def test_database_url_variable_is_rejected(
    sites: list[Path], out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(database.DATABASE_URL_VARIABLE, "postgresql://user@host/name")
    with pytest.raises(StudyError, match="would replace the database of each site: unset it"):
        merge_studies(sites, out)


def test_accepted_differences_are_reported(sites: list[Path], out: Path) -> None:
    set_in_design(sites[1], "free_movement_s = 5.0", "free_movement_s = 4.0")
    told: list[str] = []
    for _ in range(2):
        merge_studies(sites, out, accept_differences=True, report=told.append)
    assert told[0] == "study.toml: free_movement_s is 5.0 at atlanta (line 28), 4.0 at berlin (line 28)"
    with StudyStore(out) as store:
        notes = [each for each in check_study(store) if each.where == "sites"]
    assert [(each.is_error, each.message) for each in notes] == [(False, f"were merged although {told[0]}")]


# Damage


def test_damaged_recordings_are_skipped_on_request(sites: list[Path], out: Path) -> None:
    damaged, missing = sorted((sites[0] / "recordings" / "sub-002").rglob("*.mcap"))
    whole = damaged.read_bytes(), missing.read_bytes()
    damaged.write_bytes(whole[0][:-1])
    missing.unlink()
    with pytest.raises(StudyError, match="sub-002/ses-01/trial-01") as refused:
        merge_studies(sites, out)
    assert "trial-02_attempt-1.mcap is missing; use --skip-damaged to omit" in str(refused.value)
    assert not out.exists()
    told: list[str] = []
    merge_studies(sites, out, skip_damaged=True, report=told.append)
    assert len(told) == 2
    assert check_errors(out) == []
    with StudyStore(out) as store:
        left_out = [each.message for each in check_study(store) if "omitted" in each.message]
    assert len(left_out) == 2
    damaged.write_bytes(whole[0])
    missing.write_bytes(whole[1])
    assert merge_studies(sites, out)[0].copied_recording_count == 2
    with StudyStore(out) as store:
        assert not [each for each in check_study(store) if "omitted" in each.message]


@pytest.mark.slow
def test_next_merge_restores_damaged_recordings(sites: list[Path], out: Path) -> None:
    merge_studies(sites, out)
    first, second, *_ = sorted((out / "recordings").rglob("*.mcap"))
    whole = files_in(out)
    first.write_bytes(first.read_bytes()[:-1])
    second.unlink()
    found = check_errors(out)
    assert f"{first.relative_to(out)}: was changed: its checksum differs" in found
    assert f"{second.relative_to(out)}: is missing" in found
    merge_studies(sites, out)
    assert files_in(out) == whole
    with StudyStore(out) as store, store.database._engine.begin() as connection:
        connection.exec_driver_sql("UPDATE participant SET site = 'berlin' WHERE number = 1001")
    assert any("participant 1001: was changed by another program" in each for each in check_errors(out))


# Kills


@pytest.mark.slow
def test_killed_merge_is_completed_by_the_next(sites: list[Path], out: Path, tmp_path: Path) -> None:
    """Kills at some of the 20 points of the soak test: creation, copies and rows."""
    merge_studies(sites, tmp_path / "whole")
    for step in (0, 4, 30):
        assert kill_merge(sites, out, step)
        if out.exists():
            assert all(each in study_contents(tmp_path / "whole") for each in study_contents(out))
    merge_studies(sites, out)
    assert study_contents(out) == study_contents(tmp_path / "whole")
    assert check_errors(out) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "all", "berlin", "whole"]


# Plans and databases


def test_sites_share_a_frozen_plan(out: Path, tmp_path: Path) -> None:
    a, b = (make_site(tmp_path / name, name, trials=()) for name in ("a", "b"))
    with StudyStore(a) as store:
        write_plan_template(
            a, store.design, list_required_tests(store.design), suggest_hypotheses(store.design)
        )
        freeze_analysis_plan(store, list_required_tests(store.design))
    add_participant(a, 1)
    with pytest.raises(StudyError, match=r'the frozen plan.s checksum .* is ".*" at a, "none" at b'):
        merge_studies([a, b], out)
    for name in ("plan.toml", "plan-frozen.json"):
        shutil.copy(a / name, b)
    with StudyStore(b) as store:
        adopt_frozen_plan(store)
    merge_studies([b, a], out)
    with StudyStore(out) as store:
        frozen = read_frozen_plan_evidence(store)
        assert frozen is not None
        assert frozen.error_messages == ()
        assert frozen.is_confirmatory
        assert frozen.frozen_plan is not None
        assert frozen.frozen_plan.design != (out / "study.toml").read_text()
        found = find_deviations(store, frozen, list_required_tests(store.design))
    assert [each for each in found if each.where in ("study.toml", "plan.toml")] == []


@pytest.mark.slow
def test_site_may_use_postgresql(postgresql: Path, sites: list[Path], out: Path, tmp_path: Path) -> None:
    shared = make_site(tmp_path / "paris", url=new_postgresql_database(postgresql), trials=(None,))
    merge_studies([*sites, shared], out)
    assert sorted(study_contents(out)) == ["sub-1001", "sub-1002", "sub-2001", "sub-3001"]
    assert check_errors(out) == []
    before = files_in(out)
    merge_studies([shared], out)
    assert files_in(out) == before


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("in_between", [False, True])
def test_differences_between_sites_are_notes(tmp_path: Path, in_between: bool) -> None:
    a, b = make_site(tmp_path / "a", "a"), small_study(tmp_path / "b")
    set_in_design(b, 'site = ""', 'site = "b"')
    if in_between:
        add_participant(b, 2)
    set_in_design(b, "free_movement_s = 5.0", "free_movement_s = 4.0")
    add_participant(b, 2)
    merge_studies([a, b], tmp_path / "merged", accept_differences=True)
    with StudyStore(tmp_path / "merged") as store:
        found = [each for each in check_design(store) if "free_movement_s" in each.message]
    assert [
        (each.is_error, "free_movement_s is 5.0; it was 4.0 for sub-" in each.message) for each in found
    ] == [(in_between, True)]
