"""What every column of the exported tables means."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from avrgym.models.human import SEXES
from avrgym.questionnaires.questionnaire import ITEM_ORDERS, MOMENTS
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.robots.registry import ROBOTS, find_robot
from avrgym.study.design.design import Design
from avrgym.study.design.functioning import LEVELS, QUESTIONS
from avrgym.study.people.adverse_events import OUTCOMES, RELATEDNESS, SERIOUSNESS, SEVERITIES
from avrgym.study.storage.audit_log import KNOWN_BY
from avrgym.study.storage.states import ATTEMPT, PARTICIPANT, TRIAL
from avrgym.system.columns import NUMBER, TEXT, TIME, TRUTH, WHOLE, Column
from avrgym.tasks.registry import TASKS


def _one_of(*values: str) -> str:
    return ", ".join(values)


_TRUTH, _FROM_1, _FROM_0 = "true, false", "1 and above", "0 and above"
_UTC = "ISO 8601"
_NO_TRIAL = "the answer is about a whole session"
_NOT_IN_TRIAL = "it was in no trial"
_NOT_IN_SESSION = "it is about no session"
_WHOLE_STUDY = "it is about the whole study"
_NO_RESULTS = "no results were viewed"
_NEVER_ENDED = "the attempt did not end with metrics"
_RECORDING = Column("File of the recording in the study's folder.", TEXT)

PARTICIPANT_COLUMN = Column("Pseudonym of the participant.", TEXT, allowed="sub-001, sub-002 and so on")
SITE = Column(
    "Where the participant took part.", TEXT, allowed="letters, digits, - and _", empty="no site was said"
)
SIMULATED = Column("Whether a simulated participant took the place of a person.", TRUTH, allowed=_TRUTH)
SESSION = Column("Number of the participant's session.", WHOLE, allowed=_FROM_1)
POSITION = Column("Place of the trial in the participant's order, practice included.", WHOLE, allowed=_FROM_1)
PRACTICE = Column("Whether it was a practice trial, which has no questionnaire.", TRUTH, allowed=_TRUTH)
TASK = Column("What the robot helped with.", TEXT, allowed=_one_of(*TASKS))
ROBOT = Column("Which robot helped.", TEXT, allowed=_one_of(*ROBOTS))
POLICY = Column("Which policy controlled the robot.", TEXT, allowed="the design's policies")
ATTEMPT_NUMBER = Column("Number of the attempt at the trial.", WHOLE, allowed=_FROM_1)
REWARD = Column("Sum of the rewards of all control steps.", NUMBER, "1", empty=_NEVER_ENDED)
SUCCESS = Column("Whether the robot had succeeded.", TRUTH, allowed=_TRUTH)
LABELS = {
    "participant": PARTICIPANT_COLUMN,
    "site": SITE,
    "simulated": SIMULATED,
    "session": SESSION,
    "position": POSITION,
    "practice": PRACTICE,
    "task": TASK,
    "robot": ROBOT,
    "policy": POLICY,
    "attempt": ATTEMPT_NUMBER,
}
"""What tells an attempt from all others."""
_OF_TRIAL = {
    name: Column(column.meaning, column.type, column.unit, column.allowed, _NO_TRIAL)
    for name, column in LABELS.items()
    if name in ("position", "practice", "task", "robot", "policy", "attempt")
}
OF_INSTRUMENTS = ("scores", "scales")
"""The tables of studies that use instruments; others do not have them."""
RECORDS = ("events", "adverse_events", "functioning", "functioning_by_person", "notes")
"""The tables of what happened and what experimenters wrote."""
WHY = {"why": Column("Why the recording was left out.", TEXT)}
TABLES: Mapping[str, Mapping[str, Column]] = {
    "participants": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "site_participant": Column("Pseudonym of the participant at the site.", TEXT, empty="not merged from sites"),
        "simulated": SIMULATED,
        "state": Column("How far the participant has come.", TEXT, allowed=_one_of(*PARTICIPANT)),
        "sex": Column("Which body model stood for the participant.", TEXT, allowed=_one_of(*SEXES)),
        "age_years": Column("Age when enrolled.", WHOLE, "year", empty="not given"),
        "language": Column("The language that the participant read the study in.", TEXT, allowed="a language tag"),
        "torso_height_m": Column(
            "Torso height, hip bone to centre of the head, as calibrated: median over the exported completed trials.",
            NUMBER, "m", empty="no completed trial was exported",
        ),
        "cell": Column("Number of the order of trials.", WHOLE, allowed=_FROM_0, empty="no order yet"),
        "consent_version": Column("Version of the consent text that was agreed to.", TEXT, empty="no consent"),
        "consented_at": Column("When consent was given.", TIME, "UTC", _UTC, "no consent"),
    },
    "consents": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "decision": Column("Number of the participant's decision about a consent text.", WHOLE, allowed=_FROM_1),
        "agreed": Column("Whether the participant agreed.", TRUTH, allowed=_TRUTH),
        "version": Column("Version of the consent text.", TEXT, empty="not stored by the version of AVR Gym"),
        "language": Column("Language of the consent text.", TEXT, "", "a language tag", "the design's first"),
        "decided_at": Column("When the decision was stored.", TIME, "UTC", _UTC),
        "sha256": Column("Checksum of the consent text.", TEXT, "", "64 hexadecimal digits", "not stored"),
        "text": Column("File of the consent text in the export.", TEXT, empty="text not archived"),
    },
    "trials": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "position": POSITION,
        "practice": PRACTICE,
        "environment": Column("The Gymnasium environment of task and robot.", TEXT, allowed="see avrgym envs"),
        "policy": POLICY,
        "seed": Column("Seed of the trial's scene and chance.", WHOLE, allowed=_FROM_0),
        "state": Column("How far the trial has come.", TEXT, allowed=_one_of(*TRIAL)),
        "attempts": Column("How many attempts were made.", WHOLE, allowed=_FROM_0),
        "recording": Column(_RECORDING.meaning, TEXT, empty="the trial is not completed"),
    },
    "attempts": {
        **LABELS,
        "state": Column("How the attempt ended, or that it runs.", TEXT, allowed=_one_of(*ATTEMPT)),
        "started_at": Column("When the attempt began.", TIME, "UTC", _UTC),
        "ended_at": Column("When the attempt ended.", TIME, "UTC", _UTC, "it runs"),
        "steps": Column("How many control steps of 0.1 s it had.", WHOLE, "", _FROM_0, _NEVER_ENDED),
        "reward": REWARD,
        "success": Column(SUCCESS.meaning, TRUTH, "", _TRUTH, _NEVER_ENDED),
        "seconds": Column("How long the attempt took.", NUMBER, "s", _FROM_0, _NEVER_ENDED),
        "torso_height_m": Column(
            "Torso height with which the trial was run.", NUMBER, "m", empty="not completed, or left out"
        ),
        "recording": _RECORDING,
        "sha256": Column("Checksum of the closed recording.", TEXT, "", "64 hexadecimal digits", "not closed"),
    },
    "answers": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "session": SESSION,
        **_OF_TRIAL,
        "moment": Column("When it was asked.", TEXT, allowed=_one_of(*MOMENTS)),
        "questionnaire": Column("The questionnaire of the item.", TEXT, allowed="see items"),
        "item": Column(
            "The item that was rated; items has its words. A changed item is another version.",
            TEXT,
            allowed="see items",
        ),
        "value": Column("The answer on the item's own scale.", WHOLE, allowed="least to most"),
        "least": Column("The lowest value of the scale of this version.", WHOLE),
        "most": Column("The highest value of the scale of this version.", WHOLE),
        "points": Column("How many values the scale has.", WHOLE, allowed="2 to 101"),
        "response_time_s": Column(
            "From the appearance of the item to the answer, without the time in which the participant could not see or "
            "answer it: a menu over VR, a removed headset, a page in the background, lost tracking or connection. "
            "Sessions of version 0.1.0 counted that time.",
            NUMBER,
            "s",
            _FROM_0,
        ),
        "answered_at": Column("When it was stored.", TIME, "UTC", _UTC),
    },
    "items": {
        "questionnaire": Column("Name of the questionnaire.", TEXT),
        "when": Column("When it is asked, one or several moments.", TEXT, allowed=_one_of(*MOMENTS)),
        "order": Column("The order in which its items are asked.", TEXT, allowed=_one_of(*ITEM_ORDERS)),
        "item": Column("Name of the statement.", TEXT),
        "text": Column("The statement in its words.", TEXT),
        "least": Column("The lowest value of the item's scale.", WHOLE),
        "most": Column("The highest value of the item's scale.", WHOLE),
        "points": Column("How many values the scale has, in equal steps.", WHOLE, allowed="2 to 101"),
        "low": Column("The words at the lowest value.", TEXT),
        "high": Column("The words at the highest value.", TEXT),
    },
    "scores": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "session": SESSION,
        **_OF_TRIAL,
        "moment": Column("When its items were asked.", TEXT, allowed=_one_of(*MOMENTS)),
        "questionnaire": Column("Name of the questionnaire.", TEXT),
        "instrument": Column("The instrument that it uses.", TEXT, allowed=_one_of(*INSTRUMENTS)),
        "scale": Column("Which score of the instrument; how it is made stands in scales.", TEXT, allowed="see scales"),
        "score": Column("The score.", NUMBER, "1", "least to most", "answers or weights are missing that it needs"),
        "least": Column("The lowest score that answers can give.", NUMBER, "1"),
        "most": Column("The highest score that answers can give.", NUMBER, "1"),
        "answered": Column("How many of the scale's items were answered.", WHOLE, allowed=_FROM_0),
        "items": Column("How many items the scale has.", WHOLE, allowed=_FROM_1),
    },
    "scales": {
        "questionnaire": Column("Name of the questionnaire.", TEXT),
        "instrument": Column("The instrument that it uses.", TEXT, allowed=_one_of(*INSTRUMENTS)),
        "title": Column("The instrument's title.", TEXT),
        "scale": Column("Name of the score.", TEXT),
        "of": Column("What its items' counts are made into.", TEXT, allowed="mean, sum, weighted mean"),
        "factor": Column("What that is multiplied by.", NUMBER, "1"),
        "reversed": Column("Items that count from the other end: least + most − value.", TEXT, empty="none"),
        "offset": Column("What is added to each item before, after reversal.", WHOLE, "1"),
        "items": Column("Its items; one that stands there twice counts twice.", TEXT, allowed="see items"),
        "least": Column("The lowest score that answers can give.", NUMBER, "1"),
        "most": Column("The highest score that answers can give.", NUMBER, "1"),
        "missing": Column("What a missing answer makes of the score.", TEXT, allowed="no score, centre"),
        "source": Column("Where instrument and scoring were published.", TEXT),
        "licence": Column("Under which licence its words are.", TEXT),
    },
    "log": {
        "entry": Column("Number of the entry; those of a site that was merged begin at a multiple of 10^9.", WHOLE),
        "site": SITE,
        "at": Column("When it was done.", TIME, "UTC", _UTC),
        "person": Column("Who did it, by number; with --free-text by the name of a token or account.", TEXT),
        "known_by": Column("How the person is known.", TEXT, allowed=_one_of(*KNOWN_BY)),
        "name": Column("What was done or viewed.", TEXT, allowed="see The log in docs/how_to/run_sessions.md"),
        "participant": Column("Pseudonym of its participant.", TEXT, "", "", "it has none"),
        "detail": Column("More about it; refused: it changed nothing.", TEXT, empty="nothing"),
        "completed": Column(
            "Participants who had completed the study when its results were viewed.", WHOLE, "", _FROM_0, _NO_RESULTS
        ),
        "planned": Column("How many were planned then.", WHOLE, "", _FROM_1, _NO_RESULTS),
    },
    "control_steps": {
        **LABELS,
        "step": Column("Number of the control step in the trial.", WHOLE, allowed=_FROM_1),
        "time_s": Column("End of the step, from the beginning of the attempt.", NUMBER, "s", _FROM_0),
        "reward": Column("The weighted sum of the step's reward terms.", NUMBER, "1"),
        "success": Column("Whether the robot has succeeded by then.", TRUTH, allowed=_TRUTH),
        "distance_m": Column("Distance to the target, as the task defines it.", NUMBER, "m", _FROM_0),
        "force_on_person_n": Column("Force of robot and tool on the person.", NUMBER, "N", _FROM_0),
    },
    "events": {
        "participant": Column(PARTICIPANT_COLUMN.meaning, TEXT, "", PARTICIPANT_COLUMN.allowed, _WHOLE_STUDY),
        "session": Column(SESSION.meaning, WHOLE, "", _FROM_1, _NOT_IN_SESSION),
        "position": Column(POSITION.meaning, WHOLE, "", _FROM_1, _NOT_IN_TRIAL),
        "attempt": Column(ATTEMPT_NUMBER.meaning, WHOLE, "", _FROM_1, _NOT_IN_TRIAL),
        "simulated": Column(SIMULATED.meaning, TRUTH, "", _TRUTH, _WHOLE_STUDY),
        "at": Column("When it was stored.", TIME, "UTC", _UTC),
        "name": Column("What happened.", TEXT),
        "detail": Column("More about it.", TEXT, empty="nothing more, or free text without --free-text"),
    },
    "adverse_events": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "event": Column("Number of the adverse event in the study.", WHOLE, allowed=_FROM_1),
        "report": Column("Number of the report of this event; the last is how it is known.", WHOLE, allowed=_FROM_1),
        "recorded_at": Column("When the report was recorded.", TIME, "UTC", _UTC),
        "recorded_by": Column("Who recorded it.", TEXT, empty="nobody was named, or without --free-text"),
        "began_at": Column("When the event began.", TIME, "UTC", _UTC),
        "position": Column(POSITION.meaning, WHOLE, "", _FROM_1, _NOT_IN_TRIAL),
        **{
            name: Column(LABELS[name].meaning, LABELS[name].type, "", LABELS[name].allowed, _NOT_IN_TRIAL)
            for name in ("practice", "task", "robot", "policy")
        },
        "description": Column("What happened.", TEXT, empty="without --free-text"),
        "severity": Column("Grade of CTCAE 5.0, from 1 to 5 in words.", TEXT, allowed=_one_of(*SEVERITIES)),
        "seriousness": Column("Criterion of ICH E2A that applies, or none.", TEXT, allowed=_one_of(*SERIOUSNESS)),
        "relatedness": Column("Attribution to the study as NCI's CTEP grades it.", TEXT, allowed=_one_of(*RELATEDNESS)),
        "action": Column("What was done about it.", TEXT, empty="nothing, or without --free-text"),
        "outcome": Column("Outcome of ICH E2B(R3).", TEXT, allowed=_one_of(*OUTCOMES)),
    },
    "functioning": {
        "question": Column("The domain of the Washington Group Short Set, or devices.", TEXT),
        "answer": Column("A level of difficulty, or a class of ISO 9999.", TEXT),
        "people": Column(
            "How many of the people analysed gave this answer.", TEXT,
            allowed="a number from 5 on, 0, or suppressed where a group of fewer than 5 could be identified",
        ),
    },
    "functioning_by_person": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        **{
            question: Column(f"Difficulty in {question.replace('_', '-')}.", TEXT, allowed=_one_of(*LEVELS))
            for question in QUESTIONS
        },
        "devices": Column("Classes of assistive products by their numbers in ISO 9999.", TEXT, empty="nothing named"),
        "diagnosis": Column("The diagnosis in the person's words.", TEXT, empty="not given, or without --free-text"),
    },
    "notes": {
        "participant": PARTICIPANT_COLUMN,
        "site": SITE,
        "simulated": SIMULATED,
        "session": Column(SESSION.meaning, WHOLE, "", _FROM_1, _NOT_IN_SESSION),
        "at": Column("When it was written.", TIME, "UTC", _UTC),
        "text": Column("What the experimenter wrote.", TEXT),
    },
    "left_out": {**LABELS, **WHY},
}  # fmt: skip
"""Columns of each table that do not depend on the study, in their order."""


def reward_terms(design: Design) -> list[str]:
    """The reward terms of the design's tasks, of which control steps have a column each."""
    return sorted({term for task in design.tasks for term in TASKS[task].weights})


