"""Renders a recorded trial as a video, an animation or an image strip, with MuJoCo."""

# The types of PyAV's streams are known only in part.
# pyright: reportUnknownMemberType=false

import io
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from avrgym.envs.rendering import Camera
from avrgym.recording.reader import Recording
from avrgym.replay.output_files import check_output_path
from avrgym.replay.playback import (
    ComparedState,
    Playback,
    find_control_time_range_s,
    find_robot_motion_end_s,
    format_title,
)
from avrgym.system.files import write_atomically

RgbImage = NDArray[np.uint8]
"""An RGB image (height, width, 3)."""
ProgressCallback = Callable[[], None]
"""A function that is called after each recorded state."""

VIDEO_SIZE_PX, STRIP_IMAGE_SIZE_PX = (1280, 720), (640, 480)
"""Width and height of videos, and of the frames of an image strip."""
VIDEO_FRAMES_PER_S = 25
"""Number of frames of a video per second."""
GIF_FRAMES_PER_S = 10
CAPTION_HEIGHT_PX = 40
TEXT_COLOUR, BACKGROUND_COLOUR = (20, 50, 58), (255, 255, 255)
"""RGB colours of text and its background."""
IMAGE_SUFFIXES = (".png", ".jpg")
"""Allowed suffixes of the file of an image strip."""


@dataclass(frozen=True)
class DisplayedState:
    """State of a trial at one time: phase, accumulated reward, and force and success of the latest control step."""

    time_s: float
    phase: str
    accumulated_reward: float
    force_on_person_n: float
    success: bool


def write_video(recording: Recording, out: Path, *, first_person: bool, progress: ProgressCallback) -> None:
    """Write a trial as H.264 video (MP4) that plays in real time and ends at the questionnaire.

    Args:
        recording: the recording of the trial.
        out: a new file that ends in .mp4.
        first_person: render the participant's view instead of a side view.
        progress: called after each recorded state.

    Raises:
        ValueError: for a wrong suffix, a missing folder, or a recording that cannot be recomputed.
        FileExistsError: if the file exists.
        RuntimeError: if rendering fails or the encoder is missing.
    """
    check_output_path(out, (".mp4",))
    try:
        import av
    except ModuleNotFoundError as error:
        raise RuntimeError(
            "the package av (video encoder) is missing; run `pip install avrgym[video]`"
        ) from error
    unfinished = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        with av.open(str(unfinished), "w", format="mp4", options={"movflags": "faststart"}) as file:
            stream = file.add_stream("libx264", rate=VIDEO_FRAMES_PER_S, options={"crf": "20"})
            stream.width, stream.height, stream.pix_fmt = *VIDEO_SIZE_PX, "yuv420p"
            for picture in _film(recording, VIDEO_FRAMES_PER_S, first_person, progress):
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            file.mux(stream.encode())
        check_output_path(out, (".mp4",))
        os.replace(unfinished, out)
    finally:
        unfinished.unlink(missing_ok=True)


def write_gif(recording: Recording, out: Path, *, first_person: bool, progress: ProgressCallback) -> None:
    """Write a trial as a looping animation (GIF) for slides, with half the width and height of a video.

    Arguments and errors are those of ``write_video``; ``out`` must end in .gif.
    """
    check_output_path(out, (".gif",))
    film = _film(recording, GIF_FRAMES_PER_S, first_person, progress)
    pictures = (Image.fromarray(picture).reduce(2).quantize() for picture in film)
    file = io.BytesIO()
    next(pictures).save(
        file, "GIF", save_all=True, append_images=pictures, duration=1000 // GIF_FRAMES_PER_S, loop=0
    )
    check_output_path(out, (".gif",))
    write_atomically(out, file.getvalue())


