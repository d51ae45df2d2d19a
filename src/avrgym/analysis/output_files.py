"""Write the files of an analysis: report, tables, figures, publication files, and one file with all results."""

import json
import os
import tempfile
from pathlib import Path

from avrgym.analysis.figures import draw_figures
from avrgym.analysis.publication.publication_files import PUBLICATION_FOLDER as PACK
from avrgym.analysis.publication.publication_files import write_publication_files
from avrgym.analysis.report import write_report
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.study.storage.analysis_files import (
    RESULTS_FILE,
    TEMPORARY_FOLDER_PREFIX,
    find_previous_analysis_files,
    remove_files,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import make_private_folder, restrict_to_owner

REPORT_FILE = "report/index.html"
OUTPUT_FOLDERS = ("report", "tables", "figures", PACK)


def check_output_folder(out: Path) -> None:
    """Raises ``StudyError`` if writing to ``out`` would replace files that are not from an analysis."""
    present = [name for name in (*OUTPUT_FOLDERS, RESULTS_FILE) if (out / name).exists()]
    if present and find_previous_analysis_files(out) is None:
        raise StudyError(
            f"{out / present[0]} was not written by an analysis; choose another folder with --out DIR"
        )


def write_analysis(analysis: StudyAnalysis, study: Path, out: Path) -> Path:
    """Write report, tables, figures and results into the folder ``out``. Returns the path of the report.

    Files of an earlier analysis are replaced or removed. Other files are not changed. Only the owner can read the new
    files. ``study``: folder of the study; the report contains links to it.

    Raises:
        StudyError: if writing to ``out`` would replace files that are not from an analysis.
        OSError: if ``out`` cannot be written.
    """
    check_output_folder(out)
    make_private_folder(out)
    with tempfile.TemporaryDirectory(prefix=TEMPORARY_FOLDER_PREFIX, dir=out) as temporary:
        made = Path(temporary)
        _write_all(analysis, made, os.path.relpath(study, out / "report"))
        files = sorted(path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file())
        results = analysis.make_results() | {"files": files}
        (made / RESULTS_FILE).write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        restrict_to_owner(made)
        _replace(made, out, files)
    return out / REPORT_FILE


def _write_all(analysis: StudyAnalysis, made: Path, study_link: str) -> None:
    """Write all files except the results into the new folder ``made``."""
    for folder in ("report", "tables", "figures"):
        (made / folder).mkdir()
    for table in analysis.make_tables():
        table.write(made / "tables")
    drawings = draw_figures(analysis)
    for drawing in drawings:
        drawing.write(made / "figures")
    write_report(made / REPORT_FILE, analysis, drawings, study_link)
    write_publication_files(analysis, made / PACK, made / "tables")


def _replace(made: Path, out: Path, files: list[str]) -> None:
    """Move the new files from ``made`` to ``out``, the results last. Remove all other files of an earlier analysis."""
    remove_files(out, set(find_previous_analysis_files(out) or ()) - set(files))
    for folder in OUTPUT_FOLDERS:
        make_private_folder(out / folder)
    for name in [*files, RESULTS_FILE]:
        os.replace(made / name, out / name)
