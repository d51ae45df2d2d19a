"""What the documents say is there, and what is there they say."""

import re
from collections import Counter
from pathlib import Path

import pytest
from typer.main import get_command

from avrgym.cli.main import app
from avrgym.safety.approach_speed import effective_mass_kg
from avrgym.safety.force_guard import GUARD_SHARE
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N, max_impact_speed_m_s
from avrgym.tasks.constants import environment_id
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from helpers.browser.documentation import DOCUMENTS, anchors, missing_rows, name_of
from helpers.simulation.starts import begun
from helpers.system.places import ROOT

README = (ROOT / "README.md").read_text()
ENVIRONMENT_PAGE = (ROOT / "docs" / "environments.md").read_text()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_and_pictures_lead_somewhere(document):
    targets = re.findall(r"\]\(([^)#]+)", document.read_text())
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (document.parent / target).exists()] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_to_headings_find_them(document):
    links = re.findall(r"\]\(([^)#:]*)#([^)]+)\)", document.read_text())
    pages = [document.parent / target if target else document for target, _ in links]
    lost = [anchor for page, (_, anchor) in zip(pages, links, strict=True) if anchor not in anchors(page)]
    assert lost == []


EXAMPLES = {
    environment_id(task, robot)
    for task in (*TASKS, "TouchElbow")
    for robot in ("Jaco", "Gen3", "UR5", "LongArm")
}
"""Those of the pages on how to add a task and a robot."""


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_every_environment_that_is_named_exists(document):
    named = set(re.findall(r"avrgym/[A-Za-z0-9]+-v\d+", document.read_text()))
    assert named <= {*ENVIRONMENTS, *EXAMPLES}


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


@pytest.mark.parametrize(
    ("kind", "page"),
    [("original", "policies.md"), ("revised", "policies.md"), ("adaptive", "adaptive.md")],
)
def test_the_pages_of_the_policies_say_what_their_files_say(kind, page):
    assert missing_rows(page, "policy_tables", "packaged_table", kind) == []


@pytest.mark.parametrize("table", ["table", "table_of_forces"])
@pytest.mark.parametrize("kind", ["original", "revised", "adaptive"])
def test_the_page_of_policies_that_remember_says_how_all_do_with_whom(kind, table):
    assert missing_rows("adaptive.md", "partners", table, kind) == []


def test_the_page_of_the_policies_says_what_the_force_guard_is_worth():
    assert missing_rows("policies.md", "partners", "table_of_the_guard") == []


@pytest.mark.parametrize(
    ("page", "script"),
    [
        ("policies.md", "like_for_like"),
        ("policies.md", "paper_recipe"),
        ("adaptive.md", "memory_ablation"),
    ],
)
def test_the_pages_of_the_policies_say_what_trainings_for_comparison_reached(page, script):
    assert missing_rows(page, script, "table") == []


@pytest.mark.parametrize("table", ["style_rows", "range_rows"])
def test_the_page_of_the_zoo_says_who_lives_there(table):
    assert missing_rows("zoo.md", "zoo_tables", table) == []


def test_the_page_of_the_policies_says_what_regions_bear():
    page = (ROOT / "docs" / "policies.md").read_text().splitlines()
    speeds = [
        max_impact_speed_m_s(GUARD_SHARE * QUASI_STATIC_LIMIT_N, effective_mass_kg(begun(name, 1).simulation))
        for name in ("avrgym/FeedingJaco-v1", "avrgym/FeedingPR2-v1")
    ]
    for region, *fastest in zip(BODY_REGIONS, *speeds, strict=True):
        limits = f"{region.quasi_static_limit_n:g} N | {region.transient_limit_n:g} N"
        blow = f"{region.spring_n_mm:g} N/mm | {region.mass_kg:g} kg"
        allowed = " | ".join(f"{100 * speed:.0f} cm/s" for speed in fastest)
        assert f"| {region.name} | {limits} | {blow} | {allowed} | {', '.join(region.geoms)} |" in page


PAPER_PAGE = (ROOT / "docs" / "paper.md").read_text()
CLAIMS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAPER_PAGE.splitlines()
    if re.match(r"\| \d+ \|", line)
]
FOLDERS = {"docs", "research", "client", "examples", "tests", "scripts"}


def test_every_claim_of_the_paper_is_numbered_and_judged():
    assert [int(number) for number, *_ in CLAIMS] == list(range(1, len(CLAIMS) + 1))
    assert len(CLAIMS) >= 128
    judged = Counter(how for *_, how, _ in CLAIMS)
    assert set(judged) == {"same", "better", "different", "needs people"}
    for how, count in judged.items():
        assert f"| {how} | {count} |" in PAPER_PAGE
    assert f"| all | {len(CLAIMS)} |" in PAPER_PAGE


def test_every_claim_says_where_it_is_met():
    """Only what needs people may stand without a test; whatever is the same or better has one, or a file to show."""
    assert [number for number, _, where, _, _ in CLAIMS if not where] == []
    untested = {how for _, _, where, how, test in CLAIMS if test == "–" and "LICENSE" not in where}
    assert untested <= {"needs people"}


@pytest.mark.parametrize("page", ["paper.md", "differences.md", "body_alignment.md"])
def test_every_file_that_is_named_exists(page):
    text = (ROOT / "docs" / page).read_text()
    named = re.findall(r"`([\w./]+\.(?:py|md|ts|toml))`", text)
    assert named
    assert [name for name in named if not _path(name).is_file()] == []


def _path(name: str) -> Path:
    return ROOT / name if name.split("/")[0] in FOLDERS else ROOT / "src" / "avrgym" / name


@pytest.mark.parametrize("page", ["paper.md", "differences.md"])
def test_every_name_beside_a_file_is_in_it(page):
    """`file.py`, `NAME`: constants and reward terms."""
    text = (ROOT / "docs" / page).read_text()
    for file, names in re.findall(r"`([\w./]+\.py)`((?:, `\w+`)+)", text):
        for name in re.findall(r"`(\w+)`", names):
            assert re.search(rf"\b{name}\b", _path(file).read_text()), (file, name)


def test_every_test_that_is_named_exists():
    named = re.findall(r"`(test_\w+)(?:::(test_\w+))?`", PAPER_PAGE)
    assert len(named) > 100
    for file, test in named:
        source = next((ROOT / "tests").rglob(f"{file}.py")).read_text()
        assert not test or f"def {test}(" in source, (file, test)


def test_every_command_that_is_named_exists():
    commands = set(get_command(app).commands)  # type: ignore[attr-defined]
    assert set(re.findall(r"`avrgym ([a-z-]+)", PAPER_PAGE)) <= commands
