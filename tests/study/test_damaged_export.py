"""Exports of studies with damaged recordings: an error with their names, or an export without them."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import pyarrow.parquet as pq
import pytest
import sqlalchemy as sa
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.study.export import EXPORT_FORMATS, OMITTED_RECORDINGS_FILE, export_study
from avrgym.study.export.exported_attempts import list_completed_attempts, verify_attempts
from avrgym.study.storage import database, schema
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.damaged_recordings import RECORDING, count_undetected
from helpers.studies.small_studies import STEPS, enrol_with_consent, run_participant, small_study

TRIALS = 5


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study that two participants have completed."""
    folder = small_study(tmp_path_factory.mktemp("whole") / "study")
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        with StudyStore(folder) as store:
            for _ in range(2):
                run_participant(store, enrol_with_consent(store))
    return folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the study, which tests damage."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    return Path(shutil.copytree(whole, tmp_path / "study"))


def export(folder: Path, data_format: str, *options: str) -> Result:
    out = folder.parent / "out"
    arguments = ["study", "export", str(folder), "--format", data_format, "--out", str(out), *options]
    return CliRunner().invoke(app, arguments)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:3000])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def replace(path: Path) -> None:
    shutil.copy(path.with_name("trial-03_attempt-1.mcap"), path)


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "cut": (cut, "was changed: its checksum differs"),
    "empty": (lambda path: path.write_bytes(b""), "was changed: its checksum differs"),
    "flipped": (flip, "was changed: its checksum differs"),
    "another": (replace, "was changed: its checksum differs"),
    "missing": (Path.unlink, "is missing"),
}


@pytest.mark.fast_cases(7)
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("data_format", EXPORT_FORMATS)
def test_damaged_recording_prevents_an_export(folder: Path, data_format: str, damage: str) -> None:
    break_it, words = DAMAGES[damage]
    break_it(folder / RECORDING)
    before = sorted(folder.parent.iterdir())
    result = export(folder, data_format)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert f"{RECORDING} {words}; use --skip-damaged to omit" in line
    assert sorted(folder.parent.iterdir()) == before


@pytest.mark.parametrize("data_format", EXPORT_FORMATS)
def test_all_damaged_recordings_are_listed(folder: Path, data_format: str) -> None:
    broken = sorted(folder.rglob("*.mcap"))[::3]
    for path in broken:
        cut(path)
    line = export(folder, data_format).stderr
    assert all(str(path.relative_to(folder)) in line for path in broken)


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("data_format", EXPORT_FORMATS)
def test_damaged_recordings_can_be_skipped(folder: Path, data_format: str) -> None:
    cut(folder / RECORDING)
    result = export(folder, data_format, "--skip-damaged")
    assert result.exit_code == 0
    assert f"left out  {RECORDING} was changed" in result.stdout
    out = folder.parent / "out"
    (row,) = rows(out / OMITTED_RECORDINGS_FILE)
    assert (row["participant"], row["position"], row["reason"]) == (
        "sub-001", "2", f"{RECORDING} was changed: its checksum differs",
    )  # fmt: skip
    assert exported_trials(out, data_format) == 2 * TRIALS - 1


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("data_format", EXPORT_FORMATS)
def test_undamaged_study_lists_no_problems(folder: Path, data_format: str) -> None:
    assert export(folder, data_format, "--skip-damaged").exit_code == 0
    out = folder.parent / "out"
    assert not (out / OMITTED_RECORDINGS_FILE).exists()
    assert exported_trials(out, data_format) == 2 * TRIALS


def exported_trials(out: Path, data_format: str) -> int:
    """The number of trials in the files; asserts that each is complete."""
    match data_format:
        case "csv":
            lengths = len(rows(out / "control_steps.csv")) / STEPS
        case "bids":
            tables = [path.read_text().splitlines() for path in out.rglob("*_motion.tsv")]
            assert {len(lines) for lines in tables} == {STEPS}
            lengths = len(tables)
        case "hdf5" | "minari":
            demonstrations = []
            for path in out.rglob("*.hdf5"):
                with h5py.File(path) as file:
                    episodes = file["data"] if data_format == "hdf5" else file
                    demonstrations += [len(each["actions"]) for each in episodes.values()]  # pyright: ignore
            assert set(demonstrations) == {STEPS}
            lengths = len(demonstrations)
        case _:
            tables = [pq.read_table(path) for path in out.rglob("episodes/**/*.parquet")]
            lengths = sum(len(table) for table in tables)
    return int(lengths)


@pytest.mark.parametrize("data_format", EXPORT_FORMATS)
def test_export_without_readable_recordings(folder: Path, data_format: str) -> None:
    for path in folder.rglob("*.mcap"):
        path.unlink()
    assert export(folder, data_format, "--skip-damaged").exit_code == 0
    assert len(rows(folder.parent / "out" / OMITTED_RECORDINGS_FILE)) == 2 * TRIALS


def test_recording_of_another_station_is_reported(folder: Path) -> None:
    (folder / RECORDING).unlink()
    with StudyStore(folder) as store:
        store.station_name = "another"
        with pytest.raises(StudyError, match=f"{RECORDING} is at another station; it was recorded at "):
            export_study(store, "csv", folder.parent / "out")


def test_completed_trial_needs_checksum_and_complete_recording(
    folder: Path,
) -> None:
    with StudyStore(folder) as store:
        with store.database.write_transaction() as connection:
            connection.execute(sa.update(schema.ATTEMPT_TABLE).values(sha256=None))
        _, left_out = verify_attempts(list(list_completed_attempts(store)))
    assert len(left_out) == 2 * TRIALS


def test_damage_at_any_byte_is_found(folder: Path) -> None:
    assert count_undetected(folder, 200) == 0
