"""Rows of the exported tables. The annotation of each field describes its column."""

from dataclasses import dataclass
from typing import Annotated

from avrgym.commands.input_methods import INPUT_METHODS
from avrgym.commands.respondents import CONSENT_ROLES, RESPONDENTS
from avrgym.models.human import SEXES
from avrgym.questionnaires.questionnaire import ITEM_ORDERS, QUESTION_MOMENTS
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.robots.registry import ROBOTS
from avrgym.study.design.functioning import DIFFICULTY_LEVELS
from avrgym.study.people.adverse_events import (
    ADVERSE_EVENT_OUTCOMES,
    ADVERSE_EVENT_SEVERITIES,
    RELATEDNESS_GRADES,
    SERIOUSNESS_CRITERIA,
)
from avrgym.study.storage.audit_log import IDENTIFICATION_METHODS
from avrgym.study.storage.state_transitions import (
    ATTEMPT_TRANSITIONS,
    PARTICIPANT_TRANSITIONS,
    TRIAL_TRANSITIONS,
)
from avrgym.system.columns import TIME, Column
from avrgym.tasks.registry import TASKS

_FROM_0, _FROM_1 = "0 and above", "1 and above"
_SESSION_ANSWER = "the answer is about a whole session"
_NO_TRIAL = "outside trials"
_NO_SESSION = "not about a session"
_WHOLE_STUDY = "about the whole study"
_NO_METRICS = "the attempt did not end with metrics"
_NO_RESULTS = "no results were viewed"


def _one_of(*values: str) -> str:
    return ", ".join(values)


def _utc(meaning: str, empty: str = "") -> Column:
    return Column(meaning, TIME, "UTC", "ISO 8601", empty)


def _participant(empty: str = "") -> Column:
    return Column("Pseudonym of the participant.", allowed="sub-001, sub-002 and so on", empty=empty)


def _simulated(empty: str = "") -> Column:
    return Column("Whether the participant is simulated.", empty=empty)


def _session(empty: str = "") -> Column:
    return Column("Number of the participant's session.", allowed=_FROM_1, empty=empty)


def _position(empty: str = "") -> Column:
    return Column(
        "Position of the trial in the participant's order, practice trials included.",
        allowed=_FROM_1,
        empty=empty,
    )


def _practice(empty: str = "") -> Column:
    return Column("Whether it was a practice trial, which has no questionnaire.", empty=empty)


def _task(empty: str = "") -> Column:
    return Column("Task of the robot.", allowed=_one_of(*TASKS), empty=empty)


def _robot(empty: str = "") -> Column:
    return Column("Robot.", allowed=_one_of(*ROBOTS), empty=empty)


def _policy(empty: str = "") -> Column:
    return Column("Policy that controlled the robot.", allowed="the design's policies", empty=empty)


def _attempt(empty: str = "") -> Column:
    return Column("Number of the attempt at the trial.", allowed=_FROM_1, empty=empty)


Pseudonym = Annotated[str, _participant()]
SiteName = Annotated[
    str | None,
    Column("Name of the participant's site.", allowed="letters, digits, - and _", empty="no site was given"),
]
IsSimulated = Annotated[bool, _simulated()]
SessionNumber = Annotated[int, _session()]
TrialPosition = Annotated[int, _position()]
IsPractice = Annotated[bool, _practice()]
TaskName = Annotated[str, _task()]
RobotName = Annotated[str, _robot()]
PolicyName = Annotated[str, _policy()]
AttemptNumber = Annotated[int, _attempt()]
TotalReward = Annotated[float | None, Column("Sum of the rewards of all control steps.", empty=_NO_METRICS)]
QuestionMoment = Annotated[str, Column("Moment of the questionnaire.", allowed=_one_of(*QUESTION_MOMENTS))]
Respondent = Annotated[
    str,
    Column(
        "Person who answered: the participant, a proxy for the participant, or a caregiver. For a score: proxy if a "
        "proxy gave at least one of its answers.",
        allowed=_one_of(*RESPONDENTS),
    ),
]
QuestionnaireName = Annotated[str, Column("Name of the questionnaire.")]
InstrumentName = Annotated[str, Column("Name of the validated questionnaire.", allowed=_one_of(*INSTRUMENTS))]
LowestScore = Annotated[float, Column("Lowest possible score.")]
HighestScore = Annotated[float, Column("Highest possible score.")]


