"""Writes one recorded trial, or two side by side, as an HTML file. The file needs no server and no network."""

import base64
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec.structs import replace

from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import Recording
from avrgym.replay.output_files import check_output_path
from avrgym.replay.pose_packing import POSE_RESOLUTION, pack_poses
from avrgym.replay.timeline import Timeline, align_robot_starts, export_recorded_scene
from avrgym.system.files import PRIVATE_FILE_MODE, write_atomically
from avrgym.vr.live_world.scene_message import make_scene_url
from avrgym.vr.server.web_server import STATIC_FOLDER, check_client_page

PAGE_TEMPLATE = "trial.html"
"""File name of the page's template in the built client."""
DATA_SCRIPT_TAG = b'<script id="recorded" type="application/json">'
"""Tag of the script element that contains the page's data."""


class PackedTrial(msgspec.Struct, frozen=True):
    """A trial of the page: its timeline, and the packed poses of its frames, see ``pack_poses``."""

    timeline: Timeline
    poses: str


class PageData(msgspec.Struct, frozen=True):
    """Data that the page contains as JSON.

    ``step``: resolution of the packed poses. ``trials``: one or two trials with packed poses. ``scenes``: GLB files by
    URL. Poses and files are compressed (deflate) and base64-encoded.
    """

    step: float
    trials: list[PackedTrial]
    scenes: dict[str, str]


class ReplayedTrial(NamedTuple):
    """A recorded trial, with its timeline and poses from ``build_timeline``."""

    recording: Recording
    timeline: Timeline
    poses: bytes


def check_page_path(out: Path) -> None:
    """Check that a page can be written to the file ``out``.

    Raises:
        ValueError: for a suffix other than .html, or for a missing folder.
        FileExistsError: if the file exists.
        ServerError: if the client is not built.
    """
    check_output_path(out, (".html",))
    check_client_page(PAGE_TEMPLATE)


def write_page(trials: Sequence[ReplayedTrial], out: Path) -> None:
    """Write a page with one or two trials. Only the current user of this computer can read the file.

    With two trials, the earlier one is delayed: both robots start at the same time.

    Raises the same errors as ``check_page_path``.
    """
    check_page_path(out)
    before, place, after = (STATIC_FOLDER / PAGE_TEMPLATE).read_bytes().partition(DATA_SCRIPT_TAG)
    page = before + place + _within_script(_packed(trials)) + after
    check_output_path(out, (".html",))
    write_atomically(out, page, PRIVATE_FILE_MODE)


def _packed(trials: Sequence[ReplayedTrial]) -> PageData:
    recordings = [trial.recording for trial in trials]
    timelines = align_robot_starts([trial.timeline for trial in trials])
    scenes = [_scene_number(recording, recordings) for recording in recordings]
    return PageData(
        step=POSE_RESOLUTION,
        trials=[
            PackedTrial(
                replace(timeline, scene=replace(timeline.scene, url=make_scene_url(scene))),
                _deflated(pack_poses(trial.poses, len(timeline.frames_s))),
            )
            for trial, timeline, scene in zip(trials, timelines, scenes, strict=True)
        ],
        scenes={
            make_scene_url(scene): _deflated(export_recorded_scene(recordings[scene]))
            for scene in set(scenes)
        },
    )


def _scene_number(recording: Recording, recordings: Sequence[Recording]) -> int:
    """Returns the index of the first recording with the same environment, settings and person, and the same scene."""
    looks = [_appearance(each.configuration) for each in recordings]
    return looks.index(_appearance(recording.configuration))


def _appearance(trial: TrialConfiguration) -> tuple[object, ...]:
    return trial.environment, trial.settings, trial.person, trial.input_profile.absent_arms


def _deflated(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _within_script(packed: PageData) -> bytes:
    """Returns the data as JSON that is safe in an HTML script element."""
    return msgspec.json.encode(packed).replace(b"<", b"\\u003c")
