"""Table rows with the data of a study: participants, trials, attempts, answers, scores, and others.

Column names contain the unit. Head positions are in the world frame: z points up, the person faces −y. The column
``counted`` is true for the trials, answers and scores in the analysis ("analysed" in this package).
"""

from dataclasses import dataclass, replace
from typing import Annotated

from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    IsPractice,
    IsSimulated,
    PolicyName,
    Pseudonym,
    QuestionMoment,
    RobotName,
    SessionNumber,
    SiteName,
    TaskName,
    TrialPosition,
)
from avrgym.recording.streams import StreamQuality
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.table_rows import AttemptNumber
from avrgym.system.columns import Column

ALL_LABEL = "all"
"""Label in the columns ``task`` and ``robot``: all tasks together, or all robots together."""
NOT_COMPLETED_TEXT = "the trial is not completed"
NO_RECORDING_TEXT = "no complete recording contains it"
_PARTICIPANTS, _TRIALS, _ATTEMPTS = (
    COLUMNS_BY_TABLE["participants"],
    COLUMNS_BY_TABLE["trials"],
    COLUMNS_BY_TABLE["attempts"],
)
_ANSWERS, _SCORES = COLUMNS_BY_TABLE["answers"], COLUMNS_BY_TABLE["scores"]
ParticipantState = Annotated[str, _PARTICIPANTS["state"]]
Sex = Annotated[str, _PARTICIPANTS["sex"]]
AttemptCount = Annotated[int, Column("Number of attempts.", allowed=AT_LEAST_0_TEXT)]
IncompleteAttemptCount = Annotated[
    int, Column("Number of attempts that did not complete their trial.", allowed=AT_LEAST_0_TEXT)
]
IsAnalysed = Annotated[bool, Column("Whether the analyses include it.")]
TorsoHeight = Annotated[
    float | None,
    Column(
        "Calibrated torso height, from hip bone to centre of the head.", unit="m", empty=NO_RECORDING_TEXT
    ),
]
MinTargetDistance = Annotated[
    float | None, Column("Smallest distance to the target.", "", "m", AT_LEAST_0_TEXT, NO_RECORDING_TEXT)
]
MeanForce = Annotated[
    float | None,
    Column("Mean force of robot and tool on the person.", "", "N", AT_LEAST_0_TEXT, NO_RECORDING_TEXT),
]
PeakForce = Annotated[
    float | None,
    Column("Largest force of robot and tool on the person.", "", "N", AT_LEAST_0_TEXT, NO_RECORDING_TEXT),
]
MeanHeadCoordinate = Annotated[
    float | None,
    Column(
        "Head centre on this axis of the world frame: mean over the trial.", unit="m", empty=NO_RECORDING_TEXT
    ),
]
MeanWaistAngle = Annotated[
    float | None,
    Column("Waist angle about this axis: mean over the trial.", unit="°", empty=NO_RECORDING_TEXT),
]
MinWaistAngle = Annotated[
    float | None,
    Column("Waist angle about this axis: minimum in the trial.", unit="°", empty=NO_RECORDING_TEXT),
]
MaxWaistAngle = Annotated[
    float | None,
    Column("Waist angle about this axis: maximum in the trial.", unit="°", empty=NO_RECORDING_TEXT),
]


@dataclass(frozen=True, kw_only=True)
class ParticipantColumns:
    """The first columns of each row about a participant."""

    participant: Pseudonym
    site: SiteName = None
    simulated: IsSimulated


