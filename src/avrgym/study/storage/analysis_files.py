"""List and remove the files of an analysis. Other files in the analysis folder are never replaced or removed."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

FOLDER = "analysis"
"""Default folder of an analysis, relative to the study's folder."""
RESULTS = "results.json"
UNFINISHED_PREFIX = ".analysis-"
"""Prefix of an analysis' temporary folder. The folder remains if the analysis is killed."""
FORMAT_NAME = "avrgym analysis"


def previous_files(folder: Path) -> list[str] | None:
    """Returns the files of an earlier analysis in a folder, without its results file; ``None`` without an earlier
    analysis.
    """
    try:
        results = json.loads((folder / RESULTS).read_bytes())
        return list(map(str, results["files"])) if results["format"].startswith(FORMAT_NAME) else None
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files by their names relative to a folder. Names outside the folder are ignored."""
    for name in names:
        if (folder / name).resolve().is_relative_to(folder.resolve()):
            (folder / name).unlink(missing_ok=True)


def remove_analysis(folder: Path) -> None:
    """Remove only the files of an analysis from a folder, the results file last."""
    names = previous_files(folder)
    if names is not None:
        remove_files(folder, [*names, RESULTS])
    for path in unfinished_analyses(folder):
        shutil.rmtree(path)


def unfinished_analyses(folder: Path) -> list[Path]:
    """Returns the temporary folders of analyses that were killed or are running."""
    return sorted(
        path for path in folder.glob(f"{UNFINISHED_PREFIX}*") if path.is_dir() and not path.is_symlink()
    )
