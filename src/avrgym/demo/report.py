"""The report of recorded trials: one HTML file that holds everything, for any browser, from disk."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from statistics import fmean

from avrgym.analysis.page.elements import (
    Markup,
    badge,
    bullet_list,
    count_text,
    definition_list,
    figure,
    join,
    number_text,
    table,
    tag,
    warning_box,
    write_page,
)
from avrgym.analysis.page.line_charts import trial_charts
from avrgym.demo.events import folded
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.recording.reader import Recording, RecordingError, read_recording
from avrgym.recording.schema import Answer, TrackingFrame
from avrgym.vr.latency import STAGE_WORDS, STAGES, percentiles_ms

PICTURE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}


@dataclass(frozen=True)
class TrialSummary:
    """One trial's metrics; what was never recorded is ``None``."""

    reward: float
    success: bool
    steps: int
    closest_m: float | None
    peak_force_n: float | None
    frames: int
    frames_held: int
    frames_missing: int
    frame_rate_hz: float | None
    latency_ms: dict[str, dict[str, float]]


def summarise(recording: Recording) -> TrialSummary:
    """The metrics of one trial, complete or not."""
    control = [record for _, record in recording.topics["/control"]]
    frames = [record for _, record in recording.topics["/tracking"]]
    return TrialSummary(
        reward=sum(record.reward for record in control),
        success=bool(control) and control[-1].success,
        steps=len(control),
        closest_m=min((record.distance_m for record in control), default=None),
        peak_force_n=max((record.force_on_person_n for record in control), default=None),
        frames=len(frames),
        frames_held=sum(frame.held or bool(frame.held_parts) for frame in frames),
        frames_missing=_missing(frames),
        frame_rate_hz=_rate_hz(frames),
        latency_ms=percentiles_ms([record for _, record in recording.topics["/latency"]]),
    )


def write_report(
    out_dir: str | Path,
    recordings: Sequence[str | Path],
    pictures: Sequence[str | Path],
    title: str,
    moments: Mapping[Path, Path] | None = None,
) -> Path:
    """Write ``out_dir/report/index.html`` about recordings, with pictures of what the participant saw.

    It leads with what happened in each trial; ``moments`` are pictures of them by recording.

    The same input gives the same bytes. Recordings that cannot be read are named in the report; a picture of
    an unknown type raises ``ValueError``.
    """
    read, unreadable = _read_all([Path(path) for path in recordings])
    readable = [recording for _, recording in read]
    drawn = {path: _picture(picture) for path, picture in (moments or {}).items()}
    shown = [_picture(Path(path)) for path in pictures]
    trials = [_trial(number, recording) for number, recording in enumerate(readable, start=1)]
    header = [_counts(readable, unreadable), _simulated_notice(readable)]
    main = [_what_happened(read, drawn), _gallery(shown), _overview(readable), *trials]
    return write_page(Path(out_dir) / "report" / "index.html", title, header, main)


def _read_all(paths: list[Path]) -> tuple[list[tuple[Path, Recording]], list[str]]:
    readable: list[tuple[Path, Recording]] = []
    unreadable: list[str] = []
    for path in paths:
        try:
            readable.append((path, read_recording(path)))
        except (OSError, RecordingError) as error:
            unreadable.append(str(error).replace(str(path), path.name))
    return readable, unreadable


def _missing(frames: list[TrackingFrame]) -> int:
    numbers = {frame.sequence for frame in frames}
    return max(numbers) - min(numbers) + 1 - len(numbers) if numbers else 0


def _rate_hz(frames: list[TrackingFrame]) -> float | None:
    duration_s = frames[-1].received_time_s - frames[0].received_time_s if frames else 0
    return (len(frames) - 1) / duration_s if duration_s > 0 else None


# The page


def _counts(recordings: list[Recording], unreadable: list[str]) -> Markup:
    practice = sum(recording.configuration.practice for recording in recordings)
    incomplete = sum(not recording.complete for recording in recordings) + len(unreadable)
    total = len(recordings) + len(unreadable)
    line = tag(
        "p", f"{count_text(total, 'recording')}, of which {practice} practice and {incomplete} incomplete."
    )
    return join([line, tag("p", "Not readable:"), bullet_list(unreadable)]) if unreadable else line


def _simulated_notice(recordings: list[Recording]) -> Markup:
    simulated = sum(recording.configuration.simulated for recording in recordings)
    if not simulated:
        return Markup()
    which = "Every trial" if simulated == len(recordings) else f"{simulated} of {len(recordings)} trials"
    return warning_box(
        "SIMULATED PARTICIPANT.",
        f"{which} here had no person in it: poses and answers were made up by a program.",
    )