@dataclass(frozen=True, kw_only=True)
class ParticipantRow(ParticipantColumns):
    """State, body and progress of one participant. Withdrawn participants also have a row."""

    site_participant: Annotated[str | None, _PARTICIPANTS["site_participant"]] = None
    state: ParticipantState
    sex: Sex
    age_years: Annotated[int | None, _PARTICIPANTS["age_years"]]
    language: Annotated[str, _PARTICIPANTS["language"]]
    torso_height_m: Annotated[
        float | None,
        Column(
            "Calibrated torso height, from hip bone to centre of the head: median over analysed trials.",
            unit="m",
            empty=NO_RECORDING_TEXT,
        ),
    ]
    sessions: Annotated[int, Column("Number of sessions.", allowed=AT_LEAST_0_TEXT)]
    trials: Annotated[int, Column("Number of planned trials.", allowed=AT_LEAST_0_TEXT)]
    trials_completed: Annotated[int, Column("Number of completed trials.", allowed=AT_LEAST_0_TEXT)]
    trials_missing: Annotated[
        int, Column("Number of planned trials that were not completed.", allowed=AT_LEAST_0_TEXT)
    ]
    attempts: AttemptCount
    attempts_not_completed: IncompleteAttemptCount


@dataclass(frozen=True, kw_only=True)
class TrialRow(ParticipantColumns):
    """A planned trial, with the outcome of its completed attempt. Trials that were not run also have a row."""

    participant_state: ParticipantState
    sex: Sex
    position: TrialPosition
    practice: IsPractice
    task: TaskName
    robot: RobotName
    policy: PolicyName
    seed: Annotated[int, _TRIALS["seed"]]
    state: Annotated[str, _TRIALS["state"]]
    attempts: AttemptCount
    attempts_not_completed: IncompleteAttemptCount
    counted: IsAnalysed
    left_out: Annotated[
        str | None,
        Column(
            "Reason why a completed trial is not in the analyses.",
            empty="the trial is in the analyses, or is not completed",
        ),
    ] = None
    tracking_loss_share: Annotated[
        float | None,
        Column(
            "Share of the robot's time with lost or jumped tracking, in which the body model does not move.",
            allowed=FRACTION_RANGE_TEXT,
            empty=NO_RECORDING_TEXT,
        ),
    ] = None
    steps: Annotated[int | None, replace(_ATTEMPTS["steps"], empty=NOT_COMPLETED_TEXT)] = None
    reward: Annotated[float | None, replace(_ATTEMPTS["reward"], empty=NOT_COMPLETED_TEXT)] = None
    success: Annotated[bool | None, replace(_ATTEMPTS["success"], empty=NOT_COMPLETED_TEXT)] = None
    seconds: Annotated[float | None, replace(_ATTEMPTS["seconds"], empty=NOT_COMPLETED_TEXT)] = None
    recording: Annotated[str | None, replace(_ATTEMPTS["recording"], empty=NOT_COMPLETED_TEXT)] = None
    recorded: Annotated[
        str | None,
        Column(
            "State of the recording.",
            allowed="whole, changed, cut off, missing, unreadable, without a body, contradictory",
            empty=NOT_COMPLETED_TEXT,
        ),
    ] = None
    reward_recorded: Annotated[
        float | None, Column("Sum of the rewards in the recording.", empty=NO_RECORDING_TEXT)
    ] = None
    distance_min_m: MinTargetDistance = None
    force_mean_n: MeanForce = None
    force_peak_n: PeakForce = None
    guard_interventions: Annotated[
        int | None,
        Column(
            "Number of interventions of the force guard.",
            "",
            "",
            AT_LEAST_0_TEXT,
            "no force guard, or no recording",
        ),
    ] = None
    torso_height_m: TorsoHeight = None
    head_x_m: MeanHeadCoordinate = None
    head_y_m: MeanHeadCoordinate = None
    head_z_m: MeanHeadCoordinate = None
    waist_x_deg: MeanWaistAngle = None
    waist_x_min_deg: MinWaistAngle = None
    waist_x_max_deg: MaxWaistAngle = None
    waist_y_deg: MeanWaistAngle = None
    waist_y_min_deg: MinWaistAngle = None
    waist_y_max_deg: MaxWaistAngle = None
    waist_z_deg: MeanWaistAngle = None
    waist_z_min_deg: MinWaistAngle = None
    waist_z_max_deg: MaxWaistAngle = None


