"""A plan is confirmatory only if it is certainly older than the first participant."""

import json
import shutil
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from typer.testing import CliRunner, Result

from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.cli.main import app
from avrgym.recording.reader import RecordingHeader
from avrgym.study.checking.database_rebuild import rebuild_study_database
from avrgym.study.plan import date_evidence
from avrgym.study.plan.date_evidence import REGISTRATION_FILE, TIME_STAMP_FILE, verify_time_stamp
from avrgym.study.plan.frozen_plan import (
    FROZEN_PLAN_FILE,
    FrozenPlanEvidence,
    compute_sha256,
    read_frozen_plan_evidence,
)
from avrgym.study.storage import database
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.configurations import configuration
from helpers.studies.known_results import enrol_included, run_trials, write_without_figures
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant
from helpers.studies.time_stamp_authority import Authority

DATABASE_FILES = ("study.db", "study.db.sha256", "study.head")
needs_openssl = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    return Authority(tmp_path_factory.mktemp("authority") / "own")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study with a frozen plan."""
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', participants="2")
    for _ in range(2):
        assert study("freeze", folder).exit_code == 0
    return folder


def study(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)])


def take_all_in(folder: Path) -> None:
    with StudyStore(folder) as store:
        for sex in ("man", "woman"):
            run_trials(store, enrol_included(store, sex, simulated=False))


def forge(folder: Path) -> None:
    """Forge the frozen plan with a matching checksum, and delete the database."""
    record = json.loads((folder / FROZEN_PLAN_FILE).read_text())
    record["plan"] = record["plan"].replace("higher with revised", "lower with revised")
    record["sha256"]["plan.toml"] = compute_sha256(record["plan"].encode())
    record["frozen_at"] = "2025-01-01T00:00:00.000000+00:00"
    (folder / "plan.toml").write_text(record["plan"])
    (folder / FROZEN_PLAN_FILE).write_text(json.dumps(record))
    lose_database(folder)


def lose_database(folder: Path) -> None:
    for name in DATABASE_FILES:
        (folder / name).unlink()
    rebuild_study_database(folder)


def frozen_plan(folder: Path) -> FrozenPlanEvidence:
    with StudyStore(folder) as store:
        frozen = read_frozen_plan_evidence(store)
    assert frozen is not None
    return frozen


def analysed(folder: Path, out: Path) -> tuple[StudyAnalysis, str]:
    with StudyStore(folder) as store:
        analysis = analyse_study(store)
        return analysis, " ".join(Page(write_without_figures(analysis, folder, out)).text.split())


def trust(authority: Authority, monkeypatch: pytest.MonkeyPatch) -> None:
    root = x509.load_pem_x509_certificate(authority.root)
    monkeypatch.setattr(date_evidence, "_system_roots", lambda: [root])


# Unknown origin


@pytest.mark.slow
def test_forged_plan_is_not_confirmatory(folder: Path, tmp_path: Path) -> None:
    take_all_in(folder)
    _, honest = analysed(folder, tmp_path / "honest")
    assert "before the first participant" in honest
    assert "Confirmatory results" in honest
    forge(folder)
    checked = study("check", folder)
    assert checked.exit_code == 1
    assert "is of unknown date and not confirmatory" in checked.stdout
    assert "database: was rebuilt from the recordings" in checked.stdout
    assert "2025" not in study("status", folder).stdout
    analysis, page = analysed(folder, tmp_path / "forged")
    assert "2025" not in page
    assert "Confirmatory results" not in page
    assert "The date of the plan is unknown" in page
    assert "Rebuilt database." in page
    assert "confirmatory" not in {row.plan_status for row in [*analysis.tests, *analysis.model_effects]}
    methods = (tmp_path / "forged" / "reporting" / "methods.md").read_text()
    assert "2025" not in methods
    assert "all results are exploratory" in methods
    assert json.loads((tmp_path / "forged" / "results.json").read_text())["plan"]["is_confirmatory"] is False


def test_plan_after_a_rebuild_is_not_confirmatory(folder: Path) -> None:
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
    assert frozen_plan(folder).is_confirmatory
    lose_database(folder)
    frozen = frozen_plan(folder)
    assert (frozen.is_confirmatory, frozen.existed_since_text) == (False, "an unknown time")
    assert "was rebuilt at" in frozen.date_evidence_text
    for command in ("freeze", "check"):
        assert "was rebuilt" in study(command, folder).output.replace("\n", " ")
    assert study("freeze", folder, "--export", "osf").exit_code == 1
    assert not frozen_plan(folder).is_confirmatory


def test_plan_is_adopted_only_before_the_first_participant(folder: Path, tmp_path: Path) -> None:
    early, late = (make_study(tmp_path / name, tasks='["Feeding"]', participants="2") for name in ("b", "c"))
    for other in (early, late):
        shutil.copy(folder / "plan.toml", other)
        shutil.copy(folder / FROZEN_PLAN_FILE, other)
    adopted = study("freeze", early)
    assert adopted.exit_code == 0
    assert "adopted" in adopted.stdout
    frozen = frozen_plan(early)
    assert frozen.is_confirmatory
    assert frozen.frozen_plan is not None
    assert frozen.existed_since_text > frozen.frozen_plan.frozen_at
    assert "was stored in the database" in frozen.date_evidence_text
    with StudyStore(late) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
    assert "has already taken part" in study("freeze", late).output
    assert not frozen_plan(late).is_confirmatory


# Evidence from outside


def test_freeze_prints_checksum_and_registries(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]')
    study("freeze", folder)
    shown = study("freeze", folder).stdout
    assert compute_sha256((folder / FROZEN_PLAN_FILE).read_bytes()) in shown
    for word in ("osf.io", "aspredicted.org", "openssl ts -query", "--timestamp"):
        assert word in shown


def test_registration_is_only_a_claim(folder: Path) -> None:
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
    address = "https://osf.io/abcde"
    assert study("freeze", folder, "--registered", address, "--registered-on", "2026-01-02").exit_code == 0
    frozen = frozen_plan(folder)
    assert frozen.registration == date_evidence.Registration(address, date(2026, 1, 2))
    assert (
        f"The researchers claim a registration of 2026-01-02 at {address}; this is not verified."
        in frozen.date_evidence_text
    )
    before = (folder / REGISTRATION_FILE).read_bytes()
    assert study("freeze", folder, "--registered", "https://osf.io/other").exit_code == 1
    assert study("freeze", folder, "--registered", "osf").exit_code == 1
    assert (folder / REGISTRATION_FILE).read_bytes() == before
    lose_database(folder)
    assert not frozen_plan(folder).is_confirmatory


@needs_openssl
@pytest.mark.parametrize("digest", ["sha256", "sha512"])
def test_time_stamp_is_verified_without_a_network(authority: Authority, digest: str) -> None:
    stamp = verify_time_stamp(authority.stamp(b"record", digest), b"record")
    assert abs(stamp.issued_at - datetime.now(UTC)) < timedelta(minutes=5)
    assert (stamp.authority, stamp.is_trusted) == ("CN=Test Authority", False)


@needs_openssl
def test_time_stamp_of_a_known_root_is_trusted(authority: Authority, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = authority.stamp(b"record", with_root=False)
    with pytest.raises(StudyError, match="no root certificate"):
        verify_time_stamp(alone, b"record")
    trust(authority, monkeypatch)
    for stamp in (alone, authority.stamp(b"record")):
        assert verify_time_stamp(stamp, b"record").is_trusted


@needs_openssl
def test_invalid_time_stamps_are_not_stored(authority: Authority, folder: Path, tmp_path: Path) -> None:
    record = (folder / FROZEN_PLAN_FILE).read_bytes()
    sound = authority.stamp(record)
    altered = bytearray(sound)
    altered[-10] ^= 1
    for number, data in enumerate(
        (b"", b"no stamp", sound[:200], bytes(altered), authority.stamp(b"another"))
    ):
        file = tmp_path / f"{number}.tsr"
        file.write_bytes(data)
        refused = study("freeze", folder, "--timestamp", file)
        assert refused.exit_code == 1, number
        assert "time stamp" in refused.output
        assert not (folder / TIME_STAMP_FILE).exists()


@needs_openssl
def test_trusted_early_time_stamp_proves_a_plan(
    authority: Authority, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It proves the plan also after loss of the database; late or untrusted time stamps do not."""
    file = tmp_path / "early.tsr"
    file.write_bytes(authority.stamp((folder / FROZEN_PLAN_FILE).read_bytes()))
    stored = study("freeze", folder, "--timestamp", file)
    assert stored.exit_code == 0, stored.output
    with StudyStore(folder) as store:
        monkeypatch.setattr("avrgym.recording.writer.datetime", Later)
        run_participant(store, enrol_with_consent(store), trials=1)
        monkeypatch.setattr("avrgym.recording.writer.datetime", datetime)
    lose_database(folder)
    frozen = frozen_plan(folder)
    assert not frozen.is_confirmatory
    assert "the time stamp alone proves nothing" in frozen.date_evidence_text
    trust(authority, monkeypatch)
    frozen = frozen_plan(folder)
    assert frozen.is_confirmatory
    assert frozen.error_messages == ()
    assert "existed at" in frozen.date_evidence_text
    assert "unknown date" not in study("check", folder).stdout
    forged = (folder / FROZEN_PLAN_FILE).read_bytes().replace(b"higher", b"lower")
    (folder / FROZEN_PLAN_FILE).write_bytes(forged)
    assert "invalid time stamp" in " ".join(frozen_plan(folder).error_messages)
    (folder / TIME_STAMP_FILE).write_bytes(authority.stamp(forged))
    monkeypatch.setattr(
        "avrgym.study.plan.frozen_plan.read_header",
        lambda path: RecordingHeader(configuration(), datetime(2026, 1, 1, tzinfo=UTC)),
    )
    assert not frozen_plan(folder).is_confirmatory


class Later(datetime):
    """A clock five seconds ahead, because time stamps have whole seconds."""

    @classmethod
    def now(cls, tz: object = None) -> datetime:
        return datetime.now(UTC) + timedelta(seconds=5)
