"""Read the data of a study: participants, trials, attempts, answers and recordings of completed trials."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from statistics import fmean, median

import numpy as np
from msgspec.structs import asdict

from avrgym.analysis.reading.answers import ParticipantAnswers
from avrgym.analysis.reading.commands import TrialCommandsRow, make_trial_commands_row
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
from avrgym.analysis.reading.trial_time_series import (
    BodyPostureSeries,
    TrialTimeSeries,
    describe_version_differences,
    read_trial_time_series,
)
from avrgym.recording.reader import Recording, RecordingError
from avrgym.recording.schema import Latency
from avrgym.recording.streams import compute_stream_quality
from avrgym.safety.force_guard import INTERVENTION_EVENT
from avrgym.study.checking.plugin_checks import (
    RecordedPlugin,
    compare_recorded_plugins,
    list_recorded_plugins,
)
from avrgym.study.checking.tracking_loss import compute_tracking_loss_fraction, describe_excess_tracking_loss
from avrgym.study.export.exported_attempts import ExportedAttempt, list_all_attempts
from avrgym.study.plan.exclusion_rules import find_rule_violations
from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence
from avrgym.study.storage.attempts import CHECKSUM_MISMATCH_MESSAGE
from avrgym.study.storage.database_rows import Participant, Trial
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.sites import SITE_DIFFERENCE_EVENT
from avrgym.study.storage.state_transitions import ALLOCATED_STATES, StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import find_task_and_scene

RESULTS_FROM_DATABASE_TEXT = "reward and success come from the database"
NO_BIOMECHANICS_TEXT = f"{RESULTS_FROM_DATABASE_TEXT}; the trial is not in the biomechanics"
NO_TIME_SERIES_TEXT = (
    f"{RESULTS_FROM_DATABASE_TEXT}; the trial is not in the biomechanics and has no time series"
)
UNUSED_TOPICS = ("/physics",)
"""Topics of recordings that no table uses. They are not read, because they are most of a recording."""
TrialKey = tuple[str, int]
"""Key of a trial: (pseudonym of the participant, position of the trial)."""


@dataclass(frozen=True)
class StudyData:
    """The data of a study. Rows are sorted by participant and trial.

    ``time_series_by_trial``, ``latencies_by_trial``: time series and latency measurements of each recorded trial.
    ``plugins``: plug-ins in the recordings.
    """

    participants: list[ParticipantRow] = field(default_factory=list[ParticipantRow])
    trials: list[TrialRow] = field(default_factory=list[TrialRow])
    attempts: list[AttemptRow] = field(default_factory=list[AttemptRow])
    answers: list[AnswerRow] = field(default_factory=list[AnswerRow])
    scores: list[ScoreRow] = field(default_factory=list[ScoreRow])
    reward_terms: list[RewardTermRow] = field(default_factory=list[RewardTermRow])
    streams: list[StreamRow] = field(default_factory=list[StreamRow])
    commands: list[TrialCommandsRow] = field(default_factory=list[TrialCommandsRow])
    problems: list[DataProblemRow] = field(default_factory=list[DataProblemRow])
    time_series_by_trial: dict[TrialKey, TrialTimeSeries] = field(
        default_factory=dict[TrialKey, TrialTimeSeries]
    )
    latencies_by_trial: dict[TrialKey, list[Latency]] = field(default_factory=dict[TrialKey, list[Latency]])
    plugins: list[RecordedPlugin] = field(default_factory=list[RecordedPlugin])

    @property
    def analysed_pseudonyms(self) -> set[str]:
        """Returns the pseudonyms of all participants with an analysed trial or an analysed answer."""
        return {row.participant for row in (*self.trials, *self.answers) if row.counted}

    def find_analysed_participants(self, *, simulated: bool) -> list[ParticipantRow]:
        """Returns the rows of the analysed people, or of the analysed simulated participants if ``simulated``."""
        analysed = self.analysed_pseudonyms
        return [
            row for row in self.participants if row.simulated is simulated and row.participant in analysed
        ]


def read_study_data(
    store: StudyStore,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    *,
    skip_damaged: bool = False,
    answered_items: AnsweredItems | None = None,
) -> StudyData:
    """Returns the data of a study. The rows ``problems`` contain the unusable recordings.

    Args:
        store: the study.
        progress: called after each recording with the number of read recordings and the total number.
        skip_damaged: whether to ignore recording files that were changed after the trial.
        answered_items: the answered items of the study. By default, they are read from ``store``.

    Raises:
        StudyError: if recording files were changed after their trials, unless ``skip_damaged``. The message contains
            the file names.
    """
    answered_items = answered_items or AnsweredItems(store)
    found = StudyData(problems=list(_site_problems(store)))
    attempts = list(list_all_attempts(store))
    attempts_by_trial: dict[int, list[ExportedAttempt]] = defaultdict(list)
    attempts_by_participant: dict[str, list[ExportedAttempt]] = defaultdict(list)
    for each in attempts:
        attempts_by_trial[each.trial.id].append(each)
        attempts_by_participant[each.participant.pseudonym].append(each)
    completed = {each.trial.id: each for each in attempts if each.attempt.state == "completed"}
    changed = {key for key, each in completed.items() if each.is_recording_changed()}
    if changed and not skip_damaged:
        raise StudyError(_refusal([each for key, each in completed.items() if key in changed]))
    num_read = 0
    for participant in store.read_participants():
        for trial in store.read_trials(participant.pseudonym):
            row = _trial(participant, trial, attempts_by_trial[trial.id])
            if trial.id in completed:
                row = _read_recording(completed[trial.id], row, found, changed=trial.id in changed)
                num_read += 1
                progress(num_read, len(completed))
            found.trials.append(row)
    found.problems.extend(_plugin_problems(found.plugins))
    found.attempts.extend(_attempt(each) for each in attempts)
    _exclude_by_rules(store, found)
    counted: dict[str, set[int]] = defaultdict(set)
    for row in found.trials:
        if row.counted:
            counted[row.participant].add(row.position)
    for participant in store.read_participants():
        own, positions = attempts_by_participant[participant.pseudonym], counted[participant.pseudonym]
        answered = ParticipantAnswers(store, participant, own, positions, answered_items)
        found.problems.extend(answered.find_problems())
        found.answers.extend(answered.make_answer_rows())
        found.scores.extend(answered.make_score_rows())
        found.participants.append(_participant(store, participant, found))
    return found


def _exclude_by_rules(store: StudyStore, found: StudyData) -> None:
    """Exclude all trials of participants that violate an exclusion rule of the frozen plan. Report each violation."""
    frozen = read_frozen_plan_evidence(store)
    rules = (
        ()
        if frozen is None or frozen.frozen_plan is None
        else frozen.frozen_plan.parse_plan().exclusion.rules
    )
    reasons: dict[str, str] = {}
    for each in find_rule_violations(store, rules):
        reasons[each.participant] = "; ".join(filter(None, (reasons.get(each.participant), each.reason)))
    for index, row in enumerate(found.trials):
        if row.counted and row.participant in reasons:
            found.trials[index] = replace(row, counted=False, left_out=reasons[row.participant])
    simulated = {row.participant: row.simulated for row in found.trials}
    found.problems.extend(
        DataProblemRow(
            simulated=simulated[participant],
            where=participant,
            what=f"is left out: {reason}",
            consequence="no trial of this participant is in the analysis",
        )
        for participant, reason in reasons.items()
        if participant in simulated
    )


def _site_problems(store: StudyStore) -> Iterator[DataProblemRow]:
    """Yields a problem for each difference between the sites of a merged study."""
    for event in store.read_events():
        if event.name == SITE_DIFFERENCE_EVENT:
            what = f"were merged although {event.detail}"
            yield DataProblemRow(
                simulated=None, where="sites", what=what, consequence="all sites are analysed together"
            )


def _plugin_problems(plugins: Sequence[RecordedPlugin]) -> Iterator[DataProblemRow]:
    """Yields a problem for each plug-in that differs between trials, is not installed, or was not stored."""
    for simulated in (False, True):
        for found in compare_recorded_plugins(each for each in plugins if each.is_simulated is simulated):
            yield DataProblemRow(
                simulated=simulated,
                where=found.where,
                what=found.message,
                consequence="the recordings are used unchanged",
            )


def _refusal(changed: Sequence[ExportedAttempt]) -> str:
    faults = "; ".join(f"{each.attempt.recording} {CHECKSUM_MISMATCH_MESSAGE}" for each in changed)
    return f"analysis not started: {faults}; to ignore damaged recordings, use --skip-damaged"


def _trial(participant: Participant, trial: Trial, attempts: Sequence[ExportedAttempt]) -> TrialRow:
    task, robot = trial.task, trial.robot
    takes_part = participant.state in ALLOCATED_STATES
    return TrialRow(
        participant=participant.pseudonym,
        site=participant.site,
        simulated=participant.simulated,
        participant_state=participant.state,
        sex=participant.sex,
        position=trial.position,
        practice=trial.practice,
        task=task,
        robot=robot,
        policy=trial.policy,
        seed=trial.seed,
        state=trial.state,
        attempts=len(attempts),
        attempts_not_completed=sum(each.attempt.state not in ("completed", "running") for each in attempts),
        counted=trial.state == "completed" and not trial.practice and takes_part,
    )


# One recording


def _read_recording(exported: ExportedAttempt, row: TrialRow, found: StudyData, *, changed: bool) -> TrialRow:
    """Returns the row of a trial with metrics from its recording.

    Adds time series, reward terms and problems to ``found``. ``changed``: whether the file was changed after the trial.
    A changed file is not used.
    """
    row = replace(row, recording=exported.attempt.recording, **asdict(exported.attempt.metrics))

    def tell(what: str, consequence: str) -> None:
        found.problems.append(
            DataProblemRow(
                simulated=row.simulated,
                where=exported.attempt.recording,
                what=what,
                consequence=consequence,
            )
        )

    if changed:
        tell(CHECKSUM_MISMATCH_MESSAGE, NO_TIME_SERIES_TEXT)
        return replace(row, recorded="changed")
    try:
        recording = exported.read_recording(undecoded=UNUSED_TOPICS)
    except FileNotFoundError:
        tell("is missing", NO_TIME_SERIES_TEXT)
        return replace(row, recorded="missing")
    except (OSError, RecordingError, StudyError) as error:
        tell(f"cannot be read: {_without_path(error, exported)}", NO_TIME_SERIES_TEXT)
        return replace(row, recorded="unreadable")
    if recording.configuration.simulated is not row.simulated:
        tell(
            "and the study differ in whether the participant was simulated",
            "the trial is not in the analysis",
        )
        return replace(row, recorded="contradictory", counted=False)
    found.plugins.extend(
        list_recorded_plugins(recording.configuration, row.participant, row.position, simulated=row.simulated)
    )
    row = replace(row, tracking_loss_share=compute_tracking_loss_fraction(recording))
    left_out = describe_excess_tracking_loss(recording, exported.store.design) if row.counted else None
    if left_out is not None:
        tell(f"is left out: {left_out}", "the trial is not in the analysis")
        row = replace(row, counted=False, left_out=left_out)
    versions = describe_version_differences(recording)
    if versions:
        tell(f"was recorded with {versions}", "the recording is used unchanged")
    return _add_measures(recording, row, found, tell)


def _without_path(error: Exception, exported: ExportedAttempt) -> str:
    """Returns the error message without the path of the recording. Results must not depend on the path of the study."""
    return str(error).replace(f"{exported.store.resolve_path(exported.attempt.recording)}: ", "")


def _add_measures(
    recording: Recording, row: TrialRow, found: StudyData, tell: Callable[[str, str], None]
) -> TrialRow:
    configuration = recording.configuration
    _, scene = find_task_and_scene(configuration.environment, configuration.settings)
    measured = read_trial_time_series(recording, scene.posture)
    recorded = _kind(recording, measured)
    if recorded == "cut off":
        tell(
            f"is cut off: it contains {len(measured.control_steps)} of {row.steps} control steps",
            NO_BIOMECHANICS_TEXT,
        )
    elif recorded == "without a body":
        tell("does not contain the body model of this version", NO_BIOMECHANICS_TEXT)
    if measured.control_steps:
        found.time_series_by_trial[row.participant, row.position] = measured
        found.reward_terms.extend(_terms(row, measured))
        row = replace(row, **_step_metrics(measured))
    told = [record for _, record in recording.messages_by_topic["/latency"]]
    if told:
        found.latencies_by_trial[row.participant, row.position] = told
    row = replace(row, guard_interventions=count_guard_interventions(recording))
    found.streams.extend(_streams(row, recording))
    commands = make_trial_commands_row(recording, row, recording.configuration.settings.control_step_s)
    if commands is not None:
        found.commands.append(commands)
    if recorded == "whole" and row.reward != row.reward_recorded:
        tell(
            f"has a total reward of {row.reward_recorded}, the database {row.reward}",
            "the value in the database is used",
        )
    if recorded == "whole" and measured.posture_series is not None:
        row = replace(row, **_body_metrics(measured.posture_series))
    return replace(row, recorded=recorded)


def _kind(recording: Recording, measured: TrialTimeSeries) -> str:
    if not recording.is_complete:
        return "cut off"
    return "without a body" if measured.posture_series is None else "whole"


def _step_metrics(measured: TrialTimeSeries) -> dict[str, float]:
    forces = [step.force_on_person_n for step in measured.control_steps]
    return {
        "reward_recorded": _sum_in_order(step.reward for step in measured.control_steps),
        "distance_min_m": min(step.distance_m for step in measured.control_steps),
        "force_mean_n": fmean(forces),
        "force_peak_n": max(forces),
    }


def _streams(row: TrialRow, recording: Recording) -> list[StreamRow]:
    whose = {name: getattr(row, name) for name in ("participant", "site", "simulated", "position")}
    return [
        StreamRow(**whose, **vars(figures)) for figures in compute_stream_quality(recording.messages_by_topic)
    ]


def count_guard_interventions(recording: Recording) -> int | None:
    """Returns the number of force guard interventions in a recording; ``None`` if the guard was off."""
    if not recording.configuration.force_guard:
        return None
    return sum(event.name == INTERVENTION_EVENT for _, event in recording.messages_by_topic["/events"])


def _body_metrics(body: BodyPostureSeries) -> dict[str, float]:
    metrics = {"torso_height_m": body.torso_height_m}
    head = body.head_centre_pos_w.mean(axis=0)
    waist = np.degrees(body.waist_angles_rad)
    for index, axis in enumerate("xyz"):
        metrics[f"head_{axis}_m"] = float(head[index])
        metrics[f"waist_{axis}_deg"] = float(waist[:, index].mean())
        metrics[f"waist_{axis}_min_deg"] = float(waist[:, index].min())
        metrics[f"waist_{axis}_max_deg"] = float(waist[:, index].max())
    return metrics


def _terms(row: TrialRow, measured: TrialTimeSeries) -> list[RewardTermRow]:
    names = dict.fromkeys(name for step in measured.control_steps for name in step.reward_terms)
    sums = {
        name: _sum_in_order(step.reward_terms.get(name, 0.0) for step in measured.control_steps)
        for name in names
    }
    weights = measured.reward_weights
    return [
        RewardTermRow(
            participant=row.participant,
            site=row.site,
            simulated=row.simulated,
            position=row.position,
            term=name,
            sum=total,
            weight=weights.get(name),
            weighted_sum=weights[name] * total if name in weights else None,
        )
        for name, total in sums.items()
    ]


# Attempts, participants


def _attempt(exported: ExportedAttempt) -> AttemptRow:
    attempt = exported.attempt
    metrics = asdict(attempt.metrics)
    return AttemptRow(
        **vars(exported.make_identifiers()), state=attempt.state, **metrics, recording=attempt.recording
    )


def _participant(store: StudyStore, participant: Participant, found: StudyData) -> ParticipantRow:
    trials = [row for row in found.trials if row.participant == participant.pseudonym]
    heights = [row.torso_height_m for row in trials if row.counted and row.torso_height_m is not None]
    completed = sum(row.state == "completed" for row in trials)
    return ParticipantRow(
        participant=participant.pseudonym,
        site=participant.site,
        site_participant=participant.pseudonym_at_site,
        simulated=participant.simulated,
        state=participant.state,
        sex=participant.sex,
        age_years=participant.age_years,
        language=participant.language or store.design.languages[0],
        torso_height_m=median(heights) if heights else None,
        sessions=len(store.read_sessions(participant.pseudonym)),
        trials=len(trials),
        trials_completed=completed,
        trials_missing=len(trials) - completed,
        attempts=sum(row.attempts for row in trials),
        attempts_not_completed=sum(row.attempts_not_completed for row in trials),
    )


def _sum_in_order(values: Iterable[float]) -> float:
    """Returns the sum of the values, added in order as in the session. From Python 3.12, ``sum`` rounds differently."""
    return reduce(add, values, 0.0)
