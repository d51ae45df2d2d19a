"""The analysis of a study: from its recordings to the paper's results."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import msgspec

from avrgym.analysis import rows
from avrgym.analysis.headset_rows import HeadsetRow, headset_rows
from avrgym.analysis.item_rows import ItemRow, item_rows
from avrgym.analysis.latency_rows import LatencyRow, latency_rows
from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.reading.flow import Flow, flows
from avrgym.analysis.reading.observations import Observations, observe
from avrgym.analysis.reading.study_log import StudyLog, study_log
from avrgym.analysis.reading.trained_people import PEOPLE_PER_TASK, SEED, draw_people
from avrgym.analysis.repeat_rows import RepeatRow, repeat_rows
from avrgym.analysis.score_rows import ScoreRow, ScoreSummaryRow
from avrgym.analysis.site_rows import SiteEffectRow, SiteOutcomeRow
from avrgym.analysis.statistics.biomechanics import Measures, biomechanics_rows, measured_groups, range_rows
from avrgym.analysis.statistics.biomechanics_tests import biomechanics_families
from avrgym.analysis.statistics.families import Family
from avrgym.analysis.statistics.models.models import model_rows
from avrgym.analysis.statistics.objective import objective_rows
from avrgym.analysis.statistics.objective_tests import objective_families
from avrgym.analysis.statistics.offered import offered_tests, optional_tests
from avrgym.analysis.statistics.paper_tables import as_tables, paper_tables
from avrgym.analysis.statistics.primary import judged
from avrgym.analysis.statistics.scores import score_families, score_summary_rows
from avrgym.analysis.statistics.session_answers import (
    session_answer_rows,
    session_families,
    session_likert_rows,
)
from avrgym.analysis.statistics.sites import site_effect_rows, site_outcome_rows
from avrgym.analysis.statistics.subjective import answer_families, likert_rows, subjective_rows
from avrgym.analysis.statistics.tests import EXACT_RANK_SUM, EXACT_SIGNED_RANK, PERMUTATIONS
from avrgym.analysis.stream_rows import StreamRow
from avrgym.analysis.tables import Table, control_steps
from avrgym.study.checking.design_checks import check_design, check_stored_designs
from avrgym.study.checking.finding import Finding, left_out
from avrgym.study.checking.repeat_checks import check_repeats, is_simulated
from avrgym.study.checking.repeats import tried_trials
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import TABLES
from avrgym.study.export.functioning import functioning_rows
from avrgym.study.export.records import WITHOUT, adverse_event_rows
from avrgym.study.export.scores import uses_instruments
from avrgym.study.plan.deviations import deviations
from avrgym.study.plan.frozen_plan import read_frozen
from avrgym.study.plan.plan import EXPLORATORY, NOT_PLANNED, Plan
from avrgym.study.plan.plan import FILE as PLAN_FILE
from avrgym.study.storage.analysis_files import FORMAT_NAME
from avrgym.study.storage.data_loss import loss_words
from avrgym.study.storage.item_versions import Asked
from avrgym.study.storage.session_designs import Use, designs_recorded
from avrgym.study.storage.store import Store
from avrgym.vr.session.attempt import versions

IN_TABLES_ONLY = ("control_steps", "people")
"""Tables too long for the results' file."""
FORMAT = f"{FORMAT_NAME} 1"
ANALYSED_SEPARATELY = (
    "answers to different items are analysed separately, everything else is used as recorded"
)
FROM_FILE = "what recordings do not contain is taken from the study's present files"


