"""The command ``avrgym replay``."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_region_forces,
    print_table,
    report_errors,
    write_json,
)
from avrgym.vr.server.network_addresses import DEFAULT_PORT

if TYPE_CHECKING:
    from avrgym.recording.reader import Recording
    from avrgym.replay.verification import Verification

RECORDINGS_HINT = "give one of the .mcap files that `avrgym serve` writes into STUDY/recordings"


def replay(
    file: Annotated[Path, typer.Argument(help="The recording of an attempt, an .mcap file.", metavar="FILE")],
    verify: Annotated[
        bool, typer.Option("--verify", help="Recompute the recording and compare every bit.")
    ] = False,
    regions: Annotated[
        bool,
        typer.Option("--regions", help="Recompute the recording and show the contact forces by body region."),
    ] = False,
    video: Annotated[
        Path | None, typer.Option(help="Render the recording to a new .mp4 file.", metavar="OUT.mp4")
    ] = None,
    gif: Annotated[
        Path | None,
        typer.Option(help="Render the recording to a new .gif file, for slides.", metavar="OUT.gif"),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(help="Write this number of images, side by side, to the file of --out.", min=1, max=20),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A new .png or .jpg file for --frames.", metavar="OUT.png")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write the recording as one HTML file that needs neither server nor network.",
            metavar="OUT.html",
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(help="With --html: show this second recording next to it.", metavar="OTHER"),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(help="Export the recording for 3D display in Foxglove and Rerun.", metavar="OUT.mcap"),
    ] = None,
    first_person: Annotated[
        bool,
        typer.Option("--first-person", help="Render videos and images from the participant's viewpoint."),
    ] = False,
    port: Annotated[
        int, typer.Option(help="Port of the page; 0 chooses a free one.", min=0, max=65535)
    ] = DEFAULT_PORT,
    json_file: JsonFileOption = None,
) -> None:
    """Replay a recorded trial.

    Without options, the command serves a page that shows the trial in a browser. Options verify the recording, show
    forces, or write a page, a video or images.
    """
    with report_errors():
        if (frames is None) != (out is None):
            raise ValueError("--frames and --out must be given together, such as --frames 4 --out strip.png")
        if json_file is not None and verify == regions:
            raise ValueError("--json needs either --verify or --regions")
        if first_person and video is None and gif is None and frames is None:
            raise ValueError(
                "--first-person needs --video, --gif or --frames; on the page, V changes the view"
            )
        if compare is not None and html is None:
            raise ValueError("--compare needs --html, such as --html both.html --compare OTHER")
        check_json_file(json_file)
        with _with_file_name(file):
            recording = _read(file)
            if verify:
                _verify(recording, json_file)
            if regions:
                _show_regions(recording, json_file)
            if video is not None:
                _write_video(recording, video, first_person)
            if gif is not None:
                _write_gif(recording, gif, first_person)
            if frames is not None and out is not None:
                _draw_strip(recording, frames, out, first_person)
            if mcap is not None:
                _write_mcap(recording, mcap)
            if not (verify or regions) and all(each is None for each in (html, video, gif, frames, mcap)):
                _show(recording, port)
        if html is not None:
            _write_page([(file, recording), *_named(compare)], html)


@contextmanager
def _with_file_name(file: Path) -> Generator[None]:
    """Context manager: add the file name to error messages."""
    from avrgym.recording.reader import RecordingError
    from avrgym.replay.playback import ReplayError

    try:
        yield
    except RecordingError as error:  # its message contains the file
        raise ValueError(f"{error}; {RECORDINGS_HINT}") from error
    except ReplayError as error:
        raise ValueError(f"{file}: {error}") from error


def _read(file: Path) -> "Recording":
    from avrgym.recording.reader import read_recording
    from avrgym.replay.playback import format_title

    if file.is_dir():
        raise ValueError(f"{file} is a folder; {RECORDINGS_HINT}")
    if not file.is_file():
        _fetch(file)
    recording = read_recording(file)
    print_line(
        f"{format_title(recording)}, {recording.result or 'interrupted'} after {recording.duration_s:.2f} s"
    )
    return recording


def _fetch(file: Path) -> None:
    """Download the recording of a study from the study's object store, if there is no local file."""
    folder = file.absolute().parents[3] if len(file.absolute().parents) > 3 else file
    if not (folder / "study.toml").is_file():
        return
    from avrgym.study.storage.remote_recordings import fetch_recordings
    from avrgym.study.storage.store import StudyStore

    with StudyStore(folder) as store:
        fetch_recordings(store, file.parent.parent.name)


@contextmanager
def _progress(recording: "Recording", words: str) -> Generator[Callable[[], None]]:
    """Context manager: show a progress bar of the recorded states. Yields the function that advances the bar."""
    with show_progress_bar(words, len(recording.messages_by_topic["/physics"]), "states") as bar:
        yield bar.advance


