"""Rebuild a lost database from the recordings and the participation list."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import sqlalchemy as sa

from avrgym.commands.respondents import PARTICIPANT_RESPONDENT
from avrgym.recording import answers_file
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import Recording, RecordingError, read_header, read_recording
from avrgym.recording.writer import complete_truncated_recording
from avrgym.study.checking.participation_checks import (
    find_participation_list_error,
    format_restored_recordings_message,
)
from avrgym.study.design.allocation import PlannedTrial, make_trial_orders, plan_trials
from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import read_design
from avrgym.study.people.consents import restore_consents
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.answers import OPEN_QUESTIONNAIRE_EVENT
from avrgym.study.storage.attempts import INCOMPLETE_END_STATES, compute_recording_sha256
from avrgym.study.storage.database import DATABASE_FILE, find_database_url
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, format_pseudonym
from avrgym.study.storage.integrity_files import IntegrityFiles
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT, DELETED_STATE, EntryContent
from avrgym.study.storage.reconciliation import make_participant_row_values
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import ALLOCATED_STATES, UNKNOWN_PARTICIPATION_STATE, StudyError
from avrgym.study.storage.store import StudyStore, record_event
from avrgym.study.storage.study_folder import find_used_participant_numbers

PlannedTrials = tuple[PlannedTrial, ...]
ALWAYS_LOST_DATA = (
    "the answers to inclusion questions, about functioning and to questions about a session, events, adverse events, "
    "notes, refusals to re-consent, consent texts of earlier versions, the designs of sessions, the log of "
    "actions, tokens of experimenters and links of participants"
)
"""Data that are always lost: neither recordings nor the participation list contain them."""
DATA_LOST_WITHOUT_PARTICIPATION_LIST = (
    "ages, languages, consents that are in no recording, withdrawals, deletions, and participants without "
    "name and recording"
)
"""Further data that are lost if the participation list is missing or invalid."""


@dataclass(frozen=True)
class RebuildSummary:
    """Numbers of rows in the rebuilt database, and descriptions of lost data.

    ``unknown_participation_count``: number of participants with unknown consent or withdrawal. ``lost_data``: data that
    were not rebuilt, as text. ``omission_messages``: messages about omitted participants and recordings.
    """

    participant_count: int
    unknown_participation_count: int
    attempt_count: int
    answer_count: int
    lost_data: str
    omission_messages: tuple[str, ...]


@dataclass(frozen=True)
class _RecordedAttempt:
    """A recording in a session's folder. ``name``: its path relative to the study's folder."""

    name: str
    recording: Recording

    @property
    def began_at(self) -> datetime:
        """Start of the trial, UTC."""
        return self.recording.began_at

    @property
    def configuration(self) -> TrialConfiguration:
        """The configuration of the trial, as stored in the recording's metadata."""
        return self.recording.configuration

    @property
    def planned(self) -> tuple[str, str, int, bool]:
        """Environment, policy, seed, and whether the trial is practice. These values identify a planned trial."""
        configuration = self.configuration
        return configuration.environment, configuration.policy, configuration.seed, configuration.practice


def rebuild_study_database(folder: Path) -> RebuildSummary:
    """Rebuild the lost database of a study. Returns a summary. Identity file and complete recordings are not changed.

    Truncated recordings of finished trials are completed. States are read from the participation list. If the list is
    missing or invalid, all states become ``unknown``, and an invalid list is renamed.

    Raises:
        StudyError: if the study has a database, or if the folder contains no design.
    """
    _refuse_if_present(folder)
    IntegrityFiles(folder, DATABASE_FILE).remove_all()
    with StudyStore(folder, rebuild=True) as store:
        fetch_recordings(store)
        rebuilding = _Rebuilding(store)
        with store.database.write_transaction() as connection:
            rebuilding.rebuild(connection)
        return rebuilding.done()


def _refuse_if_present(folder: Path) -> None:
    if not (folder / DESIGN).is_file():
        raise StudyError(f"{folder} contains no {DESIGN}; give the folder of a study")
    if (
        not find_database_url(read_design(folder / DESIGN).database.url)
        and not (folder / DATABASE_FILE).exists()
    ):
        return
    with StudyStore(folder, rebuild=True) as store:
        if store.read_participants() or store.read_deleted_participants():
            raise StudyError(f"{folder} has a database; `avrgym study rebuild` only rebuilds a lost database")


