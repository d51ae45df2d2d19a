"""Rebuilding a lost database from the recordings and the participation list."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import sqlalchemy as sa

from avrgym.recording import answers_file
from avrgym.recording.configuration import Configuration
from avrgym.recording.reader import Recording, RecordingError, read_header, read_recording
from avrgym.recording.writer import end_cut_recording
from avrgym.study.checking.participation_checks import list_fault, recordings_came_back
from avrgym.study.design.allocation import PlannedTrial, cell_orders, plan_trials
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import read_design
from avrgym.study.people.consents import restore_consents
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.answers import QUESTIONNAIRE_OPEN
from avrgym.study.storage.attempts import INCOMPLETE_ENDS, sha256_of
from avrgym.study.storage.database import FILE, database_url
from avrgym.study.storage.integrity_files import IntegrityFiles
from avrgym.study.storage.participation import DELETED, REBUILT, Content
from avrgym.study.storage.reconciliation import participant_values
from avrgym.study.storage.rows import RECORDINGS, pseudonym_of
from avrgym.study.storage.schema import now
from avrgym.study.storage.states import PARTICIPATING, UNKNOWN, StudyError
from avrgym.study.storage.store import Store, record_event
from avrgym.study.storage.study_folder import used_numbers

Plan = tuple[PlannedTrial, ...]
LOST = (
    "the answers to inclusion questions, about functioning and to questions about a session, events, adverse events, "
    "notes, refusals to re-consent, consent texts of earlier versions, the designs of sessions, the log of "
    "actions, tokens of experimenters and links of participants"
)
"""Data that neither recordings nor list contain."""
LOST_WITH_LIST = (
    "ages, languages, consents that no recording stores, withdrawals, deletions, and participants who left neither "
    "name nor recording"
)
"""Data that are also lost without a valid participation list."""


@dataclass(frozen=True)
class RebuildSummary:
    """Counts of the rows of a new database, and the data that could not be rebuilt, in words.

    ``unknown`` counts participants whose consent or withdrawal is unknown.
    """

    participants: int
    unknown: int
    attempts: int
    answers: int
    lost: str
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Kept:
    """A recording in a session's folder, by its path in the study."""

    name: str
    recording: Recording

    @property
    def began_at(self) -> datetime:
        """Start of the trial, UTC."""
        return self.recording.began_at

    @property
    def configuration(self) -> Configuration:
        """The configuration of the trial."""
        return self.recording.configuration

    @property
    def planned(self) -> tuple[str, str, int, bool]:
        """The values of the planned trial."""
        configuration = self.configuration
        return configuration.environment, configuration.policy, configuration.seed, configuration.practice


def rebuild_study(folder: Path) -> RebuildSummary:
    """Rebuild a study's lost database; identity file and recordings stay as they are.

    Only a recording that was cut off after the robot had finished is completed.

    The participation list gives each participant's state. Where it is missing or invalid, all states are ``unknown``,
    and an invalid list is kept under another name.

    Raises:
        StudyError: when the database is there.
    """
    _refuse_if_present(folder)
    IntegrityFiles(folder, FILE).remove()
    with Store(folder, rebuild=True) as store:
        rebuilding = _Rebuilding(store)
        with store.database.write() as connection:
            rebuilding.rebuild(connection)
        return rebuilding.done()


def _refuse_if_present(folder: Path) -> None:
    if not (folder / DESIGN).is_file():
        raise StudyError(f"{folder} holds no {DESIGN}, which a study begins with")
    if not database_url(read_design(folder / DESIGN).database.url) and not (folder / FILE).exists():
        return
    with Store(folder, rebuild=True) as store:
        if store.participants() or store.tombstones():
            raise StudyError(f"{folder} has a database; only a lost one is made anew")


