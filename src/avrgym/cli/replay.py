"""The command ``avrgym replay``."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from avrgym.cli.progress import progress_bar
from avrgym.cli.terminal import (
    JsonFile,
    check_json,
    plain_errors,
    print_regions,
    print_table,
    say,
    write_json,
)
from avrgym.vr.server.addresses import PORT

if TYPE_CHECKING:
    from avrgym.recording.reader import Recording
    from avrgym.replay.verification import Verification

WHERE_RECORDINGS_ARE = "give one of the .mcap files that `avrgym serve` writes into STUDY/recordings"


def replay(
    file: Annotated[Path, typer.Argument(help="The recording of an attempt, an .mcap file.", metavar="FILE")],
    verify: Annotated[
        bool, typer.Option("--verify", help="Step it again and compare whatever it holds, bit by bit.")
    ] = False,
    regions: Annotated[
        bool, typer.Option("--regions", help="Step it again and show the forces by region of the body.")
    ] = False,
    video: Annotated[
        Path | None, typer.Option(help="Render it into a new .mp4 file.", metavar="OUT.mp4")
    ] = None,
    gif: Annotated[
        Path | None, typer.Option(help="Render it into a new .gif file, for slides.", metavar="OUT.gif")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="Draw so many pictures side by side into --out.", min=1, max=20)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="A new .png or .jpg file for --frames.", metavar="OUT.png")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(help="Write it as a page that needs neither server nor network.", metavar="OUT.html"),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(help="On the page of --html, a second recording beside it.", metavar="OTHER"),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(help="Write it in 3D for Foxglove and Rerun.", metavar="OUT.mcap"),
    ] = None,
    first_person: Annotated[
        bool, typer.Option("--first-person", help="Videos and pictures with the participant's eyes.")
    ] = False,
    port: Annotated[
        int, typer.Option(help="The port of the page; 0 takes a free one.", min=0, max=65535)
    ] = PORT,
    json_file: JsonFile = None,
) -> None:
    """Replay a recorded trial: in a browser, verified, or drawn.

    Without options it is shown in a browser; others step it again, show forces, or write a page, a video or pictures.
    """
    with plain_errors():
        if (frames is None) != (out is None):
            raise ValueError("--frames and --out go together, as in --frames 4 --out strip.png")
        if json_file is not None and verify == regions:
            raise ValueError(
                "--json writes the metrics of --verify or of --regions; give one of these with it"
            )
        if first_person and video is None and gif is None and frames is None:
            raise ValueError(
                "--first-person goes with --video, --gif or --frames; on the page V changes the view"
            )
        if compare is not None and html is None:
            raise ValueError("--compare goes with --html, as in --html both.html --compare OTHER")
        check_json(json_file)
        with _naming(file):
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
def _naming(file: Path) -> Generator[None]:
    """Say which recording cannot be read or replayed."""
    from avrgym.recording.reader import RecordingError
    from avrgym.replay.playback import ReplayError

    try:
        yield
    except RecordingError as error:  # which names its file
        raise ValueError(f"{error}; {WHERE_RECORDINGS_ARE}") from error
    except ReplayError as error:
        raise ValueError(f"{file}: {error}") from error


def _read(file: Path) -> "Recording":
    from avrgym.recording.reader import read_recording
    from avrgym.replay.playback import title

    if file.is_dir():
        raise ValueError(f"{file}: a folder; {WHERE_RECORDINGS_ARE}")
    recording = read_recording(file)
    say(f"{title(recording)}, {recording.result or 'broken off'} after {recording.duration_s:.2f} s")
    return recording


@contextmanager
def _progress(recording: "Recording", words: str) -> Generator[Callable[[], None]]:
    """A bar that each recorded state moves on."""
    with progress_bar(words, len(recording.topics["/physics"]), "states") as bar:
        yield bar.advance


def _verify(recording: "Recording", json_file: Path | None) -> None:
    from avrgym.replay.verification import verify

    with _progress(recording, "stepping again") as advance:
        found = verify(recording, advance)
    write_json(json_file, msgspec.to_builtins(found))
    if not found.complete:
        say(f"The recording is not complete: it is compared up to its end at {found.until_s:.2f} s.")
    if found.identical:
        say(f"{found.states} states bit-identical, {found.steps} control steps identical")
    else:
        _tell_differences(found)


def _tell_differences(found: "Verification") -> None:
    """Say what differs; where nothing but rounding may, more than that is an error."""
    from avrgym.replay.playback import ReplayError
    from avrgym.vr.session.attempt import versions

    say(
        f"{found.states - found.identical_states} of {found.states} states differ, "
        f"{found.steps - found.identical_steps} of {found.steps} control steps"
    )
    print_table([asdict(difference) for difference in found.differences])
    if found.agrees and not found.same_rounding:
        say(
            f"It agrees: from each recorded state a tick leads to the next within {found.tick_error:.1g}. "
            "The C library rounds otherwise here than where it was recorded."
        )
        return
    for difference in found.plugin_differences:
        say(f"A plug-in differs from the recorded one: {difference}.")
    if found.plugin_differences:
        return
    if found.same_versions:
        raise ReplayError(
            f"it differs although it was recorded with the versions that run here, {found.recorded_with}"
        )
    say(f"It was recorded with {found.recorded_with}; here runs {versions()}.")


def _show_regions(recording: "Recording", json_file: Path | None) -> None:
    from avrgym.replay.playback import region_loads
    from avrgym.safety.region_forces import region_statistics

    with _progress(recording, "stepping again") as advance:
        found = region_statistics(region_loads(recording, advance))
    figures = {region: asdict(each) for region, each in found.items()}
    print_regions({"this trial": figures})
    write_json(json_file, figures)


def _write_video(recording: "Recording", video: Path, first_person: bool) -> None:
    from avrgym.replay.pictures import write_video

    with _progress(recording, "rendering") as advance:
        write_video(recording, video, first_person=first_person, progress=advance)
    say(f"video     {video}")


def _write_gif(recording: "Recording", gif: Path, first_person: bool) -> None:
    from avrgym.replay.pictures import write_gif

    with _progress(recording, "rendering") as advance:
        write_gif(recording, gif, first_person=first_person, progress=advance)
    say(f"animation {gif}")


def _write_mcap(recording: "Recording", mcap: Path) -> None:
    from avrgym.replay.foxglove import write_foxglove

    with _progress(recording, "stepping again") as advance:
        write_foxglove(recording, mcap, advance)
    when = f"{recording.began_at:%Y-%m-%d %H:%M:%S} UTC"
    say(f"3D        {mcap}, {mcap.stat().st_size / 1e6:.1f} MB, from {when}")


def _draw_strip(recording: "Recording", count: int, out: Path, first_person: bool) -> None:
    from avrgym.replay.pictures import draw_strip

    with _progress(recording, "drawing") as advance:
        times_s = draw_strip(recording, count, out, first_person=first_person, progress=advance)
    say(f"pictures  {out}, at {', '.join(f'{time_s:.1f}' for time_s in times_s)} s")


def _named(file: Path | None) -> list[tuple[Path, "Recording"]]:
    if file is None:
        return []
    with _naming(file):
        return [(file, _read(file))]


def _write_page(recordings: list[tuple[Path, "Recording"]], html: Path) -> None:
    from avrgym.replay.page import ReplayedTrial, check_page_to_write, write_page
    from avrgym.replay.timeline import timeline_of

    check_page_to_write(html)
    trials: list[ReplayedTrial] = []
    for file, recording in recordings:
        with _naming(file), _progress(recording, "stepping again") as advance:
            trials.append(ReplayedTrial(recording, *timeline_of(recording, advance)))
    write_page(trials, html)
    say(f"page      {html}, {html.stat().st_size / 1e6:.1f} MB")


def _show(recording: "Recording", port: int) -> None:
    from avrgym.replay.server import ReplayServer
    from avrgym.replay.timeline import timeline_of

    with _progress(recording, "stepping again") as advance:
        timeline, poses = timeline_of(recording, advance)
    with ReplayServer(recording, timeline, poses, port) as server:
        say("Open this address in a browser; Space plays and pauses. Stop with Ctrl+C.")
        say(f"    {server.url}")
        server.wait()
