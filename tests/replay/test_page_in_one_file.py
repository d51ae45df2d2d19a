"""Recorded trials as pages in one file: nothing is loaded, and the page shows the recorded data."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.recording.reader import read_recording
from avrgym.replay.page import DATA_SCRIPT_TAG, ReplayedTrial, write_page
from avrgym.replay.pose_packing import POSE_RESOLUTION, pack_poses
from avrgym.replay.timeline import align_robot_starts, build_timeline
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from helpers.browser.journey import WATCH_SCENES
from helpers.vr.visit import Visit, plan

PATIENCE_MS = 180_000.0
STEPS = 3
ROBOT = "robot/"
DRAWN = """async () => {
  for (const _ of [1, 2]) await new Promise(requestAnimationFrame);
  const bodies = {};
  for (const scene of scenes) scene.traverse(({ userData, position: p, quaternion: q }) => {
    if (userData.body) bodies[userData.body] = [p.x, p.y, p.z, q.w, q.x, q.y, q.z];
  });
  return bodies;
}"""
"""The poses of bodies by name, once a whole frame has been drawn."""
WITHOUT_NAME = """() => [...document.querySelectorAll("button, input, select")]
  .filter((e) => !(e.ariaLabel || e.labels?.[0]?.textContent.trim() || e.textContent.trim()))
  .map((e) => e.outerHTML)"""
FAINT = """() => {
  const linear = (part) => part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  const contrast = (element) => {
    const [r, g, b] = getComputedStyle(element).color.match(/[\\d.]+/g).map((n) => linear(n / 255));
    return 1.05 / (0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05);
  };
  return [...document.querySelectorAll("#card *, #transport *")]
    .filter((e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()) && contrast(e) < 4.5)
    .map((e) => e.outerHTML);
}"""
"""By WCAG 2.2, 1.4.3: text on white has a contrast of 4.5 at least."""


def visited(folder: Path, environment: str, free_movement_s: float = 0.04) -> Path:
    """The recording of a short trial."""
    visit = Visit(
        folder,
        plan(environments=[f"avrgym/{environment}-v1"], trial_steps=STEPS, free_movement_s=free_movement_s),
    )
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    return visit.session.recordings[0]


@pytest.fixture(scope="module")
def scratching(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return visited(tmp_path_factory.mktemp("scratching"), "ScratchItchJaco")


@pytest.fixture(scope="module")
def feeding(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One that begins later."""
    return visited(tmp_path_factory.mktemp("feeding"), "FeedingJaco", free_movement_s=0.1)


def trial_of_file(file: Path) -> ReplayedTrial:
    recording = read_recording(file)
    return ReplayedTrial(recording, *build_timeline(recording, lambda: None))


@pytest.fixture(scope="module")
def trial(scratching: Path) -> ReplayedTrial:
    return trial_of_file(scratching)


@pytest.fixture(scope="module")
def page_file(trial: ReplayedTrial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page") / "trial.html"
    write_page([trial], out)
    return out


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))


@contextmanager
def opened(browser: Browser, file: Path) -> Iterator[Page]:
    """The page from the disk, without a network; at its end nothing was loaded but the file, and nothing failed."""
    context = browser.new_context(viewport={"width": 480, "height": 320}, offline=True)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.add_init_script(WATCH_SCENES)
    said: list[str] = []
    loaded: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("request", lambda request: loaded.append(request.url))
    page.goto(f"{file.as_uri()}?detail=light")
    page.wait_for_function("() => scenes.some((s) => s.getObjectByProperty('isSkinnedMesh', true))")
    yield page
    assert page.locator("#problem").text_content() == ""
    context.close()
    assert not [words for words in said if words.startswith("error") or "policy" in words.lower()]
    assert [url for url in loaded if not url.startswith("blob:")] == [f"{file.as_uri()}?detail=light"]


def avrgym(*arguments: Any) -> Any:
    return CliRunner().invoke(app, ["replay", *map(str, arguments)])


def held(file: Path) -> dict[str, Any]:
    """What was written into a page."""
    return json.loads(file.read_bytes().partition(DATA_SCRIPT_TAG)[2].partition(b"</script>")[0])


# What is written ---------------------------------------------------------------------------------------------


def unpacked(packed: bytes, frames: int) -> np.ndarray:
    numbers = np.frombuffer(packed, np.uint8).reshape(4, -1).T.copy().view("<i4").reshape(-1, frames)
    return POSE_RESOLUTION * np.cumsum(numbers.astype(np.int64), axis=1).T


@pytest.mark.parametrize("frames", [1, 2, 7])
def test_packed_poses_are_within_half_a_step_of_what_they_were(frames: int) -> None:
    poses = np.random.default_rng(frames).normal(scale=30.0, size=(frames, 3 * 7)).astype("<f4")
    packed = pack_poses(poses.tobytes(), frames)
    assert len(packed) == poses.nbytes
    assert np.abs(unpacked(packed, frames) - poses).max() <= POSE_RESOLUTION / 2


def test_a_page_names_nothing_to_be_loaded(page_file: Path) -> None:
    markup = re.sub(r"<script[^>]*>.*?</script>|<!--.*?-->", "", page_file.read_text(), flags=re.DOTALL)
    assert "default-src 'none'" in markup
    assert page_file.stat().st_mode & 0o077 == 0
    assert re.findall(r"(?:\b(?:src|href|action)=|url\(|@import)", markup) == []
    assert "MIT" in page_file.read_text().rpartition("<!--")[2]


