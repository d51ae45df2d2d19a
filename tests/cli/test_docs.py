"""Pages agree with the program: links, environments, rewards, commands, files and the paper's claims."""

import re
import subprocess
import sys
from collections import Counter
from dataclasses import fields
from pathlib import Path

import gymnasium.wrappers.vector
import pytest
from typer.main import get_command

from avrgym.cli.main import app
from avrgym.models.robot import Arm, Mount, Robot
from avrgym.tasks.constants import make_environment_id
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from avrgym.tasks.task import Task
from helpers.browser.documentation import DOCUMENTS, anchors, blocks, missing_rows, name_of, without_blocks
from helpers.system.paths import ROOT

README = (ROOT / "README.md").read_text()
ENVIRONMENT_PAGE = (ROOT / "docs" / "reference" / "environments.md").read_text()
CLAIMS_PAGE = ROOT / "research" / "paper_claims.md"
PAPER_PAGE = CLAIMS_PAGE.read_text()
CLAIMS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAPER_PAGE.splitlines()
    if re.match(r"\| \d+ \|", line)
]
FOLDERS = {"docs", "research", "client", "examples", "tests", "scripts", "src"}
PACKAGES = {path.name for path in (ROOT / "src" / "avrgym").iterdir() if path.is_dir()}
MAX_WORDS, MAX_README_LINES = 30_000, 120
EXAMPLES = {
    make_environment_id(task, robot)
    for task in (*TASKS, "TouchElbow")
    for robot in ("Jaco", "Fetch", "LongArm")
}
"""Environments on the pages about new tasks and robots."""
CODE_SUFFIXES = {".css", ".html", ".json", ".py", ".toml", ".ts"}
FILE_NAME = re.compile(
    r".*\.(csv|db|edf|glb|head|html|json|log|mcap|md|mp4|nc|onnx|pdf|py|sha256|svg|toml|ts|txt|zip)"
)
OTHER_NAMES = {
    *gymnasium.wrappers.__all__, *gymnasium.wrappers.vector.__all__, "NEXT_STEP",
    "Origin", "ScratchItchGen3", "ScratchItchPR2", "WARP_CACHE_PATH", "crontab", "docker", "gee", "lme4", "policy_NAME",
    "sleepstudy", "wine",
}  # fmt: skip
"""Names of other programs, and names that no file contains as one word."""


def test_pages_are_short():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    assert sum(len(page.read_text().split()) for page in pages) <= MAX_WORDS
    assert len(README.splitlines()) <= MAX_README_LINES


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_and_pictures_exist(document):
    targets = re.findall(r"\]\(([^)#]+)", document.read_text())
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (document.parent / target).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_to_headings_exist(document):
    links = re.findall(r"\]\(([^)#:]*)#([^)]+)\)", document.read_text())
    pages = [document.parent / target if target else document for target, _ in links]
    missing = [anchor for page, (_, anchor) in zip(pages, links, strict=True) if anchor not in anchors(page)]
    assert missing == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_named_environments_exist(document):
    named = set(re.findall(r"avrgym/[A-Za-z0-9]+-v\d+", document.read_text()))
    assert named <= {*ENVIRONMENTS, *EXAMPLES}


