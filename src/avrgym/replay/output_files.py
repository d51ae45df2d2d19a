"""Checks the path of an output file before it is written."""

from pathlib import Path


def check_output_path(path: Path, suffixes: tuple[str, ...]) -> None:
    """Check that the path has one of these suffixes and that a new file can be created there.

    Raises:
        ValueError: for another suffix or a missing folder.
        FileExistsError: if the file exists.
    """
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: the file name must end in {' or '.join(suffixes)}")
    if path.exists():
        raise FileExistsError(f"{path} already exists; choose another name")
    if not path.parent.is_dir():
        raise ValueError(f"cannot write {path}: the folder {path.parent} does not exist; create it first")
