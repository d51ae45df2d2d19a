"""The citation file and the issue forms."""

import re
import tomllib
from typing import Any

import pytest
from typer.main import get_command

from avrgym.cli.main import app
from helpers.system.paths import ROOT

REQUIRED = ("cff-version", "message", "title", "authors")
REQUIRED_OF_REFERENCES = ("type", "title", "authors")
"""Required by the Citation File Format 1.2.0, https://github.com/citation-file-format/citation-file-format."""
PERSON = {"family-names", "given-names"}
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md"))


def read_yaml(text: str) -> Any:
    """Read mappings, lists and strings: the subset of YAML that these files use."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    return _block(lines)


def _block(lines: list[str]) -> Any:
    indent = len(lines[0]) - len(lines[0].lstrip())
    starts = [n for n, line in enumerate(lines) if line[indent] != " "]
    parts = [lines[start:end] for start, end in zip(starts, [*starts[1:], None], strict=True)]
    if lines[0][indent] == "-":
        return [_block([each[0].replace("-", " ", 1), *each[1:]]) for each in parts]
    if not re.match(r" *[\w-]+:( |$)", lines[0]):
        return lines[0].strip()
    return {part[0].partition(":")[0].strip(): _value(part) for part in parts}


def _value(lines: list[str]) -> Any:
    value = lines[0].partition(":")[2].strip()
    if value == ">-":
        return " ".join(line.strip() for line in lines[1:])
    return value.strip('"') if value else _block(lines[1:])


CITATION = read_yaml((ROOT / "CITATION.cff").read_text())


def test_the_citation_has_all_required_fields() -> None:
    assert [name for name in REQUIRED if not CITATION.get(name)] == []
    assert CITATION["cff-version"] == "1.2.0"
    for each in (CITATION, *CITATION["references"]):
        assert each["authors"]
        assert all(author.keys() in (PERSON, {"name"}) for author in each["authors"])


def test_the_citation_has_this_version_and_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (CITATION["version"], CITATION["license"]) == (project["version"], project["license"])


def test_the_citation_refers_to_the_paper() -> None:
    (paper,) = CITATION["references"]
    assert [name for name in REQUIRED_OF_REFERENCES if not paper.get(name)] == []
    assert [author["family-names"] for author in paper["authors"]] == ["Erickson", "Gu", "Kemp"]
    assert (paper["type"], paper["year"]) == ("conference-paper", "2020")
    assert paper["conference"]["name"]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_issue_forms_have_a_header_and_valid_commands(form) -> None:
    begins, front, body = form.read_text().split("---\n", 2)
    assert begins == ""
    assert all(read_yaml(front)[key] for key in ("name", "about", "labels"))
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert set(re.findall(r"avrgym ([a-z-]+)", body)) <= commands


def test_issue_forms_exist() -> None:
    assert [form.stem for form in FORMS] == ["benchmark", "bug", "headset"]
