"""What the experimenter's dashboard shows of a study: plain values, without names and without what must stay blind."""

from collections import defaultdict
from dataclasses import dataclass

from avrgym.models.furniture.real import RealFurniture
from avrgym.recording.outcomes import Metrics
from avrgym.study.checking.results import ConditionResults, summarise_results
from avrgym.study.checking.summary import StudySummary, summarise_study
from avrgym.study.design.design import Consent, Design
from avrgym.study.storage.keyfile import read_key
from avrgym.study.storage.rows import Note, Trial, TrialAttempt
from avrgym.study.storage.states import PARTICIPANT
from avrgym.study.storage.store import Store
from avrgym.tasks.registry import find_environment


@dataclass(frozen=True)
class Overview:
    """The whole study. ``inclusion`` and ``items`` hold texts by id; ``live`` is whose session runs, ``furniture``
    what the next participant really sits and lies on.
    """

    summary: StudySummary
    blinded: bool
    consent: Consent
    inclusion: dict[str, str]
    items: dict[str, str]
    results: tuple[ConditionResults, ...]
    live: str | None
    furniture: RealFurniture


@dataclass(frozen=True)
class TrialView:
    """A trial as the experimenter may see it, with how each of its attempts ended."""

    position: int
    task: str
    robot: str
    policy: str
    practice: bool
    state: str
    attempts: tuple[str, ...]
    success: bool | None
    reward: float | None


@dataclass(frozen=True)
class ParticipantView:
    """One participant. ``identified``: the key file says who they are; ``may_become``: what may follow."""

    participant: str
    state: str
    may_become: tuple[str, ...]
    simulated: bool
    sex: str
    age_years: int | None
    identified: bool
    consented_at: str | None
    consent_version: str | None
    trials: tuple[TrialView, ...]
    notes: tuple[Note, ...]


def overview(store: Store, live: str | None, furniture: RealFurniture) -> Overview:
    """How the study stands, while the session of ``live`` runs; the next one is on this ``furniture``."""
    design = store.design
    return Overview(
        summary=summarise_study(store),
        blinded=design.blind_experimenter,
        consent=design.consent,
        inclusion={question.id: question.text for question in design.inclusion},
        items={name: item.text for name, item in design.items.items()},
        results=summarise_results(store),
        live=live,
        furniture=furniture,
    )


def participant_view(store: Store, pseudonym: str) -> ParticipantView:
    """One participant; ``StudyError`` when there is none of this pseudonym."""
    participant = store.participant(pseudonym)
    attempts = defaultdict[int, list[TrialAttempt]](list)
    for attempt in store.attempts(pseudonym):
        attempts[attempt.trial].append(attempt)
    return ParticipantView(
        participant=pseudonym,
        state=participant.state,
        may_become=PARTICIPANT[participant.state],
        simulated=participant.simulated,
        sex=participant.sex,
        age_years=participant.age_years,
        identified=pseudonym in read_key(store.folder),
        consented_at=participant.consented_at,
        consent_version=participant.consent_version,
        trials=tuple(_trial(store.design, trial, attempts[trial.id]) for trial in store.trials(pseudonym)),
        notes=tuple(store.notes(pseudonym)),
    )


def _trial(design: Design, trial: Trial, attempts: list[TrialAttempt]) -> TrialView:
    task, robot = find_environment(trial.environment)
    metrics = next((attempt.metrics for attempt in attempts if attempt.state == "completed"), Metrics())
    return TrialView(
        position=trial.position,
        task=task,
        robot=robot,
        policy=design.shown_policy(trial.policy, trial.practice),
        practice=trial.practice,
        state=trial.state,
        attempts=tuple(attempt.state for attempt in attempts),
        success=metrics.success,
        reward=metrics.reward,
    )
