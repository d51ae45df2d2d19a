"""Files of Windows editors are read; spreadsheets, Python, pandas and R read the tables."""

import codecs
import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from typer.testing import CliRunner

from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.study_analysis import analyse_study
from avrgym.analysis.tables import Table
from avrgym.cli.main import app
from avrgym.learning.hyperparameter_files import read_toml
from avrgym.people.people_file import PeopleFileError, read_people
from avrgym.study.checking.study_checks import check_study
from avrgym.study.design.design import DesignError, read_design
from avrgym.study.export import export_study
from avrgym.study.export.table_files import write_csv
from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import find_deviations
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column
from avrgym.texts.interface_texts import read_texts
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant, small_study

UMLAUTS = "Ärger über Füße, «naïve» 姓名"


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


def mark(path: Path) -> Path:
    """Save a file like Windows Notepad, with a byte-order mark and CRLF line ends."""
    path.write_bytes(codecs.BOM_UTF8 + path.read_bytes().replace(b"\n", b"\r\n"))
    return path


def own(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "texts": ('[sentences]\n"Feed" = "Füttern"\n', lambda path: read_texts("de", path.parents[1])),
    "settings": ("learning_rate = 1e-3 # ü\n", read_toml),
    "people": ('title = "Müde Leute"\n', lambda path: read_outcome(path)),
}


def read_outcome(path: Path) -> str:
    """The error for an incomplete file of people, which is not about its encoding or TOML syntax."""
    with pytest.raises(PeopleFileError) as refused:
        read_people(path, ["Feeding"])
    return str(refused.value)


@pytest.mark.parametrize("kind", READERS)
def test_byte_order_mark_does_not_change_contents(tmp_path: Path, kind: str) -> None:
    text, read = READERS[kind]
    path = own(tmp_path, "texts/de.toml", text)
    before = read(path)
    assert read(mark(path)) == before


def test_study_saved_with_windows_notepad_is_valid(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    before = read_design(folder / "study.toml")
    assert read_design(mark(folder / "study.toml")) == before
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
        assert [each.message for each in check_study(store) if each.is_error] == []


def test_other_encodings_are_rejected_with_advice(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    path = folder / "study.toml"
    path.write_text(path.read_text(), encoding="utf-16")
    with pytest.raises(DesignError, match="save it as UTF-8"):
        read_design(path)


def test_byte_order_mark_does_not_change_a_frozen_plan(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    for _ in range(2):  # the first writes a plan to fill in
        assert CliRunner().invoke(app, ["study", "freeze", str(folder)]).exit_code == 0
    for name in ("study.toml", "plan.toml"):
        path = folder / name
        path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())
    with StudyStore(folder) as store:
        frozen = read_frozen_plan_evidence(store)
        assert frozen is not None
        assert [
            each for each in find_deviations(store, frozen, {}) if each.where in ("study.toml", "plan.toml")
        ] == []


# Tables


def write_table(folder: Path) -> Path:
    write_csv(folder / "a.csv", [{"participant": "sub-001", "text": UMLAUTS}])
    return folder / "a.csv"


def write_analysis_table(folder: Path) -> Path:
    Table(
        "a", {"participant": Column(""), "text": Column("")}, [{"participant": "sub-001", "text": UMLAUTS}]
    ).write(folder)
    return folder / "a.csv"


@pytest.mark.parametrize("write", [write_table, write_analysis_table])
def test_pandas_and_python_read_the_same_tables(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    path = write(tmp_path)
    assert path.read_bytes().startswith(codecs.BOM_UTF8), "Excel takes it for another encoding"
    engines: tuple[Any, ...] = ("c", "python")
    for engine in engines:
        frame: Any = pd.read_csv(path, engine=engine)
        assert list(frame.columns) == ["participant", "text"]
        assert frame["text"].tolist() == [UMLAUTS]
    with open(path, encoding="utf-8-sig", newline="") as file:
        assert list(csv.DictReader(file)) == [{"participant": "sub-001", "text": UMLAUTS}]


@pytest.mark.slow
@pytest.mark.parametrize("data_format", ["csv", "bids"])
def test_only_csv_files_have_a_byte_order_mark(tmp_path: Path, data_format: str) -> None:
    """CSV files of exports and analyses have one; TSV, JSON and text files have none."""
    with StudyStore(make_study(tmp_path / "study", tasks='["Feeding"]')) as store:
        run_participant(store, enrol_with_consent(store), trials=2)
        export_study(store, data_format, tmp_path / "out")
        write_analysis(analyse_study(store), store.folder, tmp_path / "analysis")
    files = [path for name in ("out", "analysis") for path in (tmp_path / name).rglob("*") if path.is_file()]
    assert any(path.suffix == ".csv" for path in files)
    for path in files:
        assert path.read_bytes().startswith(codecs.BOM_UTF8) == (path.suffix == ".csv"), path
