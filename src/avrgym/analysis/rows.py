"""The rows of the analysis' tables. Every row says whether it is about simulated participants.

Columns carry their units; what is not known is ``None`` and an empty cell. Positions are in the world's frame, z up,
the person facing −y.
"""

from dataclasses import dataclass


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
class Outcome:
    """A condition's counted trials; intervals are 95 % intervals.

    The row of the task ``all`` has no reward: rewards of different tasks cannot be compared.
    """

    simulated: bool
    task: str
    robot: str
    policy: str
    trials: int
    reward_mean: float | None
    reward_low: float | None
    reward_high: float | None
    successes: int
    success_rate: float | None
    success_low: float | None
    success_high: float | None


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """What a policy's file says of its own evaluation; ``simulation_note`` why there is nothing, or what to mind."""

    simulation_people: str | None = None
    simulation_episodes: int | None = None
    simulation_reward_mean: float | None = None
    simulation_reward_low: float | None = None
    simulation_reward_high: float | None = None
    simulation_success_rate: float | None = None
    simulation_success_low: float | None = None
    simulation_success_high: float | None = None
    simulation_note: str = ""


@dataclass(frozen=True, kw_only=True)
class ObjectiveRow(Simulated, Outcome):
    """A condition's counted trials, then the same policy in simulation."""


@dataclass(frozen=True, kw_only=True)
class SubjectiveRow:
    """Counted answers to one item with one policy; ``all`` tasks or robots are taken together."""

    simulated: bool
    item: str
    policy: str
    task: str
    robot: str
    n: int
    mean: float
    least: int
    lower_quartile: float
    median: float
    upper_quartile: float
    most: int


@dataclass(frozen=True, kw_only=True)
class SessionAnswerRow:
    """Counted answers to one item before or after sessions, one for each participant; or their ``change``.

    The change is that of the participants who answered both times, after less before.
    """

    simulated: bool
    questionnaire: str
    item: str
    moment: str
    n: int
    mean: float
    least: int
    lower_quartile: float
    median: float
    upper_quartile: float
    most: int


@dataclass(frozen=True, kw_only=True)
class LikertRow:
    """How often a value was answered to an item: with a policy, over all tasks and robots, or about sessions."""

    simulated: bool
    questionnaire: str
    moment: str
    item: str
    policy: str | None
    value: int
    count: int
    share: float


@dataclass(frozen=True, kw_only=True)
class TestedRow:
    """A test of ``group_a`` against ``group_b``.

    Tests of one ``family`` are corrected together. ``unit`` is what one value stands for. ``n_a`` and ``n_b``
    values were given, ``n`` went into the test, ``zeros`` differences of zero were left out. ``role`` is what the
    test is for its question; ``p_primary`` of primary results is p corrected over all of them, ``mark`` stars it.
    See ``statistics.Comparison`` for the others. ``planned`` says what the study's frozen plan has a test
    as: ``confirmatory``, ``exploratory`` or ``not in the plan``; nothing where no plan was frozen.
    """

    simulated: bool
    family: str
    quantity: str
    unit: str
    group_a: str
    group_b: str
    test: str
    n_a: int
    n_b: int
    n: int
    zeros: int
    median_a: float | None
    median_b: float | None
    statistic: float | None
    method: str
    p: float | None
    p_holm: float | None
    p_primary: float | None = None
    mark: str = ""
    effect: float | None
    effect_low: float | None
    effect_high: float | None
    note: str
    role: str = ""
    planned: str = ""


@dataclass(frozen=True, kw_only=True)
class BiomechanicsRow:
    """How a measure is distributed: among participants, one value for each, or among people of the training."""

    simulated: bool
    quantity: str
    posture: str
    people: str
    n: int
    mean: float
    deviation: float | None
    least: float
    lower_quartile: float
    median: float
    upper_quartile: float
    most: float


@dataclass(frozen=True, kw_only=True)
class RangeRow:
    """What range would have covered the participants, and what share of them each distribution's range covers."""

    simulated: bool
    quantity: str
    n: int
    least: float
    most: float
    original_low: float
    original_high: float
    original_covers: float
    revised_low: float
    revised_high: float
    revised_covers: float


@dataclass(frozen=True, kw_only=True)
class PersonRow:
    """Someone drawn from a distribution that policies trained with; ``number`` counts within a task."""

    simulated: bool
    people: str
    task: str
    posture: str
    number: int
    sex: str
    torso_height_m: float
    waist_x_deg: float
    waist_y_deg: float
    waist_z_deg: float
    head_x_m: float
    head_y_m: float
    head_z_m: float
