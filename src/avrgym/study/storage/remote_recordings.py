"""Copies of a study's recordings in its object store.

A recording is complete in the study's folder before it is uploaded. The files of an attempt only grow, so the longer
copy is newer. Without an object store, the functions of this module do nothing.
"""

import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

import sqlalchemy as sa

from avrgym.recording.answers_file import get_answers_path
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER
from avrgym.study.storage.object_store import ObjectStore
from avrgym.study.storage.schema import ATTEMPT_TABLE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import remove_folder

UPLOAD_INTERVAL_S = 3.0
UPLOAD_RETRY_DELAY_S = 2.0
_NAME = re.compile(rf"{RECORDINGS_FOLDER}/sub-[0-9]{{3,9}}/ses-[0-9]+/[\w-]+\.(mcap|answers\.jsonl)")
"""Files that are downloaded. Other names in the object store are ignored."""


def fetch_recordings(store: StudyStore, pseudonym: str = "") -> None:
    """Download recordings that the study's folder lacks, and answers that another computer added.

    ``pseudonym``: download only recordings of this participant. Raises ``StudyError`` if the object store cannot be
    used.
    """
    remote = store.object_store
    if remote is None or store.database.is_read_only:
        return
    for name, size in remote.list_file_sizes(f"{RECORDINGS_FOLDER}/{pseudonym}").items():
        if _NAME.fullmatch(name) and size > _size(store.folder / name):
            remote.download_file(name, store.resolve_path(name))


def upload_recording_before_storage(store: StudyStore, name: str, stopped: Callable[[], bool]) -> None:
    """Upload a recording and its answers, if the study's folder is a temporary copy.

    The recording is then safe before its rows are stored. A failed upload is repeated until it succeeds. ``name``: path
    of the recording, relative to the study's folder. ``stopped``: function that returns true to stop the repetition.
    Raises ``StudyError`` in this case.
    """
    while store.is_temporary and store.object_store is not None:
        try:
            for each in _files(name):
                if (store.folder / each).is_file():
                    store.object_store.upload_file(each, store.folder / each)
            return
        except StudyError:
            if stopped():
                raise
            time.sleep(UPLOAD_RETRY_DELAY_S)


def read_object_store_error(store: StudyStore) -> str:
    """Returns the error of the latest request to the study's object store; empty without an error."""
    return "" if store.object_store is None else store.object_store.latest_error_message


def remove_recordings(store: StudyStore, pseudonym: str) -> None:
    """Remove all recordings of a participant, first from the object store.

    Raises ``StudyError`` if the object store cannot be used. No local file is removed then.
    """
    if store.object_store is not None:
        store.object_store.delete_files(f"{RECORDINGS_FOLDER}/{pseudonym}/")
    remove_folder(store.folder / RECORDINGS_FOLDER / pseudonym)


class RecordingUploader:
    """Context manager: a thread that uploads the recordings of ended attempts.

    At its end, the context uploads all remaining recordings. The next context repeats failed uploads.
    """

    def __init__(self, store: StudyStore, report: Callable[[str], None] = lambda problem: None) -> None:
        """``report``: called with each new error, and with a message when uploads succeed again."""
        self._store, self._report = store, report
        self._uploaded: dict[str, int] | None = None
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uploads", daemon=True)

    def __enter__(self) -> Self:
        if self._store.object_store is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        if self._store.object_store is not None:
            self._thread.join()
            self._try_upload(self._store.object_store)

    def _run(self) -> None:
        while self._store.object_store is not None and not self._closed.wait(UPLOAD_INTERVAL_S):
            self._try_upload(self._store.object_store)

    def _try_upload(self, remote: ObjectStore) -> None:
        before = self._problem
        try:
            self.upload_recordings(remote)
            self._problem = ""
        except (StudyError, OSError) as error:
            self._problem = str(error)
        if self._problem != before:
            self._report(self._problem or "recordings are uploaded again")

    def upload_recordings(self, remote: ObjectStore) -> None:
        """Upload all files that are longer than their copies. Raises ``StudyError`` after the first failure."""
        if self._uploaded is None:
            self._uploaded = remote.list_file_sizes(RECORDINGS_FOLDER)
        for recording in _ended_recordings(self._store):
            for name in _files(recording):
                if _size(self._store.folder / name) > self._uploaded.get(name, -1):
                    with suppress(FileNotFoundError):  # the participant was deleted
                        self._uploaded[name] = remote.upload_file(name, self._store.resolve_path(name))


def _ended_recordings(store: StudyStore) -> list[str]:
    table = ATTEMPT_TABLE
    with store.database.read_transaction() as connection:
        return list(
            connection.execute(sa.select(table.c.recording).where(table.c.state != "running")).scalars()
        )


def _files(recording: str) -> tuple[str, str]:
    """Returns the names of a recording and its answers file."""
    return recording, get_answers_path(recording).as_posix()


def _size(path: Path) -> int:
    """Returns the size of a file in bytes; -1 if it does not exist."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return -1
