"""The documentation's pages: their blocks of code and the commands in them."""

import re
import runpy
import shlex
import textwrap
from pathlib import Path
from typing import NamedTuple

from helpers.system.paths import ROOT

DOCS = ROOT / "docs"
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *sorted(DOCS.rglob("*.md")), ROOT / "examples" / "README.md"]
_BLOCK = re.compile(r"^( *)```(\w+)[^\n]*\n(.*?)^\1```", re.M | re.S)


class Block(NamedTuple):
    """A fenced block of code and its language."""

    language: str
    text: str


def blocks(page: Path) -> list[Block]:
    """The blocks of a page in order; indentation of lists is removed."""
    found = _BLOCK.findall(page.read_text())
    return [Block(language, textwrap.dedent(text)) for _, language, text in found]


def commands(text: str) -> list[list[str]]:
    """The words of each shell command of a block, without comments and redirections."""
    lines = text.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line.partition(" > ")[0], comments=True))]


def missing_rows(note: str, script: str, table: str, *arguments: str) -> list[str]:
    """The rows of a script's table that a note in ``research`` does not contain."""
    lines = (ROOT / "research" / note).read_text().splitlines()
    rows = [*runpy.run_path(str(ROOT / "research" / f"{script}.py"))[table](*arguments)]
    assert len(rows) > 2
    return [row for row in rows if row not in lines]


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings: their words, joined by hyphens."""
    headings = re.findall(r"^#+ +(.+)$", _BLOCK.sub("", page.read_text()), flags=re.MULTILINE)
    words = (re.sub(r"[^\w\s-]", "", heading).lower() for heading in headings)
    return {re.sub(r"[\s-]+", "-", each.strip()) for each in words}


def name_of(page: Path) -> str:
    """The path of a page, such as ``docs/how_to/connect_headset.md``."""
    return page.relative_to(ROOT).as_posix()
