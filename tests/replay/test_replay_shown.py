"""Replays for viewers: the page and its server, videos, and sequences of pictures."""

from collections.abc import Iterator
from pathlib import Path

import av
import httpx
import numpy as np
import pytest
from PIL import Image, ImageSequence
from playwright.sync_api import expect, sync_playwright

from avrgym.recording.reader import Recording, read_recording
from avrgym.replay.playback import ComparedState, Playback
from avrgym.replay.rendering import (
    CAPTION_HEIGHT_PX,
    GIF_FRAMES_PER_S,
    STRIP_IMAGE_SIZE_PX,
    VIDEO_FRAMES_PER_S,
    VIDEO_SIZE_PX,
    write_gif,
    write_image_strip,
    write_video,
)
from avrgym.replay.server import ReplayServer
from avrgym.replay.timeline import STATES_PER_FRAME, build_timeline
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.live_world.scene_message import encode_world_poses
from helpers.vr.visit import Visit, plan

PATIENCE_S = 180.0
STEPS = 3


def nothing() -> None:
    """Hears no progress."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A short trial of scratching, which draws a mark on the person."""
    visit = Visit(
        tmp_path_factory.mktemp("visit"),
        plan(environments=["avrgym/ScratchItchJaco-v1"], trial_steps=STEPS, free_movement_s=0.04),
    )
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.tick(10)
    visit.answer(1, 2, 3, 4)
    visit.leave()
    return read_recording(visit.session.recordings[0])


@pytest.fixture(scope="module")
def server(recording: Recording) -> Iterator[ReplayServer]:
    with ReplayServer(recording, *build_timeline(recording, nothing), port=0) as server:
        yield server


# What the page is given --------------------------------------------------------------------------------------


def test_the_poses_are_those_of_every_second_recorded_state(recording: Recording) -> None:
    timeline, frames = build_timeline(recording, nothing)
    playback = Playback(recording)
    shown = [
        (again.time_s, encode_world_poses(playback.episodes))
        for again in playback.recompute()
        if isinstance(again, ComparedState)
    ][::STATES_PER_FRAME]
    assert timeline.frames_s == [time_s for time_s, _ in shown]
    assert frames == b"".join(frame for _, frame in shown)
    things = len(timeline.scene.bodies) + timeline.scene.marks
    assert timeline.scene.marks == 1
    assert np.frombuffer(frames, "<f4").shape == (len(shown) * things * 7,)


def test_the_timeline_tells_rewards_phases_and_answers(recording: Recording) -> None:
    timeline, _ = build_timeline(recording, nothing)
    control = [record for _, record in recording.messages_by_topic["/control"]]
    assert timeline.steps.reward[-1] == pytest.approx(sum(record.reward for record in control))
    assert timeline.steps.force_n == [record.force_on_person_n for record in control]
    shown = [each for each in timeline.events if each.kind != "event"]  # a busy machine may stall
    kinds = [event.kind for event in shown]
    phases = ["free_before", "countdown", "trial", "retreat", "free_after", "questionnaire", "confirm"]
    assert kinds == [*phases, "answer", "answer", "answer", "answer"]
    assert shown[7].text.startswith("L1: 1 of 7: The robot successfully")
    assert (timeline.simulated, timeline.complete, timeline.result) == (True, True, "completed")


def test_only_who_has_the_token_reads_a_replay(server: ReplayServer) -> None:
    base, token = server.url.split("/replay#token=")
    for path in ("timeline", "poses", "scenes/0.glb"):
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": token}):
            assert httpx.get(f"{base}/{path}", headers=headers, timeout=PATIENCE_S).status_code == 401
    own = {"Authorization": f"Bearer {token}"}
    assert "ScratchItch" in httpx.get(f"{base}/timeline", headers=own, timeout=PATIENCE_S).json()["title"]
    hostile = own | {"Origin": "http://elsewhere.example"}
    assert httpx.get(f"{base}/timeline", headers=hostile, timeout=PATIENCE_S).status_code == 403
    named = own | {"Host": "elsewhere.example"}
    assert httpx.get(f"{base}/timeline", headers=named, timeout=PATIENCE_S).status_code == 400