def most_joints(design: Design) -> int:
    """The most joints of any arm of the design's robots: so many columns a control step has for its action."""
    return max(len(arm.joints) for name in design.robots for arm in find_robot(name).arms.values())


def columns_of(table: str, design: Design) -> Mapping[str, Column]:
    """Every column of a table, in its order."""
    if table != "control_steps":
        return TABLES[table]
    terms = {
        f"term_{term}": Column(
            f"Reward term {term}, not weighted.", NUMBER, _unit(term), empty="the task has no such term"
        )
        for term in reward_terms(design)
    }
    actions = {
        f"action_{joint + 1}": Column(
            f"Action of arm joint {joint + 1}: its speed as a share of its limit.", NUMBER, "1", "−1 to 1"
        )
        for joint in range(most_joints(design))
    }
    return {**TABLES[table], **terms, **actions}


def codebook(tables: Sequence[str], design: Design) -> Iterator[dict[str, Any]]:
    """A row for every column of tables."""
    for table in tables:
        for name, column in columns_of(table, design).items():
            yield {"table": table, "column": name, **asdict(column)}


def _unit(term: str) -> str:
    """The unit that a term's name ends with."""
    for ending, unit in (("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m"), ("_n", "N")):
        if term.endswith(ending):
            return unit
    return "1"
