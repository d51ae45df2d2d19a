"""What the documents say is there, and what is there they say."""

import re
import runpy
from pathlib import Path

import pytest
from typer.main import get_command

from avrgym.cli import app
from avrgym.tasks import ENVIRONMENTS, TASKS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ENVIRONMENT_PAGE = (ROOT / "docs" / "environments.md").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_and_pictures_lead_somewhere(document):
    targets = re.findall(r"\]\(([^)#]+)", document.read_text())
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (document.parent / target).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_environment_that_is_named_exists(document):
    named = set(re.findall(r"avrgym/[A-Za-z0-9]+-v\d+", document.read_text()))
    assert named <= set(ENVIRONMENTS)


def test_every_environment_is_described_with_a_picture():
    assert set(ENVIRONMENTS) <= set(re.findall(r"avrgym/[A-Za-z0-9]+-v\d+", ENVIRONMENT_PAGE))
    assert ENVIRONMENT_PAGE.count("](pictures/") == len(ENVIRONMENTS)


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_every_reward_term_is_described_with_its_weight(task):
    for term, weight in task.weights.items():
        assert f"| `{term}` | {weight:g} |" in ENVIRONMENT_PAGE


def test_the_readme_names_every_command():
    commands = get_command(app).commands  # type: ignore[attr-defined]
    assert [command for command in commands if f"`avrgym {command}" not in README] == []


@pytest.mark.parametrize("kind", ["original", "revised"])
def test_the_page_of_the_policies_says_what_their_files_say(kind):
    tables = runpy.run_path(str(ROOT / "examples" / "policy_tables.py"))
    page = (ROOT / "docs" / "policies.md").read_text().splitlines()
    assert [row for row in tables["packaged_table"](kind) if row not in page] == []
