"""Commands print markup and control characters in texts as plain text."""

import io
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import escape_control_characters, print_line, print_table
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant

HOSTILE = (
    "[red]", "[/]", "[/red]", "[bold", "bold]", "[link=https://example.org]here[/link]", "[@click=quit]", "\\[x]",
    ":smile:", "{task.description}", "{0} %s %(name)s", "äöü 漢字 🤖 עברית", "two\nlines", "a\ttab", "'\"`$(true)",
    "", " ", "x" * 500, "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\r\b\x00\x7f\x9b", "\ud800",
)  # fmt: skip
PIECES = (*"[]/\\: =#abz'\"`{}()", "red", "bold", "link=", "\x1b", "🤖", "é")


def hostile_texts() -> list[str]:
    rng = np.random.default_rng(10)
    random = ["".join(rng.choice(PIECES, rng.integers(1, 12))) for _ in range(500)]
    return [*HOSTILE, *random]


def avrgym(*arguments: str | Path, answers: str | None = None) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=answers)


def output_of(action: Callable[[], object], monkeypatch: pytest.MonkeyPatch, encoding: str = "utf-8") -> str:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding, newline="", write_through=True)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        action()
    return raw.getvalue().decode(encoding)


def test_a_line_is_printed_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in hostile_texts():
        shown = output_of(lambda text=text: print_line(text), monkeypatch)
        assert shown == escape_control_characters(text, "utf-8") + "\n"
        if (
            not any(ord(character) < 32 or 0x7F <= ord(character) < 0xA0 for character in text)
            and text != "\ud800"
        ):
            assert shown == text + "\n"


def test_no_control_character_reaches_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in hostile_texts():
        shown = output_of(lambda text=text: print_line(text), monkeypatch)
        assert not {ord(character) for character in shown} & {*range(9), *range(11, 32), *range(127, 160)}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8"])
def test_a_table_is_shown_in_every_encoding(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row = {"name": None, "other": "漢字", "list": [None, 1.5]}
    shown = output_of(lambda: print_table([row]), monkeypatch, encoding)
    dash = "–" if encoding in ("cp1252", "utf-8") else "-"
    cells = [word for word in shown.splitlines()[-2].split() if word != "|"]
    assert cells == [dash, escape_control_characters("漢字", encoding), f"{dash},", "1.5"]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "utf-8"])
