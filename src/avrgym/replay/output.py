"""Where what is made of a recording may be written."""

from pathlib import Path


def check_new(path: Path, suffixes: tuple[str, ...]) -> None:
    """Nothing that exists is written over.

    Raises:
        ValueError: for another ending than these, or where there is no such folder.
        FileExistsError: when there is such a file.
    """
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: the name must end in {' or '.join(suffixes)}")
    if path.exists():
        raise FileExistsError(f"{path} exists already; choose another name")
    if not path.parent.is_dir():
        raise ValueError(f"cannot write {path}: there is no folder {path.parent}")
