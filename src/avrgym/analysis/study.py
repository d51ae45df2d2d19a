"""Analyse a study: compute all tables and tests from recordings and database."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import msgspec

from avrgym.analysis.answers.scores import ScoreSummaryRow, score_summary_rows, score_test_families
from avrgym.analysis.answers.session_answers import (
    SessionAnswerRow,
    session_answer_rows,
    session_likert_rows,
    session_test_families,
)
from avrgym.analysis.answers.trial_answers import (
    AnswerSummaryRow,
    LikertRow,
    answer_summary_rows,
    answer_test_families,
    likert_rows,
)
from avrgym.analysis.biomechanics.biomechanics import (
    BiomechanicsRow,
    BodyTrials,
    MeasureRangeRow,
    biomechanics_rows,
    body_trials_by_group,
    measure_range_rows,
)
from avrgym.analysis.biomechanics.tests import biomechanics_test_families
from avrgym.analysis.biomechanics.training_people import (
    PEOPLE_PER_TASK,
    SampledPersonRow,
    sample_training_people,
)
from avrgym.analysis.designs import ItemVersionRow, item_version_rows
from avrgym.analysis.flow import ParticipantFlow, participant_flows
from avrgym.analysis.headsets import HeadsetRow, headset_rows
from avrgym.analysis.latency import LatencyRow, latency_rows
from avrgym.analysis.log import AccessLogSummary, summarise_access_log
from avrgym.analysis.models.models import ModelRow, model_rows
from avrgym.analysis.outcomes.outcomes import (
    ObjectiveOutcomeRow,
    objective_outcome_rows,
    outcome_test_families,
)
from avrgym.analysis.outcomes.paper_tables import paper_csv_tables, paper_tables
from avrgym.analysis.plan import FrozenPlan, add_plan_status, plan_results, read_frozen_plan
from avrgym.analysis.primary import assign_result_roles
from avrgym.analysis.reading.commands import CommandRow
from avrgym.analysis.reading.rows import (
    AnswerRow,
    AttemptRow,
    DataProblemRow,
    ParticipantRow,
    RewardTermRow,
    ScoreRow,
    StreamRow,
    TrialRow,
)
from avrgym.analysis.reading.study_data import StudyData, read_study_data
from avrgym.analysis.repeats import RepeatRow, repeat_rows
from avrgym.analysis.sessions import SessionRow, session_rows
from avrgym.analysis.sites import SiteEffectRow, SiteOutcomeRow, site_effect_rows, site_outcome_rows
from avrgym.analysis.statistics.comparisons import ComparisonFamily, ComparisonRow
from avrgym.analysis.statistics.tests import MAX_EXACT_RANK_SUM_N, MAX_EXACT_SIGNED_RANK_N, PERMUTATION_COUNT
from avrgym.analysis.tables import Table, control_steps_table
from avrgym.study.checking.design_checks import check_design, check_stored_designs
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.repeat_checks import check_repeats, is_simulated_study
from avrgym.study.checking.repeats import attempted_trials
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.functioning import functioning_counts
from avrgym.study.export.records import DEFAULT_EXPORT_OPTIONS, adverse_event_rows
from avrgym.study.export.scores import uses_instruments
from avrgym.study.storage.analysis_files import ANALYSIS_FORMAT
from avrgym.study.storage.data_loss import describe_data_loss
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.session_designs import SessionDesign, designs_from_recordings
from avrgym.study.storage.store import Store
from avrgym.system.random_streams import TRAINING_POPULATION_SEED
from avrgym.vr.session.attempt import versions

CSV_ONLY_TABLES = ("control_steps", "people")
"""Names of the tables that are only in CSV files. They are too long for ``results.json``."""
RESULTS_FORMAT = f"{ANALYSIS_FORMAT} 1"
CURRENT_FILES_TEXT = "data that recordings do not contain are taken from the current files of the study"


@dataclass(frozen=True, eq=False)
class StudyAnalysis:
    """The results of a study.

    Attributes:
        design: the current design with all answered items.
        frozen_plan: the frozen plan; ``None`` without a frozen plan.
        design_differences: differences between the recorded designs and the current design.
        session_designs: the recorded designs of the participants.
        item_versions: versions of answered items.
        study_data: the data of the study.
        flows: number of participants at each step: of people, then of simulated participants.
        headset_checks: headset checks of sessions.
        sessions: day, trials and time in VR of each session.
        body_trials: analysed trials with recorded body posture: of people, then of simulated participants.
        training_people: people sampled from the training populations.
        objective_outcomes: reward and success of each condition.
        answer_summaries: summaries of answers after trials.
        session_answers: summaries of answers before and after sessions, after breaks, and of caregivers.
        answer_frequencies: frequency of each value of each item.
        score_summaries: summaries of questionnaire scores.
        families: families of tests.
        models: effects in regression models.
        biomechanics, measure_ranges: distributions and ranges of body measures.
        site_outcomes, site_effects: results of each site; empty for a single site.
        latency_summaries: latency from pose to displayed frame.
        rebuilt_at: time of the rebuild of the database; ``None`` if it was not rebuilt.
        access_log: summary of the access log.
        adverse_events: all reports of adverse events, with follow-ups.
        functioning: numbers of answers about functioning.
        data_losses: consequences of a lost database, as sentences.
        repeats: repeated trials by condition.
        repeat_findings: results of the tests of repeats.
        repeats_of_simulated: whether ``repeat_findings`` are about simulated participants (otherwise about people).
    """

    design: Design
    frozen_plan: FrozenPlan | None
    design_differences: list[Finding]
    session_designs: list[SessionDesign]
    item_versions: list[ItemVersionRow]
    study_data: StudyData
    flows: list[ParticipantFlow]
    headset_checks: list[HeadsetRow]
    sessions: list[SessionRow]
    body_trials: list[BodyTrials]
    training_people: list[SampledPersonRow]
    objective_outcomes: list[ObjectiveOutcomeRow]
    answer_summaries: list[AnswerSummaryRow]
    session_answers: list[SessionAnswerRow]
    answer_frequencies: list[LikertRow]
    score_summaries: list[ScoreSummaryRow]
    families: list[ComparisonFamily]
    models: list[ModelRow]
    biomechanics: list[BiomechanicsRow]
    measure_ranges: list[MeasureRangeRow]
    site_outcomes: list[SiteOutcomeRow]
    site_effects: list[SiteEffectRow]
    latency_summaries: list[LatencyRow]
    rebuilt_at: str | None
    access_log: AccessLogSummary
    adverse_events: list[Mapping[str, Any]]
    functioning: list[dict[str, Any]]
    data_losses: tuple[str, ...]
    repeats: list[RepeatRow]
    repeat_findings: list[str]
    repeats_of_simulated: bool

    @property
    def tests(self) -> list[ComparisonRow]:
        """Returns the rows of all statistical tests, in the order of the families."""
        return [row for family in self.families for row in family.rows]

    def tables(self) -> Iterator[Table]:
        """Yields the tables of the analysis. Each table becomes a CSV file."""
        seen = self.study_data
        yield Table.from_rows("participants", ParticipantRow, seen.participants)
        yield Table.from_rows("sessions", SessionRow, self.sessions)
        yield Table.from_rows("trials", TrialRow, seen.trials)
        yield Table.from_rows("attempts", AttemptRow, seen.attempts)
        yield Table.from_rows("repeats", RepeatRow, self.repeats)
        yield Table.from_rows("answers", AnswerRow, seen.answers)
        yield Table.from_rows("items", ItemVersionRow, self.item_versions)
        yield Table.from_rows("reward_terms", RewardTermRow, seen.reward_terms)
        if seen.streams:
            yield Table.from_rows("streams", StreamRow, seen.streams)
        if seen.commands:
            yield Table.from_rows("commands", CommandRow, seen.commands)
        if self.functioning:
            yield Table("functioning", COLUMNS_BY_TABLE["functioning"], self.functioning)
        yield Table("adverse_events", COLUMNS_BY_TABLE["adverse_events"], self.adverse_events)
        yield Table.from_rows("problems", DataProblemRow, seen.problems)
        yield Table.from_rows("objective", ObjectiveOutcomeRow, self.objective_outcomes)
        yield from paper_csv_tables(list(paper_tables(self.design, self.objective_outcomes)))
        yield Table.from_rows("subjective", AnswerSummaryRow, self.answer_summaries)
        yield Table.from_rows("session_answers", SessionAnswerRow, self.session_answers)
        yield Table.from_rows("likert", LikertRow, self.answer_frequencies)
        if uses_instruments(self.design):
            yield Table.from_rows("scores", ScoreRow, seen.scores)
            yield Table.from_rows("score_summaries", ScoreSummaryRow, self.score_summaries)
        yield Table.from_rows("tests", ComparisonRow, self.tests)
        yield Table.from_rows("models", ModelRow, self.models)
        yield Table.from_rows("biomechanics", BiomechanicsRow, self.biomechanics)
        yield Table.from_rows("ranges", MeasureRangeRow, self.measure_ranges)
        yield Table.from_rows("people", SampledPersonRow, self.training_people)
        if self.site_outcomes:
            yield Table.from_rows("site_outcomes", SiteOutcomeRow, self.site_outcomes)
            yield Table.from_rows("site_effects", SiteEffectRow, self.site_effects)
        yield Table.from_rows("latency", LatencyRow, self.latency_summaries)
        if self.headset_checks:
            yield Table.from_rows("headset_checks", HeadsetRow, self.headset_checks)
        yield control_steps_table(
            seen.trial_series, {row.participant: row for row in seen.participants}, self.design
        )

    def results(self) -> dict[str, Any]:
        """Returns the contents of ``results.json``: all results, without control steps and sampled people."""
        return {
            "format": RESULTS_FORMAT,
            "title": self.design.title,
            "versions": msgspec.to_builtins(versions()),
            "questionnaires": msgspec.to_builtins(self.design.questionnaires),
            "settings": {
                "people_per_task": PEOPLE_PER_TASK,
                "seed": TRAINING_POPULATION_SEED,
                "permutations": PERMUTATION_COUNT,
                "exact_signed_rank": MAX_EXACT_SIGNED_RANK_N,
                "exact_rank_sum": MAX_EXACT_RANK_SUM_N,
            },
            "differences": [
                {"where": each.where, "message": each.message, "is_error": each.is_error}
                for each in self.design_differences
            ],
            **({"plan": plan_results(self.frozen_plan)} if self.frozen_plan else {}),
            **({"database_rebuilt_at": self.rebuilt_at} if self.rebuilt_at else {}),
            "log": asdict(self.access_log),
            **({"losses": list(self.data_losses)} if self.data_losses else {}),
            "repeat_findings": self.repeat_findings,
            **{table.name: list(table.rows) for table in self.tables() if table.name not in CSV_ONLY_TABLES},
        }


def analyse_study(
    store: Store,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    *,
    skip_damaged: bool = False,
) -> StudyAnalysis:
    """Returns the analysis of a study with its current data. Arguments and errors: see ``read_study_data``."""
    fetch_recordings(store)
    answered_items = AnsweredItems(store)
    design = answered_items.design
    observed = read_study_data(store, progress, skip_damaged=skip_damaged, answered_items=answered_items)
    differences = list(check_design(store))
    observed.problems.extend(_problem(each, CURRENT_FILES_TEXT) for each in check_stored_designs(store))
    people = sample_training_people(design)
    groups = body_trials_by_group(observed.trials)
    given = design, observed.answers
    plan = read_frozen_plan(store, design, observed)
    confirmed = plan.confirmatory_plan if plan else None
    families = [
        *outcome_test_families(design, observed.trials),
        *answer_test_families(*given),
        *session_test_families(*given),
        *score_test_families(design, observed.scores),
        *biomechanics_test_families(groups, people),
    ]
    families = add_plan_status(families, confirmed, design) if confirmed else families
    found = assign_result_roles(families, model_rows(design, observed, confirmed), confirmed)
    return StudyAnalysis(
        design=design,
        frozen_plan=plan,
        design_differences=differences,
        session_designs=designs_from_recordings(store),
        item_versions=item_version_rows(store, answered_items),
        study_data=observed,
        flows=participant_flows(store, observed),
        headset_checks=headset_rows(store),
        sessions=session_rows(store, observed.participants),
        body_trials=groups,
        training_people=people,
        objective_outcomes=objective_outcome_rows(store, observed.trials),
        answer_summaries=answer_summary_rows(*given),
        session_answers=session_answer_rows(*given),
        answer_frequencies=likert_rows(*given) + session_likert_rows(*given),
        families=found.families,
        models=found.model_rows,
        score_summaries=score_summary_rows(design, observed.scores),
        biomechanics=biomechanics_rows(groups, people),
        measure_ranges=measure_range_rows(groups),
        site_outcomes=site_outcome_rows(design, observed.trials),
        site_effects=site_effect_rows(design, observed.trials, observed.answers, observed.scores),
        latency_summaries=latency_rows(observed.trials, observed.latencies_by_trial),
        rebuilt_at=store.rebuilt_at(),
        access_log=summarise_access_log(store),
        adverse_events=[
            vars(row) for row in adverse_event_rows(store, store.participants(), DEFAULT_EXPORT_OPTIONS)
        ],
        functioning=[vars(row) for row in functioning_counts(store)] if store.design.ask_functioning else [],
        data_losses=describe_data_loss(store),
        repeats=repeat_rows(attempted_trials(store)),
        repeat_findings=[f"{each.where}: {each.message}" for each in check_repeats(store)],
        repeats_of_simulated=is_simulated_study(store),
    )


def _problem(found: Finding, consequence: str) -> DataProblemRow:
    return DataProblemRow(simulated=None, where=found.where, what=found.message, consequence=consequence)
