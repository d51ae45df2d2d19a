"""Share of tracking loss in a trial: time with missing, late or implausible frames. The person model then stops."""

from avrgym.models.body_names import TRACKED_BODY_PART_LABELS, TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.recording.reader import Recording
from avrgym.recording.schema import TrackingFrame
from avrgym.study.design.design import Design
from avrgym.vr.tracking.pose_freshness import STALE_POSE_AGE_S


def compute_tracking_loss_fraction(recording: Recording, part: TrackedBodyPart | None = None) -> float | None:
    """Returns the share (0 to 1) of the robot's assistance time without tracking; ``None`` without assistance.

    A frame is valid until the next frame, for at most ``STALE_POSE_AGE_S``. A frame is lost if the whole frame, or one
    body part in it, is stale or rejected. With ``part``, only this body part is considered.
    """
    span = _assistance_span_s(recording)
    if span is None:
        return None
    frames = [(time_ns / 1e9, frame) for time_ns, frame in recording.messages_by_topic["/tracking"]]
    ends_s = [time_s for time_s, _ in frames[1:]] + [span[1]]
    tracked_s = sum(
        _overlap_s(span, time_s, min(end_s, time_s + STALE_POSE_AGE_S))
        for (time_s, frame), end_s in zip(frames, ends_s, strict=False)
        if not _is_held(frame, part)
    )
    return min(max(1.0 - tracked_s / (span[1] - span[0]), 0.0), 1.0)


def describe_excess_tracking_loss(recording: Recording, design: Design) -> str | None:
    """Returns the reason why tracking loss excludes a trial, with the share of each body part.

    Returns ``None`` if the trial is not excluded.
    """
    share = compute_tracking_loss_fraction(recording)
    if share is None or share <= design.max_held_share:
        return None
    parts = {
        TRACKED_BODY_PART_LABELS[part]: compute_tracking_loss_fraction(recording, part) or 0.0
        for part in TRACKED_BODY_PARTS
    }
    by_part = ", ".join(f"{words} {100 * part:.1f} %" for words, part in parts.items())
    return (
        f"tracking was lost for {100 * share:.1f} % of the robot's assistance time ({by_part}); "
        f"max_held_share allows {100 * design.max_held_share:g} %"
    )


def _is_held(frame: TrackingFrame, part: TrackedBodyPart | None) -> bool:
    in_part = bool(frame.rejected_parts) if part is None else part in frame.rejected_parts
    return frame.rejected or in_part


def _assistance_span_s(recording: Recording) -> tuple[float, float] | None:
    """Returns start and end of the robot's assistance, in seconds; ``None`` without control steps.

    If the recording does not contain the start of assistance, the first control step is the start.
    """
    control_s = [time_ns / 1e9 for time_ns, _ in recording.messages_by_topic["/control"]]
    begins_s = [
        time_ns / 1e9
        for time_ns, event in recording.messages_by_topic["/events"]
        if (event.name, event.detail) == ("phase", "trial")
    ]
    if not control_s or (begins_s + control_s)[0] >= control_s[-1]:
        return None
    return (begins_s + control_s)[0], control_s[-1]


def _overlap_s(span: tuple[float, float], begin_s: float, end_s: float) -> float:
    return max(0.0, min(span[1], end_s) - max(span[0], begin_s))
