"""`avrgym` with other limits of time: python limits.py MODULE:NAME=SECONDS ... -- ARGUMENTS."""

import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import pytest

RELAXED_LIMITS = (
    "avrgym.vr.session.session:MAX_TICK_GAP_S=inf",
    "avrgym.vr.session.state:UNTRACKED_LIMIT_S=60",
)
"""No trial ends because a busy machine stands still or tracks late."""


def set_limits(limits: Iterable[str], patch: pytest.MonkeyPatch) -> None:
    """Set what the limits say, until the patch is undone; each must be there."""
    for limit in limits:
        place, seconds = limit.split("=")
        module, name = place.split(":")
        patch.setattr(import_module(module), name, float(seconds))


def command_with_limits(*limits: str) -> list[str | Path]:
    """The first words of a command that runs `avrgym` so."""
    return [sys.executable, Path(__file__), *limits, "--"]


if __name__ == "__main__":
    from avrgym.cli import app

    end = sys.argv.index("--")
    set_limits(sys.argv[1:end], pytest.MonkeyPatch())
    del sys.argv[1 : end + 1]
    app()
