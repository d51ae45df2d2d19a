"""Code blocks and commands of the documentation's pages."""

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
    """Return the code blocks of a page in order, without the indentation of lists."""
    found = _BLOCK.findall(page.read_text())
    return [Block(language, textwrap.dedent(text)) for _, language, text in found]


def without_blocks(page: Path) -> str:
    """Return a page without its code blocks."""
    return _BLOCK.sub("", page.read_text())


def commands(text: str) -> list[list[str]]:
    """Split a block into shell commands, without comments and redirections."""
    lines = text.replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line.partition(" > ")[0], comments=True))]


def missing_rows(note: str, script: str, table: str, *arguments: str) -> list[str]:
    """Return the rows of a script's table that are missing in a research note."""
    lines = (ROOT / "research" / note).read_text().splitlines()
    rows = [*runpy.run_path(str(ROOT / "research" / f"{script}.py"))[table](*arguments)]
    assert len(rows) > 2
    return [row for row in rows if row not in lines]


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    headings = re.findall(r"^#+ +(.+)$", without_blocks(page), flags=re.MULTILINE)
    words = (re.sub(r"[^\w\s-]", "", heading).lower() for heading in headings)
    return {re.sub(r"[\s-]+", "-", each.strip()) for each in words}


def name_of(page: Path) -> str:
    """Return the path of a page, such as ``docs/how_to/connect_headset.md``."""
    return page.relative_to(ROOT).as_posix()