def test_characters_outside_the_encoding_are_escaped(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in hostile_texts():
        assert (
            output_of(lambda text=text: print_line(text), monkeypatch, encoding)
            == escape_control_characters(text, encoding) + "\n"
        )


def test_a_table_does_not_truncate_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = hostile_texts()
    for name, cell in zip(texts, reversed(texts), strict=True):
        row = {name: cell, "other": 1.5, "list": [cell, cell]}
        shown = output_of(lambda row=row: print_table([row]), monkeypatch)
        for text in (name, cell):
            for line in escape_control_characters(text, "utf-8").expandtabs(8).splitlines():
                assert line.strip() in shown


def test_a_table_has_the_width_of_its_cells_and_shows_missing_values_as_dashes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a pipe or a file, the width of the terminal does not matter."""
    monkeypatch.setenv("COLUMNS", "20")
    row = {f"figure_{number}_of_many": None if number else "x" * 30 for number in range(12)}
    shown = output_of(lambda: print_table([row]), monkeypatch)
    header, values = (
        next(line for line in shown.splitlines() if word in line) for word in ("figure_0", "xxx")
    )
    assert header.split() == list(row)
    assert values.split() == ["x" * 30, *["–"] * 11]


def test_system_errors_name_the_file_and_the_reason(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out, reason in (("none/new", "no such file or directory"), ("file/new", "not a directory")):
        result = avrgym("new", "task", "LiftArm", "--out", tmp_path / out)
        assert (result.exit_code, result.stderr) == (1, f"avrgym: {tmp_path / out}: {reason}\n")


def test_a_progress_bar_accepts_any_text(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in HOSTILE:
        with show_progress_bar(text, 2) as bar:
            bar.advance()
            bar.update(2, 2, text)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study with brackets in all free texts."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    folder = make_study(
        tmp_path / "st[/]udy [red]", tasks='["Feeding"]', title='"A [bold] title [/] :smile:"'
    )
    design = folder / "study.toml"
    text = design.read_text()
    text = text.replace("You take part in a study", "You [may stop] take [/part] in a [red]study[/red]")
    text = text.replace("Are you 18 years", "Are [you] 18 [/] years")
    design.write_text(text)
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), trials=2)
    return folder


def test_consent_shows_texts_in_brackets(folder: Path) -> None:
    avrgym("study", "enrol", folder, "--body", "woman")
    shown = avrgym("study", "consent", folder, "sub-002", answers="y\n" * 6)
    assert "You [may stop] take [/part] in a [red]study[/red]" in shown.stdout
    assert "Are [you] 18 [/] years" in shown.stdout


COMMANDS = [
    (("study", "status", "STUDY"), 0, "A [bold] title [/] :smile:"),
    (("study", "check", "STUDY"), 0, "no errors"),
    (("study", "export", "STUDY", "--format", "csv", "--out", "ta[/]bles"), 0, "ta[/]bles"),
    (("study", "export", "STUDY", "--format", "[/]", "--out", "tables"), 1, "unknown format '[/]'"),
    (("study", "new", "[bold]new[/]"), 0, "[bold]new[/]/study.toml"),
    (("study", "enrol", "STUDY", "--body", "[/]"), 1, "unknown body model '[/]'"),
    (("study", "consent", "STUDY", "[/]"), 1, "'[/]' is not a pseudonym"),
    (("study", "withdraw", "STUDY", "sub-001", "--reason", "[/]"), 0, "sub-001 has withdrawn"),
    (("study", "delete-participant", "STUDY", "[/]"), 1, "'[/]' is not a pseudonym"),
    (("analyze", "STUDY", "--out", "o[/]ut"), 0, "o[/]ut/report/index.html"),
    (("fit-people", "[/]"), 1, "[/] contains no study.toml"),
    (("replay", "[/].mcap"), 1, "[/].mcap"),
    (("study", "status", "two\nlines"), 1, "two lines contains no study.toml"),
    (("evaluate", "[/]"), 1, "[/]"),
    (("evaluate", "avrgym/FeedingJaco-v1", "--policy", "[/]"), 1, "no policy '[/]'"),
    (("evaluate", "avrgym/FeedingJaco-v1", "--people", "[/]"), 1, "[/]"),
    (("train", "[/]"), 1, "[/]"),
    (("view", "[/]", "--port", "0"), 1, "[/]"),
    (("serve", "--person", "[/]"), 1, "[/]"),
    (("serve", "--study", "[/]", "--participant", "[/]"), 1, "[/]"),
    (("bench", "sim", "--env", "[/]"), 1, "[/]"),
    (("bench", "vr", "--env", "[/]"), 1, "[/]"),
]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(("arguments", "code", "words"), COMMANDS, ids=lambda value: str(value)[:50])
def test_every_command_prints_brackets(
    folder: Path, arguments: tuple[str, ...], code: int, words: str
) -> None:
    result = avrgym(*(folder if argument == "STUDY" else argument for argument in arguments))
    output = result.stdout + result.stderr
    assert (result.exit_code, words in output) == (code, True), output
    assert code == 0 or len(result.stderr.splitlines()) == 1


def test_findings_with_brackets_are_shown(folder: Path) -> None:
    stray = folder / "recordings" / "[red]stray[bold].mcap"
    stray.parent.mkdir(exist_ok=True)
    stray.write_text("nothing")
    result = avrgym("study", "check", folder, "--json", "che[red]ck.json")
    assert result.exit_code == 1
    assert "recordings/[red]stray[bold].mcap: belongs to no attempt" in result.stdout
    assert json.loads(Path("che[red]ck.json").read_text())
