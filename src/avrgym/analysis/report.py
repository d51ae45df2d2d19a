"""The report of recorded trials: one HTML file that holds everything, for any browser, from disk."""

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from avrgym.files import write_whole
from avrgym.study.questionnaire import LIKERT_ITEMS
from avrgym.study.recording import Recording, RecordingError, read_recording
from avrgym.study.records import TrackingFrame

PICTURE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".webp": "image/webp"}

# Colours that matplotlib writes and that the page replaces by those of its light or dark theme.
_INK, _LINE = "#00000a", "#00000b"
_THEME = {_INK: "currentColor", _LINE: "var(--accent)"}
_PLOT_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "avrgym",
    "font.family": "sans-serif",
    "font.size": 10,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": _INK,
    "ytick.color": _INK,
}

_CSS = """
:root { color-scheme: light dark; --ground: #fff; --ink: #1c2024; --faint: #5b6570; --rule: #d5dae0;
  --accent: #0b62a8; --warning: #8a3b00; --warning-ground: #fff1e3; }
@media (prefers-color-scheme: dark) { :root { --ground: #14171a; --ink: #e6e9ec; --faint: #a0aab4;
  --rule: #363d45; --accent: #6db7f2; --warning: #ffb673; --warning-ground: #35230f; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 1rem; background: var(--ground); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1, h2, h3 { line-height: 1.2; }
article { border-top: 1px solid var(--rule); margin-top: 2.5rem; }
a { color: var(--accent); }
.faint, figcaption, caption { color: var(--faint); }
.notice, .badge { background: var(--warning-ground); color: var(--warning); border-radius: .3rem; }
.notice { padding: .75rem 1rem; }
.badge { display: inline-block; padding: .1rem .5rem; margin: 0 .4rem .4rem 0; font-size: .85rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 1rem 0; overflow-wrap: normal; }
caption { text-align: left; padding-bottom: .3rem; }
th, td { padding: .3rem .8rem .3rem 0; border-bottom: 1px solid var(--rule); text-align: left;
  vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
@media (max-width: 30rem) { table { font-size: .875rem; } th, td { padding-right: .5rem; } }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(max(8.5rem, 22%), 1fr)); gap: .8rem; }
dt { color: var(--faint); font-size: .85rem; }
dd { margin: 0; font-size: 1.15rem; font-variant-numeric: tabular-nums; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); gap: 1rem; }
figure { margin: 0; max-width: 40rem; }
figure svg, figure img { display: block; width: 100%; height: auto; }
figure img { border-radius: .3rem; }
""".strip()


class _Markup(str):
    """Text that is HTML already; every other text is escaped."""


def _tag(name: str, *children: Any, **attributes: Any) -> _Markup:
    content = "".join(child if isinstance(child, _Markup) else escape(str(child)) for child in children)
    settings = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value))}"' for key, value in attributes.items()
    )
    return _Markup(f"<{name}{settings}>{content}</{name}>")


@dataclass(frozen=True)
class TrialSummary:
    """One trial in figures; what was never recorded is ``None``."""

    reward: float
    success: bool
    steps: int
    closest_m: float | None
    peak_force_n: float | None
    frames: int
    frames_held: int
    frames_missing: int
    frame_rate_hz: float | None


def summarise(recording: Recording) -> TrialSummary:
    """The figures of one trial, complete or not."""
    control = [record for _, record in recording.topics["/control"]]
    frames = [record for _, record in recording.topics["/tracking"]]
    return TrialSummary(
        reward=sum(record.reward for record in control),
        success=bool(control) and control[-1].success,
        steps=len(control),
        closest_m=min((record.distance_m for record in control), default=None),
        peak_force_n=max((record.force_on_person_n for record in control), default=None),
        frames=len(frames),
        frames_held=sum(frame.held for frame in frames),
        frames_missing=_missing(frames),
        frame_rate_hz=_rate_hz(frames),
    )


def write_report(
    out_dir: str | Path, recordings: Sequence[str | Path], pictures: Sequence[str | Path], title: str
) -> Path:
    """Write ``out_dir/report/index.html`` about recordings, with pictures of what the participant saw.

    The same input gives the same bytes. Recordings that cannot be read are named in the report; a picture of
    an unknown type raises ``ValueError``.
    """
    readable, unreadable = _read_all([Path(path) for path in recordings])
    shown = [_picture(Path(path)) for path in pictures]
    page = _page(title, readable, unreadable, shown)
    path = Path(out_dir) / "report" / "index.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, page.encode())
    return path


def _read_all(paths: list[Path]) -> tuple[list[Recording], list[str]]:
    readable, unreadable = [], []
    for path in paths:
        try:
            readable.append(read_recording(path))
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