@dataclass(frozen=True)
class ParticipantRow:
    """Row of ``participants``: one participant, with state, body and trial order."""

    participant: Pseudonym
    site: SiteName
    site_participant: Annotated[
        str | None, Column("Pseudonym of the participant at the site.", empty="not merged from sites")
    ]
    simulated: IsSimulated
    state: Annotated[str, Column("State of the participation.", allowed=_one_of(*PARTICIPANT_TRANSITIONS))]
    sex: Annotated[str, Column("Sex of the body model.", allowed=_one_of(*SEXES))]
    age_years: Annotated[int | None, Column("Age at enrolment.", unit="year", empty="not given")]
    language: Annotated[str, Column("Language of the texts.", allowed="a language tag")]
    torso_height_m: Annotated[
        float | None,
        Column(
            "Torso height, hip bone to centre of the head, as calibrated: median over the exported completed trials.",
            unit="m",
            empty="no completed trial was exported",
        ),
    ]
    cell: Annotated[
        int | None, Column("Index of the participant's trial order.", allowed=_FROM_0, empty="not allocated")
    ]
    consent_version: Annotated[
        str | None, Column("Version of the consent text that the participant accepted.", empty="no consent")
    ]
    consented_at: Annotated[str | None, _utc("Time of the consent.", "no consent")]


@dataclass(frozen=True)
class ConsentRow:
    """Row of ``consents``: one decision of a participant about a consent text."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    decision: Annotated[int, Column("Number of the participant's decision.", allowed=_FROM_1)]
    role: Annotated[
        str,
        Column(
            "Role of the decision: consent of the participant, consent of a representative (proxy), or assent of the "
            "participant to a representative's consent.",
            allowed=_one_of(*CONSENT_ROLES),
        ),
    ]
    agreed: Annotated[bool, Column("Whether the person agreed.")]
    version: Annotated[
        str | None,
        Column("Version of the consent text.", empty="an earlier version of AVR Gym did not store it"),
    ]
    language: Annotated[
        str | None,
        Column(
            "Language of the consent text.", allowed="a language tag", empty="the design's first language"
        ),
    ]
    decided_at: Annotated[str, _utc("Time of the decision.")]
    sha256: Annotated[
        str | None,
        Column("Checksum of the consent text.", allowed="64 hexadecimal digits", empty="not stored"),
    ]
    text: Annotated[
        str | None, Column("File of the consent text in the export.", empty="the text is not stored")
    ]


@dataclass(frozen=True)
class TrialRow:
    """Row of ``trials``: one planned trial."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    position: TrialPosition
    practice: IsPractice
    environment: Annotated[
        str, Column("The Gymnasium environment of task and robot.", allowed="see avrgym envs")
    ]
    policy: PolicyName
    seed: Annotated[int, Column("Seed of the initial state and of exploration noise.", allowed=_FROM_0)]
    state: Annotated[str, Column("State of the trial.", allowed=_one_of(*TRIAL_TRANSITIONS))]
    attempts: Annotated[int, Column("Number of attempts.", allowed=_FROM_0)]
    recording: Annotated[
        str | None,
        Column("File of the recording in the study's folder.", empty="the trial is not completed"),
    ]


