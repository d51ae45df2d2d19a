"""Making a lost database anew from the recordings, as far as they tell."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import sqlalchemy as sa

from avrgym.recording.files import (
    Recording,
    RecordingError,
    end_cut_recording,
    read_configuration,
    read_recording,
)
from avrgym.study.design.allocation import PlannedTrial, cell_orders, plan_trials
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import read_design
from avrgym.study.people.consents import restore_consents
from avrgym.study.storage import ledger, schema
from avrgym.study.storage.answers import OPEN
from avrgym.study.storage.attempts import BROKEN_OFF, sha256_of
from avrgym.study.storage.database import FILE, REBUILT, database_url
from avrgym.study.storage.remains import known_numbers
from avrgym.study.storage.rows import RECORDINGS, pseudonym_of
from avrgym.study.storage.schema import now
from avrgym.study.storage.seal import Seal
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, record_event

Plan = tuple[PlannedTrial, ...]
LOST = (
    "ages, consents that no recording stores, the answers to inclusion questions and to questions about a session, "
    "events, adverse events, notes, the log of who did what, tokens of experimenters, who withdrew, who was deleted, "
    "and whoever was enrolled but left neither name nor recording"
)
"""What no recording tells."""


@dataclass(frozen=True)
class Rebuilt:
    """What a new database holds, by count, and what could not be made anew, in words."""

    participants: int
    attempts: int
    answers: int
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class _Kept:
    """A recording in a session's folder; ``began`` is when, as its file's time tells."""

    name: str
    recording: Recording
    began: datetime

    @property
    def planned(self) -> tuple[Any, ...]:
        """What a trial was planned with."""
        return tuple(
            self.recording.metadata.get(name) for name in ("environment", "policy", "seed", "practice")
        )


def rebuild_study(folder: Path) -> Rebuilt:
    """Rebuild a study's lost database; key file and recordings stay as they are.

    Only a recording that was cut off after the robot had finished is completed.

    Raises:
        StudyError: when the database is there.
    """
    _refuse_if_present(folder)
    Seal(folder, FILE).remove()
    with Store(folder, anew=True) as store:
        rebuilding = _Rebuilding(store)
        with store.database.write() as connection:
            record_event(connection, REBUILT, f"lost: {LOST}", {})
            for number in sorted(known_numbers(store.folder)):
                rebuilding.rebuild(connection, number)
        return rebuilding.done()


def _refuse_if_present(folder: Path) -> None:
    if not (folder / DESIGN).is_file():
        raise StudyError(f"{folder} holds no {DESIGN}, which a study begins with")
    if not database_url(read_design(folder / DESIGN).database.url) and not (folder / FILE).exists():
        return
    with Store(folder, anew=True) as store:
        if store.participants() or store.tombstones():
            raise StudyError(f"{folder} has a database; only a lost one is made anew")


class _Rebuilding:
    """Participant after participant within one transaction."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._left_out: list[str] = []
        self._participants = self._attempts = self._answers = 0

    def done(self) -> Rebuilt:
        return Rebuilt(self._participants, self._attempts, self._answers, tuple(self._left_out))

    def rebuild(self, connection: sa.Connection, number: int) -> None:
        """A participant with their trials, or the reason why there is none."""
        visits = self._visits(number)
        kept = [each for visit in visits.values() for each in visit]
        if not kept:
            self._left_out.append(f"{pseudonym_of(number)}: no recording tells of them")
            return
        fitting = self._fitting(number, kept)
        if len(fitting) != 1:
            self._left_out.append(f"{pseudonym_of(number)}: their recordings fit no one order of the design")
            return
        ((cell, plan),) = fitting.items()
        self._insert(connection, number, cell, plan, visits)

    def _fitting(self, number: int, kept: list[_Kept]) -> dict[int, Plan]:
        """The plans that recordings may be of, by cell."""
        design = self._store.design
        plans = {
            cell: plan_trials(design, cell, number, design.site) for cell in range(len(cell_orders(design)))
        }
        exact = {cell: plan for cell, plan in plans.items() if _covers(plan, kept)}
        adopted = {cell: _adopt(plan, kept) for cell, plan in plans.items()}
        return exact or {cell: plan for cell, plan in adopted.items() if _covers(plan, kept)}

    def _visits(self, number: int) -> dict[str, list[_Kept]]:
        """The recordings of each session, in the order of their names; a session may have none that loads."""
        visits: dict[str, list[_Kept]] = {}
        for folder in sorted((self._store.folder / RECORDINGS / pseudonym_of(number)).glob("ses-*")):
            loaded = [self._load(path) for path in sorted(folder.glob("*.mcap"))]
            visits[folder.name] = [each for each in loaded if each]
        return visits

    def _load(self, path: Path) -> _Kept | None:
        name = path.relative_to(self._store.folder).as_posix()
        try:
            if not read_configuration(path).get("simulated"):
                end_cut_recording(path)
            recording = read_recording(path)
        except (OSError, RecordingError) as error:
            self._left_out.append(f"{name}: {error}")
            return None
        lasted = timedelta(seconds=max((time_ns for _, time_ns, _ in recording.messages), default=0) / 1e9)
        ended = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        return _Kept(name, recording, ended - lasted)

    def _insert(
        self,
        connection: sa.Connection,
        number: int,
        cell: int,
        plan: Plan,
        visits: Mapping[str, list[_Kept]],
    ) -> None:
        kept = [each for visit in visits.values() for each in visit]
        trials = self._insert_participant(connection, number, cell, plan, kept)
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
            ledger.update(connection, schema.TRIAL, trial, state="completed")
        all_answered = completed == set(trials.values()) and not self._opened
        state = "completed" if all_answered else "allocated"
        ledger.update(connection, schema.PARTICIPANT, number, state=state)

    def _insert_participant(
        self,
        connection: sa.Connection,
        number: int,
        cell: int,
        plan: Plan,
        kept: list[_Kept],
    ) -> dict[tuple[Any, ...], int]:
        """The ids of the participant's trials, by what they were planned with.

        No session opens without consent, so there was one before the first recording.
        """
        self._participants += 1
        first = _stored(min(each.began for each in kept))
        metadata = kept[0].recording.metadata
        ledger.insert(
            connection,
            schema.PARTICIPANT,
            number=number,
            state="allocated",
            simulated=bool(metadata.get("simulated")),
            site=self._store.design.site or None,
            sex=metadata["person"]["sex"],
            cell=cell,
            enrolled_at=first,
            consented_at=first,
        )
        recorded = [each.recording.metadata.get("consent") for each in kept]
        restore_consents(
            self._store, connection, number, [each for each in recorded if each] or [{"at": first}]
        )
        record_event(connection, "participant rebuilt", "consent was before this", {"participant": number})
        return {
            _planned(trial): ledger.insert(
                connection, schema.TRIAL, **asdict(trial), participant=number, state="planned"
            )
            for trial in plan
        }

    def _insert_session(
        self, connection: sa.Connection, participant: int, number: int, kept: list[_Kept]
    ) -> int:
        return ledger.insert(
            connection,
            schema.SESSION,
            participant=participant,
            number=number,
            state="interrupted",
            station=self._store.station,
            process=0,
            opened_at=_stored(kept[0].began),
            closed_at=now(),
            headset_check=kept[-1].recording.metadata.get("headset_check"),
        )

    def _insert_attempt(
        self, connection: sa.Connection, trial: int, session: int, number: int, kept: _Kept, *, again: bool
    ) -> bool:
        """Insert an attempt with its answers; whether it completed its trial."""
        end = kept.recording.end
        answers = kept.recording.topics["/answers"]
        asked = {item["id"] for item in kept.recording.metadata.get("items", [])}
        missing = sorted(asked - {answer.item for _, answer in answers})
        completed = end == "completed" and kept.recording.complete and not again
        broken_off = end if end in BROKEN_OFF else "interrupted"
        attempt = ledger.insert(
            connection,
            schema.ATTEMPT,
            trial=trial,
            session=session,
            number=number,
            state="completed" if completed else broken_off,
            recording=kept.name,
            sha256=sha256_of(self._store, kept.name),
            metrics=msgspec.to_builtins(kept.recording.metrics),
            torso_height_m=kept.recording.torso_height_m,
            started_at=_stored(kept.began),
            ended_at=now(),
        )
        self._attempts += 1
        if completed and missing:
            event = {"session": session, "attempt": attempt}
            record_event(connection, OPEN, ", ".join(missing), event)
            self._opened = True
        latest = {answer.item: (time_ns, answer) for time_ns, answer in answers}
        for time_ns, answer in latest.values():
            given = _stored(kept.began + timedelta(seconds=time_ns / 1e9))
            row = msgspec.structs.asdict(answer)
            ledger.insert(
                connection, schema.ANSWER, session=session, attempt=attempt, answered_at=given, **row
            )
            self._answers += 1
        return completed


def _planned(trial: PlannedTrial) -> tuple[Any, ...]:
    return trial.environment, trial.policy, trial.seed, trial.practice


def _covers(plan: Plan, kept: Iterable[_Kept]) -> bool:
    return {each.planned for each in kept} <= {_planned(trial) for trial in plan}


def _adopt(plan: Plan, kept: Iterable[_Kept]) -> Plan:
    """A plan with the practice robots and seeds of recordings whose version drew them otherwise, by position."""
    told = {each.recording.metadata.get("trial"): each.planned for each in kept}
    return tuple(
        _adopt_one(trial, *told[trial.position]) if trial.position in told else trial for trial in plan
    )


def _adopt_one(trial: PlannedTrial, environment: str, policy: str, seed: int, practice: bool) -> PlannedTrial:
    if trial.practice != practice:
        return trial
    return replace(trial, seed=seed, environment=environment if practice else trial.environment)


def _stored(moment: datetime) -> str:
    return moment.isoformat(timespec="microseconds")