def _verify(recording: "Recording", json_file: Path | None) -> None:
    import msgspec

    from avrgym.replay.verification import verify_recording

    with _progress(recording, "recomputing") as advance:
        found = verify_recording(recording, advance)
    write_json(json_file, msgspec.to_builtins(found))
    if not found.is_complete:
        print_line(f"The recording is not complete: compared up to its end at {found.end_time_s:.2f} s.")
    if found.is_identical:
        print_line(f"{found.num_states} states bit-identical, {found.num_steps} control steps identical")
    else:
        _print_differences(found)


def _print_differences(found: "Verification") -> None:
    """Print the differences between the recording and the recomputed trial.

    Raises:
        ReplayError: if neither rounding nor changed plug-ins or versions explain the differences.
    """
    from avrgym.replay.playback import ReplayError
    from avrgym.vr.session.attempt import read_package_versions

    print_line(
        f"{found.num_states - found.num_identical_states} of {found.num_states} states differ, "
        f"{found.num_steps - found.num_identical_steps} of {found.num_steps} control steps"
    )
    print_table([asdict(difference) for difference in found.differences])
    if found.agrees_within_rounding and not found.has_same_rounding:
        print_line(
            f"The replay agrees: each tick from a recorded state reproduces the next state within "
            f"{found.max_tick_error:.1g}. The C library of this computer rounds differently."
        )
        return
    for difference in found.plugin_differences:
        print_line(f"A plug-in has changed: {difference}.")
    if found.plugin_differences:
        return
    if found.has_same_versions:
        raise ReplayError(
            f"the replay differs from the recording, although both have the same versions: {found.recorded_versions}; "
            "restore a backup of the recording, or report this error"
        )
    print_line(
        f"The trial was recorded with {found.recorded_versions}; the installed versions are {read_package_versions()}."
    )


def _show_regions(recording: "Recording", json_file: Path | None) -> None:
    from avrgym.replay.playback import compute_region_loads
    from avrgym.safety.region_forces import compute_region_statistics

    with _progress(recording, "recomputing") as advance:
        found = compute_region_statistics(compute_region_loads(recording, advance))
    figures = {region: asdict(each) for region, each in found.items()}
    print_region_forces({"this trial": figures})
    write_json(json_file, figures)


def _write_video(recording: "Recording", video: Path, first_person: bool) -> None:
    from avrgym.replay.rendering import write_video

    with _progress(recording, "rendering") as advance:
        write_video(recording, video, first_person=first_person, progress=advance)
    print_line(f"video     {video}")


def _write_gif(recording: "Recording", gif: Path, first_person: bool) -> None:
    from avrgym.replay.rendering import write_gif

    with _progress(recording, "rendering") as advance:
        write_gif(recording, gif, first_person=first_person, progress=advance)
    print_line(f"animation {gif}")


def _write_mcap(recording: "Recording", mcap: Path) -> None:
    from avrgym.replay.foxglove import write_foxglove

    with _progress(recording, "recomputing") as advance:
        write_foxglove(recording, mcap, advance)
    when = f"{recording.began_at:%Y-%m-%d %H:%M:%S} UTC"
    print_line(f"3D        {mcap}, {mcap.stat().st_size / 1e6:.1f} MB, from {when}")


def _draw_strip(recording: "Recording", count: int, out: Path, first_person: bool) -> None:
    from avrgym.replay.rendering import write_image_strip

    with _progress(recording, "drawing") as advance:
        times_s = write_image_strip(recording, count, out, first_person=first_person, progress=advance)
    print_line(f"images    {out}, at {', '.join(f'{time_s:.1f}' for time_s in times_s)} s")


def _named(file: Path | None) -> list[tuple[Path, "Recording"]]:
    if file is None:
        return []
    with _with_file_name(file):
        return [(file, _read(file))]


def _write_page(recordings: list[tuple[Path, "Recording"]], html: Path) -> None:
    from avrgym.replay.page import ReplayedTrial, check_page_path, write_page
    from avrgym.replay.timeline import build_timeline

    check_page_path(html)
    trials: list[ReplayedTrial] = []
    for file, recording in recordings:
        with _with_file_name(file), _progress(recording, "recomputing") as advance:
            trials.append(ReplayedTrial(recording, *build_timeline(recording, advance)))
    write_page(trials, html)
    print_line(f"page      {html}, {html.stat().st_size / 1e6:.1f} MB")


def _show(recording: "Recording", port: int) -> None:
    from avrgym.replay.server import ReplayServer
    from avrgym.replay.timeline import build_timeline

    with _progress(recording, "recomputing") as advance:
        timeline, poses = build_timeline(recording, advance)
    with ReplayServer(recording, timeline, poses, port) as server:
        print_line("Open this address in a browser; Space plays and pauses. Stop with Ctrl+C.")
        print_line(f"    {server.url}")
        server.wait()
