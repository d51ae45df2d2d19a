"""Files that are sent, with their contents, to processes on other computers."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import mkdtemp


@dataclass(frozen=True)
class TransferredFile:
    """The name of a file or folder, and its contents. ``content`` is the content of a file. ``files`` contains relative
    path and content of each file of a folder.
    """

    name: str
    content: bytes | None = None
    files: tuple[tuple[str, bytes], ...] = ()

    @classmethod
    def read(cls, name: str) -> "TransferredFile":
        """Returns the file with this name and its contents. If there is no such file, only the name is stored."""
        return cls(name, Path(name).read_bytes() if Path(name).is_file() else None)

    @classmethod
    def read_folder(cls, name: str, files: Iterable[Path]) -> "TransferredFile":
        """Returns the folder ``name`` with the contents of its ``files``."""
        return cls(name, files=tuple((str(file.relative_to(name)), file.read_bytes()) for file in files))

    def get_local_path(self) -> str:
        """Returns a path of the files on this computer.

        This is ``name`` if identical files exist there. Otherwise it is the path of a temporary copy.
        """
        found = all(path.is_file() and path.read_bytes() == content for path, content in self._at(self.name))
        return self.name if found else _copy(self)

    def write(self, path: Path) -> None:
        """Write the file, or the files of the folder, to ``path``."""
        for file, content in self._at(path):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)

    def _at(self, path: str | Path) -> list[tuple[Path, bytes]]:
        """Returns the path and content of each file that ``write`` writes to ``path``."""
        alone = [] if self.content is None else [(Path(path), self.content)]
        return alone + [(Path(path) / name, content) for name, content in self.files]


@cache
def _copy(snapshot: TransferredFile) -> str:
    """Write a temporary copy, and return its path. The copy has the same base name, because results contain this
    name."""
    contents = [each for each in (snapshot.content, *dict(snapshot.files).values()) if each is not None]
    folder = Path(mkdtemp(prefix=f"avrgym-{sha256(b''.join(contents)).hexdigest()[:8]}-"))
    path = folder / Path(snapshot.name).name
    snapshot.write(path)
    return str(path)
