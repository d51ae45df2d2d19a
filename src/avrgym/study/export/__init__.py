"""Exports of a study in formats that other tools read: pseudonymised, not anonymous."""

import os
import tempfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

from avrgym.study.states import StudyError
from avrgym.study.store import Store

FORMATS: Mapping[str, str] = {
    "csv": "tables",
    "bids": "bids",
    "hdf5": "robomimic",
    "lerobot": "lerobot",
}
"""Format to the module that writes it."""

NOTICE = (
    "This export of an AVR Gym study is pseudonymised, not anonymous: movements of head and hands may identify a "
    "person. Whatever a simulated participant left is marked as simulated."
)


def export_study(store: Store, data_format: str, out: Path) -> int:
    """Export a study into a new or empty folder, which appears whole or not at all.

    Returns:
        The number of files.

    Raises:
        StudyError: for an unknown format, a folder that holds something, or when the extra ``export`` is missing.
    """
    if data_format not in FORMATS:
        raise StudyError(f"unknown format {data_format!r}; allowed: {', '.join(FORMATS)}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StudyError(f"{out} holds something already; choose another folder")
    write = _writer(data_format)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as temporary:
        folder = Path(temporary) / "export"
        folder.mkdir()
        write(store, folder)
        files = sum(path.is_file() for path in folder.rglob("*"))
        if out.exists():
            out.rmdir()
        os.replace(folder, out)
    return files


def _writer(data_format: str) -> Callable[[Store, Path], None]:
    try:
        return import_module(f"{__name__}.{FORMATS[data_format]}").write
    except ModuleNotFoundError as error:
        raise StudyError(
            f"{error.name} is missing; `pip install avrgym[export]` brings what {data_format} needs"
        ) from error
