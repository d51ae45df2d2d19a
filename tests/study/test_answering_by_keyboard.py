"""Questions answered by keyboard in a browser; a stop rule pauses, and the dashboard shows the reason."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect, sync_playwright

from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.live_server import LiveServer
from helpers.browser.journey import TIMEOUT_S
from helpers.studies.small_studies import enrol_with_consent, make_study

ASKED = """
[[questionnaires]]
name = "before"
when = "before_session"
items = [
    { id = "nausea", text = "Nausea", points = 4, low = "none", high = "severe", labels = ["none", "slight", "moderate", "severe"] },
    { id = "load", text = "How hard was it?", points = 3, low = "very easy", high = "very hard", labels = ["0", "50", "100"] },
    { id = "calm", text = "How calm are you?", points = 5, low = "not", high = "very" },
]

[[stop_rules]]
item = "nausea"
at_least = 3
then = "pause"
"""  # noqa: E501
WHY = "'Nausea' was answered 'moderate'; the limit of its stop rule is 3"


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', practice_policy='""')
    with open(folder / "study.toml", "a") as file:
        file.write(ASKED)
    with StudyStore(folder) as opened:
        yield opened


def answers(page: Page) -> list[str]:
    """The accessible names of the buttons."""
    return (
        page.get_by_role("group", name=page.locator("#statement").inner_text())
        .get_by_role("button")
        .all_inner_texts()
    )


@pytest.mark.slow
def test_keyboard_answers_and_reason_of_a_pause(
    store: StudyStore,
) -> None:
    expect.set_options(timeout=1000 * TIMEOUT_S)
    pseudonym = enrol_with_consent(store)
    with (
        LiveServer(
            lambda send: StudySessions(store, send, first=pseudonym),
            "127.0.0.1",
            0,
            study=lambda tokens, sessions: make_dashboard_app(store, tokens, sessions),
        ) as server,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        dashboard, page = (browser.new_page(viewport={"width": 360, "height": 640}) for _ in range(2))
        dashboard.goto(server.list_page_urls("dashboard?detail=light", server.tokens.experimenter)[0])
        expect(dashboard.locator("#server")).to_contain_text("Connected")
        page.goto(server.list_page_urls("?detail=light")[0])
        expect(page.locator("#statement")).to_have_text("Nausea")
        assert answers(page) == ["none", "slight", "moderate", "severe"]
        expect(page.locator("#anchors")).to_be_hidden()

        page.get_by_role("button", name="moderate").press("Enter")
        expect(page.locator("#statement")).to_have_text("How hard was it?")
        assert answers(page) == ["0", "50", "100"]
        expect(page.locator("#low")).to_have_text("0: very easy")
        expect(page.get_by_role("button", name="0", exact=True)).to_be_focused()
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator("#statement")).to_have_text("How calm are you?")
        assert answers(page) == ["1", "2", "3", "4", "5"]
        expect(page.locator("#high")).to_have_text("5: very")
        page.keyboard.press("Space")
        page.get_by_role("button", name="Done").press("Enter")

        expect(dashboard.locator("#watch-phase")).to_have_text(
            f"the participant is not in VR; on hold: {WHY}"
        )
        assert "stop rule" not in page.locator("body").inner_text()
        browser.close()
    given = [(answer.item, answer.value) for answer in store.read_answers(pseudonym)]
    assert given == [("nausea", 3), ("load", 2), ("calm", 1)]