class _Rebuilding:
    """Rebuild all participants in one transaction."""

    def __init__(self, store: StudyStore) -> None:
        self._store = store
        self._left_out: list[str] = []
        self._participants = self._unknown = self._attempts = self._answers = 0
        numbers = find_used_participant_numbers(store.folder)
        self._visits = {number: self._load_visits(number) for number in sorted(numbers)}
        self._listed = store.read_participation_list()
        self._fault = find_participation_list_error(store, self._listed, self._beginnings())

    def done(self) -> RebuildSummary:
        return RebuildSummary(
            self._participants,
            self._unknown,
            self._attempts,
            self._answers,
            self._lost,
            tuple(self._left_out),
        )

    def rebuild(self, connection: sa.Connection) -> None:
        """Insert all participants, an event for this rebuild, and an event for each earlier rebuild."""
        for each in self._listed.list_database_rebuild_contents() if self._listed else ():
            hash_chain.insert_row(
                connection,
                schema.EVENT_TABLE,
                recorded_at=each["at"],
                name=DATABASE_REBUILT_EVENT,
                detail=each["detail"],
            )
        record_event(connection, DATABASE_REBUILT_EVENT, f"lost: {self._lost}", {})
        if self._fault and self._listed:
            self._store.database.participation_list.rename_invalid_file()
        for number in self._visits:
            self._rebuild_participant(connection, number)

    @property
    def _lost(self) -> str:
        if self._fault:
            reason = f"because the participation list {self._fault}"
            return f"{ALWAYS_LOST_DATA}; {DATA_LOST_WITHOUT_PARTICIPATION_LIST}, {reason}"
        return ALWAYS_LOST_DATA

    def _beginnings(self) -> dict[int, datetime]:
        """Returns the start time of each participant's first recording, by participant number."""
        recorded_attempts = {number: _flat(visits) for number, visits in self._visits.items()}
        return {
            number: min(each.began_at for each in own) for number, own in recorded_attempts.items() if own
        }

    def _rebuild_participant(self, connection: sa.Connection, number: int) -> None:
        """Insert a participant and their trials, or add a message about the omitted participant or trials."""
        content = self._listed.latest_content_by_participant.get(number) if self._listed else None
        recorded_attempts = _flat(self._visits[number])
        if content and content["state"] == DELETED_STATE:
            self._insert_tombstone(connection, number, content)
            return
        if not recorded_attempts and not content:
            self._left_out.append(f"{format_pseudonym(number)}: no recording contains them")
            return
        fitting = self._fitting(number, recorded_attempts, content)
        if recorded_attempts and len(fitting) != 1:
            self._left_out.append(
                f"{format_pseudonym(number)}: their recordings match no single order of the design"
            )
            self._insert_participant(connection, number, None, (), content)
            return
        cell, plan = next(iter(fitting.items())) if len(fitting) == 1 else (None, ())
        self._insert(connection, number, cell, plan, content)

    def _insert_tombstone(self, connection: sa.Connection, number: int, content: EntryContent) -> None:
        row = {"number": number, "simulated": content.get("simulated", False), "deleted_at": content["at"]}
        hash_chain.insert_row(connection, schema.TOMBSTONE_TABLE, **row)
        if self._visits[number]:
            self._left_out.append(
                f"{format_pseudonym(number)}: {format_restored_recordings_message(content['at'])}"
            )

    def _fitting(
        self, number: int, recorded_attempts: list[_RecordedAttempt], content: EntryContent | None
    ) -> dict[int, PlannedTrials]:
        """Returns the trial plans that match the recordings, by cell. A cell is the index of a trial order in the
        design.

        If the participation list contains the participant's cell, only this cell is considered.
        """
        design = self._store.design
        cells = range(len(make_trial_orders(design)))
        site = design.site
        if content and not self._fault:
            cells = [cell for cell in cells if cell == content.get("cell")]
            site = content.get("site") or ""
        plans = {cell: plan_trials(design, cell, number, site) for cell in cells}
        exact = {cell: plan for cell, plan in plans.items() if _covers(plan, recorded_attempts)}
        adopted = {cell: _adopt(plan, recorded_attempts) for cell, plan in plans.items()}
        return exact or {cell: plan for cell, plan in adopted.items() if _covers(plan, recorded_attempts)}

    def _load_visits(self, number: int) -> dict[str, list[_RecordedAttempt]]:
        """Returns the readable recordings of each session in order of file names, by the session's folder name."""
        visits: dict[str, list[_RecordedAttempt]] = {}
        for folder in sorted(
            (self._store.folder / RECORDINGS_FOLDER / format_pseudonym(number)).glob("ses-*")
        ):
            loaded = [self._load(path) for path in sorted(folder.glob("*.mcap"))]
            visits[folder.name] = [each for each in loaded if each]
        return visits

    def _load(self, path: Path) -> _RecordedAttempt | None:
        name = path.relative_to(self._store.folder).as_posix()
        try:
            if not read_header(path).configuration.simulated:
                complete_truncated_recording(path)
            recording = read_recording(path)
        except (OSError, RecordingError) as error:
            self._left_out.append(f"{name}: {error}")
            return None
        return _RecordedAttempt(name, recording)

    def _insert(
        self,
        connection: sa.Connection,
        number: int,
        cell: int | None,
        plan: PlannedTrials,
        content: EntryContent | None,
    ) -> None:
        visits = self._visits[number]
        recorded_attempts = _flat(visits)
        trials = self._insert_participant(connection, number, cell, plan, content)
        attempts: dict[int, int] = defaultdict(int)
        completed: set[int] = set()
        self._opened = False
        for name, visit in visits.items():
            if not name.removeprefix("ses-").isdecimal():
                continue
            session = self._insert_session(
                connection, number, int(name.removeprefix("ses-")), visit or recorded_attempts[:1]
            )
            for each in visit:
                trial = trials[each.planned]
                attempts[trial] += 1
                again = trial in completed
                if self._insert_attempt(connection, trial, session, attempts[trial], each, again=again):
                    completed.add(trial)
        for trial in completed:
            hash_chain.update_row(connection, schema.TRIAL_TABLE, trial, state="completed")
        all_answered = bool(trials) and completed == set(trials.values()) and not self._opened
        if self._known_state(content) in ALLOCATED_STATES:
            state = "completed" if all_answered else "allocated"
            hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, number, state=state)

    def _known_state(self, content: EntryContent | None) -> str:
        """Returns the participant's state in the list; ``UNKNOWN_PARTICIPATION_STATE`` if the list is invalid."""
        return UNKNOWN_PARTICIPATION_STATE if self._fault or content is None else content["state"]

    def _insert_participant(
        self,
        connection: sa.Connection,
        number: int,
        cell: int | None,
        plan: PlannedTrials,
        content: EntryContent | None,
    ) -> dict[tuple[Any, ...], int]:
        """Insert a participant and their trials. Returns each trial's id by environment, policy, seed and practice."""
        self._participants += 1
        recorded_attempts = _flat(self._visits[number])
        values = make_participant_row_values(content) if content and not self._fault else {}
        if recorded_attempts and not values:
            configuration = recorded_attempts[0].configuration
            values = {
                "simulated": configuration.simulated,
                "site": self._store.design.site or None,
                "sex": configuration.person.sex,
                "enrolled_at": _stored(min(each.began_at for each in recorded_attempts)),
            }
        elif content and not values:
            values = {name: content[name] for name in ("simulated", "sex", "enrolled_at")}
        state = self._known_state(content)
        if state in ALLOCATED_STATES and not plan:
            state = UNKNOWN_PARTICIPATION_STATE
        row = values | {"number": number, "state": state, "cell": cell}
        if recorded_attempts and recorded_attempts[-1].configuration.respondent != PARTICIPANT_RESPONDENT:
            row["respondent"] = recorded_attempts[-1].configuration.respondent
        hash_chain.insert_row(connection, schema.PARTICIPANT_TABLE, **row)
        self._unknown += state == UNKNOWN_PARTICIPATION_STATE
        consents = self._listed.list_consents(number) if self._listed and not self._fault else []
        recorded = [
            consent
            for each in recorded_attempts
            for consent in (each.configuration.consent, each.configuration.proxy_consent)
        ]
        restore_consents(self._store, connection, number, [*consents, *(each for each in recorded if each)])
        claimed = f"the invalid list contains the state {content['state']}" if content and self._fault else ""
        record_event(connection, "participant rebuilt", claimed, {"participant": number})
        return {
            _planned(trial): hash_chain.insert_row(
                connection, schema.TRIAL_TABLE, **asdict(trial), participant=number, state="planned"
            )
            for trial in plan
        }

    def _insert_session(
        self,
        connection: sa.Connection,
        participant: int,
        number: int,
        recorded_attempts: list[_RecordedAttempt],
    ) -> int:
        return hash_chain.insert_row(
            connection,
            schema.SESSION_TABLE,
            participant=participant,
            number=number,
            state="interrupted",
            station=self._store.station_name,
            process_id=0,
            opened_at=_stored(recorded_attempts[0].began_at),
            closed_at=make_utc_timestamp(),
            headset_check=msgspec.to_builtins(recorded_attempts[-1].configuration.headset_check),
        )

    def _insert_attempt(
        self,
        connection: sa.Connection,
        trial: int,
        session: int,
        number: int,
        recorded: _RecordedAttempt,
        *,
        again: bool,
    ) -> bool:
        """Insert an attempt and its answers. Returns whether the attempt completed its trial."""
        end = recorded.recording.result
        answers = recorded.recording.messages_by_topic["/answers"]
        asked = {item.id for item in recorded.configuration.items}
        missing = sorted(asked - {answer.item for _, answer in answers})
        completed = end == "completed" and recorded.recording.is_complete and not again
        broken_off = end if end in INCOMPLETE_END_STATES else "interrupted"
        attempt = hash_chain.insert_row(
            connection,
            schema.ATTEMPT_TABLE,
            trial=trial,
            session=session,
            number=number,
            state="completed" if completed else broken_off,
            recording=recorded.name,
            sha256=compute_recording_sha256(self._store, recorded.name),
            metrics=msgspec.to_builtins(recorded.recording.metrics),
            torso_height_m=recorded.configuration.person.torso_height_m,
            input_profile=msgspec.to_builtins(recorded.configuration.input_profile),
            started_at=_stored(recorded.began_at),
            ended_at=make_utc_timestamp(),
        )
        self._attempts += 1
        if completed and missing:
            event = {"session": session, "attempt": attempt}
            record_event(connection, OPEN_QUESTIONNAIRE_EVENT, ", ".join(missing), event)
            self._opened = True
        latest = {answer.item: (time_ns, answer) for time_ns, answer in answers}
        late = answers_file.read_answer_timestamps(self._store.folder / recorded.name)
        for time_ns, answer in latest.values():
            given = late.get(answer.item) or _stored(recorded.began_at + timedelta(seconds=time_ns / 1e9))
            row = msgspec.structs.asdict(answer)
            if recorded.configuration.respondent != PARTICIPANT_RESPONDENT:
                row["respondent"] = recorded.configuration.respondent
            hash_chain.insert_row(
                connection, schema.ANSWER_TABLE, session=session, attempt=attempt, answered_at=given, **row
            )
            self._answers += 1
        return completed