@dataclass(frozen=True, kw_only=True)
class AttemptRow(ParticipantColumns):
    """An attempt to run a trial, with its outcome from the database."""

    session: SessionNumber
    position: TrialPosition
    practice: IsPractice
    task: TaskName
    robot: RobotName
    policy: PolicyName
    attempt: AttemptNumber
    state: Annotated[str, _ATTEMPTS["state"]]
    steps: Annotated[int | None, _ATTEMPTS["steps"]]
    reward: Annotated[float | None, _ATTEMPTS["reward"]]
    success: Annotated[bool | None, _ATTEMPTS["success"]]
    seconds: Annotated[float | None, _ATTEMPTS["seconds"]]
    recording: Annotated[str, _ATTEMPTS["recording"]]


@dataclass(frozen=True, kw_only=True)
class _AnswerColumns(ParticipantColumns):
    """Columns of an answer or score: its session, moment, questionnaire and trial."""

    counted: IsAnalysed
    session: SessionNumber
    moment: QuestionMoment
    respondent: Annotated[str, _ANSWERS["respondent"]]
    questionnaire: Annotated[
        str | None, replace(_ANSWERS["questionnaire"], empty="the design has no such item")
    ]
    position: Annotated[int | None, _ANSWERS["position"]]
    task: Annotated[str | None, _ANSWERS["task"]]
    robot: Annotated[str | None, _ANSWERS["robot"]]
    policy: Annotated[str | None, _ANSWERS["policy"]]
    attempt: Annotated[int | None, _ANSWERS["attempt"]]


@dataclass(frozen=True, kw_only=True)
class AnswerRow(_AnswerColumns):
    """An answer to one item.

    An answer after a trial is analysed if the trial is analysed. Two answers about sessions are analysed for each
    participant and item: the latest answer after a session, and the latest answer before that session.
    """

    item: Annotated[str, _ANSWERS["item"]]
    value: Annotated[int, _ANSWERS["value"]]
    minimum: Annotated[int | None, replace(_ANSWERS["minimum"], empty="the design has no such item")]
    maximum: Annotated[int | None, replace(_ANSWERS["maximum"], empty="the design has no such item")]
    points: Annotated[int | None, replace(_ANSWERS["points"], empty="the design has no such item")]
    response_time_s: Annotated[float, _ANSWERS["response_time_s"]]


@dataclass(frozen=True, kw_only=True)
class ScoreRow(_AnswerColumns):
    """The score of one scale of a validated questionnaire, from the answers of one participant at one moment.

    A score is analysed if all its answers are analysed.
    """

    instrument: Annotated[str, _SCORES["instrument"]]
    scale: Annotated[str, _SCORES["scale"]]
    score: Annotated[float | None, _SCORES["score"]]
    minimum: Annotated[float, _SCORES["minimum"]]
    maximum: Annotated[float, _SCORES["maximum"]]
    answered: Annotated[int, _SCORES["answered"]]
    items: Annotated[int, _SCORES["items"]]


@dataclass(frozen=True, kw_only=True)
class RewardTermRow(ParticipantColumns):
    """Sum of one reward term over the control steps of a trial."""

    position: TrialPosition
    term: Annotated[str, Column("Name of the reward term.")]
    sum: Annotated[float, Column("Sum over the trial, not weighted.")]
    weight: Annotated[float | None, Column("Weight of the term.", empty="not recorded")]
    weighted_sum: Annotated[float | None, Column("Sum times weight.", empty="not recorded")]


@dataclass(frozen=True, kw_only=True)
class DataProblemRow:
    """A problem in the data of a study, and its consequence for the analysis."""

    simulated: Annotated[
        bool | None, replace(_ATTEMPTS["simulated"], empty="the problem concerns the whole study")
    ]
    where: Annotated[str, Column("Recording, participant or file with the problem.")]
    what: Annotated[str, Column("The problem.")]
    consequence: Annotated[str, Column("Its consequence for the analysis.")]


@dataclass(frozen=True, kw_only=True)
class StreamRow(StreamQuality):
    """Quality of the sample times of one stream, in the recording of one completed trial."""

    participant: Pseudonym
    site: SiteName = None
    simulated: IsSimulated
    position: TrialPosition
