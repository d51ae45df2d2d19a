"""Recordings on their way from a site into a merged study, compared with their checksums."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from avrgym.recording import answers_file
from avrgym.study.merge.sources import Row, Source
from avrgym.study.plan.freezing import sha256
from avrgym.study.storage.attempts import CHANGED
from avrgym.study.storage.rows import RECORDINGS, participant_number, pseudonym_of
from avrgym.study.storage.sites import merged_number
from avrgym.study.storage.states import StudyError
from avrgym.system.files import PRIVATE_FILE, make_private_folder, write_whole

_IN_RECORDINGS = re.compile(rf"{RECORDINGS}/(sub-[0-9]{{3,9}})/")


def merged_name(text: str, site: int) -> str:
    """A recording's name, or text that begins with one, as it is in the merged study."""
    match = _IN_RECORDINGS.match(text)
    if match is None:
        return text
    pseudonym = pseudonym_of(merged_number(site, participant_number(match[1])))
    return f"{RECORDINGS}/{pseudonym}/{text[match.end() :]}"


@dataclass(frozen=True)
class Recording:
    """A recording of a site, and where it goes; without a checksum nobody vouches for it, and it may be missing."""

    attempt: int
    participant: int
    name: str
    source: Path | None
    target: Path
    sha256: str | None

    def is_there(self) -> bool:
        """Whether the merged study has it as it is vouched for."""
        return self.sha256 is not None and self.target.is_file() and _checksum(self.target) == self.sha256

    def fault(self) -> str | None:
        """Why it cannot be copied: a clause that begins with its name."""
        if self.source is None:
            return f"{self.name} lies outside the study's recordings"
        if self.sha256 is None:
            return None
        if not self.source.is_file():
            return f"{self.name} is missing"
        return None if _checksum(self.source) == self.sha256 else f"{self.name} {CHANGED}"

    def copy(self) -> bool:
        """Copy it, so that it appears whole or not at all; whether that changed anything.

        Raises:
            StudyError: when it is not as it is vouched for.
        """
        if self.source is None or not self.source.is_file():
            return False
        data = self.source.read_bytes()
        if self.sha256 not in (None, sha256(data)):
            raise StudyError(f"{self.name} {CHANGED} while it was copied")
        make_private_folder(self.target.parent)
        late = answers_file.answers_path(self.source)
        if late.is_file():
            write_whole(answers_file.answers_path(self.target), late.read_bytes(), PRIVATE_FILE)
        if self.target.is_file() and self.target.read_bytes() == data:
            return False
        write_whole(self.target, data, PRIVATE_FILE)
        return True


def recordings_of(source: Source, site: int, folder: Path) -> Iterator[Recording]:
    """Every recording of a site, on its way into the merged study in ``folder``."""
    participants = {row["id"]: row["participant"] for row in source.rows["session"]}
    for row in source.rows["attempt"]:
        name = row["recording"]
        target = folder / merged_name(name, site)
        yield Recording(
            row["id"], participants[row["session"]], name, _path(source, name), target, _vouched(row)
        )


def _vouched(row: Row) -> str | None:
    """The checksum of an attempt's recording; one that completed its trial has a recording, so another fits none."""
    return row["sha256"] or ("none" if row["state"] == "completed" else None)


def _path(source: Source, name: str) -> Path | None:
    if not _IN_RECORDINGS.match(name) or ".." in name.split("/"):
        return None
    try:
        return source.store.path(name)
    except StudyError:
        return None


def _checksum(path: Path) -> str:
    return sha256(path.read_bytes())
