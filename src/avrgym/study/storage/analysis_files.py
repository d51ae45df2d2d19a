"""Files that an analysis wrote into a folder. Only these files are ever replaced or removed."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

FOLDER = "analysis"
"""The default folder of an analysis, in the study's folder."""
RESULTS = "results.json"
UNFINISHED_PREFIX = ".analysis-"
"""Prefix of the temporary folder of an analysis. A killed analysis leaves it behind."""
FORMAT_NAME = "avrgym analysis"


def previous_files(folder: Path) -> list[str] | None:
    """Files of an earlier analysis in a folder, without its results; ``None`` if there is none."""
    try:
        results = json.loads((folder / RESULTS).read_bytes())
        return list(map(str, results["files"])) if results["format"].startswith(FORMAT_NAME) else None
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files of a folder by their relative names. Names that lead out of it are ignored."""
    for name in names:
        if (folder / name).resolve().is_relative_to(folder.resolve()):
            (folder / name).unlink(missing_ok=True)


def remove_analysis(folder: Path) -> None:
    """Remove only the files that analyses wrote into a folder; the results are removed last."""
    names = previous_files(folder)
    if names is not None:
        remove_files(folder, [*names, RESULTS])
    for path in unfinished_analyses(folder):
        shutil.rmtree(path)


def unfinished_analyses(folder: Path) -> list[Path]:
    """Temporary folders of analyses that were killed or are running."""
    return sorted(
        path for path in folder.glob(f"{UNFINISHED_PREFIX}*") if path.is_dir() and not path.is_symlink()
    )