@dataclass(frozen=True)
class AttemptIdentifiers:
    """Columns that identify an attempt: participant, session, trial, condition and attempt number."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    session: SessionNumber
    position: TrialPosition
    practice: IsPractice
    task: TaskName
    robot: RobotName
    policy: PolicyName
    attempt: AttemptNumber


@dataclass(frozen=True)
class AttemptRow(AttemptIdentifiers):
    """Row of ``attempts``: one attempt at a trial."""

    state: Annotated[str, Column("State of the attempt.", allowed=_one_of(*ATTEMPT_TRANSITIONS))]
    started_at: Annotated[str, _utc("Start of the attempt.")]
    ended_at: Annotated[str | None, _utc("End of the attempt.", "the attempt is running")]
    steps: Annotated[
        int | None, Column("Number of control steps of 0.1 s.", allowed=_FROM_0, empty=_NO_METRICS)
    ]
    reward: TotalReward
    success: Annotated[bool | None, Column("Whether the robot has succeeded.", empty=_NO_METRICS)]
    seconds: Annotated[
        float | None, Column("Duration of the attempt.", unit="s", allowed=_FROM_0, empty=_NO_METRICS)
    ]
    torso_height_m: Annotated[
        float | None,
        Column("Torso height of the body model.", unit="m", empty="not completed, or recording omitted"),
    ]
    input_method: Annotated[
        str | None,
        Column(
            "Input method in the participant's input profile.",
            allowed=_one_of(*INPUT_METHODS),
            empty="recorded by AVR Gym 0.2",
        ),
    ]
    recording: Annotated[str, Column("File of the recording in the study's folder.")]
    sha256: Annotated[
        str | None,
        Column(
            "Checksum of the closed recording.", allowed="64 hexadecimal digits", empty="recording not closed"
        ),
    ]


@dataclass(frozen=True)
class OmittedAttemptRow(AttemptIdentifiers):
    """Row of ``left_out``: one attempt whose recording was not exported."""

    reason: Annotated[str, Column("Reason why the recording was omitted.")]


@dataclass(frozen=True)
class ControlStepRow(AttemptIdentifiers):
    """Row of ``control_steps``: one control step. The export adds columns for reward terms and actions."""

    step: Annotated[int, Column("Number of the control step in the trial.", allowed=_FROM_1)]
    time_s: Annotated[
        float, Column("End of the step, from the start of the attempt.", unit="s", allowed=_FROM_0)
    ]
    reward: Annotated[float, Column("Weighted sum of the reward terms.")]
    success: Annotated[bool, Column("Whether the robot has succeeded so far.")]
    distance_m: Annotated[
        float, Column("Distance to the target, as the task defines it.", unit="m", allowed=_FROM_0)
    ]
    force_on_person_n: Annotated[
        float, Column("Contact force of robot and tool on the person.", unit="N", allowed=_FROM_0)
    ]


@dataclass(frozen=True)
class AnswerIdentifiers:
    """Columns that identify an answer. An answer about a whole session has no trial."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    session: SessionNumber
    position: Annotated[int | None, _position(_SESSION_ANSWER)]
    practice: Annotated[bool | None, _practice(_SESSION_ANSWER)]
    task: Annotated[str | None, _task(_SESSION_ANSWER)]
    robot: Annotated[str | None, _robot(_SESSION_ANSWER)]
    policy: Annotated[str | None, _policy(_SESSION_ANSWER)]
    attempt: Annotated[int | None, _attempt(_SESSION_ANSWER)]
    moment: QuestionMoment
    respondent: Respondent
    questionnaire: QuestionnaireName


@dataclass(frozen=True)
class AnswerRow(AnswerIdentifiers):
    """Row of ``answers``: one answer to an item."""

    item: Annotated[
        str,
        Column("Name of the item version. The table items contains the texts.", allowed="see items"),
    ]
    value: Annotated[int, Column("The answer on the item's own scale.", allowed="minimum to maximum")]
    minimum: Annotated[int, Column("Lowest value of the scale of this version.")]
    maximum: Annotated[int, Column("Highest value of the scale of this version.")]
    points: Annotated[int, Column("Number of values of the scale.", allowed="2 to 101")]
    response_time_s: Annotated[
        float,
        Column(
            "Time from the appearance of the item to the answer. Time without a visible, active item "
            "is not counted: menus over VR, a removed headset, a page in the background, lost tracking or connection.",
            unit="s",
            allowed=_FROM_0,
        ),
    ]
    answered_at: Annotated[str, _utc("Time of storage.")]


