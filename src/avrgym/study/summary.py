"""How a study stands: figures for the table of ``avrgym study status`` and for whoever leads it."""

from collections import Counter
from dataclasses import dataclass

from avrgym.study.allocation import cell_orders
from avrgym.study.rows import Participant
from avrgym.study.states import TAKES_PART
from avrgym.study.store import Store


@dataclass(frozen=True)
class ParticipantSummary:
    """One participant in figures; practice trials count as trials."""

    participant: str
    state: str
    simulated: bool
    cell: int | None
    consented: bool
    sessions: int
    trials_completed: int
    trials: int
    attempts: int
    answers: int


@dataclass(frozen=True)
class StudySummary:
    """A whole study. ``filled`` and ``completed_cells`` count participants per cell of the design."""

    title: str
    planned: int
    simulated: int
    completed: int
    withdrawn: int
    excluded: int
    deleted: int
    filled: tuple[int, ...]
    completed_cells: tuple[int, ...]
    participants: tuple[ParticipantSummary, ...]


def summarise_study(store: Store) -> StudySummary:
    """How the study stands now."""
    participants = store.participants()
    states = Counter(participant.state for participant in participants)
    return StudySummary(
        title=store.design.title,
        planned=store.design.participants,
        simulated=sum(participant.simulated for participant in participants),
        completed=states["completed"],
        withdrawn=states["withdrawn"],
        excluded=states["excluded"],
        deleted=len(store.tombstones()),
        filled=_per_cell(store, participants, TAKES_PART),
        completed_cells=_per_cell(store, participants, ("completed",)),
        participants=tuple(_summarise(store, participant) for participant in participants),
    )


def _per_cell(store: Store, participants: list[Participant], states: tuple[str, ...]) -> tuple[int, ...]:
    count = Counter(participant.cell for participant in participants if participant.state in states)
    return tuple(count[cell] for cell in range(len(cell_orders(store.design))))


def _summarise(store: Store, participant: Participant) -> ParticipantSummary:
    pseudonym = participant.pseudonym
    trials = store.trials(pseudonym)
    return ParticipantSummary(
        participant=pseudonym,
        state=participant.state,
        simulated=participant.simulated,
        cell=participant.cell,
        consented=participant.consented_at is not None,
        sessions=len(store.sessions(pseudonym)),
        trials_completed=sum(trial.state == "completed" for trial in trials),
        trials=len(trials),
        attempts=len(store.attempts(pseudonym)),
        answers=len(store.answers(pseudonym)),
    )