def _flat(visits: Mapping[str, list[_RecordedAttempt]]) -> list[_RecordedAttempt]:
    return [each for visit in visits.values() for each in visit]


def _planned(trial: PlannedTrial) -> tuple[Any, ...]:
    return trial.environment, trial.policy, trial.seed, trial.practice


def _covers(plan: PlannedTrials, recorded_attempts: Iterable[_RecordedAttempt]) -> bool:
    return {each.planned for each in recorded_attempts} <= {_planned(trial) for trial in plan}


def _adopt(plan: PlannedTrials, recorded_attempts: Iterable[_RecordedAttempt]) -> PlannedTrials:
    """Returns the plan with the recorded practice robots and seeds.

    They differ from the plan in studies of earlier AVR Gym versions.
    """
    recorded = {each.configuration.trial_number: each.planned for each in recorded_attempts}
    return tuple(
        _adopt_one(trial, *recorded[trial.position]) if trial.position in recorded else trial
        for trial in plan
    )


def _adopt_one(trial: PlannedTrial, environment: str, policy: str, seed: int, practice: bool) -> PlannedTrial:
    if trial.practice != practice:
        return trial
    return replace(trial, seed=seed, environment=environment if practice else trial.environment)


def _stored(moment: datetime) -> str:
    return moment.isoformat(timespec="microseconds")
