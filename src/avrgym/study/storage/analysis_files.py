"""Which files in a folder an analysis made: only they are ever replaced or removed."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

FOLDER = "analysis"
"""Where in a study's folder its analysis goes."""
RESULTS = "results.json"
UNFINISHED_PREFIX = ".analysis-"
"""What the folder's name begins with in which an analysis is made; one that was killed leaves it."""
FORMAT_NAME = "avrgym analysis"


def previous_files(folder: Path) -> list[str] | None:
    """The files that an earlier analysis made in a folder, besides its results; ``None`` when there was none."""
    try:
        results = json.loads((folder / RESULTS).read_bytes())
        return list(map(str, results["files"])) if results["format"].startswith(FORMAT_NAME) else None
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove files of a folder by their relative names; one that leads out of it stays."""
    for name in names:
        if (folder / name).resolve().is_relative_to(folder.resolve()):
            (folder / name).unlink(missing_ok=True)


def remove_analysis(folder: Path) -> None:
    """Remove what analyses made in a folder, if any did, and nothing else; the results go last."""
    names = previous_files(folder)
    if names is not None:
        remove_files(folder, [*names, RESULTS])
    for path in unfinished_analyses(folder):
        shutil.rmtree(path)


def unfinished_analyses(folder: Path) -> list[Path]:
    """The folders that analyses left which were killed, or that one is being made in."""
    return sorted(
        path for path in folder.glob(f"{UNFINISHED_PREFIX}*") if path.is_dir() and not path.is_symlink()
    )
