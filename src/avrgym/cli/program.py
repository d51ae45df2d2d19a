"""The program ``avrgym``: how signals and missing packages end it. Ctrl+C, SIGTERM and SIGHUP do the same."""

import os
import signal
import sys
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from avrgym.system.extras import extra_of

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_INTERRUPTED = 130
"""What Typer makes of a KeyboardInterrupt."""
MOST_SIGNALS = 3
"""The first one lets the program end well, and the next does not disturb that; this many end it at once."""
EXTRAS = {
    "study": "study",
    "analyze": "study",
    "fit-people": "study",
    "demo": "study",
    "sweep": "train,cluster",
}
"""Extras with all packages of a command, where it needs more than one extra's."""


class Signals:
    """The signals that came so far; those that were ignored when the program began, as by ``nohup``, stay so."""

    def __init__(self) -> None:
        self.received: list[int] = []

    def listen(self) -> None:
        """Let the first signal from now on raise ``KeyboardInterrupt``."""
        for each in STOPPING:
            if signal.getsignal(each) is not signal.SIG_IGN:
                signal.signal(each, self._receive)

    @property
    def exit_code(self) -> int:
        """That of a program which the first of them broke off."""
        return 128 + self.received[0]

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received.append(number)
        if len(self.received) == 1:
            raise KeyboardInterrupt
        if len(self.received) >= MOST_SIGNALS:
            os._exit(self.exit_code)


class Commands(TyperGroup):
    """Commands of which one whose packages are missing ends with the command that installs them."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; raises ``typer.Exit``."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            extra = extra_of(error.name or "", preferred=EXTRAS.get(ctx.invoked_subcommand or ""))
            if extra is None:
                raise
            typer.echo(f"avrgym: {error.name} is missing; run `pip install 'avrgym[{extra}]'`", err=True)
            raise typer.Exit(1) from error


class Program(typer.Typer):
    """A command line of which signals break off a command with the exit code 128 and the signal's number."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Run the command line's command; raises ``SystemExit``."""
        signals = Signals()
        try:
            signals.listen()
            return super().__call__(*arguments, **options)
        except (KeyboardInterrupt, SystemExit) as end:
            if not signals.received or not _is_broken_off(end):
                raise
            kept = _notes(end)
        typer.echo("; ".join(["avrgym: stopped", *kept]), err=True)
        sys.exit(signals.exit_code)


def _is_broken_off(end: BaseException) -> bool:
    """Whether a command ended by an interrupt that it did not take for an ordinary end."""
    return (
        isinstance(end, KeyboardInterrupt)
        or isinstance(end.__context__, typer.Abort)
        or (isinstance(end, SystemExit) and end.code == _INTERRUPTED)
    )


def _notes(end: BaseException) -> list[str]:
    """What was noted on the interrupt that led to an end: what is kept, and how to go on."""
    error: BaseException | None = end
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return list(dict.fromkeys(getattr(error, "__notes__", [])))
        error = error.__cause__ or error.__context__
    return []
