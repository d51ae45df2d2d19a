"""The participant's time in VR: breaks by rule and by request, and the maximum time of a session."""

from typing import Annotated

import msgspec

LIMIT_WARNING_TIME_S = 300.0
"""Time before the limit, in seconds, at which the experimenter receives a warning."""

Minutes = Annotated[float, msgspec.Meta(ge=0, le=480)]


class SessionRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rules for the participant's time in VR. A value of 0 disables a rule.

    ``break_every_minutes``: time in VR after which a break follows the current trial. ``max_headset_minutes``: time in
    VR after which no further trial begins in this session.
    """

    break_every_minutes: Minutes = 0.0
    max_headset_minutes: Minutes = 0.0


NO_SESSION_RULES = SessionRules()


class HeadsetTime:
    """Counts the time in VR of one session.

    ``total_s``: time in VR. ``is_break_due``: a break follows before the next trial. ``are_break_questions_due``: the
    questions after the break were not answered yet.
    """

    def __init__(self, rules: SessionRules = NO_SESSION_RULES, earlier_s: float = 0.0) -> None:
        """``earlier_s``: time in VR of interrupted sessions that this session continues."""
        self.rules = rules
        self.total_s = earlier_s
        self.are_break_questions_due = False
        self._requested = False
        self._since_break_s = earlier_s
        self._stored_s = earlier_s
        self._warned = False

    @property
    def is_limit_reached(self) -> bool:
        """Whether the maximum time in VR is reached."""
        limit_s = self.limit_s
        return limit_s is not None and self.total_s >= limit_s

    @property
    def limit_s(self) -> float | None:
        """Maximum time in VR in seconds; ``None`` without a limit."""
        return 60.0 * self.rules.max_headset_minutes or None

    @property
    def is_break_due(self) -> bool:
        """Whether a break is due, by rule or by request."""
        every_s = 60.0 * self.rules.break_every_minutes
        return self._requested or (every_s > 0.0 and self._since_break_s >= every_s)

    def add_time(self, seconds: float) -> None:
        """Add ``seconds`` to the time in VR."""
        self.total_s += seconds
        self._since_break_s += seconds

    def request_break(self) -> None:
        """Request a break before the next trial."""
        self._requested = True

    def begin_break(self) -> None:
        """Begin a break. Questions about the break follow after its end."""
        self._requested, self.are_break_questions_due = False, True
        self._since_break_s = 0.0

    def end_break(self) -> None:
        """End a break. The time in VR until the next break is then counted from 0."""
        self._since_break_s = 0.0

    def pop_warning(self) -> str:
        """Returns a warning once, when the maximum time is nearly reached; otherwise an empty text."""
        limit_s = self.limit_s
        if self._warned or limit_s is None or self.total_s < limit_s - LIMIT_WARNING_TIME_S:
            return ""
        self._warned = True
        return (
            f"{max(limit_s - self.total_s, 0.0) / 60.0:.0f} min of {limit_s / 60.0:g} min in the headset are left; "
            "after that, no further trial begins"
        )

    def pop_unstored_time_s(self) -> float:
        """Returns the time in VR since the previous call, in seconds."""
        unstored_s, self._stored_s = self.total_s - self._stored_s, self.total_s
        return unstored_s
