"""Integrity files of the database. They reveal changes by other programs, and replacement by an older copy.

``study.head`` contains heads of the hash chain. A head is the number and digest of the last entry after a transaction.
The file has a line for each transaction since the database was last closed. A head is written after its transaction is
on disk. If the chain lacks one of these heads, an older copy replaced the database.

``study.db.sha256`` contains the checksum of the SQLite file in the format of ``sha256sum``. It is removed before each
write, and written when the database is closed. If the database has another checksum, the file is renamed to
``study.db.sha256.mismatch``. The user must find the cause and remove this file.
"""

import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from avrgym.study.storage.hash_chain import HashChainHead
from avrgym.system.files import PRIVATE_FILE_MODE, open_privately, write_atomically

HASH_CHAIN_HEAD_FILE = "study.head"
CHECKSUM_FILE = "study.db.sha256"
CHECKSUM_MISMATCH_FILE = f"{CHECKSUM_FILE}.mismatch"
"""File names of the heads, of the checksum, and of a checksum that differed from the database."""
_HEAD_LINE = re.compile(r"([1-9][0-9]{0,17}) ([0-9a-f]{64})")


class IntegrityFileError(ValueError):
    """Raised if an integrity file is damaged."""


class IntegrityFiles:
    """Reads and writes the integrity files of a database.

    Callers must hold the database's write lock, except for reading and ``append_chain_head``.
    """

    def __init__(self, folder: Path, database: str) -> None:
        self._folder, self._database = folder, database
        self._noted = False

    @property
    def stored_database_checksum(self) -> str | None:
        """The stored checksum of the database; ``None`` if the file is missing.

        Raises ``IntegrityFileError`` if the file is damaged.
        """
        path = self._folder / CHECKSUM_FILE
        if not path.exists():
            return None
        match = re.fullmatch(rf"([0-9a-f]{{64}})  {re.escape(self._database)}\n", _text(path))
        if match is None:
            raise IntegrityFileError(f"{CHECKSUM_FILE} is damaged; restore a backup of the study")
        return match[1]

    def set_checksum(self, checksum: str) -> None:
        """Write the checksum file. ``checksum``: SHA-256 of the database (hexadecimal)."""
        data = f"{checksum}  {self._database}\n".encode()
        write_atomically(self._folder / CHECKSUM_FILE, data, mode=PRIVATE_FILE_MODE)

    def invalidate_checksum(self, actual: Callable[[], str]) -> None:
        """Remove the checksum file before a write. If the database has another checksum, rename the file instead.

        ``actual``: function that returns the checksum of the database.
        """
        path = self._folder / CHECKSUM_FILE
        if not path.exists():
            return
        if self._fits(actual()):
            path.unlink()
        else:
            os.replace(path, self._folder / CHECKSUM_MISMATCH_FILE)
        _sync(self._folder)

    def _fits(self, actual: str) -> bool:
        try:
            return self.stored_database_checksum == actual
        except IntegrityFileError:
            return False

    @property
    def has_checksum_mismatch(self) -> bool:
        """Whether a writer found a database that another program had changed."""
        return (self._folder / CHECKSUM_MISMATCH_FILE).exists()

    def append_chain_head(self, head: HashChainHead) -> None:
        """Append a chain head after a transaction. Errors are ignored, because the transaction is complete."""
        with suppress(OSError, IntegrityFileError):
            if not self._noted:
                self._cut_unfinished_line()
            self._noted = True
        with (
            suppress(OSError),
            open(self._folder / HASH_CHAIN_HEAD_FILE, "ab", buffering=0, opener=open_privately) as file,
        ):
            file.write(_line(head))

    def _cut_unfinished_line(self) -> None:
        """Remove an unfinished last line after a crash."""
        path = self._folder / HASH_CHAIN_HEAD_FILE
        if path.exists() and not path.read_bytes().endswith(b"\n"):
            self.replace_chain_heads(self.read_chain_heads() or ())

    def read_chain_heads(self) -> list[HashChainHead] | None:
        """Returns the stored heads of the hash chain; ``None`` without a file. A truncated last line is ignored.

        Raises ``IntegrityFileError`` if the file is damaged.
        """
        path = self._folder / HASH_CHAIN_HEAD_FILE
        if not path.exists():
            return None
        *lines, last = _text(path).split("\n")
        found = [_HEAD_LINE.fullmatch(line) for line in lines]
        if not all(found) or len(last) > len(_line(HashChainHead(10**18))):
            raise IntegrityFileError(f"{HASH_CHAIN_HEAD_FILE} is damaged; restore a backup of the study")
        return [HashChainHead(int(match[1]), match[2]) for match in found if match]

    def replace_chain_heads(self, heads: Iterable[HashChainHead]) -> None:
        """Replace all heads in ``study.head``."""
        data = b"".join(map(_line, heads))
        write_atomically(self._folder / HASH_CHAIN_HEAD_FILE, data, mode=PRIVATE_FILE_MODE)

    def remove_all(self) -> None:
        """Delete all integrity files, for the rebuild of a lost database."""
        for name in (HASH_CHAIN_HEAD_FILE, CHECKSUM_FILE, CHECKSUM_MISMATCH_FILE):
            (self._folder / name).unlink(missing_ok=True)


def _line(head: HashChainHead) -> bytes:
    return f"{head.number} {head.digest}\n".encode()


def _text(path: Path) -> str:
    return path.read_bytes().decode("ascii", "replace")


def _sync(folder: Path) -> None:
    """Flush changes of a folder to disk, if the operating system supports this."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
