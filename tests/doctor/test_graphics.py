"""Checks of graphics cards, and drivers that do not respond."""

from collections.abc import Callable
from pathlib import Path

import pytest

from avrgym.doctor import graphics


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Installs a program, a shell script, before all others."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")

    def install(name: str, script: str) -> None:
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)

    return install


def test_a_graphics_card_is_named_and_a_silent_driver_is_a_warning(
    program: Callable[[str, str], None],
) -> None:
    program("nvidia-smi", "echo 'A Card, 550.54'")
    assert graphics.check_graphics_card().message == "A Card, driver 550.54"
    program("nvidia-smi", "echo 'Driver/library version mismatch'; exit 18")
    found = graphics.check_graphics_card()
    assert found.state == "warning"
    assert "Driver/library version mismatch" in found.message


def test_a_missing_graphics_card_is_ok(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert graphics.check_graphics_card().state == "ok"