@dataclass(frozen=True)
class ItemRow:
    """Row of ``items``: one item of a questionnaire."""

    questionnaire: QuestionnaireName
    when: Annotated[str, Column("Moments of the questionnaire.", allowed=_one_of(*QUESTION_MOMENTS))]
    order: Annotated[str, Column("Order of the items.", allowed=_one_of(*ITEM_ORDERS))]
    item: Annotated[str, Column("Name of the item.")]
    text: Annotated[str, Column("Text of the item.")]
    minimum: Annotated[int, Column("Lowest value of the scale.")]
    maximum: Annotated[int, Column("Highest value of the scale.")]
    points: Annotated[int, Column("Number of values of the scale, in equal steps.", allowed="2 to 101")]
    low: Annotated[str, Column("Label of the lowest value.")]
    high: Annotated[str, Column("Label of the highest value.")]


@dataclass(frozen=True)
class ScoreRow(AnswerIdentifiers):
    """Row of ``scores``: one score of a scale of a validated questionnaire."""

    instrument: InstrumentName
    scale: Annotated[
        str, Column("Name of the scale. The table scales describes its computation.", allowed="see scales")
    ]
    score: Annotated[
        float | None,
        Column("The score.", allowed="minimum to maximum", empty="required answers or weights are missing"),
    ]
    minimum: LowestScore
    maximum: HighestScore
    answered: Annotated[int, Column("Number of answered items of the scale.", allowed=_FROM_0)]
    items: Annotated[int, Column("Number of items of the scale.", allowed=_FROM_1)]


@dataclass(frozen=True)
class ScaleRow:
    """Row of ``scales``: one scale of a validated questionnaire, and its computation."""

    questionnaire: QuestionnaireName
    instrument: InstrumentName
    title: Annotated[str, Column("Title of the validated questionnaire.")]
    scale: Annotated[str, Column("Name of the scale.")]
    function: Annotated[
        str, Column("Function that combines the item values.", allowed="mean, sum, weighted mean")
    ]
    factor: Annotated[float, Column("Factor that multiplies the result of the function.")]
    reversed: Annotated[str, Column("Reversed items: minimum + maximum − value.", empty="none")]
    offset: Annotated[int, Column("Added to each item value after reversal.", unit="1")]
    items: Annotated[
        str, Column("Items of the scale. An item that is listed twice counts twice.", allowed="see items")
    ]
    minimum: LowestScore
    maximum: HighestScore
    missing: Annotated[
        str,
        Column(
            "Rule for a missing answer: no score, or the centre of the response scale.",
            allowed="no score, centre",
        ),
    ]
    source: Annotated[str, Column("Publication of questionnaire and scoring.")]
    licence: Annotated[str, Column("Licence of the texts.")]


@dataclass(frozen=True)
class AuditLogRow:
    """Row of ``log``: one entry of the audit log."""

    entry: Annotated[int, Column("Number of the entry; those of a merged site begin at a multiple of 10^9.")]
    site: SiteName
    at: Annotated[str, _utc("Time of the action.")]
    person: Annotated[str, Column("Number of the person; with --free-text, name of the token or account.")]
    known_by: Annotated[
        str, Column("Method that identified the person.", allowed=_one_of(*IDENTIFICATION_METHODS))
    ]
    name: Annotated[str, Column("The action.", allowed="see Log in docs/how_to/run_sessions.md")]
    participant: Annotated[
        str | None,
        Column("Pseudonym of the affected participant.", empty="the action concerns no participant"),
    ]
    detail: Annotated[
        str | None,
        Column("Further information; refused: the action changed nothing.", empty="no further information"),
    ]
    completed: Annotated[
        int | None,
        Column(
            "Number of participants who had completed the study when results were viewed.",
            allowed=_FROM_0,
            empty=_NO_RESULTS,
        ),
    ]
    planned: Annotated[
        int | None,
        Column(
            "Planned number of participants when results were viewed.", allowed=_FROM_1, empty=_NO_RESULTS
        ),
    ]


