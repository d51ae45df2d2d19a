"""Runs `avrgym` with other time limits: python time_limits.py MODULE:NAME=SECONDS ... -- ARGUMENTS."""

import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path

import pytest

RELAXED_LIMITS = (
    "avrgym.vr.session.session:MAX_TICK_GAP_S=inf",
    "avrgym.vr.session.session_state:UNTRACKED_TIMEOUT_S=60",
)
"""Limits with which no trial ends on a busy machine."""


def set_limits(limits: Iterable[str], patch: pytest.MonkeyPatch) -> None:
    """Set limits until the patch is undone. Each constant must exist."""
    for limit in limits:
        place, seconds = limit.split("=")
        module, name = place.split(":")
        patch.setattr(import_module(module), name, float(seconds))


def command_with_limits(*limits: str) -> list[str | Path]:
    """Return the start of a command line that runs `avrgym` with these limits."""
    return [sys.executable, Path(__file__), *limits, "--"]


if __name__ == "__main__":
    from avrgym.cli import app

    end = sys.argv.index("--")
    set_limits(sys.argv[1:end], pytest.MonkeyPatch())
    del sys.argv[1 : end + 1]
    app()
