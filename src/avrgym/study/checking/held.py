"""How much of a trial its person was held, because tracking was lost, late, or not to be believed."""

from avrgym.recording.files import Recording
from avrgym.study.design.design import Design
from avrgym.vr.tracking.frames import STALE_S


def held_share(recording: Recording) -> float | None:
    """The share, 0 to 1, of the time in which the robot helped that the person was held; ``None`` where it never did.

    Each frame stands for the time until the next one: it was followed, until it was stale, unless it was held as a
    whole or in part.
    """
    span = _driven_span_s(recording)
    if span is None:
        return None
    frames = [(time_ns / 1e9, frame) for time_ns, frame in recording.topics["/tracking"]]
    ends_s = [time_s for time_s, _ in frames[1:]] + [span[1]]
    followed_s = sum(
        _overlap_s(span, time_s, min(end_s, time_s + STALE_S))
        for (time_s, frame), end_s in zip(frames, ends_s, strict=False)
        if not (frame.held or frame.held_parts)
    )
    return min(max(1.0 - followed_s / (span[1] - span[0]), 0.0), 1.0)


def too_much_held(share: float | None, design: Design) -> str | None:
    """Why a trial whose person was held for such a share does not count; ``None`` if it does."""
    if share is None or share <= design.max_held_share:
        return None
    return (
        f"its person was held for {100 * share:.1f} % of the time in which the robot helped; "
        f"max_held_share allows {100 * design.max_held_share:g} %"
    )


def _driven_span_s(recording: Recording) -> tuple[float, float] | None:
    """From when to when the robot helped; without the event that it began, from its first control step on."""
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
