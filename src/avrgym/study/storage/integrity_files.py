"""What stands beside a study's database to tell that it was changed from outside, or set back.

``study.head`` holds ends of the ledger's chain, a line with number and digest for each transaction since the database
was last closed. A transaction is noted once it is on disk, so a chain without one of these ends has lost it.

``study.db.sha256`` is the checksum of SQLite's file, as ``sha256sum`` writes it, while nobody writes to the study: it
is removed before anything is written and made when a writer is done. One that a writer found wrong is kept as
``study.db.sha256.mismatch`` until somebody has looked into it.
"""

import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from avrgym.study.storage.hash_chain import Head
from avrgym.system.files import PRIVATE_FILE, private_opener, write_atomically

HEAD = "study.head"
CHECKSUM = "study.db.sha256"
MISMATCH = f"{CHECKSUM}.mismatch"
_HEAD_LINE = re.compile(r"([1-9][0-9]{0,17}) ([0-9a-f]{64})")


class IntegrityFileError(ValueError):
    """A file beside the database that is damaged."""


class IntegrityFiles:
    """The files beside the database in a study's folder. Whoever calls a method holds the database's lock for writing,
    but for ``note`` and ``heads``."""

    def __init__(self, folder: Path, database: str) -> None:
        self._folder, self._database = folder, database
        self._noted = False

    @property
    def checksum(self) -> str | None:
        """The stored checksum of the database's file, if there is one; ``IntegrityFileError`` for a damaged file."""
        path = self._folder / CHECKSUM
        if not path.exists():
            return None
        match = re.fullmatch(rf"([0-9a-f]{{64}})  {re.escape(self._database)}\n", _text(path))
        if match is None:
            raise IntegrityFileError(f"{CHECKSUM} is damaged")
        return match[1]

    def set_checksum(self, checksum: str) -> None:
        """Seal the database's file."""
        data = f"{checksum}  {self._database}\n".encode()
        write_atomically(self._folder / CHECKSUM, data, mode=PRIVATE_FILE)

    def remove_checksum(self, actual: Callable[[], str]) -> None:
        """Before something is written: remove the seal, or keep it as evidence where the file's checksum is another."""
        path = self._folder / CHECKSUM
        if not path.exists():
            return
        if self._fits(actual()):
            path.unlink()
        else:
            os.replace(path, self._folder / MISMATCH)
        _sync(self._folder)

    def _fits(self, actual: str) -> bool:
        try:
            return self.checksum == actual
        except IntegrityFileError:
            return False

    @property
    def mismatch(self) -> bool:
        """Whether a writer found that the file had been changed."""
        return (self._folder / MISMATCH).exists()

    def note(self, head: Head) -> None:
        """Note the end of the chain after a transaction, which stands whether that succeeds or not."""
        with suppress(OSError, IntegrityFileError):
            if not self._noted:
                self._cut_unfinished_line()
            self._noted = True
        with suppress(OSError), open(self._folder / HEAD, "ab", buffering=0, opener=private_opener) as file:
            file.write(_line(head))

    def _cut_unfinished_line(self) -> None:
        """Remove what a crash may have cut, so that the next line stands by itself."""
        path = self._folder / HEAD
        if path.exists() and not path.read_bytes().endswith(b"\n"):
            self.set_heads(self.heads() or ())

    def heads(self) -> list[Head] | None:
        """The stored heads, if any; ``IntegrityFileError`` for a damaged file. A crash may cut the last line."""
        path = self._folder / HEAD
        if not path.exists():
            return None
        *lines, last = _text(path).split("\n")
        found = [_HEAD_LINE.fullmatch(line) for line in lines]
        if not all(found) or len(last) > len(_line(Head(10**18))):
            raise IntegrityFileError(f"{HEAD} is damaged")
        return [Head(int(match[1]), match[2]) for match in found if match]

    def set_heads(self, heads: Iterable[Head]) -> None:
        """Note no other ends than these."""
        data = b"".join(map(_line, heads))
        write_atomically(self._folder / HEAD, data, mode=PRIVATE_FILE)

    def remove(self) -> None:
        """Forget everything about a database that is no more."""
        for name in (HEAD, CHECKSUM, MISMATCH):
            (self._folder / name).unlink(missing_ok=True)


def _line(head: Head) -> bytes:
    return f"{head.number} {head.digest}\n".encode()


def _text(path: Path) -> str:
    return path.read_bytes().decode("ascii", "replace")


def _sync(folder: Path) -> None:
    """Put on disk that a file of a folder has gone, where the system can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
