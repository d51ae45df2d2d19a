"""Analyse a study: compute all tables and tests from recordings and database."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import msgspec

from avrgym.analysis.access_log import AccessLogSummary, summarise_access_log
from avrgym.analysis.answers.scores import (
    ScoreSummaryRow,
    compute_score_test_families,
    make_score_summary_rows,
)
from avrgym.analysis.answers.session_answers import (
    SessionAnswerSummaryRow,
    compute_session_test_families,
    make_session_answer_frequency_rows,
    make_session_answer_rows,
)
from avrgym.analysis.answers.trial_answers import (
    AnswerFrequencyRow,
    AnswerSummaryRow,
    compute_answer_test_families,
    make_answer_frequency_rows,
    make_answer_summary_rows,
)
from avrgym.analysis.biomechanics.body_measures import (
    BodyMeasureRangeRow,
    BodyMeasureRow,
    PostureTrials,
    group_posture_trials,
    make_body_measure_range_rows,
    make_body_measure_rows,
)
from avrgym.analysis.biomechanics.population_tests import compute_biomechanics_test_families
from avrgym.analysis.biomechanics.training_populations import (
    SAMPLED_PEOPLE_PER_TASK,
    SampledPersonRow,
    sample_training_populations,
)
from avrgym.analysis.designs import ItemVersionRow, make_item_version_rows
from avrgym.analysis.headsets import HeadsetCheckRow, make_headset_check_rows
from avrgym.analysis.latency import LatencyRow, make_latency_rows
from avrgym.analysis.models.regression_models import ModelEffectRow, make_model_effect_rows
from avrgym.analysis.outcomes.condition_outcomes import (
    ObjectiveOutcomeRow,
    compute_outcome_test_families,
    make_objective_outcome_rows,
)
from avrgym.analysis.outcomes.paper_tables import make_paper_csv_tables, make_paper_tables
from avrgym.analysis.participant_flow import ParticipantFlow, compute_participant_flows
from avrgym.analysis.plan import (
    PlanWithDeviations,
    add_plan_status,
    make_plan_results,
    read_plan_with_deviations,
)
from avrgym.analysis.primary_results import assign_result_roles
from avrgym.analysis.reading.commands import TrialCommandsRow
from avrgym.analysis.reading.study_data import StudyData, read_study_data
from avrgym.analysis.reading.table_rows import (
    AnswerRow,
    AttemptRow,
    DataProblemRow,
    ParticipantRow,
    RewardTermRow,
    ScoreRow,
    StreamRow,
    TrialRow,
)
from avrgym.analysis.repeated_trials import RepeatedTrialsRow, make_repeated_trials_rows
from avrgym.analysis.sessions import SessionRow, make_session_rows
from avrgym.analysis.sites import SiteEffectRow, SiteOutcomeRow, make_site_effect_rows, make_site_outcome_rows
from avrgym.analysis.statistics.comparisons import ComparisonFamily, ComparisonRow
from avrgym.analysis.statistics.rank_tests import (
    MAX_EXACT_RANK_SUM_N,
    MAX_EXACT_SIGNED_RANK_N,
    PERMUTATION_COUNT,
)
from avrgym.analysis.tables import Table, make_control_steps_table
from avrgym.study.checking.design_checks import check_design, check_stored_designs
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.repeat_checks import check_repeats, is_simulated_study
from avrgym.study.checking.repeats import list_attempted_trials
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.event_tables import DEFAULT_EXPORT_OPTIONS, make_adverse_event_rows
from avrgym.study.export.functioning import count_functioning_answers
from avrgym.study.export.scores import uses_instruments
from avrgym.study.storage.analysis_files import ANALYSIS_FORMAT
from avrgym.study.storage.data_loss import describe_data_loss
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.session_designs import SessionDesign, read_designs_from_recordings
from avrgym.study.storage.store import StudyStore
from avrgym.system.random_streams import TRAINING_POPULATION_SEED
from avrgym.vr.session.attempt import read_package_versions

CSV_ONLY_TABLES = ("control_steps", "people")
"""Names of the tables that are only in CSV files. They are too long for ``make_results.json``."""
RESULTS_FORMAT = f"{ANALYSIS_FORMAT} 1"
CURRENT_FILES_TEXT = "data that recordings do not contain are taken from the current files of the study"


@dataclass(frozen=True, eq=False)
class StudyAnalysis:
    """The results of a study.

    Attributes:
        design: the current design with all answered items.
        plan_with_deviations: the frozen plan; ``None`` without a frozen plan.
        design_differences: differences between the recorded designs and the current design.
        session_designs: the recorded designs of the participants.
        item_versions: versions of answered items.
        study_data: the data of the study.
        participant_flows: number of participants at each step: of people, then of simulated participants.
        headset_checks: headset checks of sessions.
        sessions: day, trials and time in VR of each session.
        posture_trials: analysed trials with recorded body posture: of people, then of simulated participants.
        training_people: people sampled from the training populations.
        objective_outcomes: reward and success of each condition.
        answer_summaries: summaries of answers after trials.
        session_answers: summaries of answers before and after sessions, after breaks, and of caregivers.
        answer_frequencies: frequency of each value of each item.
        score_summaries: summaries of questionnaire scores.
        test_families: families of tests.
        model_effects: effects in regression models.
        biomechanics_rows, measure_ranges: distributions and ranges of body measures.
        site_outcomes, site_effects: results of each site; empty for a single site.
        latency_summaries: latency from pose to displayed frame.
        database_rebuilt_at: time of the rebuild of the database; ``None`` if it was not rebuilt.
        access_log: summary of the access log.
        adverse_events: all reports of adverse events, with follow-ups.
        functioning_counts: numbers of answers about functioning.
        data_losses: consequences of a lost database, as sentences.
        repeated_trials: repeated trials by condition.
        repeat_findings: results of the tests of repeats.
        are_repeats_simulated: whether ``repeat_findings`` are about simulated participants (otherwise about people).
    """

    design: Design
    plan_with_deviations: PlanWithDeviations | None
    design_differences: list[Finding]
    session_designs: list[SessionDesign]
    item_versions: list[ItemVersionRow]
    study_data: StudyData
    participant_flows: list[ParticipantFlow]
    headset_checks: list[HeadsetCheckRow]
    sessions: list[SessionRow]
    posture_trials: list[PostureTrials]
    training_people: list[SampledPersonRow]
    objective_outcomes: list[ObjectiveOutcomeRow]
    answer_summaries: list[AnswerSummaryRow]
    session_answers: list[SessionAnswerSummaryRow]
    answer_frequencies: list[AnswerFrequencyRow]
    score_summaries: list[ScoreSummaryRow]
    test_families: list[ComparisonFamily]
    model_effects: list[ModelEffectRow]
    biomechanics_rows: list[BodyMeasureRow]
    measure_ranges: list[BodyMeasureRangeRow]
    site_outcomes: list[SiteOutcomeRow]
    site_effects: list[SiteEffectRow]
    latency_summaries: list[LatencyRow]
    database_rebuilt_at: str | None
    access_log: AccessLogSummary
    adverse_events: list[Mapping[str, Any]]
    functioning_counts: list[dict[str, Any]]
    data_losses: tuple[str, ...]
    repeated_trials: list[RepeatedTrialsRow]
    repeat_findings: list[str]
    are_repeats_simulated: bool

    @property
    def tests(self) -> list[ComparisonRow]:
        """Returns the rows of all statistical tests, in the order of the families."""
        return [row for family in self.test_families for row in family.rows]

    def make_tables(self) -> Iterator[Table]:
        """Yields the tables of the analysis. Each table becomes a CSV file."""
        seen = self.study_data
        yield Table.from_rows("participants", ParticipantRow, seen.participants)
        yield Table.from_rows("sessions", SessionRow, self.sessions)
        yield Table.from_rows("trials", TrialRow, seen.trials)
        yield Table.from_rows("attempts", AttemptRow, seen.attempts)
        yield Table.from_rows("repeats", RepeatedTrialsRow, self.repeated_trials)
        yield Table.from_rows("answers", AnswerRow, seen.answers)
        yield Table.from_rows("items", ItemVersionRow, self.item_versions)
        yield Table.from_rows("reward_terms", RewardTermRow, seen.reward_terms)
        if seen.streams:
            yield Table.from_rows("streams", StreamRow, seen.streams)
        if seen.commands:
            yield Table.from_rows("commands", TrialCommandsRow, seen.commands)
        if self.functioning_counts:
            yield Table("functioning", COLUMNS_BY_TABLE["functioning"], self.functioning_counts)
        yield Table("adverse_events", COLUMNS_BY_TABLE["adverse_events"], self.adverse_events)
        yield Table.from_rows("problems", DataProblemRow, seen.problems)
        yield Table.from_rows("objective", ObjectiveOutcomeRow, self.objective_outcomes)
        yield from make_paper_csv_tables(list(make_paper_tables(self.design, self.objective_outcomes)))
        yield Table.from_rows("subjective", AnswerSummaryRow, self.answer_summaries)
        yield Table.from_rows("session_answers", SessionAnswerSummaryRow, self.session_answers)
        yield Table.from_rows("likert", AnswerFrequencyRow, self.answer_frequencies)
        if uses_instruments(self.design):
            yield Table.from_rows("scores", ScoreRow, seen.scores)
            yield Table.from_rows("score_summaries", ScoreSummaryRow, self.score_summaries)
        yield Table.from_rows("tests", ComparisonRow, self.tests)
        yield Table.from_rows("models", ModelEffectRow, self.model_effects)
        yield Table.from_rows("biomechanics", BodyMeasureRow, self.biomechanics_rows)
        yield Table.from_rows("ranges", BodyMeasureRangeRow, self.measure_ranges)
        yield Table.from_rows("people", SampledPersonRow, self.training_people)
        if self.site_outcomes:
            yield Table.from_rows("site_outcomes", SiteOutcomeRow, self.site_outcomes)
            yield Table.from_rows("site_effects", SiteEffectRow, self.site_effects)
        yield Table.from_rows("latency", LatencyRow, self.latency_summaries)
        if self.headset_checks:
            yield Table.from_rows("headset_checks", HeadsetCheckRow, self.headset_checks)
        yield make_control_steps_table(
            seen.time_series_by_trial, {row.participant: row for row in seen.participants}, self.design
        )

    def make_results(self) -> dict[str, Any]:
        """Returns the contents of ``make_results.json``: all results, without control steps and sampled people."""
        return {
            "format": RESULTS_FORMAT,
            "title": self.design.title,
            "versions": msgspec.to_builtins(read_package_versions()),
            "questionnaires": msgspec.to_builtins(self.design.questionnaires),
            "settings": {
                "people_per_task": SAMPLED_PEOPLE_PER_TASK,
                "seed": TRAINING_POPULATION_SEED,
                "permutations": PERMUTATION_COUNT,
                "exact_signed_rank": MAX_EXACT_SIGNED_RANK_N,
                "exact_rank_sum": MAX_EXACT_RANK_SUM_N,
            },
            "differences": [
                {"where": each.where, "message": each.message, "is_error": each.is_error}
                for each in self.design_differences
            ],
            **({"plan": make_plan_results(self.plan_with_deviations)} if self.plan_with_deviations else {}),
            **({"database_rebuilt_at": self.database_rebuilt_at} if self.database_rebuilt_at else {}),
            "log": asdict(self.access_log),
            **({"losses": list(self.data_losses)} if self.data_losses else {}),
            "repeat_findings": self.repeat_findings,
            **{
                table.name: list(table.rows)
                for table in self.make_tables()
                if table.name not in CSV_ONLY_TABLES
            },
        }


def analyse_study(
    store: StudyStore,
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
    people = sample_training_populations(design)
    groups = group_posture_trials(observed.trials)
    given = design, observed.answers
    plan = read_plan_with_deviations(store, design, observed)
    confirmed = plan.confirmatory_plan if plan else None
    families = [
        *compute_outcome_test_families(design, observed.trials),
        *compute_answer_test_families(*given),
        *compute_session_test_families(*given),
        *compute_score_test_families(design, observed.scores),
        *compute_biomechanics_test_families(groups, people),
    ]
    families = add_plan_status(families, confirmed, design) if confirmed else families
    found = assign_result_roles(families, make_model_effect_rows(design, observed, confirmed), confirmed)
    return StudyAnalysis(
        design=design,
        plan_with_deviations=plan,
        design_differences=differences,
        session_designs=read_designs_from_recordings(store),
        item_versions=make_item_version_rows(store, answered_items),
        study_data=observed,
        participant_flows=compute_participant_flows(store, observed),
        headset_checks=make_headset_check_rows(store),
        sessions=make_session_rows(store, observed.participants),
        posture_trials=groups,
        training_people=people,
        objective_outcomes=make_objective_outcome_rows(store, observed.trials),
        answer_summaries=make_answer_summary_rows(*given),
        session_answers=make_session_answer_rows(*given),
        answer_frequencies=make_answer_frequency_rows(*given) + make_session_answer_frequency_rows(*given),
        test_families=found.families,
        model_effects=found.model_rows,
        score_summaries=make_score_summary_rows(design, observed.scores),
        biomechanics_rows=make_body_measure_rows(groups, people),
        measure_ranges=make_body_measure_range_rows(groups),
        site_outcomes=make_site_outcome_rows(design, observed.trials),
        site_effects=make_site_effect_rows(design, observed.trials, observed.answers, observed.scores),
        latency_summaries=make_latency_rows(observed.trials, observed.latencies_by_trial),
        database_rebuilt_at=store.read_database_rebuild_time(),
        access_log=summarise_access_log(store),
        adverse_events=[
            vars(row)
            for row in make_adverse_event_rows(store, store.read_participants(), DEFAULT_EXPORT_OPTIONS)
        ],
        functioning_counts=[vars(row) for row in count_functioning_answers(store)]
        if store.design.ask_functioning
        else [],
        data_losses=describe_data_loss(store),
        repeated_trials=make_repeated_trials_rows(list_attempted_trials(store)),
        repeat_findings=[f"{each.where}: {each.message}" for each in check_repeats(store)],
        are_repeats_simulated=is_simulated_study(store),
    )


def _problem(found: Finding, consequence: str) -> DataProblemRow:
    return DataProblemRow(simulated=None, where=found.where, what=found.message, consequence=consequence)
