"""Read and write files: atomic writes, private files, files that users edit, and the folder for a user's data."""

import codecs
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

from avrgym.system.processes import is_process_running

PRIVATE_FILE_MODE, PRIVATE_FOLDER_MODE = 0o600, 0o700
_OTHERS = 0o077
_UNFINISHED = re.compile(r"\..+\.([0-9]+)\.part")


def write_atomically(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Write a file atomically. If an error occurs, the previous file is unchanged.

    ``mode``: permissions of the file; the umask of the process restricts them.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def find_leftover_files(folder: Path) -> list[Path]:
    """Returns the temporary files of killed processes in a folder and its subfolders, see ``write_atomically``."""
    found = ((path, _UNFINISHED.fullmatch(path.name)) for path in folder.rglob(".*.part"))
    return sorted(path for path, match in found if match and not is_process_running(int(match[1])))


def remove_leftover_files(folder: Path) -> None:
    """Remove the temporary files of killed processes in a folder, see ``find_leftover_files``."""
    for path in find_leftover_files(folder):
        path.unlink(missing_ok=True)


def write_folder_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """Write a new or empty folder atomically. Only the folder's owner can open it.

    ``write`` is called with a temporary folder, which is renamed afterwards. Temporary folders of killed processes are
    removed.
    """
    make_private_folder(path.parent)
    for left in path.parent.glob(f".{path.name}.*.new"):
        number = left.name.split(".")[-2]
        if number.isdecimal() and not is_process_running(int(number)):
            shutil.rmtree(left)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.new")
    temporary.mkdir(mode=PRIVATE_FOLDER_MODE)
    try:
        write(temporary)
        restrict_to_owner(temporary)
        if path.exists():
            path.rmdir()
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def open_privately(path: str, flags: int) -> int:
    """Opener for Python's ``open``: only the owner can read or write a new file. Returns the file descriptor."""
    return os.open(path, flags, PRIVATE_FILE_MODE)


def write_private_file(path: Path, text: str) -> None:
    """Write a new file that only its owner can read, and sync it to disk.

    Raises:
        FileExistsError: if the file exists. The existing file is not changed.
    """
    with open(path, "x", encoding="utf-8", opener=open_privately) as file:
        try:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            path.unlink(missing_ok=True)
            raise


def make_private_folder(path: Path) -> None:
    """Create a folder and its missing parents. Only the owner can open the new folders."""
    if not path.parent.exists():
        make_private_folder(path.parent)
    path.mkdir(mode=PRIVATE_FOLDER_MODE, exist_ok=True)


def restrict_to_owner(path: Path) -> None:
    """Remove the permissions of other users on a file, or on a folder and its contents."""
    for each in find_exposed_paths(path):
        each.chmod(each.stat().st_mode & ~_OTHERS)


def remove_folder(path: Path) -> None:
    """Remove a folder with its contents, if it exists. If it is a symbolic link, only the link is removed."""
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)


def find_exposed_paths(path: Path) -> Iterator[Path]:
    """Yields those paths on which other users have permissions: ``path`` and, for a folder, its contents.

    Symbolic links are ignored.
    """
    if os.name != "posix" or not os.path.lexists(path):
        return
    within = path.rglob("*") if path.is_dir() and not path.is_symlink() else ()
    for each in (path, *within):
        if not each.is_symlink() and each.stat().st_mode & _OTHERS:
            yield each


_USER_ENCODING = "utf-8-sig"


def read_user_text(path: Path) -> str:
    """Returns the text of a file that users edit: UTF-8, with or without a byte-order mark (BOM).

    Raises:
        UnicodeDecodeError: for a file in another encoding.
        OSError: if the file cannot be read.
    """
    return path.read_text(encoding=_USER_ENCODING)


def make_bom_variants(data: bytes) -> tuple[bytes, bytes]:
    """Returns the bytes of a UTF-8 text ``data``: first without, then with a byte-order mark (BOM)."""
    text = data.removeprefix(codecs.BOM_UTF8)
    return text, codecs.BOM_UTF8 + text


def open_new_csv(path: Path) -> TextIO:
    """Open and return a new CSV file with a byte-order mark (BOM). Excel needs the mark for non-ASCII characters."""
    return open(path, "x", encoding=_USER_ENCODING, newline="")


def get_user_data_folder() -> Path:
    """Returns the folder for the user's keys, tokens and certificates. On Linux it is in ``$XDG_DATA_HOME`` or
    ``~/.local/share``."""
    import platformdirs  # a package of the extra vr

    return platformdirs.user_data_path("avrgym", appauthor=False)
