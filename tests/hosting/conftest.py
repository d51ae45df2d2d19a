"""A hosted study and a browser for the tests of a module."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from avrgym.hosting.capacity import SessionCapacity
from avrgym.hosting.host import StudyHost
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from helpers.browser.journey import TIMEOUT_S
from helpers.hosting.served_host import Served
from helpers.studies.small_studies import small_study


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder = small_study(tmp_path_factory.mktemp("hosted") / "study")
    (folder / "host.toml").write_text(
        'headset_check = false\n[completed]\ncode = "DONE"\n[screened_out]\ncode = "OUT"\n[withdrawn]\ncode = "LEFT"\n'
    )
    with (
        pytest.MonkeyPatch.context() as patch,
        StudyStore(folder) as store,
        StudyHost(store, max_sessions=3) as host,
    ):
        patch.setattr(SessionCapacity, "idle_cores", None)  # other tests use the processors
        yield Served(host)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    expect.set_options(timeout=1000 * TIMEOUT_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        yield browser
        browser.close()