def write_image_strip(
    recording: Recording, count: int, out: Path, *, first_person: bool, progress: ProgressCallback
) -> list[float]:
    """Write one image: frames of the robot's motion at evenly spaced times, side by side.

    Arguments and errors are those of ``write_video``; ``out`` must end in .png or .jpg. ``count``: number of frames.

    Returns:
        The time of each frame, in seconds from the start of the motion.
    """
    check_output_path(out, IMAGE_SUFFIXES)
    begins_s, ends_s = find_control_time_range_s(recording)
    times_s = np.linspace(begins_s, ends_s, count).tolist() if count > 1 else [0.5 * (begins_s + ends_s)]
    drawn = [
        _titled(picture, f"{moment.time_s - begins_s:.1f} s")
        for moment, picture in _pictures(recording, times_s, STRIP_IMAGE_SIZE_PX, first_person, progress)
    ]
    strip = Image.fromarray(np.concatenate(drawn, axis=1))
    sheet = Image.new("RGB", (strip.width, strip.height + CAPTION_HEIGHT_PX), BACKGROUND_COLOUR)
    sheet.paste(strip, (0, CAPTION_HEIGHT_PX))
    _write(sheet, (10, CAPTION_HEIGHT_PX // 2), format_title(recording), "lm")
    check_output_path(out, IMAGE_SUFFIXES)
    file = io.BytesIO()
    sheet.save(file, Image.registered_extensions()[out.suffix.lower()])
    write_atomically(out, file.getvalue())
    return [time_s - begins_s for time_s in times_s]


def _film(
    recording: Recording, frames_per_s: int, first_person: bool, progress: ProgressCallback
) -> Iterator[RgbImage]:
    """Yields images at a constant rate, up to the questionnaire. Each image shows the first recorded state at or after
    its time.
    """
    begins_s, _ = find_control_time_range_s(recording)
    times_s = np.arange(0.0, find_robot_motion_end_s(recording), 1.0 / frames_per_s).tolist()
    for moment, picture in _pictures(recording, times_s, VIDEO_SIZE_PX, first_person, progress):
        yield _subtitled(picture, format_title(recording), moment, begins_s)


def _pictures(
    recording: Recording,
    times_s: list[float],
    size_px: tuple[int, int],
    first_person: bool,
    progress: ProgressCallback,
) -> Iterator[tuple[DisplayedState, RgbImage]]:
    """Yields an image and its state for each time in ``times_s``: the first recorded state at or after this time."""
    playback = Playback(recording)
    width_px, height_px = size_px
    camera = Camera(playback.episodes, 0, width_px=width_px, height_px=height_px, first_person=first_person)
    try:
        waiting = iter(times_s)
        due_s = next(waiting, None)
        for moment in _moments(playback, progress):
            picture = None
            while due_s is not None and moment.time_s >= due_s - 1e-9:
                picture = camera.render() if picture is None else picture
                yield moment, picture
                due_s = next(waiting, None)
            if due_s is None:
                return
    finally:
        camera.close()


def _moments(playback: Playback, progress: ProgressCallback) -> Iterator[DisplayedState]:
    """Yields the display values of each recorded state. Meanwhile, the world of ``playback`` is in this state."""
    reward, force_n, success = 0.0, 0.0, False
    for compared in playback.recompute(follow=True):
        if isinstance(compared, ComparedState):
            yield DisplayedState(compared.time_s, playback.phase, reward, force_n, success)
            progress()
        else:
            reward += compared.recorded_step.reward
            force_n, success = compared.recorded_step.force_on_person_n, compared.recorded_step.success


def _titled(picture: RgbImage, text: str) -> RgbImage:
    """Returns the image with the caption ``text`` below it."""
    sheet = Image.new("RGB", (picture.shape[1], picture.shape[0] + CAPTION_HEIGHT_PX), BACKGROUND_COLOUR)
    sheet.paste(Image.fromarray(picture), (0, 0))
    _write(sheet, (picture.shape[1] // 2, picture.shape[0] + CAPTION_HEIGHT_PX // 2), text, "mm")
    return np.asarray(sheet)


def _subtitled(picture: RgbImage, text: str, moment: DisplayedState, begins_s: float) -> RgbImage:
    """Returns the image with the trial's title and state at its lower edge."""
    sheet = Image.fromarray(picture)
    height = picture.shape[0]
    band = Image.new("RGB", (sheet.width, CAPTION_HEIGHT_PX), BACKGROUND_COLOUR)
    sheet.paste(band, (0, height - CAPTION_HEIGHT_PX))
    middle = height - CAPTION_HEIGHT_PX // 2
    _write(sheet, (16, middle), text, "lm")
    state = f"reward {moment.accumulated_reward:.1f}   force {moment.force_on_person_n:.1f} N"
    success = "success   " if moment.success else ""
    _write(sheet, (sheet.width - 16, middle), f"{success}{state}   {moment.time_s - begins_s:.1f} s", "rm")
    return np.asarray(sheet)


def _write(sheet: Image.Image, place: tuple[int, int], text: str, anchor: str) -> None:
    font = ImageFont.load_default(20)
    ImageDraw.Draw(sheet).text(place, text, TEXT_COLOUR, font, anchor=anchor)