def _overview(recordings: list[Recording]) -> Markup:
    heads = ("Trial", "Environment", "Policy", "Participant", "Reward", "Success", "Steps")
    rows = [_overview_row(number, recording) for number, recording in enumerate(recordings, start=1)]
    return tag(
        "section",
        tag("h2", "Trials"),
        table("The reward is the sum over all steps", heads, rows, numbers=(4, 6)),
    )


def _overview_row(number: int, recording: Recording) -> tuple[object, ...]:
    summary = summarise(recording)
    return (
        tag("a", number, href=f"#trial-{number}"),
        recording.configuration.environment,
        recording.configuration.policy + (" (practice)" if recording.configuration.practice else ""),
        "simulated" if recording.configuration.simulated else "person",
        number_text(summary.reward),
        _success(recording, summary),
        summary.steps,
    )


def _gallery(pictures: list[Markup]) -> Markup:
    if not pictures:
        return Markup()
    return tag("section", tag("h2", "What the participant saw"), tag("div", *pictures, class_="figures"))


def _picture(path: Path) -> Markup:
    if path.suffix.lower() not in PICTURE_TYPES:
        raise ValueError(f"{path}: not a picture; allowed: {', '.join(PICTURE_TYPES)}")
    caption = re.sub(r"[-_]+", " ", path.stem)
    data = base64.b64encode(path.read_bytes()).decode()
    source = f"data:{PICTURE_TYPES[path.suffix.lower()]};base64,{data}"
    image = Markup(f'<img src="{source}" alt="{escape(caption)}">')
    return figure(image, caption)


# What happened


def telling_moment_s(recording: Recording) -> float:
    """When a picture tells most of a trial: at the success, else when the robot was nearest; from its beginning."""
    control = recording.topics["/control"]
    if not control:
        return 0.0
    success = next((time_ns for time_ns, record in control if record.success), None)
    nearest_ns, _ = min(control, key=lambda each: each[1].distance_m)
    return (nearest_ns if success is None else success) / 1e9


def _what_happened(recordings: list[tuple[Path, Recording]], drawn: Mapping[Path, Markup]) -> Markup:
    """Each trial with its picture, success, force and answers."""
    if not recordings:
        return Markup()
    happened = [
        _happened(number, recording, drawn.get(path))
        for number, (path, recording) in enumerate(recordings, start=1)
    ]
    return tag("section", tag("h2", "What happened"), tag("div", *happened, class_="figures pairs"))


def _happened(number: int, recording: Recording, picture: Markup | None) -> Markup:
    environment, goal = recording.configuration.environment, recording.configuration.goal
    name = environment.removeprefix("avrgym/").removesuffix("-v1")
    facts = {"Success": _success_when(recording), "Force on the person": _force(recording)}
    told = [tag("p", f"The participant was told: {goal}")] if goal else []
    more = tag("p", tag("a", "More about this trial", href=f"#trial-{number}"))
    return tag(
        "div", tag("h3", name), picture or Markup(), *told, definition_list(facts), _ratings(recording), more
    )


def _success_when(recording: Recording) -> str:
    control, summary = recording.topics["/control"], summarise(recording)
    first = next((record.step for _, record in control if record.success), None)
    return _success(recording, summary) if first is None else f"yes, after {first * CONTROL_STEP_S:.0f} s"


def _force(recording: Recording) -> str:
    forces = [record.force_on_person_n for _, record in recording.topics["/control"]]
    if not forces:
        return "not recorded"
    return (
        f"at most {number_text(max(forces), 'N', digits=1)}, mean {number_text(fmean(forces), 'N', digits=1)}"
    )


def _ratings(recording: Recording) -> Markup:
    """What the participant answered, in a line each."""
    asked = [(_asked(recording, answer), answer.item) for _, answer in recording.topics["/answers"]]
    return bullet_list([f"{value}: {text or item}" for (text, _, value), item in asked])


# One trial


def _trial(number: int, recording: Recording) -> Markup:
    heading = (
        f"Trial {number}: {recording.configuration.environment}, {recording.configuration.policy} policy"
    )
    return tag(
        "article",
        tag("h2", heading),
        _badges(recording),
        _metrics(recording, summarise(recording)),
        _plots(recording),
        _reward_terms(recording),
        _answers(recording),
        _events(recording),
        id=f"trial-{number}",
    )