@pytest.mark.slow
def test_the_page_plays_seeks_and_changes_its_view(server: ReplayServer) -> None:
    expect.set_options(timeout=1000 * PATIENCE_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page(viewport={"width": 480, "height": 320})
        page.set_default_timeout(1000 * PATIENCE_S)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(server.url.replace("/replay#", "/replay?detail=light#"))
        expect(page.locator("#title")).to_contain_text("ScratchItchJaco-v1, drive")
        expect(page.locator("#simulated")).to_be_visible()
        page.keyboard.press("End")
        expect(page.locator("#phase-name td")).to_have_text("confirm")
        expect(page.locator("#step td")).to_have_text(f"{STEPS} of {STEPS}")
        page.keyboard.press("Home")
        expect(page.locator("#phase-name td")).to_have_text("free before")
        page.keyboard.press("r")
        expect(page.locator("#phase-name td")).to_have_text("trial")
        expect(page.locator("#events li:visible")).to_have_text(["0.0 strial", f"{STEPS / 10} sretreat"])
        page.keyboard.press("End")
        expect(page.locator("#clock")).to_have_text(f"{STEPS / 10} / {STEPS / 10} s")
        page.keyboard.press("r")
        page.keyboard.press("Home")
        expect(page.locator("#phase-name td")).to_have_text("free before")
        page.keyboard.press("v")
        expect(page.locator("#from-inside")).to_be_checked()
        page.keyboard.press(" ")
        expect(page.locator("#events [aria-current]")).to_contain_text("L4: 4")
        expect(page.locator("#play")).to_have_text("Play")
        browser.close()
    assert errors == []


# Pictures ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_video_lasts_as_long_as_the_trial_until_the_questionnaire(
    recording: Recording, tmp_path: Path
) -> None:
    out = tmp_path / "trial.mp4"
    write_video(recording, out, first_person=False, progress=nothing)
    (asked_s,) = (
        time_ns / 1e9
        for time_ns, event in recording.messages_by_topic["/events"]
        if event.detail == "questionnaire"
    )
    with av.open(str(out)) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert file.streams.video[0].average_rate == VIDEO_FRAMES_PER_S
    assert len(frames) == pytest.approx(asked_s * VIDEO_FRAMES_PER_S, abs=1)
    assert frames[0].shape == (VIDEO_SIZE_PX[1], VIDEO_SIZE_PX[0], 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 0.1
    assert [path.name for path in tmp_path.iterdir()] == ["trial.mp4"]
    with pytest.raises(FileExistsError, match="already exists"):
        write_video(recording, out, first_person=False, progress=nothing)


@pytest.mark.slow
def test_an_animation_lasts_as_long_as_the_trial_and_begins_again(
    recording: Recording, tmp_path: Path
) -> None:
    out = tmp_path / "trial.gif"
    write_gif(recording, out, first_person=False, progress=nothing)
    with Image.open(out) as shown:
        assert shown.size == (VIDEO_SIZE_PX[0] // 2, VIDEO_SIZE_PX[1] // 2)
        assert shown.info["loop"] == 0
        pictures = [
            (picture.info["duration"], np.asarray(picture.convert("RGB"), int))
            for picture in ImageSequence.Iterator(shown)
        ]
    assert np.abs(pictures[-1][1] - pictures[0][1]).mean() > 0.1
    (asked_s,) = (
        time_ns / 1e9
        for time_ns, event in recording.messages_by_topic["/events"]
        if event.detail == "questionnaire"
    )
    assert sum(milliseconds for milliseconds, _ in pictures) / 1000 == pytest.approx(
        asked_s, abs=1 / GIF_FRAMES_PER_S
    )
    with pytest.raises(FileExistsError, match="already exists"):
        write_gif(recording, out, first_person=False, progress=nothing)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("first_person", [False, True])
def test_a_strip_shows_the_trial_from_its_beginning_to_its_end(
    recording: Recording, tmp_path: Path, first_person: bool
) -> None:
    out = tmp_path / "strip.png"
    times_s = write_image_strip(recording, 2, out, first_person=first_person, progress=nothing)
    assert times_s == pytest.approx([0.0, 0.1 * STEPS], abs=0.02)
    with Image.open(out) as strip:
        assert strip.size == (2 * STRIP_IMAGE_SIZE_PX[0], STRIP_IMAGE_SIZE_PX[1] + 2 * CAPTION_HEIGHT_PX)
        pixels = np.asarray(strip)
    middle = pixels[CAPTION_HEIGHT_PX:-CAPTION_HEIGHT_PX]
    assert middle[:, : STRIP_IMAGE_SIZE_PX[0]].std() > 5