class _Rebuilding:
    """Participant after participant within one transaction."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._left_out: list[str] = []
        self._participants = self._unknown = self._attempts = self._answers = 0
        numbers = used_numbers(store.folder)
        self._visits = {number: self._load_visits(number) for number in sorted(numbers)}
        self._listed = store.participation()
        self._fault = list_fault(store, self._listed, self._beginnings())

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
        """Insert all participants, and the events of this rebuilding and of earlier ones."""
        for each in self._listed.rebuilds() if self._listed else ():
            hash_chain.insert(connection, schema.EVENT, at=each["at"], name=REBUILT, detail=each["detail"])
        record_event(connection, REBUILT, f"lost: {self._lost}", {})
        if self._fault and self._listed:
            self._store.database.participation.rename_invalid()
        for number in self._visits:
            self._rebuild_participant(connection, number)

    @property
    def _lost(self) -> str:
        if self._fault:
            return f"{LOST}; {LOST_WITH_LIST}, because the participation list {self._fault}"
        return LOST

    def _beginnings(self) -> dict[int, datetime]:
        """When the first recording of each participant began."""
        kept = {number: _flat(visits) for number, visits in self._visits.items()}
        return {number: min(each.began_at for each in own) for number, own in kept.items() if own}

    def _rebuild_participant(self, connection: sa.Connection, number: int) -> None:
        """A participant with their trials, or the reason why there is none."""
        content = self._listed.latest.get(number) if self._listed else None
        kept = _flat(self._visits[number])
        if content and content["state"] == DELETED:
            self._insert_tombstone(connection, number, content)
            return
        if not kept and not content:
            self._left_out.append(f"{pseudonym_of(number)}: no recording tells of them")
            return
        fitting = self._fitting(number, kept, content)
        if kept and len(fitting) != 1:
            self._left_out.append(f"{pseudonym_of(number)}: their recordings fit no one order of the design")
            self._insert_participant(connection, number, None, (), content)
            return
        cell, plan = next(iter(fitting.items())) if len(fitting) == 1 else (None, ())
        self._insert(connection, number, cell, plan, content)

    def _insert_tombstone(self, connection: sa.Connection, number: int, content: Content) -> None:
        row = {"number": number, "simulated": content.get("simulated", False), "deleted_at": content["at"]}
        hash_chain.insert(connection, schema.TOMBSTONE, **row)
        if self._visits[number]:
            self._left_out.append(f"{pseudonym_of(number)}: {recordings_came_back(content['at'])}")

    def _fitting(self, number: int, kept: list[_Kept], content: Content | None) -> dict[int, Plan]:
        """Plans of trials that fit the recordings, by cell; only those of the list's cell if it contains one."""
        design = self._store.design
        cells = range(len(cell_orders(design)))
        site = design.site
        if content and not self._fault:
            cells = [cell for cell in cells if cell == content.get("cell")]
            site = content.get("site") or ""
        plans = {cell: plan_trials(design, cell, number, site) for cell in cells}
        exact = {cell: plan for cell, plan in plans.items() if _covers(plan, kept)}
        adopted = {cell: _adopt(plan, kept) for cell, plan in plans.items()}
        return exact or {cell: plan for cell, plan in adopted.items() if _covers(plan, kept)}

    def _load_visits(self, number: int) -> dict[str, list[_Kept]]:
        """The recordings of each session, in the order of their names; a session may have none that loads."""
        visits: dict[str, list[_Kept]] = {}
        for folder in sorted((self._store.folder / RECORDINGS / pseudonym_of(number)).glob("ses-*")):
            loaded = [self._load(path) for path in sorted(folder.glob("*.mcap"))]
            visits[folder.name] = [each for each in loaded if each]
        return visits

    def _load(self, path: Path) -> _Kept | None:
        name = path.relative_to(self._store.folder).as_posix()
        try:
            if not read_header(path).configuration.simulated:
                end_cut_recording(path)
            recording = read_recording(path)
        except (OSError, RecordingError) as error:
            self._left_out.append(f"{name}: {error}")
            return None
        return _Kept(name, recording)

    def _insert(
        self,
        connection: sa.Connection,
        number: int,
        cell: int | None,
        plan: Plan,
        content: Content | None,
    ) -> None:
        visits = self._visits[number]
        kept = _flat(visits)
        trials = self._insert_participant(connection, number, cell, plan, content)
        attempts: dict[int, int] = defaultdict(int)
        completed: set[int] = set()
        self._opened = False
        for name, visit in visits.items():
            if not name.removeprefix("ses-").isdecimal():
                continue
            session = self._insert_session(
                connection, number, int(name.removeprefix("ses-")), visit or kept[:1]
            )
            for each in visit:
                trial = trials[each.planned]
                attempts[trial] += 1
                again = trial in completed
                if self._insert_attempt(connection, trial, session, attempts[trial], each, again=again):
                    completed.add(trial)
        for trial in completed:
            hash_chain.update(connection, schema.TRIAL, trial, state="completed")
        all_answered = bool(trials) and completed == set(trials.values()) and not self._opened
        if self._known_state(content) in PARTICIPATING:
            state = "completed" if all_answered else "allocated"
            hash_chain.update(connection, schema.PARTICIPANT, number, state=state)

    def _known_state(self, content: Content | None) -> str:
        """A participant's state in a valid list."""
        return UNKNOWN if self._fault or content is None else content["state"]

    def _insert_participant(
        self, connection: sa.Connection, number: int, cell: int | None, plan: Plan, content: Content | None
    ) -> dict[tuple[Any, ...], int]:
        """Insert a participant and their trials; the ids of the trials by plan."""
        self._participants += 1
        kept = _flat(self._visits[number])
        values = participant_values(content) if content and not self._fault else {}
        if kept and not values:
            configuration = kept[0].configuration
            values = {
                "simulated": configuration.simulated,
                "site": self._store.design.site or None,
                "sex": configuration.person.sex,
                "enrolled_at": _stored(min(each.began_at for each in kept)),
            }
        elif content and not values:
            values = {name: content[name] for name in ("simulated", "sex", "enrolled_at")}
        state = self._known_state(content)
        if state in PARTICIPATING and not plan:
            state = UNKNOWN
        row = values | {"number": number, "state": state, "cell": cell}
        hash_chain.insert(connection, schema.PARTICIPANT, **row)
        self._unknown += state == UNKNOWN
        consents = self._listed.consents(number) if self._listed and not self._fault else []
        recorded = [each.configuration.consent for each in kept]
        restore_consents(self._store, connection, number, [*consents, *(each for each in recorded if each)])
        claimed = f"the invalid list contains the state {content['state']}" if content and self._fault else ""
        record_event(connection, "participant rebuilt", claimed, {"participant": number})
        return {
            _planned(trial): hash_chain.insert(
                connection, schema.TRIAL, **asdict(trial), participant=number, state="planned"
            )
            for trial in plan
        }

    def _insert_session(
        self, connection: sa.Connection, participant: int, number: int, kept: list[_Kept]
    ) -> int:
        return hash_chain.insert(
            connection,
            schema.SESSION,
            participant=participant,
            number=number,
            state="interrupted",
            station=self._store.station,
            process=0,
            opened_at=_stored(kept[0].began_at),
            closed_at=now(),
            headset_check=msgspec.to_builtins(kept[-1].configuration.headset_check),
        )

    def _insert_attempt(
        self, connection: sa.Connection, trial: int, session: int, number: int, kept: _Kept, *, again: bool
    ) -> bool:
        """Insert an attempt with its answers; whether it completed its trial."""
        end = kept.recording.result
        answers = kept.recording.topics["/answers"]
        asked = {item.id for item in kept.configuration.items}
        missing = sorted(asked - {answer.item for _, answer in answers})
        completed = end == "completed" and kept.recording.complete and not again
        broken_off = end if end in INCOMPLETE_ENDS else "interrupted"
        attempt = hash_chain.insert(
            connection,
            schema.ATTEMPT,
            trial=trial,
            session=session,
            number=number,
            state="completed" if completed else broken_off,
            recording=kept.name,
            sha256=sha256_of(self._store, kept.name),
            metrics=msgspec.to_builtins(kept.recording.metrics),
            torso_height_m=kept.configuration.person.torso_height_m,
            started_at=_stored(kept.began_at),
            ended_at=now(),
        )
        self._attempts += 1
        if completed and missing:
            event = {"session": session, "attempt": attempt}
            record_event(connection, QUESTIONNAIRE_OPEN, ", ".join(missing), event)
            self._opened = True
        latest = {answer.item: (time_ns, answer) for time_ns, answer in answers}
        late = answers_file.answer_times(self._store.folder / kept.name)
        for time_ns, answer in latest.values():
            given = late.get(answer.item) or _stored(kept.began_at + timedelta(seconds=time_ns / 1e9))
            row = msgspec.structs.asdict(answer)
            hash_chain.insert(
                connection, schema.ANSWER, session=session, attempt=attempt, answered_at=given, **row
            )
            self._answers += 1
        return completed


def _flat(visits: Mapping[str, list[_Kept]]) -> list[_Kept]:
    return [each for visit in visits.values() for each in visit]


def _planned(trial: PlannedTrial) -> tuple[Any, ...]:
    return trial.environment, trial.policy, trial.seed, trial.practice


def _covers(plan: Plan, kept: Iterable[_Kept]) -> bool:
    return {each.planned for each in kept} <= {_planned(trial) for trial in plan}


def _adopt(plan: Plan, kept: Iterable[_Kept]) -> Plan:
    """A plan with the practice robots and seeds of recordings whose version drew them otherwise, by position."""
    told = {each.configuration.trial: each.planned for each in kept}
    return tuple(
        _adopt_one(trial, *told[trial.position]) if trial.position in told else trial for trial in plan
    )


def _adopt_one(trial: PlannedTrial, environment: str, policy: str, seed: int, practice: bool) -> PlannedTrial:
    if trial.practice != practice:
        return trial
    return replace(trial, seed=seed, environment=environment if practice else trial.environment)


def _stored(moment: datetime) -> str:
    return moment.isoformat(timespec="microseconds")
