"""The share of a trial with tracking loss: lost, late or implausible data, for which the person is held still."""

from avrgym.models.body_names import PART_LABELS, PARTS, Part
from avrgym.recording.reader import Recording
from avrgym.recording.schema import TrackingFrame
from avrgym.study.design.design import Design
from avrgym.vr.tracking.frames import STALE_S


def tracking_loss_share(recording: Recording, part: Part | None = None) -> float | None:
    """The share (0 to 1) of tracking loss in the time of the robot's assistance; ``None`` without assistance.

    A frame counts as tracked until the next one, or until it is stale, unless it or a part of it was held. With
    ``part``, only this part counts.
    """
    span = _assistance_span_s(recording)
    if span is None:
        return None
    frames = [(time_ns / 1e9, frame) for time_ns, frame in recording.topics["/tracking"]]
    ends_s = [time_s for time_s, _ in frames[1:]] + [span[1]]
    tracked_s = sum(
        _overlap_s(span, time_s, min(end_s, time_s + STALE_S))
        for (time_s, frame), end_s in zip(frames, ends_s, strict=False)
        if not _is_held(frame, part)
    )
    return min(max(1.0 - tracked_s / (span[1] - span[0]), 0.0), 1.0)


def describe_excess_loss(recording: Recording, design: Design) -> str | None:
    """The reason why a trial is excluded for tracking loss, with the share of each part; ``None`` if it is not."""
    share = tracking_loss_share(recording)
    if share is None or share <= design.max_held_share:
        return None
    parts = {PART_LABELS[part]: tracking_loss_share(recording, part) or 0.0 for part in PARTS}
    by_part = ", ".join(f"{words} {100 * part:.1f} %" for words, part in parts.items())
    return (
        f"its person was held for {100 * share:.1f} % of the time in which the robot helped ({by_part}); "
        f"max_held_share allows {100 * design.max_held_share:g} %"
    )


def _is_held(frame: TrackingFrame, part: Part | None) -> bool:
    in_part = bool(frame.held_parts) if part is None else part in frame.held_parts
    return frame.held or in_part


def _assistance_span_s(recording: Recording) -> tuple[float, float] | None:
    """Begin and end of the robot's assistance; without its event, it begins with the first control step."""
    control_s = [time_ns / 1e9 for time_ns, _ in recording.topics["/control"]]
    begins_s = [
        time_ns / 1e9
        for time_ns, event in recording.topics["/events"]
        if (event.name, event.detail) == ("phase", "trial")
    ]
    if not control_s or (begins_s + control_s)[0] >= control_s[-1]:
        return None
    return (begins_s + control_s)[0], control_s[-1]


def _overlap_s(span: tuple[float, float], begin_s: float, end_s: float) -> float:
    return max(0.0, min(span[1], end_s) - max(span[0], begin_s))
