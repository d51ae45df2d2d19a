"""Evaluates the measurements of a headset check. Reports whether a session may begin, or the faults and remedies.

The limits are design choices. A display below 60 Hz flickers. Dropped frames are visible, and many people do not
tolerate 5 % for half an hour. Jitter above the limits means that tracking is disturbed.
"""

from collections.abc import Iterator, Sequence

from avrgym.recording.configuration import HeadsetCheck, TrackingQuality
from avrgym.texts.interface_texts import ENGLISH_TEXTS, ParticipantText
from avrgym.vr.latency import STAGE_LABELS

MIN_DISPLAY_HZ = 60.0
MAX_DROPPED_FRAME_FRACTION = 0.05
MAX_LATENCY_MS = 100.0
MIN_TRACKED_FRACTION = 0.95
MAX_JITTER_MM = {"head": 1.0, "controller": 2.0, "hand": 5.0}
"""Maximum jitter by tracked device, in mm. It is larger for a bare hand, because cameras track it less precisely."""
MIN_RENDERED_FRAMES = 30


def is_headset_ready(check: HeadsetCheck) -> bool:
    """Returns whether a session may begin: the headset has no fault."""
    return not find_headset_faults(check)


def find_headset_faults(check: HeadsetCheck) -> list[ParticipantText]:
    """Returns the reasons why a session may not begin, each with its remedy."""
    of_parts = (_frame_faults, _latency_faults, _tracking_faults, _sense_faults, _stop_faults)
    return [fault for faults_of in of_parts for fault in faults_of(check)]


def make_result_message(check: HeadsetCheck, max_faults: int) -> ParticipantText:
    """Returns the text with the result for the participant: at most ``max_faults`` faults, and the number of further
    faults."""
    found = find_headset_faults(check)
    if not found:
        return ParticipantText("headset_ready")
    text = _in_a_row(found[:max_faults])
    if len(found) > max_faults:
        text = ParticipantText("more_faults", {"faults": text, "more": str(len(found) - max_faults)})
    return ParticipantText("headset_not_ready", {"faults": text})


def format_result(check: HeadsetCheck) -> str:
    """Returns the result of the headset check as text for experimenters, with all faults."""
    return "Go: the headset is ready." if is_headset_ready(check) else f"No-go. {format_faults(check)}"


def format_faults(check: HeadsetCheck) -> str:
    """Returns all faults of the headset check as English text."""
    return " ".join(ENGLISH_TEXTS.format_for_vr(fault) for fault in find_headset_faults(check))


def format_measurements(check: HeadsetCheck) -> str:
    """Returns all measurements of the headset check as one line of text."""
    total = check.latency_ms.get("total_ms")
    return "; ".join(
        [
            f"{check.frame_rate_hz:.0f} frames per second" + _of_display(check.display_hz),
            f"{100.0 * check.dropped_share:.1f} % dropped",
            "latency not measured"
            if total is None
            else f"latency: median {total['p50']:.0f} ms, 95th percentile {total['p95']:.0f} ms ({_stages(check)})",
            *(_part_text(name, part) for name, part in _parts(check)),
            f"vibration {_felt(check.vibration_felt, 'felt')}, chime {_felt(check.sound_heard, 'heard')}",
            *(
                []
                if check.stop_method is None
                else [f"stop tested with: {check.stop_method}{_after(check.stop_delay_s)}"]
            ),
        ]
    )


def _after(seconds: float | None) -> str:
    return "" if seconds is None else f" after {seconds:.1f} s"


def _in_a_row(said: Sequence[ParticipantText]) -> ParticipantText:
    first, *rest = said
    return ParticipantText("one_after_another", {"first": first, "rest": _in_a_row(rest)}) if rest else first


def _of_display(display_hz: float | None) -> str:
    return "" if display_hz is None else f" (display: {display_hz:.0f})"


def _stages(check: HeadsetCheck) -> str:
    return ", ".join(f"{words} {check.latency_ms[stage]['p50']:.0f}" for stage, words in STAGE_LABELS.items())


def _felt(answer: bool | None, verb: str) -> str:
    return "not asked" if answer is None else verb if answer else f"not {verb}"


def _parts(check: HeadsetCheck) -> tuple[tuple[str, TrackingQuality], ...]:
    return ("head", check.head), ("left hand", check.left), ("right hand", check.right)


def _part_text(name: str, part: TrackingQuality) -> str:
    jitter = "" if part.jitter_mm is None else f", jitter {part.jitter_mm:.2f} mm"
    reach = "" if part.reach_m is None else f", reach {part.reach_m:.2f} m"
    return f"{name} ({part.modality}) tracked {100.0 * part.tracked_share:.0f} %{jitter}{reach}"


def _frame_faults(check: HeadsetCheck) -> Iterator[ParticipantText]:
    if check.num_frames < MIN_RENDERED_FRAMES:
        yield ParticipantText("fault_no_pictures")
        return
    display_hz = check.display_hz or check.frame_rate_hz
    if display_hz < MIN_DISPLAY_HZ:
        yield ParticipantText(
            "fault_display", {"hz": f"{display_hz:.0f}", "least_hz": f"{MIN_DISPLAY_HZ:.0f}"}
        )
    if check.dropped_share > MAX_DROPPED_FRAME_FRACTION:
        shares = {"percent": check.dropped_share, "most_percent": MAX_DROPPED_FRAME_FRACTION}
        yield ParticipantText(
            "fault_dropped", {name: f"{100.0 * share:.0f}" for name, share in shares.items()}
        )


def _latency_faults(check: HeadsetCheck) -> Iterator[ParticipantText]:
    total = check.latency_ms.get("total_ms")
    if total is None:
        yield ParticipantText("fault_no_answer")
    elif total["p95"] > MAX_LATENCY_MS:
        slowest = max(STAGE_LABELS, key=lambda stage: check.latency_ms[stage]["p95"])
        values = {"ms": f"{total['p95']:.0f}", "most_ms": f"{MAX_LATENCY_MS:.0f}"}
        yield ParticipantText(
            "fault_late", values | {"advice": ParticipantText(f"advice_{slowest.removesuffix('_ms')}")}
        )


def _tracking_faults(check: HeadsetCheck) -> Iterator[ParticipantText]:
    for name, part in _parts(check):
        tracked = {"part": ParticipantText(f"part_{name.replace(' ', '_')}")}
        if part.modality == "mouse":
            yield ParticipantText("fault_mouse", tracked)
            continue
        if part.modality == "rests":
            continue
        if part.tracked_share < MIN_TRACKED_FRACTION:
            shares = {
                "percent": f"{100.0 * part.tracked_share:.0f}",
                "least_percent": f"{100.0 * MIN_TRACKED_FRACTION:.0f}",
            }
            yield ParticipantText("fault_untracked", tracked | shares)
        limit_mm = MAX_JITTER_MM.get("head" if name == "head" else part.modality)
        if limit_mm is not None and part.jitter_mm is not None and part.jitter_mm > limit_mm:
            yield ParticipantText(
                "fault_jitter", tracked | {"mm": f"{part.jitter_mm:.1f}", "most_mm": f"{limit_mm:g}"}
            )


def _sense_faults(check: HeadsetCheck) -> Iterator[ParticipantText]:
    if check.vibration_felt is False:
        yield ParticipantText("fault_haptics")
    if check.sound_heard is False:
        yield ParticipantText("fault_sound")


def _stop_faults(check: HeadsetCheck) -> Iterator[ParticipantText]:
    if check.stop_method == "none":
        yield ParticipantText("fault_no_stop")
