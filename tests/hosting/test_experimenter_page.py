"""The experimenter's page of a hosted study in a browser."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, ViewportSize, expect

from helpers.browser.accessibility import violations
from helpers.browser.staged_page import StagedPage

pytestmark = pytest.mark.slow
PHONE = ViewportSize(width=390, height=844)
DESKTOP = ViewportSize(width=1440, height=900)


def session_rows() -> list[dict]:
    """Twelve sessions, as the experimenter's server describes them."""
    phases = ("headset", "calibration", "trial", "questionnaire")
    return [
        {
            "id": f"{number:024x}",
            "participant": f"sub-{number:03}",
            "state": "running",
            "phase": phases[number % 4],
            "trial": number,
            "trials": 16,
            "connected": number != 5,
            "paused": number == 7,
            "minutes": 3.0 * number,
            "latency_ms": None if number == 1 else 20.0 + 9.0 * number,
            "untracked_share": 0.001 * number,
            "missed_ticks": number,
            "cpu_share": 0.25,
            "crashes": number // 9,
            "warnings": ["the participant is not connected"] if number == 5 else [],
        }
        for number in range(1, 13)
    ]


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_page_of_twelve_sessions_is_accessible(browser: Browser, size: ViewportSize, tmp_path: Path) -> None:
    view = {
        "title": "A study at home",
        "is_open": True,
        "capacity": 12,
        "session_cpu_share": 0.25,
        "missed_share": 0.001,
        "waiting": 3,
        "participants": {"allocated": 15, "completed": 20, "withdrawn": 2},
        "copies_requested": ["sub-004"],
        "problems": ["recordings are not copied: the object store cannot be reached"],
        "sessions": session_rows(),
    }
    page: Page = browser.new_page(viewport=size)
    staged = StagedPage(page, [])
    staged.answers["api/sessions"] = lambda: view
    staged.open("host.html")
    expect(page.get_by_role("heading", name="sub-012")).to_be_visible()
    assert violations(page) == []
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    page.screenshot(path=tmp_path / "sessions.png", full_page=True)
    print(tmp_path / "sessions.png", json.dumps(size))
    page.close()
