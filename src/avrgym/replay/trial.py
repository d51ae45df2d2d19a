"""What a recording says about itself: which trial it is of, its phases, and how it ended."""

from dataclasses import dataclass

from avrgym.recording.reader import Recording


class ReplayError(ValueError):
    """A recording that cannot be replayed; the message says what it lacks or what has changed."""


@dataclass(frozen=True)
class Trial:
    """Which attempt at which trial it was, in a session of what name.

    ``result`` is how it ended, ``None`` for a recording that breaks off; ``seconds`` how long what is there lasts,
    ``shown_s`` how long until the questionnaire, in which nothing moves but the participant.
    """

    session: str
    environment: str
    policy: str
    number: int
    attempt: int
    practice: bool
    simulated: bool
    sex: str
    torso_height_m: float
    result: str | None
    seconds: float
    shown_s: float

    @property
    def title(self) -> str:
        """The trial in words; whoever is simulated is said to be."""
        kind = "practice" if self.practice else f"trial {self.number}"
        who = "simulated participant" if self.simulated else "participant"
        scene = self.environment.removeprefix("avrgym/")
        return f"{scene}, {self.policy}, {kind}, attempt {self.attempt}: {who}"


def trial_of(recording: Recording) -> Trial:
    """Which trial a recording is of.

    Raises:
        ReplayError: for a recording that does not say so.
    """
    metadata, outcome = recording.metadata, recording.outcome
    seconds = max((time_ns for _, time_ns, _ in recording.messages), default=0) / 1e9
    try:
        return Trial(
            session=metadata["session"],
            environment=metadata["environment"],
            policy=metadata["policy"],
            number=metadata["trial"],
            attempt=metadata["attempt"],
            practice=metadata["practice"],
            simulated=metadata["simulated"],
            sex=metadata["person"]["sex"],
            torso_height_m=metadata["person"]["torso_height_m"],
            result=None if outcome is None else outcome["result"],
            seconds=seconds,
            shown_s=next((time_s for time_s, name in phases(recording) if name == "questionnaire"), seconds),
        )
    except KeyError as error:
        raise ReplayError(f"its configuration lacks {error}") from error


def phases(recording: Recording) -> list[tuple[float, str]]:
    """When each phase began, s, and its name."""
    events = recording.topics["/events"]
    return [(time_ns / 1e9, event.detail) for time_ns, event in events if event.name == "phase"]


def driven_span_s(recording: Recording) -> tuple[float, float]:
    """From when to when the robot helped; where it never did, the whole of what is there."""
    began = [time_s for time_s, name in phases(recording) if name == "trial"]
    control = recording.topics["/control"]
    if not began or not control:
        return 0.0, trial_of(recording).shown_s
    return began[0], control[-1][0] / 1e9