def _page(title: str, recordings: list[Recording], unreadable: list[str], pictures: list[_Markup]) -> str:
    head = _tag("title", title) + _tag("style", _Markup(_CSS))
    trials = [_trial(number, recording) for number, recording in enumerate(recordings, start=1)]
    body = _tag(
        "body",
        _tag("header", _tag("h1", title), _counts(recordings, unreadable), _simulated_notice(recordings)),
        _tag("main", _overview(recordings), _gallery(pictures), *trials),
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"{head}</head>\n{body}\n</html>\n"
    )


def _counts(recordings: list[Recording], unreadable: list[str]) -> _Markup:
    practice = sum(bool(recording.metadata.get("practice")) for recording in recordings)
    incomplete = sum(not recording.complete for recording in recordings) + len(unreadable)
    total = len(recordings) + len(unreadable)
    line = _tag(
        "p", f"{_count(total, 'recording')}, of which {practice} practice and {incomplete} incomplete."
    )
    reasons = [_tag("li", reason) for reason in unreadable]
    return _Markup(line + (_tag("p", "Not readable:") + _tag("ul", *reasons) if reasons else ""))


def _simulated_notice(recordings: list[Recording]) -> _Markup:
    simulated = sum(_is_simulated(recording) for recording in recordings)
    if not simulated:
        return _Markup()
    which = "Every trial" if simulated == len(recordings) else f"{simulated} of {len(recordings)} trials"
    return _tag(
        "p",
        _tag("strong", "SIMULATED PARTICIPANT. "),
        f"{which} here had no person in it: poses and answers were made up by a program.",
        class_="notice",
        role="note",
    )


def _overview(recordings: list[Recording]) -> _Markup:
    heads = ("Trial", "Environment", "Policy", "Participant", "Reward", "Success", "Steps")
    rows = [_overview_row(number, recording) for number, recording in enumerate(recordings, start=1)]
    return _tag(
        "section",
        _tag("h2", "Trials"),
        _table("The reward is the sum over all steps", heads, rows, numbers=(4, 6)),
    )


def _overview_row(number: int, recording: Recording) -> tuple:
    summary = summarise(recording)
    return (
        _tag("a", number, href=f"#trial-{number}"),
        _text(recording, "environment"),
        _text(recording, "policy") + (" (practice)" if recording.metadata.get("practice") else ""),
        "simulated" if _is_simulated(recording) else "person",
        _number(summary.reward),
        _success(recording, summary),
        summary.steps,
    )


def _gallery(pictures: list[_Markup]) -> _Markup:
    if not pictures:
        return _Markup()
    return _tag("section", _tag("h2", "What the participant saw"), _tag("div", *pictures, class_="figures"))


def _picture(path: Path) -> _Markup:
    if path.suffix.lower() not in PICTURE_TYPES:
        raise ValueError(f"{path}: not a picture; allowed: {', '.join(PICTURE_TYPES)}")
    caption = re.sub(r"[-_]+", " ", path.stem)
    data = base64.b64encode(path.read_bytes()).decode()
    source = f"data:{PICTURE_TYPES[path.suffix.lower()]};base64,{data}"
    image = _Markup(f'<img src="{source}" alt="{escape(caption)}">')
    return _tag("figure", image, _tag("figcaption", caption))


# One trial


def _trial(number: int, recording: Recording) -> _Markup:
    heading = f"Trial {number}: {_text(recording, 'environment')}, {_text(recording, 'policy')} policy"
    return _tag(
        "article",
        _tag("h2", heading),
        _badges(recording),
        _figures(recording, summarise(recording)),
        _plots(number, recording),
        _reward_terms(recording),
        _answers(recording),
        _events(recording),
        id=f"trial-{number}",
    )


def _badges(recording: Recording) -> _Markup:
    marks = {
        "SIMULATED PARTICIPANT": _is_simulated(recording),
        "practice": recording.metadata.get("practice"),
        "incomplete recording": not recording.complete,
    }
    return _Markup("".join(_tag("span", text, class_="badge") for text, holds in marks.items() if holds))


def _figures(recording: Recording, summary: TrialSummary) -> _Markup:
    held = f"{_count(summary.frames_held, 'frame')} of {summary.frames}"
    figures = {
        "Reward": _number(summary.reward),
        "Success": _success(recording, summary),
        "Steps": summary.steps,
        "Closest to the target": _number(summary.closest_m, "m"),
        "Peak force on the person": _number(summary.peak_force_n, "N"),
        "Tracking rate": _number(summary.frame_rate_hz, "Hz", digits=0),
        "Tracking held": held if summary.frames else "no frames",
        "Tracking lost": _count(summary.frames_missing, "frame"),
    }
    return _tag("dl", *(_tag("div", _tag("dt", name), _tag("dd", value)) for name, value in figures.items()))


