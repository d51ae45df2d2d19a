"""Analyse a study: compute all tables and tests from recordings and database."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import msgspec

from avrgym.analysis.answers.scores import ScoreSummaryRow, score_families, score_summary_rows
from avrgym.analysis.answers.session_answers import (
    SessionAnswerRow,
    session_answer_rows,
    session_families,
    session_likert_rows,
)
from avrgym.analysis.answers.trial_answers import (
    LikertRow,
    SubjectiveRow,
    answer_families,
    likert_rows,
    subjective_rows,
)
from avrgym.analysis.biomechanics.biomechanics import (
    BiomechanicsRow,
    BodyTrials,
    RangeRow,
    biomechanics_rows,
    body_trials_by_group,
    range_rows,
)
from avrgym.analysis.biomechanics.tests import biomechanics_families
from avrgym.analysis.biomechanics.training_people import (
    PEOPLE_PER_TASK,
    PersonRow,
    sample_training_people,
)
from avrgym.analysis.designs import ItemRow, item_rows
from avrgym.analysis.flow import ParticipantFlow, participant_flows
from avrgym.analysis.headsets import HeadsetRow, headset_rows
from avrgym.analysis.latency import LatencyRow, latency_rows
from avrgym.analysis.log import StudyLog, study_log
from avrgym.analysis.models.models import ModelRow, model_rows
from avrgym.analysis.outcomes.outcomes import ObjectiveRow, objective_rows, outcome_families
from avrgym.analysis.outcomes.paper_tables import csv_tables, paper_tables
from avrgym.analysis.plan import FrozenPlan, label_by_plan, plan_results, read_frozen_plan
from avrgym.analysis.primary import assign_roles
from avrgym.analysis.reading.commands import CommandRow
from avrgym.analysis.reading.rows import (
    AnswerRow,
    AttemptRow,
    ParticipantRow,
    ProblemRow,
    ScoreRow,
    StreamRow,
    TermRow,
    TrialRow,
)
from avrgym.analysis.reading.study_data import StudyData, read_study
from avrgym.analysis.repeats import RepeatRow, repeat_rows
from avrgym.analysis.sessions import SessionRow, session_rows
from avrgym.analysis.sites import SiteEffectRow, SiteOutcomeRow, site_effect_rows, site_outcome_rows
from avrgym.analysis.statistics.comparisons import ComparisonRow, Family
from avrgym.analysis.statistics.tests import MAX_EXACT_RANK_SUM, MAX_EXACT_SIGNED_RANK, PERMUTATIONS
from avrgym.analysis.tables import Table, control_steps
from avrgym.study.checking.design_checks import check_design, check_stored_designs
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.repeat_checks import check_repeats, is_simulated
from avrgym.study.checking.repeats import attempted_trials
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import TABLES
from avrgym.study.export.functioning import functioning_counts
from avrgym.study.export.records import DEFAULT_EXPORT_OPTIONS, adverse_event_rows
from avrgym.study.export.scores import uses_instruments
from avrgym.study.storage.analysis_files import FORMAT_NAME
from avrgym.study.storage.data_loss import describe_data_loss
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.session_designs import SessionDesign, recorded_designs
from avrgym.study.storage.store import Store
from avrgym.system.random_streams import TRAINING_PEOPLE_SEED
from avrgym.vr.session.attempt import versions

CSV_ONLY_TABLES = ("control_steps", "people")
"""Names of the tables that are only in CSV files. They are too long for ``results.json``."""
FORMAT = f"{FORMAT_NAME} 1"
FROM_CURRENT_FILES = "data that recordings do not contain are taken from the current files of the study"


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of a study.

    Attributes:
        design: the current design with all answered items.
        plan: the frozen plan; ``None`` if there is none.
        differences: differences between the recorded designs and the current design.
        session_designs: the recorded designs of the participants.
        items: versions of answered items.
        observed: the data of the study.
        flows: number of participants at each step: of people, then of simulated participants.
        headsets: headset checks of sessions.
        sessions: day, trials and time in VR of each session.
        groups: analysed trials with recorded body posture: of people, then of simulated participants.
        people: people sampled from the training populations.
        objective: reward and success of each condition.
        subjective: summaries of answers after trials.
        session_answers: summaries of answers before and after sessions, after breaks, and of caregivers.
        likert: frequency of each value of each item.
        score_summaries: summaries of questionnaire scores.
        families: tests by family.
        models: effects in regression models.
        biomechanics, ranges: distributions and ranges of body measures.
        site_outcomes, site_effects: results of each site; empty for a single site.
        latency: latency from pose to displayed frame.
        rebuilt_at: time of the rebuild of the database; ``None`` if it was not rebuilt.
        log: summary of the access log.
        adverse_events: reports of adverse events.
        functioning: numbers of answers about functioning.
        losses: consequences of a lost database.
        repeats: repeated trials by condition.
        repeat_findings: results of the tests of repeats.
        repeats_of_simulated: ``repeat_findings`` are about simulated participants, otherwise about people.
    """

    design: Design
    plan: FrozenPlan | None
    differences: list[Finding]
    session_designs: list[SessionDesign]
    items: list[ItemRow]
    observed: StudyData
    flows: list[ParticipantFlow]
    headsets: list[HeadsetRow]
    sessions: list[SessionRow]
    groups: list[BodyTrials]
    people: list[PersonRow]
    objective: list[ObjectiveRow]
    subjective: list[SubjectiveRow]
    session_answers: list[SessionAnswerRow]
    likert: list[LikertRow]
    score_summaries: list[ScoreSummaryRow]
    families: list[Family]
    models: list[ModelRow]
    biomechanics: list[BiomechanicsRow]
    ranges: list[RangeRow]
    site_outcomes: list[SiteOutcomeRow]
    site_effects: list[SiteEffectRow]
    latency: list[LatencyRow]
    rebuilt_at: str | None
    log: StudyLog
    adverse_events: list[Mapping[str, Any]]
    functioning: list[dict[str, Any]]
    losses: tuple[str, ...]
    repeats: list[RepeatRow]
    repeat_findings: list[str]
    repeats_of_simulated: bool

    @property
    def tests(self) -> list[ComparisonRow]:
        """Returns the test rows of all families."""
        return [row for family in self.families for row in family.rows]

    def tables(self) -> Iterator[Table]:
        """Yields all tables for the CSV files."""
        seen = self.observed
        yield Table.of("participants", ParticipantRow, seen.participants)
        yield Table.of("sessions", SessionRow, self.sessions)
        yield Table.of("trials", TrialRow, seen.trials)
        yield Table.of("attempts", AttemptRow, seen.attempts)
        yield Table.of("repeats", RepeatRow, self.repeats)
        yield Table.of("answers", AnswerRow, seen.answers)
        yield Table.of("items", ItemRow, self.items)
        yield Table.of("reward_terms", TermRow, seen.terms)
        if seen.streams:
            yield Table.of("streams", StreamRow, seen.streams)
        if seen.commands:
            yield Table.of("commands", CommandRow, seen.commands)
        if self.functioning:
            yield Table("functioning", TABLES["functioning"], self.functioning)
        yield Table("adverse_events", TABLES["adverse_events"], self.adverse_events)
        yield Table.of("problems", ProblemRow, seen.problems)
        yield Table.of("objective", ObjectiveRow, self.objective)
        yield from csv_tables(list(paper_tables(self.design, self.objective)))
        yield Table.of("subjective", SubjectiveRow, self.subjective)
        yield Table.of("session_answers", SessionAnswerRow, self.session_answers)
        yield Table.of("likert", LikertRow, self.likert)
        if uses_instruments(self.design):
            yield Table.of("scores", ScoreRow, seen.scores)
            yield Table.of("score_summaries", ScoreSummaryRow, self.score_summaries)
        yield Table.of("tests", ComparisonRow, self.tests)
        yield Table.of("models", ModelRow, self.models)
        yield Table.of("biomechanics", BiomechanicsRow, self.biomechanics)
        yield Table.of("ranges", RangeRow, self.ranges)
        yield Table.of("people", PersonRow, self.people)
        if self.site_outcomes:
            yield Table.of("site_outcomes", SiteOutcomeRow, self.site_outcomes)
            yield Table.of("site_effects", SiteEffectRow, self.site_effects)
        yield Table.of("latency", LatencyRow, self.latency)
        if self.headsets:
            yield Table.of("headset_checks", HeadsetRow, self.headsets)
        yield control_steps(seen.series, {row.participant: row for row in seen.participants}, self.design)

    def results(self) -> dict[str, Any]:
        """Returns the contents of ``results.json``: all results, without control steps and sampled people."""
        return {
            "format": FORMAT,
            "title": self.design.title,
            "versions": msgspec.to_builtins(versions()),
            "questionnaires": msgspec.to_builtins(self.design.questionnaires),
            "settings": {
                "people_per_task": PEOPLE_PER_TASK,
                "seed": TRAINING_PEOPLE_SEED,
                "permutations": PERMUTATIONS,
                "exact_signed_rank": MAX_EXACT_SIGNED_RANK,
                "exact_rank_sum": MAX_EXACT_RANK_SUM,
            },
            "differences": [
                {"where": each.where, "message": each.message, "is_error": each.is_error}
                for each in self.differences
            ],
            **({"plan": plan_results(self.plan)} if self.plan else {}),
            **({"database_rebuilt_at": self.rebuilt_at} if self.rebuilt_at else {}),
            "log": asdict(self.log),
            **({"losses": list(self.losses)} if self.losses else {}),
            "repeat_findings": self.repeat_findings,
            **{table.name: list(table.rows) for table in self.tables() if table.name not in CSV_ONLY_TABLES},
        }


