"""What strangers meet beside the documents: how to cite, and the forms of issues."""

import re
import tomllib
from typing import Any

import pytest
from typer.main import get_command

from avrgym.cli.main import app
from helpers.system.places import ROOT

REQUIRED = ("cff-version", "message", "title", "authors")
REQUIRED_OF_REFERENCES = ("type", "title", "authors")
"""By the Citation File Format 1.2.0, https://github.com/citation-file-format/citation-file-format."""
PERSON = {"family-names", "given-names"}
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.md"))


def read_yaml(text: str) -> Any:
    """Mappings, lists and texts, indented by two, quoted or folded: as much of YAML as the file needs."""
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


def test_the_citation_has_what_its_format_requires() -> None:
    assert [name for name in REQUIRED if not CITATION.get(name)] == []
    assert CITATION["cff-version"] == "1.2.0"
    for each in (CITATION, *CITATION["references"]):
        assert each["authors"]
        assert all(author.keys() in (PERSON, {"name"}) for author in each["authors"])


def test_the_citation_names_this_version_and_licence() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (CITATION["version"], CITATION["license"]) == (project["version"], project["license"])


def test_the_citation_refers_to_the_paper() -> None:
    (paper,) = CITATION["references"]
    assert [name for name in REQUIRED_OF_REFERENCES if not paper.get(name)] == []
    assert [author["family-names"] for author in paper["authors"]] == ["Erickson", "Gu", "Kemp"]
    assert (paper["type"], paper["year"]) == ("conference-paper", "2020")
    assert paper["conference"]["name"]


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_a_form_has_a_name_and_names_commands_that_exist(form) -> None:
    begins, front, body = form.read_text().split("---\n", 2)
    assert begins == ""
    assert all(read_yaml(front)[key] for key in ("name", "about", "labels"))
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert set(re.findall(r"avrgym ([a-z-]+)", body)) <= commands


def test_there_is_a_form_for_a_bug_a_headset_and_a_benchmark() -> None:
    assert [form.stem for form in FORMS] == ["benchmark", "bug", "headset"]
