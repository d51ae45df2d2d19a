"""The program ``avrgym``: handling of signals (Ctrl+C, SIGTERM, SIGHUP) and of missing packages."""

import os
import signal
import sys
from types import FrameType
from typing import Any

import typer
from typer.core import TyperGroup

from avrgym.system.extras import extra_of

STOP_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
_INTERRUPTED = 130
"""Typer's exit code for a KeyboardInterrupt."""
MAX_SIGNALS = 3
"""The first signal ends the program in order, the second is ignored, the third ends it immediately."""
EXTRAS = {
    "study": "study",
    "analyze": "study",
    "fit-people": "study",
    "demo": "study",
    "sweep": "train,cluster",
}
"""The extras to install for a command, if one package alone does not identify them."""


class Signals:
    """The received signals. Signals that are ignored at the start, as with ``nohup``, remain ignored."""

    def __init__(self) -> None:
        self.received: list[int] = []

    def listen(self) -> None:
        """Raise ``KeyboardInterrupt`` at the first signal from now on."""
        for each in STOP_SIGNALS:
            if signal.getsignal(each) is not signal.SIG_IGN:
                signal.signal(each, self._receive)

    @property
    def exit_code(self) -> int:
        """The exit code of a program interrupted by the first signal."""
        return 128 + self.received[0]

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received.append(number)
        if len(self.received) == 1:
            raise KeyboardInterrupt
        if len(self.received) >= MAX_SIGNALS:
            os._exit(self.exit_code)


class Commands(TyperGroup):
    """Commands that report missing packages with the command that installs them."""

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
    """A command line whose commands exit with 128 plus the number of the signal that interrupts them."""

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
    """Whether a command was interrupted and did not treat this as its normal end."""
    return (
        isinstance(end, KeyboardInterrupt)
        or isinstance(end.__context__, typer.Abort)
        or (isinstance(end, SystemExit) and end.code == _INTERRUPTED)
    )


def _notes(end: BaseException) -> list[str]:
    """The notes on the interrupt: what is stored, and how to continue."""
    error: BaseException | None = end
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return list(dict.fromkeys(getattr(error, "__notes__", [])))
        error = error.__cause__ or error.__context__
    return []