def analyse(
    store: Store,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    *,
    skip_damaged: bool = False,
) -> Analysis:
    """Returns the analysis of a study in its current state. Arguments and errors are those of ``read_study``."""
    answered_items = AnsweredItems(store)
    design = answered_items.design
    observed = read_study(store, progress, skip_damaged=skip_damaged, answered_items=answered_items)
    differences = list(check_design(store))
    observed.problems.extend(_problem(each, FROM_CURRENT_FILES) for each in check_stored_designs(store))
    people = sample_training_people(design)
    groups = body_trials_by_group(observed.trials)
    given = design, observed.answers
    plan = read_frozen_plan(store, design, observed)
    confirmed = plan.confirmed if plan else None
    families = [
        *outcome_families(design, observed.trials),
        *answer_families(*given),
        *session_families(*given),
        *score_families(design, observed.scores),
        *biomechanics_families(groups, people),
    ]
    families = label_by_plan(families, confirmed, design) if confirmed else families
    found = assign_roles(families, model_rows(design, observed, confirmed), confirmed)
    return Analysis(
        design=design,
        plan=plan,
        differences=differences,
        session_designs=recorded_designs(store),
        items=item_rows(store, answered_items),
        observed=observed,
        flows=participant_flows(store, observed),
        headsets=headset_rows(store),
        sessions=session_rows(store, observed.participants),
        groups=groups,
        people=people,
        objective=objective_rows(store, observed.trials),
        subjective=subjective_rows(*given),
        session_answers=session_answer_rows(*given),
        likert=likert_rows(*given) + session_likert_rows(*given),
        families=found.families,
        models=found.models,
        score_summaries=score_summary_rows(design, observed.scores),
        biomechanics=biomechanics_rows(groups, people),
        ranges=range_rows(groups),
        site_outcomes=site_outcome_rows(design, observed.trials),
        site_effects=site_effect_rows(design, observed.trials, observed.answers, observed.scores),
        latency=latency_rows(observed.trials, observed.latencies),
        rebuilt_at=store.rebuilt_at(),
        log=study_log(store),
        adverse_events=[
            vars(row) for row in adverse_event_rows(store, store.participants(), DEFAULT_EXPORT_OPTIONS)
        ],
        functioning=[vars(row) for row in functioning_counts(store)] if store.design.ask_functioning else [],
        losses=describe_data_loss(store),
        repeats=repeat_rows(attempted_trials(store)),
        repeat_findings=[f"{each.where}: {each.message}" for each in check_repeats(store)],
        repeats_of_simulated=is_simulated(store),
    )


def _problem(found: Finding, consequence: str) -> ProblemRow:
    return ProblemRow(simulated=None, where=found.where, what=found.message, consequence=consequence)
