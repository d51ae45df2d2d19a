"""Fixtures for tests of live sessions."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant
from helpers.vr.visit import Visit, plan

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture
def visit(tmp_path: Path) -> Iterator[Callable[..., Visit]]:
    """Return a function that creates visits with short trials; they end after the test."""
    visits: list[Visit] = []

    def make(participant: SimulatedParticipant | None = None, countdown_s: float = 0.1, **options) -> Visit:
        short = replace(plan(**options), countdown_s=countdown_s)
        visits.append(Visit(tmp_path / f"visit-{len(visits)}", short, participant=participant))
        return visits[-1]

    yield make
    for each in visits:
        each.leave()


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """Chromium for all tests of a module."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        yield browser
        browser.close()