def _plots(number: int, recording: Recording) -> _Markup:
    control = recording.topics["/control"]
    if not control:
        return _tag("p", "No step of the robot was recorded.", class_="faint")
    times_s = [log_time_ns / 1e9 for log_time_ns, _ in control]
    distances = [record.distance_m for _, record in control]
    forces = [record.force_on_person_n for _, record in control]
    return _tag(
        "div",
        _plot(f"t{number}d-", "Distance to the target", "m", times_s, distances),
        _plot(f"t{number}f-", "Force on the person", "N", times_s, forces),
        class_="figures",
    )


def _reward_terms(recording: Recording) -> _Markup:
    control = [record for _, record in recording.topics["/control"]]
    names = dict.fromkeys(name for record in control for name in record.reward_terms)
    if not names:
        return _Markup()
    weights = recording.metadata.get("reward_weights") or {}
    rows = [
        _term_row(name, sum(record.reward_terms.get(name, 0.0) for record in control), weights.get(name))
        for name in names
    ]
    heads = ("Term", "Sum", "Weight", "Weighted sum")
    return _table("Reward terms, summed over the steps", heads, rows, numbers=(1, 2, 3))


def _term_row(name: str, total: float, weight: float | None) -> tuple[str, str, str, str]:
    if weight is None:
        return (name, _number(total), "", "")
    return (name, _number(total), _number(weight), _number(weight * total))


def _answers(recording: Recording) -> _Markup:
    items = {item.id: item for item in LIKERT_ITEMS}
    rows = []
    for _, answer in recording.topics["/answers"]:
        item = items.get(answer.item)
        value = f"{answer.value} of {item.points}" if item else answer.value
        rows.append((answer.item, item.text if item else "", value, _number(answer.response_time_s, "s")))
    if not rows:
        return _tag("p", "No answers were recorded.", class_="faint")
    caption = f"Answers, from 1 ({LIKERT_ITEMS[0].low}) to {LIKERT_ITEMS[0].points} ({LIKERT_ITEMS[0].high})"
    return _table(caption, ("Item", "Statement", "Answer", "Time"), rows, numbers=(2, 3))


def _events(recording: Recording) -> _Markup:
    rows = [
        (_number(log_time_ns / 1e9, "s"), event.name, event.detail)
        for log_time_ns, event in recording.topics["/events"]
    ]
    if not rows:
        return _Markup()
    return _table("Events", ("At", "Event", "Detail"), rows, numbers=(0,))


# Parts


def _is_simulated(recording: Recording) -> bool:
    return bool(recording.metadata.get("simulated"))


def _text(recording: Recording, name: str) -> str:
    return str(recording.metadata.get(name, f"unknown {name}"))


def _success(recording: Recording, summary: TrialSummary) -> str:
    return "yes" if summary.success else "no" if recording.complete else "not yet (incomplete)"


def _number(value: float | None, unit: str = "", digits: int = 2) -> str:
    return "not recorded" if value is None else f"{value:z.{digits}f} {unit}".rstrip().replace("-", "−")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _table(caption: str, heads: Sequence[str], rows: Sequence[Sequence], numbers: Sequence[int]) -> _Markup:
    kinds = ["number" if column in numbers else "text" for column in range(len(heads))]
    head = [_tag("th", text, scope="col", class_=kind) for text, kind in zip(heads, kinds, strict=True)]
    body = [
        _tag("tr", *(_tag("td", cell, class_=kind) for cell, kind in zip(row, kinds, strict=True)))
        for row in rows
    ]
    table = _tag("table", _tag("caption", caption), _tag("thead", _tag("tr", *head)), _tag("tbody", *body))
    return _tag("div", table, class_="scroll", tabindex=0, role="region", aria_label=caption)


def _plot(prefix: str, name: str, unit: str, times_s: list[float], values: list[float]) -> _Markup:
    with matplotlib.rc_context(_PLOT_STYLE):
        figure = Figure(figsize=(4.8, 2.4), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(times_s, values, color=_LINE, linewidth=1.5)
        axes.set(xlabel="time / s", ylabel=unit, ylim=(0, None))
        axes.margins(x=0)
        buffer = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    caption = f"{name}, {unit}, over the trial's time"
    return _tag("figure", _inline(buffer.getvalue(), prefix, caption), _tag("figcaption", caption))


def _inline(document: str, prefix: str, label: str) -> _Markup:
    """An SVG document as part of the page: its own ids, the page's colours, a name for screen readers."""
    svg = document[document.index("<svg") :]
    svg = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{prefix}", svg)
    for colour, replacement in _THEME.items():
        svg = svg.replace(colour, replacement)
    return _Markup(svg.replace("<svg", f'<svg role="img" aria-label="{escape(label)}"', 1))
