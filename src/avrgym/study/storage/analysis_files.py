"""List and remove the files of an analysis. Other files in the analysis folder are never replaced or removed."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

ANALYSIS_FOLDER = "analysis"
"""Default folder of an analysis, relative to the study's folder."""
RESULTS_FILE = "results.json"
"""File name of the results of an analysis."""
TEMPORARY_FOLDER_PREFIX = ".analysis-"
"""Prefix of the temporary folder of an analysis. A killed analysis leaves this folder behind."""
ANALYSIS_FORMAT = "avrgym analysis"


def find_previous_analysis_files(folder: Path) -> list[str] | None:
    """Returns the files of an earlier analysis in a folder, without ``results.json``; ``None`` without an analysis."""
    try:
        results = json.loads((folder / RESULTS_FILE).read_bytes())
        return list(map(str, results["files"])) if results["format"].startswith(ANALYSIS_FORMAT) else None
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files from a folder. ``names``: paths relative to the folder; paths outside it are ignored."""
    for name in names:
        if (folder / name).resolve().is_relative_to(folder.resolve()):
            (folder / name).unlink(missing_ok=True)


def remove_analysis(folder: Path) -> None:
    """Remove the files of an analysis from a folder, ``results.json`` last. Other files remain."""
    names = find_previous_analysis_files(folder)
    if names is not None:
        remove_files(folder, [*names, RESULTS_FILE])
    for path in find_leftover_analysis_folders(folder):
        shutil.rmtree(path)


def find_leftover_analysis_folders(folder: Path) -> list[Path]:
    """Returns the temporary folders of killed and running analyses."""
    return sorted(
        path for path in folder.glob(f"{TEMPORARY_FOLDER_PREFIX}*") if path.is_dir() and not path.is_symlink()
    )
