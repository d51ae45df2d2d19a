"""The site of ``make docs`` has no warnings, valid links, no external files, and accessible pages."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest
from playwright.sync_api import sync_playwright

from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from helpers.browser.accessibility import violations
from helpers.browser.documentation import DOCS
from helpers.system.paths import ROOT

SITE = ROOT / "build" / "site"
LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
NOT_LOADED = {"canonical", "next", "prev", "alternate"}


class Page(HTMLParser):
    """The links, loaded files and anchors of a page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.anchors: set[str] = {""}
        self.feed(file.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        if tag in LOADED and values.get("rel") not in NOT_LOADED and values.get(LOADED[tag]):
            self.loads.add(values[LOADED[tag]])


@pytest.fixture(scope="module")
def site() -> dict[Path, Page]:
    """The pages of the site, rebuilt."""
    subprocess.run([sys.executable, ROOT / "scripts" / "write_reference.py"], check=True, timeout=300)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return {file: Page(file) for file in sorted(SITE.rglob("*.html"))}


@pytest.mark.slow
def test_every_page_is_built_and_is_in_the_navigation(site: dict[Path, Page]) -> None:
    pages = {page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md")}
    assert {file.relative_to(SITE).with_suffix(".md").as_posix() for file in site} == {*pages, "404.md"}
    navigation = tomllib.loads((ROOT / "zensical.toml").read_text())["project"]["nav"]
    assert sorted(_files(navigation)) == sorted(pages)


def _files(entries: list[dict[str, object]]) -> Iterator[str]:
    for entry in entries:
        for inside in entry.values():
            yield from [inside] if isinstance(inside, str) else _files(inside)  # type: ignore[arg-type]


@pytest.mark.slow
def test_links_and_pictures_exist(site: dict[Path, Page]) -> None:
    broken = [(file.name, link) for file, page in site.items() for link in page.links | page.loads
              if not _exists(file, link, site)]  # fmt: skip
    assert broken == []


def _exists(file: Path, link: str, site: dict[Path, Page]) -> bool:
    path, anchor = urldefrag(link)
    if re.match(r"[a-z]+:", path) or file.name == "404.html":  # served at any address
        return True
    target = (file.parent / unquote(path)).resolve() if path else file
    return target.exists() and (target not in site or unquote(anchor) in site[target].anchors)


@pytest.mark.slow
def test_nothing_is_loaded_from_the_network(site: dict[Path, Page]) -> None:
    foreign = re.compile(r"(?:[a-z]+:)?//")
    assert {link for page in site.values() for link in page.loads if foreign.match(link)} == set()
    styles = "".join(file.read_text() for file in SITE.rglob("*.css"))
    assert re.findall(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//[^)]*", styles) == []
    lazily_loaded = "mermaid", "glightbox", "pyodide", "ace-editor"
    text = "".join(file.read_text() for file in site)
    assert [name for name in lazily_loaded if f'class="{name}' in text] == []


@pytest.mark.slow
def test_every_kind_of_page_is_accessible(site: dict[Path, Page]) -> None:
    """Text, code and pictures, wide tables, and a long reference."""
    shown = {
        "index.html",
        "how_to/connect_headset.html",
        "reference/policies.html",
        "reference/study_file.html",
    }
    assert shown <= {file.relative_to(SITE).as_posix() for file in site}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page()
        found = {}
        for name in sorted(shown):
            page.goto((SITE / name).as_uri())
            page.wait_for_load_state("networkidle")
            found[name] = violations(page)
        browser.close()
    assert found == {name: [] for name in shown}


@pytest.mark.slow
def test_the_reference_has_every_command_message_and_topic(site: dict[Path, Page]) -> None:
    from avrgym.recording.schema import TOPICS
    from write_typescript import UNIONS

    anchors = {file.stem: page.anchors for file, page in site.items()}
    assert {"avrgym-demo", "avrgym-study-new", "avrgym-replay"} <= anchors["commands"]
    assert {"hello", "tracking", "welcome", "state"} <= anchors["messages"]
    assert {topic.strip("/") for topic in TOPICS} <= anchors["recording"]
    assert len(anchors["messages"]) > sum(len(union.__args__) for union in UNIONS.values())
    assert "avrgym.models.human.Person" in anchors["python"]
