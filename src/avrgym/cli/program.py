"""The program ``avrgym``: handle signals (Ctrl+C, SIGTERM, SIGHUP) and missing packages."""

import os
import signal
import sys
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from avrgym.system.extras import find_extra

STOP_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
_INTERRUPTED = 130
"""Exit code of Typer after a ``KeyboardInterrupt`` (Ctrl+C)."""
MAX_SIGNALS = 3
"""Number of the signal that ends the program immediately. The first signal ends the program with clean-up. The second
signal is ignored."""
EXTRA_BY_COMMAND = {
    "study": "study",
    "analyze": "study",
    "fit-people": "study",
    "demo": "study",
    "host": "study",
    "sweep": "train,cluster",
}
"""Extras of AVR Gym by command. If one of them contains a missing package, the error message suggests this extra."""


class SignalHandler:
    """Handles the signals of Ctrl+C, SIGTERM and SIGHUP. If the program starts with an ignored signal (``nohup``), this
    signal remains ignored.

    ``received_signals``: numbers of the received signals in order.
    """

    def __init__(self) -> None:
        self.received_signals: list[int] = []

    def install_handlers(self) -> None:
        """Install the signal handlers. The first signal then raises ``KeyboardInterrupt``."""
        for each in STOP_SIGNALS:
            if signal.getsignal(each) is not signal.SIG_IGN:
                signal.signal(each, self._receive)

    @property
    def exit_code(self) -> int:
        """The exit code of the program: 128 plus the number of the first signal."""
        return 128 + self.received_signals[0]

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received_signals.append(number)
        if len(self.received_signals) == 1:
            raise KeyboardInterrupt
        if len(self.received_signals) >= MAX_SIGNALS:
            os._exit(self.exit_code)


class CommandGroup(TyperGroup):
    """A group of commands. If a package is missing, it prints the command that installs the package."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, and return its result. Raises ``typer.Exit`` if a package is missing."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            extra = find_extra(error.name or "", preferred=EXTRA_BY_COMMAND.get(ctx.invoked_subcommand or ""))
            if extra is None:
                raise
            typer.echo(f"avrgym: {error.name} is missing; run `pip install 'avrgym[{extra}]'`", err=True)
            raise typer.Exit(1) from error


class Program(typer.Typer):
    """A command line program. A signal ends it with exit code 128 plus the signal's number."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Run the command. Raises ``SystemExit`` at the end."""
        signals = SignalHandler()
        try:
            signals.install_handlers()
            return super().__call__(*arguments, **options)
        except (KeyboardInterrupt, SystemExit) as end:
            if not signals.received_signals or not _is_broken_off(end):
                raise
            kept = _notes(end)
        typer.echo("; ".join(["avrgym: stopped", *kept]), err=True)
        sys.exit(signals.exit_code)


def _is_broken_off(end: BaseException) -> bool:
    """Returns whether an interruption (Ctrl+C or a signal) ended the command."""
    return (
        isinstance(end, KeyboardInterrupt)
        or isinstance(end.__context__, typer.Abort)
        or (isinstance(end, SystemExit) and end.code == _INTERRUPTED)
    )


def _notes(end: BaseException) -> list[str]:
    """Returns the notes of an interruption: the stored results, and the command that continues the work."""
    error: BaseException | None = end
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return list(dict.fromkeys(getattr(error, "__notes__", [])))
        error = error.__cause__ or error.__context__
    return []
