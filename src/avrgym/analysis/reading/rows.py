"""The rows of the analysis' tables. Every row says whether it is about simulated participants.

Columns carry their units; what is not known is ``None`` and an empty cell. Positions are in the world's frame, z up,
the person facing −y.
"""

from dataclasses import dataclass

from avrgym.recording.streams import StreamFigures


@dataclass(frozen=True, kw_only=True)
class ParticipantRow:
    """Someone who takes or took part; ``torso_height_m`` is the median over the counted trials' calibrations.

    ``site`` is where; ``site_participant`` the pseudonym there, in a study that was merged from sites.
    """

    participant: str
    site: str | None = None
    site_participant: str | None = None
    simulated: bool
    state: str
    sex: str
    age_years: int | None
    language: str
    torso_height_m: float | None
    sessions: int
    trials: int
    trials_completed: int
    trials_missing: int
    attempts: int
    attempts_broken_off: int


@dataclass(frozen=True, kw_only=True)
class TrialRow:
    """A planned trial, run or not.

    ``counted``: it enters the analyses; ``left_out`` is why it does not, where its person was held for too large a
    share, ``held_share``, of the time in which the robot helped. ``recorded`` says how the completed attempt's
    recording is: ``whole``, ``changed``, ``cut off``, ``missing``, ``unreadable``, ``without a body`` or
    ``contradictory``.
    ``reward``, ``success`` and ``seconds`` are those stored when the trial was completed, ``reward_recorded`` is
    summed from the recording. Distance and force are over the control steps; head and waist are means over them,
    waists with their ends. ``guard_interventions`` is how often the force guard acted, ``None`` without one.
    """

    participant: str
    site: str | None = None
    simulated: bool
    participant_state: str
    sex: str
    position: int
    practice: bool
    task: str
    robot: str
    policy: str
    seed: int
    state: str
    attempts: int
    attempts_broken_off: int
    counted: bool
    left_out: str | None = None
    held_share: float | None = None
    steps: int | None = None
    reward: float | None = None
    success: bool | None = None
    seconds: float | None = None
    recording: str | None = None
    recorded: str | None = None
    reward_recorded: float | None = None
    distance_least_m: float | None = None
    force_mean_n: float | None = None
    force_peak_n: float | None = None
    guard_interventions: int | None = None
    torso_height_m: float | None = None
    head_x_m: float | None = None
    head_y_m: float | None = None
    head_z_m: float | None = None
    waist_x_deg: float | None = None
    waist_x_least_deg: float | None = None
    waist_x_most_deg: float | None = None
    waist_y_deg: float | None = None
    waist_y_least_deg: float | None = None
    waist_y_most_deg: float | None = None
    waist_z_deg: float | None = None
    waist_z_least_deg: float | None = None
    waist_z_most_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class AttemptRow:
    """An attempt at a trial, with the metrics that were stored at its end."""

    participant: str
    site: str | None = None
    simulated: bool
    session: int
    position: int
    practice: bool
    task: str
    robot: str
    policy: str
    attempt: int
    state: str
    steps: int | None
    reward: float | None
    success: bool | None
    seconds: float | None
    recording: str


@dataclass(frozen=True, kw_only=True)
class AnswerRow:
    """An answer; one about a whole session has no trial. ``moment`` is when it was asked.

    ``value`` is on the item's own scale from ``least`` to ``most``, which has ``points`` values.

    ``counted`` as for its trial, for completed attempts; about sessions for the answers that are compared, one for each
    participant, item and moment: the latest after a session, and the latest before that.
    """

    participant: str
    site: str | None = None
    simulated: bool
    counted: bool
    session: int
    moment: str
    questionnaire: str | None
    position: int | None
    task: str | None
    robot: str | None
    policy: str | None
    attempt: int | None
    item: str
    value: int
    least: int | None
    most: int | None
    points: int | None
    response_time_s: float


@dataclass(frozen=True, kw_only=True)
class TermRow:
    """What a reward term added up to in a trial; ``weighted_sum`` is its part of the reward."""

    participant: str
    site: str | None = None
    simulated: bool
    position: int
    term: str
    sum: float
    weight: float | None
    weighted_sum: float | None


@dataclass(frozen=True, kw_only=True)
class ProblemRow:
    """Something that is not as it should be, and what the analysis makes of it."""

    simulated: bool | None
    where: str
    what: str
    consequence: str


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A scale of an instrument, from the answers of one participant at one time, between ``least`` and ``most``.

    One about a whole session has no trial. ``score`` is missing where answers or weights are that it needs. ``counted``
    as for the answers that it comes from.
    """

    participant: str
    site: str | None = None
    simulated: bool
    counted: bool
    session: int
    moment: str
    position: int | None
    task: str | None
    robot: str | None
    policy: str | None
    attempt: int | None
    questionnaire: str
    instrument: str
    scale: str
    score: float | None
    least: float
    most: float
    answered: int
    items: int


@dataclass(frozen=True, kw_only=True)
class StreamRow(StreamFigures):
    """How well the samples of a stream lie in time in the recording of one completed trial."""

    participant: str
    site: str | None = None
    simulated: bool
    position: int


ALL = "all"
"""Stands for all tasks or all robots, taken together."""
