"""Files by their content, for processes that may not see them."""

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import mkdtemp


@dataclass(frozen=True)
class Carried:
    """A name, and the file's content where it is that of a file."""

    name: str
    content: bytes | None = None

    @classmethod
    def of(cls, name: str) -> "Carried":
        """What stands behind a name here."""
        return cls(name, Path(name).read_bytes() if Path(name).is_file() else None)

    def here(self) -> str:
        """A name by which this process finds it: its own, or that of a copy where no such file is seen here."""
        if self.content is None or _seen(self):
            return self.name
        return _copy(self)


def _seen(carried: Carried) -> bool:
    path = Path(carried.name)
    return path.is_file() and path.read_bytes() == carried.content


@cache
def _copy(carried: Carried) -> str:
    """A copy of the same file name, which rows and messages show; it stays as long as the machine keeps such files."""
    assert carried.content is not None
    folder = Path(mkdtemp(prefix=f"avrgym-{sha256(carried.content).hexdigest()[:8]}-"))
    path = folder / Path(carried.name).name
    path.write_bytes(carried.content)
    return str(path)
