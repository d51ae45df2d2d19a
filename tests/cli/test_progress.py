"""Progress of long tasks: on a terminal, in a file, and after an interruption."""

import io
import signal
import subprocess
import sys
from collections.abc import Iterable

import pytest

from avrgym.cli import progress
from avrgym.cli.progress import WorkRate, format_duration, show_progress_bar
from avrgym.cli.terminal import print_table
from helpers.system.processes import kill_with_parent

STOPPED = """
import os, signal
from avrgym.cli.program import Program
from avrgym.cli.progress import show_progress_bar
import typer

app = Program()

@app.command()
def work():
    with show_progress_bar("working", 10, "steps", stopped="`work --resume` goes on") as bar:
        bar.advance()
        os.kill(os.getpid(), signal.{signal})
        signal.pause()

app()
"""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class File(io.StringIO):
    encoding = "utf-8"


def output_of(out: io.StringIO, patch: pytest.MonkeyPatch, seconds: Iterable[float]) -> str:
    """Return the output for ten steps, with one step at each of the given times."""
    now_s = [0.0]
    with patch.context() as here:
        here.setattr(sys, "stdout", out)
        with show_progress_bar("walking", 10, "steps", clock=lambda: now_s[0]) as bar:
            for second in seconds:
                now_s[0] = second
                bar.advance()
    return out.getvalue()


@pytest.mark.parametrize(
    "colours", [{}, {"FORCE_COLOR": "1", "TERM": "xterm-256color"}], ids=["plain", "forced"]
)
def test_a_file_gets_plain_lines(colours: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in colours.items():
        monkeypatch.setenv(name, value)
    assert output_of(File(), monkeypatch, range(6, 66, 6)).splitlines() == [
        "walking: 2 of 10 steps (20 %), 0.17 a second, 48 s left",
        "walking: 4 of 10 steps (40 %), 0.17 a second, 36 s left",
        "walking: 6 of 10 steps (60 %), 0.17 a second, 24 s left",
        "walking: 8 of 10 steps (80 %), 0.17 a second, 12 s left",
        "walking: 10 of 10 steps (100 %), 0.17 a second",
        "walking: done in 60 s",
    ]


def test_a_short_task_writes_nothing_to_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    assert output_of(File(), monkeypatch, [0.9 * progress.LINE_INTERVAL_S] * 10) == ""


def test_a_terminal_shows_a_temporary_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    text = output_of(Terminal(), monkeypatch, range(6, 66, 6))
    assert "\x1b[2K" in text
    assert "10/10" in text
    assert "steps (" not in text


def test_a_task_of_unknown_length_shows_the_completed_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, out = [0.0], File()
    with monkeypatch.context() as here:
        here.setattr(sys, "stdout", out)
        with show_progress_bar("reading", unit="files", clock=lambda: now_s[0]) as bar:
            now_s[0] = 20.0
            bar.update(3)
            now_s[0] = 40.0
            bar.update(6, 12, "reading again")
            now_s[0] = 60.0
            bar.update(7)
            now_s[0] = 80.0
            bar.update(8)
    assert out.getvalue().splitlines() == [
        "reading: 3 files",
        "reading again: 6 of 12 files (50 %), 0.15 a second, 40 s left",
        "reading again: 7 of 12 files (58 %), 0.1 a second, 50 s left",
        "reading again: 8 of 12 files (67 %), 0.083 a second, 48 s left",
        "reading: done in 80 s",
    ]


def test_completed_steps_before_a_resume_do_not_count_for_the_rate() -> None:
    rate = WorkRate()
    for now_s, done in ((5.0, 1000.0), (10.0, 1010.0), (10.5, 1011.0), (15.0, 1020.0)):
        rate.add_sample(now_s, done)
    assert rate.work_per_s == pytest.approx(2.0)


def test_the_rate_covers_the_latest_minutes() -> None:
    rate = WorkRate()
    for second in range(0, 4000, 2):
        rate.add_sample(float(second), min(second, 2000) * 10.0 + max(second - 2000, 0) * 1.0)
    assert rate.work_per_s == pytest.approx(1.0)


def test_a_table_in_a_file_has_no_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    out = File()
    with monkeypatch.context() as here:
        here.setattr(sys, "stdout", out)
        print_table([{"name": "x" * 300, "value": 1.0}])
    assert "\x1b" not in out.getvalue()
    assert "x" * 300 in out.getvalue()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
@pytest.mark.fast_cases(1)
def test_an_interruption_prints_one_line_with_the_resume_command(number: signal.Signals) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", STOPPED.replace("{signal}", number.name)],
        capture_output=True,
        text=True,
        preexec_fn=kill_with_parent,
    )
    assert ran.returncode == 128 + number
    assert ran.stderr == "avrgym: stopped; `work --resume` goes on\n"


def test_an_error_is_not_an_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="wrong") as error, show_progress_bar("working"):
        raise ValueError("wrong")
    assert not getattr(error.value, "__notes__", [])


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (99.4, "99 s"), (99.6, "100 s"), (100, "2 min"), (3569, "59 min"), (3600, "1 h 0 min"),
     (9000, "2 h 30 min")],
)  # fmt: skip
def test_duration_texts(seconds: float, words: str) -> None:
    assert format_duration(seconds) == words
