"""Export a study in formats of other programs. Exports are pseudonymised, not anonymous."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

from avrgym.study.export.event_tables import DEFAULT_EXPORT_OPTIONS, ExportOptions
from avrgym.study.export.exported_attempts import (
    ExportedAttempt,
    OmittedAttempt,
    list_completed_attempts,
    verify_attempts,
)
from avrgym.study.storage.data_loss import describe_data_loss
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import write_folder_atomically

EXPORT_FORMATS: Mapping[str, str] = {
    "csv": "tables",
    "bids": "bids",
    "hdf5": "robomimic",
    "lerobot": "lerobot",
    "minari": "minari",
}
"""The module that writes each format, by format name."""
FORMATS_WITH_EVENTS = ("csv", "bids")
"""Formats that contain events and experimenters' texts. Other formats contain only trials."""
FORMATS_WITH_IMAGES = ("hdf5", "lerobot")
"""Formats that can contain camera images."""
OMITTED_RECORDINGS_FILE = "left_out.csv"
"""File name of the table of omitted recordings."""
FormatWriter = Callable[..., None]
"""Function that writes attempts into a folder. Functions of ``FORMATS_WITH_EVENTS`` also accept ``extras``."""

PRIVACY_NOTICE = (
    "This export of an AVR Gym study is pseudonymised, not anonymous: movements of head and hands may identify a "
    "person. Data of simulated participants are marked as simulated."
)


def export_study(
    store: StudyStore,
    data_format: str,
    out: Path,
    *,
    skip_damaged: bool = False,
    extras: ExportOptions = DEFAULT_EXPORT_OPTIONS,
    cameras: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, all_: None,
    report: Callable[[str], None] = lambda text: None,
) -> int:
    """Export a study into a new or empty folder. Returns the number of files. After an error, no folder remains.

    First, the checksum of every recording of a completed trial is verified.

    Args:
        store: the study.
        data_format: one of ``EXPORT_FORMATS``.
        out: the folder.
        extras: whether to export free text and health data.
        cameras: camera images to render for each control step, such as ``wrist:128x96:rgb+depth``.
        skip_damaged: omit damaged and missing recordings, and list them in ``left_out.csv``.
        progress: called after each recording, with the number of verified recordings and their total number.
        report: called with the name of each omitted recording and the reason.

    Raises:
        StudyError: for an unknown format or camera, or for extras or cameras that the format cannot contain. Also for a
            non-empty folder, a damaged or missing recording, or a missing package of ``avrgym[export]``.
        RuntimeError: if rendering fails.
    """
    if data_format not in EXPORT_FORMATS:
        raise StudyError(f"unknown format {data_format!r}; allowed: {', '.join(EXPORT_FORMATS)}")
    if extras != DEFAULT_EXPORT_OPTIONS and data_format not in FORMATS_WITH_EVENTS:
        raise StudyError(
            f"{data_format} cannot contain free text and health data; allowed: {', '.join(FORMATS_WITH_EVENTS)}"
        )
    if cameras and data_format not in FORMATS_WITH_IMAGES:
        raise StudyError(f"{data_format} cannot contain images; allowed: {', '.join(FORMATS_WITH_IMAGES)}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StudyError(f"{out} is not empty; choose another folder")
    fetch_recordings(store)
    write = _writer(data_format)
    if data_format in FORMATS_WITH_EVENTS:
        write = partial(write, extras=extras)
    if cameras:
        write = partial(write, cameras=cameras)
    sound, left_out = verify_attempts(list(list_completed_attempts(store)), progress)
    if left_out and not skip_damaged:
        raise StudyError(_refusal(left_out))
    for each in left_out:
        report(each.reason)
    write_folder_atomically(out, lambda folder: _write(store, write, sound, left_out, folder))
    return sum(path.is_file() for path in out.rglob("*"))


def _refusal(left_out: Sequence[OmittedAttempt]) -> str:
    faults = "; ".join(each.reason for each in left_out)
    return f"nothing was exported: {faults}; use --skip-damaged to omit damaged and missing recordings"


def _write(
    store: StudyStore,
    write: FormatWriter,
    sound: Sequence[ExportedAttempt],
    left_out: Sequence[OmittedAttempt],
    folder: Path,
) -> None:
    from avrgym.study.export.table_files import write_csv
    from avrgym.study.export.table_rows import OmittedAttemptRow

    write(store, sound, folder)
    _add_losses(store, folder)
    if left_out:
        write_csv(
            folder / OMITTED_RECORDINGS_FILE,
            [
                OmittedAttemptRow(**vars(each.attempt.make_identifiers()), reason=each.reason)
                for each in left_out
            ],
        )


def _add_losses(store: StudyStore, folder: Path) -> None:
    """Append sentences about a loss of the study's database to the README files."""
    words = describe_data_loss(store)
    for path in folder.rglob("README*") if words else ():
        with path.open("a", encoding="utf-8") as file:
            file.write("".join(f"\n{each}\n" for each in words))


def _writer(data_format: str) -> FormatWriter:
    try:
        return import_module(f"{__name__}.{EXPORT_FORMATS[data_format]}").write
    except ModuleNotFoundError as error:
        raise StudyError(f"{data_format} needs {error.name}; run `pip install avrgym[export]`") from error