@pytest.mark.parametrize("document", [page for page in DOCUMENTS if page.name != "CHANGELOG.md"], ids=name_of)
def test_named_source_files_exist(document):
    named = re.findall(r"`((?:\w+/)+[\w./-]+\.(?:py|md|ts|toml))`", document.read_text())
    named += re.findall(r"`((?:\w+/)+)`", document.read_text())
    paths = [name for name in named if name.split("/")[0] in FOLDERS | PACKAGES]
    assert [name for name in paths if not _path(name).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_named_identifiers_exist(document, words):
    """Of the tables of renamed things in the changelog, only the new names exist."""
    text = without_blocks(document)
    if document.name == "CHANGELOG.md":
        text = text.partition("\n## 0.2.0")[0].partition("\n### Removed")[2].partition("\n### Renamed")[2]
        text = "\n".join(re.findall(r"^\| .* \| (.*) \|$", text, re.M))
    in_blocks = {word for block in blocks(document) for word in re.findall(r"\w+", block.text)}
    named = re.findall(r"`\.?([A-Za-z_][\w.]*)(?:\([^`]*\))?`", text)
    parts = {part for name in named if not FILE_NAME.fullmatch(name) for part in name.split(".")}
    assert parts - words - OTHER_NAMES - in_blocks == set()


@pytest.fixture(scope="module")
def words() -> set[str]:
    """All words of the program's code and scripts, and the names of these files and their folders."""
    folders = ["src/avrgym", "client/src", "examples", "scripts"]
    files = [
        path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in CODE_SUFFIXES
    ]
    files += [ROOT / "Makefile", ROOT / "pyproject.toml"]
    names = {name for path in files for name in (path.stem, path.parent.name)}
    return names | {word for path in files for word in re.findall(r"\w+", path.read_text())}


def _path(name: str) -> Path:
    return ROOT / name if name.split("/")[0] in FOLDERS else ROOT / "src" / "avrgym" / name


@pytest.mark.slow
def test_code_on_pages_has_correct_types(tmp_path):
    for document in DOCUMENTS:
        code = [
            block.text
            for block in blocks(document)
            if block.language == "python" and "--8<--" not in block.text
        ]
        file = tmp_path / f"{name_of(document).replace('/', '-')}.py"
        file.write_text(
            "\n".join(["# pyright: reportOptionalMemberAccess=false, reportUndefinedVariable=false", *code])
        )
    command = [Path(sys.executable).with_name("pyright"), "--pythonpath", sys.executable, tmp_path]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


def test_every_environment_has_a_picture():
    assert set(ENVIRONMENTS) <= set(re.findall(r"avrgym/[A-Za-z0-9]+-v\d+", ENVIRONMENT_PAGE))
    assert ENVIRONMENT_PAGE.count("](../pictures/") == len(ENVIRONMENTS)


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_every_reward_term_has_its_weight(task):
    for term, weight in task.reward_weights.items():
        assert f"| `{term}` | {weight:g} |" in ENVIRONMENT_PAGE


def test_the_readme_lists_every_command():
    commands = get_command(app).commands  # type: ignore[attr-defined]
    assert [command for command in commands if f"`{command}`" not in README] == []


@pytest.mark.parametrize(
    ("page", "record"),
    [("add_a_task.md", Task), ("add_a_robot.md", Robot), ("add_a_robot.md", Arm), ("add_a_robot.md", Mount)],
)
def test_pages_list_every_field_of_a_record(page, record):
    listed = re.findall(r"`(\w+)[`(]", (ROOT / "docs" / "how_to" / page).read_text())
    assert [field.name for field in fields(record) if field.name not in listed] == []


@pytest.mark.parametrize(
    ("note", "script"),
    [
        ("2026-11-23-like-for-like.md", "like_for_like"),
        ("2026-11-24-paper-recipe.md", "paper_recipe"),
        ("2026-11-27-adaptive-policies.md", "memory_ablation"),
    ],
)
def test_research_notes_contain_the_tables_of_their_scripts(note, script):
    assert missing_rows(note, script, "table") == []


# Claims of the paper


def test_claims_are_numbered_and_compared():
    assert [int(number) for number, *_ in CLAIMS] == list(range(1, len(CLAIMS) + 1))
    assert len(CLAIMS) >= 128
    results = Counter(result for *_, result, _ in CLAIMS)
    assert set(results) == {"same", "better", "different", "needs people"}
    for result, count in results.items():
        assert f"| {result} | {count} |" in PAPER_PAGE
    assert f"| all | {len(CLAIMS)} |" in PAPER_PAGE


def test_claims_have_an_implementation_and_a_test():
    """Claims about people can have no test."""
    assert [number for number, _, where, _, _ in CLAIMS if not where] == []
    untested = {result for _, _, where, result, test in CLAIMS if test == "–" and "LICENSE" not in where}
    assert untested <= {"needs people"}


def test_files_of_claims_exist():
    test_named_source_files_exist(CLAIMS_PAGE)
    named = set(re.findall(r"`(test_\w+)`", PAPER_PAGE))
    assert len(named) > 40
    assert [name for name in sorted(named) if not [*(ROOT / "tests").rglob(f"{name}.py")]] == []


def test_commands_of_claims_exist():
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert set(re.findall(r"`avrgym ([a-z-]+)", PAPER_PAGE)) <= commands