@dataclass(frozen=True)
class EventRow:
    """Row of ``events``: one event of a participant or session, such as a changed state."""

    participant: Annotated[str | None, _participant(_WHOLE_STUDY)]
    session: Annotated[int | None, _session(_NO_SESSION)]
    position: Annotated[int | None, _position(_NO_TRIAL)]
    attempt: Annotated[int | None, _attempt(_NO_TRIAL)]
    simulated: Annotated[bool | None, _simulated(_WHOLE_STUDY)]
    at: Annotated[str, _utc("Time of storage.")]
    name: Annotated[str, Column("Name of the event.")]
    detail: Annotated[
        str | None,
        Column("Further information.", empty="no further information, or free text without --free-text"),
    ]


@dataclass(frozen=True)
class AdverseEventRow:
    """Row of ``adverse_events``: one report of an adverse event."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    event: Annotated[int, Column("Number of the adverse event in the study.", allowed=_FROM_1)]
    report: Annotated[int, Column("Number of the report of this event; the last is valid.", allowed=_FROM_1)]
    recorded_at: Annotated[str, _utc("Time of the report.")]
    recorded_by: Annotated[
        str | None, Column("Author of the report.", empty="no author is stored, or without --free-text")
    ]
    began_at: Annotated[str, _utc("Start of the event.")]
    position: Annotated[int | None, _position(_NO_TRIAL)]
    practice: Annotated[bool | None, _practice(_NO_TRIAL)]
    task: Annotated[str | None, _task(_NO_TRIAL)]
    robot: Annotated[str | None, _robot(_NO_TRIAL)]
    policy: Annotated[str | None, _policy(_NO_TRIAL)]
    description: Annotated[str | None, Column("Description of the event.", empty="without --free-text")]
    severity: Annotated[
        str, Column("Grade of CTCAE 5.0, from 1 to 5 in words.", allowed=_one_of(*ADVERSE_EVENT_SEVERITIES))
    ]
    seriousness: Annotated[
        str, Column("Criterion of ICH E2A, or none.", allowed=_one_of(*SERIOUSNESS_CRITERIA))
    ]
    relatedness: Annotated[
        str,
        Column("Attribution to the study, as NCI's CTEP grades it.", allowed=_one_of(*RELATEDNESS_GRADES)),
    ]
    action: Annotated[str | None, Column("Action taken.", empty="no action, or without --free-text")]
    outcome: Annotated[str, Column("Outcome of ICH E2B(R3).", allowed=_one_of(*ADVERSE_EVENT_OUTCOMES))]


@dataclass(frozen=True)
class FunctioningCountRow:
    """Row of ``functioning``: number of participants with the same answer about functioning."""

    question: Annotated[str, Column("The domain of the Washington Group Short Set, or devices.")]
    answer: Annotated[str, Column("A level of difficulty, or a class of ISO 9999.")]
    people: Annotated[
        str,
        Column(
            "Number of analysed participants with this answer.",
            allowed="0, a number from 5, or suppressed if a group of fewer than 5 could be identified",
        ),
    ]


def _difficulty(domain: str) -> Column:
    return Column(f"Difficulty in {domain}.", allowed=_one_of(*DIFFICULTY_LEVELS))


@dataclass(frozen=True)
class FunctioningRow:
    """Row of ``functioning_by_person``: answers of one participant about functioning."""

    participant: Pseudonym
    site: SiteName
    seeing: Annotated[str, _difficulty("seeing")]
    hearing: Annotated[str, _difficulty("hearing")]
    walking: Annotated[str, _difficulty("walking")]
    remembering: Annotated[str, _difficulty("remembering")]
    self_care: Annotated[str, _difficulty("self-care")]
    communicating: Annotated[str, _difficulty("communicating")]
    devices: Annotated[
        str | None,
        Column("Classes of assistive products by their numbers in ISO 9999.", empty="no device named"),
    ]
    diagnosis: Annotated[
        str | None, Column("The diagnosis in the person's words.", empty="not given, or without --free-text")
    ]


@dataclass(frozen=True)
class NoteRow:
    """Row of ``notes``: one note of an experimenter about a participant."""

    participant: Pseudonym
    site: SiteName
    simulated: IsSimulated
    session: Annotated[int | None, _session(_NO_SESSION)]
    at: Annotated[str, _utc("Time of writing.")]
    text: Annotated[str, Column("The note.")]
