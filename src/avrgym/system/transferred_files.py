"""Files by their content, for processes that may not see them."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import mkdtemp


@dataclass(frozen=True)
class TransferredFile:
    """A name, and the file's content where it is that of a file, or those of a folder's ``files`` by their paths."""

    name: str
    content: bytes | None = None
    files: tuple[tuple[str, bytes], ...] = ()

    @classmethod
    def of(cls, name: str) -> "TransferredFile":
        """What stands behind a name here."""
        return cls(name, Path(name).read_bytes() if Path(name).is_file() else None)

    @classmethod
    def folder(cls, name: str, files: Iterable[Path]) -> "TransferredFile":
        """A folder with some of the files in it."""
        return cls(name, files=tuple((str(file.relative_to(name)), file.read_bytes()) for file in files))

    def here(self) -> str:
        """A name by which this process finds it: its own, or that of a copy where no such files are seen here."""
        return self.name if all(_seen(*each) for each in self._there(Path(self.name))) else _copy(self)

    def _there(self, path: Path) -> list[tuple[Path, bytes]]:
        """Where its files are and what they hold, were it at a path."""
        alone = [] if self.content is None else [(path, self.content)]
        return alone + [(path / name, content) for name, content in self.files]

    def write(self, path: Path) -> None:
        """Write its files where it is to be."""
        for file, content in self._there(path):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)


def _seen(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


@cache
def _copy(carried: TransferredFile) -> str:
    """A copy of the same name, which rows and messages show; it stays as long as the machine keeps such files."""
    contents = [
        content for content in (carried.content, *dict(carried.files).values()) if content is not None
    ]
    folder = Path(mkdtemp(prefix=f"avrgym-{sha256(b''.join(contents)).hexdigest()[:8]}-"))
    path = folder / Path(carried.name).name
    carried.write(path)
    return str(path)