def test_no_text_of_a_recording_ends_the_script_that_holds_it(trial: ReplayedTrial, tmp_path: Path) -> None:
    """Nor is a scene written twice that two trials share."""
    hostile = "</script><script>alert(1)</script><!--"
    changed = trial._replace(timeline=msgspec.structs.replace(trial.timeline, title=hostile))
    out = tmp_path / "trial.html"
    write_page([trial, changed], out)
    written = held(out)
    assert written["trials"][1]["timeline"]["title"] == hostile
    assert list(written["scenes"]) == [each["timeline"]["scene"]["url"] for each in written["trials"][:1]]


def test_a_page_names_session_policy_and_versions(page_file: Path) -> None:
    (written,) = held(page_file)["trials"]
    facts = written["timeline"]["facts"]
    assert facts["Session"] == "visit"
    assert facts["Participant"] == "simulated by a program"
    assert (facts["Environment"], facts["Policy"]) == ("avrgym/ScratchItchJaco-v1", "drive")
    assert re.fullmatch(r"AVR Gym \S+, MuJoCo \S+", facts["Recorded with"])
    assert facts["Body"].startswith("woman, torso 0.")


def test_trials_are_aligned_where_the_robot_begins(trial: ReplayedTrial, feeding: Path) -> None:
    other = trial_of_file(feeding)
    first, second = align_robot_starts([trial.timeline, other.timeline])
    begin_s = [next(h.time_s for h in each.events if h.kind == "trial") for each in (first, second)]
    assert begin_s[0] == pytest.approx(begin_s[1])
    later_s = first.seconds - trial.timeline.seconds
    assert later_s > 0.05
    assert np.subtract(first.frames_s, trial.timeline.frames_s) == pytest.approx(later_s)
    assert np.subtract(first.steps.time_s, trial.timeline.steps.time_s) == pytest.approx(later_s)
    assert second == other.timeline


# What is seen ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_draws_what_was_recorded(
    browser: Browser, page_file: Path, trial: ReplayedTrial, tmp_path: Path
) -> None:
    timeline = trial.timeline
    poses = np.frombuffer(trial.poses, "<f4").reshape(len(timeline.frames_s), -1, 7)
    drawn: list[dict[str, list[float]]] = []
    with opened(browser, page_file) as page:
        for key, frame, step in (("Home", 0, 0), ("End", -1, STEPS)):
            page.keyboard.press(key)
            expect(page.locator("#step td")).to_have_text(f"{step} of {STEPS}")
            drawn.append(page.evaluate(DRAWN))
            for body, pose in drawn[-1].items():
                recorded = poses[frame, timeline.scene.bodies.index(body)]
                assert np.abs(pose - recorded).max() <= POSE_RESOLUTION / 2 + 1e-6, body
        assert any(drawn[0][body] != drawn[1][body] for body in drawn[0] if body.startswith(ROBOT))
        assert {"person/head", "wheelchair"} <= set(drawn[0])
        expect(page.locator("#simulated")).to_have_text("Simulated participant")
        expect(page.locator("#events")).to_contain_text("L1: 1 of 7")
        assert page.locator("#charts .answer").count() == 4
        page.get_by_text("About this trial").click()
        expect(page.locator("#title dl")).to_contain_text("avrgym/ScratchItchJaco-v1")
        assert page.evaluate(WITHOUT_NAME) == []
        assert page.evaluate(FAINT) == []
        page.screenshot(path=tmp_path / "seen.png")
    with Image.open(tmp_path / "seen.png") as seen:
        assert np.asarray(seen.convert("L"))[:, 400:].std() > 5


@pytest.mark.slow
def test_two_trials_are_drawn_beside_each_other(
    browser: Browser, scratching: Path, feeding: Path, tmp_path: Path
) -> None:
    out = tmp_path / "both.html"
    done = avrgym(scratching, "--html", out, "--compare", feeding)
    assert done.exit_code == 0, done.output
    assert "both.html" in done.stdout
    assert len(held(out)["scenes"]) == 2
    with opened(browser, out) as page:
        expect(page.locator("#view canvas")).to_have_count(2)
        expect(page.locator("#charts svg")).to_have_count(2)
        expect(page.locator("#simulated")).to_have_text("Simulated participants")
        page.keyboard.press("Shift+ArrowLeft")
        page.keyboard.press("End")
        expect(page.locator("#step td")).to_have_text([f"{STEPS} of {STEPS}"] * 2)
        expect(page.locator("#title")).to_contain_text("A: ScratchItchJaco-v1")
        expect(page.locator("#title")).to_contain_text("B: FeedingJaco-v1")


# What cannot be written --------------------------------------------------------------------------------------


def test_mistakes_are_answered_in_one_line(scratching: Path, tmp_path: Path) -> None:
    old = tmp_path / "old.html"
    old.write_text("mine")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(scratching.read_bytes()[:200])
    new = tmp_path / "new.html"
    for arguments, words in (
        ((scratching, "--html", old), "already exists"),
        ((scratching, "--html", tmp_path / "page.txt"), ".html"),
        ((scratching, "--html", tmp_path / "none" / "page.html"), "does not exist"),
        ((damaged, "--html", new), "damaged.mcap"),
        ((scratching, "--html", new, "--compare", damaged), "damaged.mcap"),
        ((scratching, "--compare", scratching), "--html"),
    ):
        done = avrgym(*arguments)
        assert done.exit_code == 1, arguments
        assert words in done.stderr
        assert len(done.stderr.splitlines()) == 1
    assert old.read_text() == "mine"
    assert not new.exists()
