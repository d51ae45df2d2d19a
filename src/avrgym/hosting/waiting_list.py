"""Waiting list of participants for a free session, and their estimated waiting time."""

import heapq
from collections.abc import Sequence

PRESENCE_TIMEOUT_S = 30.0
"""Time in seconds after which participants without a request are removed. Pages send a request every few seconds."""


class WaitingList:
    """Waiting participants in order of arrival."""

    def __init__(self) -> None:
        self._seen_s: dict[str, float] = {}
        self._restored: set[str] = set()

    def restore(self, pseudonyms: Sequence[str], now_s: float) -> None:
        """Add the waiting participants from before a restart. They can start only after a request of their page."""
        self._seen_s = {**dict.fromkeys(pseudonyms, now_s), **self._seen_s}
        self._restored.update(pseudonyms)

    @property
    def pseudonyms(self) -> tuple[str, ...]:
        """The waiting participants in order of arrival."""
        return tuple(self._seen_s)

    def __len__(self) -> int:
        return len(self._seen_s)

    def __contains__(self, pseudonym: str) -> bool:
        return pseudonym in self._seen_s

    def join(self, pseudonym: str, now_s: float) -> None:
        """Add a participant at the end, or confirm that a waiting participant is present."""
        self._seen_s[pseudonym] = now_s
        self._restored.discard(pseudonym)

    def leave(self, pseudonym: str) -> None:
        """Remove a participant. Participants that do not wait are ignored."""
        self._seen_s.pop(pseudonym, None)

    def count_participants_ahead(self, pseudonym: str) -> int:
        """Returns the number of participants before this participant."""
        return list(self._seen_s).index(pseudonym)

    def remove_absent(self, now_s: float) -> None:
        """Remove participants without a request in the last ``PRESENCE_TIMEOUT_S``."""
        self._seen_s = {
            each: seen_s for each, seen_s in self._seen_s.items() if now_s - seen_s < PRESENCE_TIMEOUT_S
        }

    def find_next_present(self) -> str | None:
        """Returns the first waiting participant that is present; ``None`` if there is none."""
        return next((each for each in self._seen_s if each not in self._restored), None)


def estimate_wait_s(position: int, remaining_s: Sequence[float], session_s: float, sessions: int) -> float:
    """Returns the estimated time until a participant's session starts, in seconds.

    When a session ends, the session of the next waiting participant starts.

    Args:
        position: number of participants before this participant.
        remaining_s: estimated remaining time of each running session.
        session_s: estimated duration of a session.
        sessions: number of sessions that can run concurrently.
    """
    ends_s = [0.0] * max(sessions - len(remaining_s), 0) + [max(each, 0.0) for each in remaining_s]
    heapq.heapify(ends_s)
    for _ in range(max(len(remaining_s) - sessions, 0)):  # more sessions run than can start now
        heapq.heappop(ends_s)
    for _ in range(position):
        heapq.heapreplace(ends_s, ends_s[0] + session_s)
    return ends_s[0]
