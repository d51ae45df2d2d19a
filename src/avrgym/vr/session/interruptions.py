"""Interruptions of an attempt: the participant cannot act, or the process was suspended."""

from collections.abc import Mapping
from dataclasses import dataclass

from avrgym.models.body_names import TRACKED_BODY_PART_LABELS, TrackedBodyPart
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.protocol.messages import Visibility
from avrgym.vr.session import events

UNTRACKED_TIMEOUT_S = 1.0
"""Time in seconds without a measured pose after which a part of the body is considered untracked."""
INVISIBILITY_REASONS: dict[Visibility, str] = {
    "visible-blurred": "a menu of the headset covers the scene",
    "hidden": "the headset was taken off, or the page is in the background",
    "context-lost": "the graphics of the participant's device failed",
}
UNTRACKED_TEXT_KEYS: Mapping[TrackedBodyPart, str] = {
    "head": "untracked",
    "left": "left_untracked",
    "right": "right_untracked",
}
"""Keys of the texts about an untracked part of the body, before a trial."""
TRACKING_TIMEOUT_TEXT_KEYS: Mapping[TrackedBodyPart, str] = {
    "head": "tracking_timed_out",
    "left": "left_timed_out",
    "right": "right_timed_out",
}
"""Keys of the texts about an untracked part of the body, after it has interrupted an attempt."""


@dataclass(frozen=True)
class Interruption:
    """An interruption of an attempt. The recording contains ``event_name`` and ``reason``.

    ``event``: the event for the observer. ``participant_text``: the text for the participant.
    """

    event_name: str
    reason: str
    event: events.SessionEvent
    participant_text: ParticipantText


def make_tracking_interruption(now_s: float, part: TrackedBodyPart) -> Interruption:
    """Returns the interruption of an attempt because a part of the body was untracked for ``UNTRACKED_TIMEOUT_S``."""
    seconds = f"{UNTRACKED_TIMEOUT_S:g}"
    message = ParticipantText(TRACKING_TIMEOUT_TEXT_KEYS[part], {"seconds": seconds})
    why = f"tracking was lost for {seconds} s: {TRACKED_BODY_PART_LABELS[part]}"
    return Interruption("tracking_timed_out", why, events.TrackingTimedOut(now_s, part), message)


def make_visibility_interruption(now_s: float, visibility: Visibility) -> Interruption:
    """Returns the interruption of an attempt because the participant no longer sees the scene."""
    why = f"the participant does not see the scene: {INVISIBILITY_REASONS[visibility]}"
    return Interruption(
        "visibility_lost", why, events.VisibilityLost(now_s, visibility), ParticipantText("visibility_lost")
    )


def make_suspension_interruption(now_s: float, seconds: float) -> Interruption:
    """Returns the interruption of an attempt by a suspended process or computer. ``seconds``: its duration."""
    why = f"the computer was suspended for {seconds:.1f} s"
    message = ParticipantText("time_lost", {"seconds": f"{seconds:.1f}"})
    return Interruption("time_lost", why, events.TimeLost(now_s, seconds), message)