@dataclass(frozen=True, eq=False)
class FrozenPlan:
    """A study's frozen plan, if it can still be told, and in what the study deviates from it.

    ``words`` are what is known of its date. ``confirms``: it is known to be from before the first participant.
    ``sha256`` is the checksum of the plan, ``record_sha256`` that of its frozen record.
    """

    at: str
    plan: Plan | None
    sha256: str | None
    deviations: list[Finding]
    words: str
    confirms: bool
    record_sha256: str

    @property
    def confirmed(self) -> Plan | None:
        """The plan that makes tests confirmatory, if there is one."""
        return self.plan if self.confirms else None


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of a study. ``groups`` are the groups of participants with recorded bodies.

    ``design`` is the study's design with all items that participants answered. ``uses`` are the designs that people
    took part with, as recorded, and ``differences`` their differences from the study's present design.
    ``losses`` describe the consequences of a lost database.

    ``repeat_findings`` are about simulated participants if ``repeats_about`` is true, else about people.
    """

    design: Design
    plan: FrozenPlan | None
    differences: list[Finding]
    uses: list[Use]
    items: list[ItemRow]
    observed: Observations
    flows: list[Flow]
    headsets: list[HeadsetRow]
    groups: list[Measures]
    people: list[rows.PersonRow]
    objective: list[rows.ObjectiveRow]
    subjective: list[rows.SubjectiveRow]
    session_answers: list[rows.SessionAnswerRow]
    likert: list[rows.LikertRow]
    score_summaries: list[ScoreSummaryRow]
    families: list[Family]
    models: list[ModelRow]
    biomechanics: list[rows.BiomechanicsRow]
    ranges: list[rows.RangeRow]
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
    repeats_about: bool

    @property
    def tests(self) -> list[rows.TestedRow]:
        """The tests of all families."""
        return [row for family in self.families for row in family.rows]

    def tables(self) -> Iterator[Table]:
        """Every table."""
        seen = self.observed
        yield Table.of("participants", rows.ParticipantRow, seen.participants)
        yield Table.of("trials", rows.TrialRow, seen.trials)
        yield Table.of("attempts", rows.AttemptRow, seen.attempts)
        yield Table.of("repeats", RepeatRow, self.repeats)
        yield Table.of("answers", rows.AnswerRow, seen.answers)
        yield Table.of("items", ItemRow, self.items)
        yield Table.of("reward_terms", rows.TermRow, seen.terms)
        if seen.streams:
            yield Table.of("streams", StreamRow, seen.streams)
        if self.functioning:
            yield Table("functioning", list(TABLES["functioning"]), self.functioning)
        yield Table("adverse_events", list(TABLES["adverse_events"]), self.adverse_events)
        yield Table.of("problems", rows.ProblemRow, seen.problems)
        yield Table.of("objective", rows.ObjectiveRow, self.objective)
        yield from as_tables(list(paper_tables(self.design, self.objective)))
        yield Table.of("subjective", rows.SubjectiveRow, self.subjective)
        yield Table.of("session_answers", rows.SessionAnswerRow, self.session_answers)
        yield Table.of("likert", rows.LikertRow, self.likert)
        if uses_instruments(self.design):
            yield Table.of("scores", ScoreRow, seen.scores)
            yield Table.of("score_summaries", ScoreSummaryRow, self.score_summaries)
        yield Table.of("tests", rows.TestedRow, self.tests)
        yield Table.of("models", ModelRow, self.models)
        yield Table.of("biomechanics", rows.BiomechanicsRow, self.biomechanics)
        yield Table.of("ranges", rows.RangeRow, self.ranges)
        yield Table.of("people", rows.PersonRow, self.people)
        if self.site_outcomes:
            yield Table.of("site_outcomes", SiteOutcomeRow, self.site_outcomes)
            yield Table.of("site_effects", SiteEffectRow, self.site_effects)
        yield Table.of("latency", LatencyRow, self.latency)
        if self.headsets:
            yield Table.of("headset_checks", HeadsetRow, self.headsets)
        yield control_steps(seen.series, {row.participant: row for row in seen.participants})

    def results(self) -> dict[str, Any]:
        """Every number but those of single control steps and of the people drawn, which only tables hold."""
        return {
            "format": FORMAT,
            "title": self.design.title,
            "versions": versions(),
            "questionnaires": msgspec.to_builtins(self.design.questionnaires),
            "settings": {
                "people_per_task": PEOPLE_PER_TASK,
                "seed": SEED,
                "permutations": PERMUTATIONS,
                "exact_signed_rank": EXACT_SIGNED_RANK,
                "exact_rank_sum": EXACT_RANK_SUM,
            },
            "differences": [
                {"where": each.where, "what": each.what, "wrong": each.wrong} for each in self.differences
            ],
            **({"plan": _plan_results(self.plan)} if self.plan else {}),
            **({"database_rebuilt_at": self.rebuilt_at} if self.rebuilt_at else {}),
            "log": asdict(self.log),
            **({"losses": list(self.losses)} if self.losses else {}),
            "repeat_findings": self.repeat_findings,
            **{table.name: list(table.rows) for table in self.tables() if table.name not in IN_TABLES_ONLY},
        }


def analyse(
    store: Store,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    *,
    skip_damaged: bool = False,
) -> Analysis:
    """Analyse a study as it stands, with ``observe``'s arguments and errors."""
    asked = Asked(store)
    design = asked.design
    observed = observe(store, progress, skip_damaged=skip_damaged, asked=asked)
    differences = list(check_design(store))
    observed.problems.extend(_problem(each, ANALYSED_SEPARATELY) for each in differences)
    observed.problems.extend(_problem(each, FROM_FILE) for each in check_stored_designs(store))
    people = draw_people(design)
    groups = measured_groups(observed.trials)
    given = design, observed.answers
    plan = _frozen_plan(store, design, observed)
    confirmed = plan.confirmed if plan else None
    families = [
        *objective_families(design, observed.trials),
        *answer_families(*given),
        *session_families(*given),
        *score_families(design, observed.scores),
        *biomechanics_families(groups, people),
    ]
    families = _labelled(families, confirmed, design) if confirmed else families
    found = judged(families, model_rows(design, observed, confirmed), confirmed)
    return Analysis(
        design=design,
        plan=plan,
        differences=differences,
        uses=designs_recorded(store),
        items=item_rows(store, asked),
        observed=observed,
        flows=flows(store, observed),
        headsets=headset_rows(store),
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
        adverse_events=list(adverse_event_rows(store, store.participants(), WITHOUT)),
        functioning=list(functioning_rows(store)) if store.design.ask_functioning else [],
        losses=loss_words(store),
        repeats=repeat_rows(tried_trials(store)),
        repeat_findings=[f"{each.where}: {each.what}" for each in check_repeats(store)],
        repeats_about=is_simulated(store),
    )