def _badges(recording: Recording) -> Markup:
    marks = {
        "SIMULATED PARTICIPANT": recording.configuration.simulated,
        "practice": recording.configuration.practice,
        "incomplete recording": not recording.complete,
    }
    return join([badge(text) for text, holds in marks.items() if holds])


def _metrics(recording: Recording, summary: TrialSummary) -> Markup:
    held = f"{count_text(summary.frames_held, 'frame')} of {summary.frames}"
    metrics = {
        "Reward": number_text(summary.reward),
        "Success": _success(recording, summary),
        "Steps": summary.steps,
        "Closest to the target": number_text(summary.closest_m, "m"),
        "Peak force on the person": number_text(summary.peak_force_n, "N"),
        "Tracking rate": number_text(summary.frame_rate_hz, "Hz", digits=0),
        "Tracking held": held if summary.frames else "no frames",
        "Tracking lost": count_text(summary.frames_missing, "frame"),
        "From pose to picture": _latency(summary.latency_ms),
    }
    return definition_list(metrics)


def _latency(percentiles_ms: dict[str, dict[str, float]]) -> str:
    """The half and all but one in twenty, then the halves of the stages."""
    if not percentiles_ms:
        return "not recorded"
    total = percentiles_ms["total_ms"]
    stages = ", ".join(f"{STAGE_WORDS[stage]} {percentiles_ms[stage]['p50']:.0f}" for stage in STAGES)
    return f"{total['p50']:.0f} ms, 95 % within {total['p95']:.0f}: {stages}"


def _plots(recording: Recording) -> Markup:
    control = recording.topics["/control"]
    if not control:
        return tag("p", "No step of the robot was recorded.", class_="faint")
    times_s = [log_time_ns / 1e9 for log_time_ns, _ in control]
    weights = recording.configuration.reward_weights
    return trial_charts(times_s, [record for _, record in control], weights)


def _reward_terms(recording: Recording) -> Markup:
    control = [record for _, record in recording.topics["/control"]]
    names = dict.fromkeys(name for record in control for name in record.reward_terms)
    if not names:
        return Markup()
    weights = recording.configuration.reward_weights
    rows = [
        _term_row(name, sum(record.reward_terms.get(name, 0.0) for record in control), weights.get(name))
        for name in names
    ]
    heads = ("Term", "Sum", "Weight", "Weighted sum")
    return table("Reward terms, summed over the steps", heads, rows, numbers=(1, 2, 3))


def _term_row(name: str, total: float, weight: float | None) -> tuple[str, str, str, str]:
    if weight is None:
        return (name, number_text(total), "", "")
    return (name, number_text(total), number_text(weight), number_text(weight * total))


def _answers(recording: Recording) -> Markup:
    latest = {answer.item: answer for _, answer in recording.topics["/answers"]}
    rows = [
        (item, *_asked(recording, answer), number_text(answer.response_time_s, "s"))
        for item, answer in latest.items()
    ]
    if not rows:
        return tag("p", "No answers were recorded.", class_="faint")
    return table("Answers", ("Item", "Statement", "Scale", "Answer", "Time"), rows, numbers=(3, 4))


def _asked(recording: Recording, answer: Answer) -> tuple[str, str, str]:
    """Statement, scale and value of an answer, in the words of its recording as far as it has them."""
    item = next((each for each in recording.configuration.items if each.id == answer.item), None)
    if item is None:
        return "", "", str(answer.value)
    if labels := item.labels:
        return item.text, f"{labels[0]} to {labels[-1]}", labels[answer.value - 1]
    low, high = (f" ({end})" if end else "" for end in (item.low, item.high))
    return item.text, f"1{low} to {item.points}{high}", f"{answer.value} of {item.points}"


def _events(recording: Recording) -> Markup:
    until_s = max((time_ns for _, time_ns, _ in recording.messages), default=0) / 1e9
    rows = [
        (
            number_text(each.at_s, "s"),
            each.name,
            each.times,
            number_text(each.lasted_s, "s", absent=""),
            each.detail,
        )
        for each in folded(recording.topics["/events"], until_s)
    ]
    if not rows:
        return Markup()
    heads = ("First at", "Event", "Times", "Lasted in all", "Detail")
    return table("Events", heads, rows, numbers=(0, 2, 3))


# Parts


def _success(recording: Recording, summary: TrialSummary) -> str:
    return "yes" if summary.success else "no" if recording.complete else "not yet (incomplete)"
