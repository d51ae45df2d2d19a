"""Text files that people edit or open with other programs: UTF-8 with or without a byte-order mark."""

import codecs
from pathlib import Path
from typing import TextIO

_ENCODING = "utf-8-sig"


def read_user_text(path: Path) -> str:
    """The text of a file that people edit; editors such as Windows Notepad put a byte-order mark before it.

    Raises:
        UnicodeDecodeError: for a file in another encoding.
        OSError: when it cannot be read.
    """
    return path.read_text(encoding=_ENCODING)


def both_forms(data: bytes) -> tuple[bytes, bytes]:
    """The bytes of a text in UTF-8 without and with a byte-order mark, for comparisons that accept either."""
    text = data.removeprefix(codecs.BOM_UTF8)
    return text, codecs.BOM_UTF8 + text


def new_table(path: Path) -> TextIO:
    """Open a new file for comma-separated values with a byte-order mark, without which Excel garbles umlauts."""
    return open(path, "x", encoding=_ENCODING, newline="")
