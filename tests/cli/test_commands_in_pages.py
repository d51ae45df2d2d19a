"""Commands and code of pages are valid, and tutorials and how-to pages run.

They run in empty folders with smaller numbers. Commands of servers are only parsed; other tests run servers.
"""

import shutil
import tomllib
import warnings
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.study.design.design import parse_design, read_default_design_text
from helpers.browser.documentation import DOCS, DOCUMENTS, blocks, commands, name_of
from helpers.learning.small_training import shorten_training
from helpers.system.paths import OLD_RECORDING, ROOT

SMALLER = {"--episodes": "1", "--steps": "1", "--participants": "2", "--simulations": "4"}
SERVERS = ("serve", "view")
SET_UP = {"make", ".", "mkdir", "cd", "pip", "python3"}
ANSWERS = "y\n" + "y\ny\ny\ny\ny\ny\nn\n"
"""Answers to the consent text of the paper's protocol and its inclusion questions."""
RECORDING = OLD_RECORDING


@pytest.fixture(autouse=True)
def _small_and_quiet(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    shorten_training(monkeypatch)
    matplotlib.use("agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


# Every page


def _without_effect(group: Any) -> Any:
    """Return the program with commands that only parse their arguments."""
    for command in group.commands.values():
        if hasattr(command, "commands"):
            _without_effect(command)
        else:
            command.callback = lambda **_: None
    return group


def _commands_of_pages() -> list[tuple[str, list[str]]]:
    """Return every `avrgym` command in the code blocks of all pages."""
    found = [
        (name_of(page), words)
        for page in DOCUMENTS
        for block in blocks(page)
        if block.language == "sh"
        for words in commands(block.text)
        if Path(words[0]).name == "avrgym"
    ]
    assert len(found) > 80
    return found


def test_every_command_of_every_page_is_valid() -> None:
    program = _without_effect(get_command(app))
    for page, words in _commands_of_pages():
        try:
            program.main([str(word) for word in words[1:]], prog_name="avrgym", standalone_mode=False)
        except Exception as error:
            pytest.fail(f"{page}: {' '.join(words)}: {error}")


@pytest.mark.parametrize("page", DOCUMENTS, ids=name_of)
def test_code_blocks_are_valid(page: Path) -> None:
    for language, text in blocks(page):
        if language == "toml":
            tomllib.loads(text)
        if language == "python" and "--8<--" not in text:
            compile(text, name_of(page), "exec")


@pytest.mark.parametrize("page", ["how_to/questionnaire.md", "how_to/stations.md"])
def test_additions_to_a_study_are_valid(page: str) -> None:
    text = read_default_design_text().partition("[database]")[0]
    for language, added in blocks(DOCS / page):
        if language == "toml" and any(
            word in added for word in ("use =", "items =", "[[stop_rules]]", "url =")
        ):
            text += added
    assert parse_design(text).questionnaires


# Pages that are run


def run_page(page: str, folder: Path, only: str = "") -> None:
    """Run the commands and Python of a page in a folder, and apply its changes to files."""
    known: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for language, text in blocks(ROOT / page):
            if only not in ("", language):
                continue
            if language == "sh":
                for words in commands(text):
                    _run(words)
            elif language == "python":
                exec(compile(text, page, "exec"), known)
            elif language == "toml":
                _write(text)


def _run(words: list[str]) -> None:
    if words[0] in SET_UP:
        return
    if words[0] == "cp":
        shutil.copytree(words[2], words[3])
        return
    assert words[0] == "avrgym", words
    if words[1] in SERVERS or words[1:] == ["doctor"]:
        return
    smaller = [SMALLER.get(before, word) for before, word in pairwise(words)]
    if words[1] == "study" and words[2] in ("simulate", "power"):
        smaller += ["--jobs", "1"]
    done = CliRunner().invoke(app, smaller, input=ANSWERS)
    assert done.exit_code == 0, (words, done.output)


def _write(text: str) -> None:
    """Change the study's design or write the population file."""
    design = Path("my-study/study.toml")
    if "torso_height_m" in text:
        Path("tall.toml").write_text(text)
    elif design.is_file():
        lines = design.read_text().splitlines()
        for changed in [*text.splitlines(), "trial_steps = 3", "free_movement_s = 0.0"]:
            name = changed.split(" = ")[0]
            lines = [changed if line.startswith(f"{name} = ") else line for line in lines]
        design.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder after the studies tutorial."""
    folder = tmp_path_factory.mktemp("lab")
    run_page("docs/tutorials/first_study.md", folder)
    return folder


@pytest.mark.slow
def test_the_tutorial_on_studies_ends_with_a_report(study_folder: Path) -> None:
    assert (study_folder / "my-study" / "analysis" / "report" / "index.html").stat().st_size > 5_000
    assert (study_folder / "my-data" / "codebook.csv").is_file()
    assert "simulated" in (study_folder / "rehearsal" / "analysis" / "report" / "index.html").read_text()


@pytest.fixture
def lab(study_folder: Path, tmp_path: Path) -> Path:
    """A folder with the results of the tutorials."""
    shutil.copytree(study_folder / "rehearsal", tmp_path / "my-study")
    for session in ("study", "met"):
        (tmp_path / session / "recordings").mkdir(parents=True)
        shutil.copy(RECORDING, tmp_path / session / "recordings" / "trial-02_attempt-1.mcap")
    return tmp_path


@pytest.mark.slow
def test_the_first_trial_is_replayed_and_shown(lab: Path) -> None:
    run_page("docs/tutorials/first_trial.md", lab)
    assert (lab / "my-first-trial.html").stat().st_size > 100_000
    assert (lab / "my-first-trial.png").is_file()


@pytest.mark.slow
def test_a_policy_is_trained_and_evaluated(lab: Path) -> None:
    run_page("docs/tutorials/train_and_meet.md", lab)
    assert (lab / "mine.json").is_file()


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    ["how_to/people.md", "how_to/own_analysis.md", "reference/recording.md", "reference/policy_file.md"],
)
def test_the_page_runs(page: str, lab: Path) -> None:
    run_page(f"docs/{page}", lab)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        "docs/how_to/replay.md",
        "docs/how_to/fit_people.md",
    ],
)
def test_python_blocks_run(page: str, lab: Path) -> None:
    """Pages with long commands: only their Python runs here."""
    shutil.copy(RECORDING, lab / "trial-03_attempt-1.mcap")
    (lab / "people.toml").write_text(
        "cooperating = false\n[torso_height_m]\nman = [0.5, 0.6]\nwoman = [0.5, 0.6]\n"
    )
    run_page(page, lab, only="python")


def test_the_controller_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (mine,) = (
        text for language, text in blocks(DOCS / "how_to" / "add_a_controller.md") if language == "python"
    )
    Path("mine.py").write_text(mine)
    _run(["avrgym", "evaluate", "avrgym/FeedingJaco-v1", "--policy", "mine:Reach", "--episodes", "20"])