def _problem(found: Finding, consequence: str) -> rows.ProblemRow:
    return rows.ProblemRow(simulated=None, where=found.where, what=found.what, consequence=consequence)


def _frozen_plan(store: Store, design: Design, observed: Observations) -> FrozenPlan | None:
    frozen = read_frozen(store)
    if frozen is None:
        return None
    exclusions = [
        left_out(row.participant, row.position, row.left_out) for row in observed.trials if row.left_out
    ]
    found = deviations(store, frozen, offered_tests(design), exclusions, optional_tests(design))
    record = frozen.record
    return FrozenPlan(
        at=frozen.at,
        plan=record.parsed() if record else None,
        sha256=record.sha256[PLAN_FILE] if record else None,
        deviations=found,
        words=frozen.words,
        confirms=frozen.confirms,
        record_sha256=frozen.sha256,
    )


def _labelled(families: list[Family], plan: Plan, design: Design) -> list[Family]:
    """The families with what each test is by the plan; what it need not name is exploratory."""
    optional = optional_tests(design)

    def label(row: rows.TestedRow) -> str:
        by_plan = plan.label(row.family, row.quantity)
        return EXPLORATORY if by_plan == NOT_PLANNED and row.family in optional else by_plan

    return [
        replace(family, rows=tuple(replace(row, planned=label(row)) for row in family.rows))
        for family in families
    ]


def _plan_results(plan: FrozenPlan) -> dict[str, Any]:
    return {
        "frozen_at": plan.at,
        "sha256": plan.sha256,
        "record_sha256": plan.record_sha256,
        "origin": plan.words,
        "confirms": plan.confirms,
        "plan": None if plan.plan is None else msgspec.to_builtins(plan.plan),
        "deviations": [{"where": each.where, "what": each.what} for each in plan.deviations],
    }
