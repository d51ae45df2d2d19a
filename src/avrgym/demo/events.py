"""The events of a trial for people: what happened again and again stands in one line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from avrgym.recording.schema import Event

ENDS: Mapping[str, str] = {"tracking_lost": "tracking_found", "pose_held": "pose_followed"}
"""What lasts, and the event that ends it."""


@dataclass(frozen=True)
class Happened:
    """Something that happened so many ``times``, first at a time; ``lasted_s`` in all, where it lasts."""

    at_s: float
    name: str
    detail: str
    times: int = 0
    lasted_s: float | None = None


def folded(events: Sequence[tuple[int, Event]], until_s: float) -> list[Happened]:
    """Events with their times in nanoseconds, each kind once, in the order of their beginnings.

    What nothing has ended lasts ``until_s``.
    """
    found: dict[tuple[str, str], Happened] = {}
    for index, (time_ns, event) in enumerate(events):
        if event.name in ENDS.values():
            continue
        key, at_s = (event.name, event.detail), time_ns / 1e9
        before = found.get(key, Happened(at_s, *key))
        found[key] = replace(before, times=before.times + 1)
        if event.name in ENDS:
            lasted_s = _end_s(events[index + 1 :], event, until_s) - at_s
            found[key] = replace(found[key], lasted_s=(before.lasted_s or 0.0) + lasted_s)
    return list(found.values())


def _end_s(later: Sequence[tuple[int, Event]], event: Event, until_s: float) -> float:
    """When an event ended; those of parts of the body have them for their details."""
    ends_ns = (
        time_ns for time_ns, end in later if end.name == ENDS[event.name] and end.detail in ("", event.detail)
    )
    return next(ends_ns, round(1e9 * until_s)) / 1e9
