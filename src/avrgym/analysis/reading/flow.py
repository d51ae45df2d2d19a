"""Who came how far in a study, as flow diagrams of participants show it, and what else only the database knows."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from avrgym.analysis.rows import TrialRow
from avrgym.study.storage.rows import Participant
from avrgym.study.storage.store import Store


@dataclass(frozen=True, kw_only=True)
class Flow:
    """How many people, or simulated participants, came how far; each step is what is left of the one before.

    ``enrolled`` counts also those whose data were ``deleted``, of whom nothing else is known. ``orders`` says how
    many were given each order of trials, ``consents`` how many agreed to each version of the consent text. Days are
    those of sessions, ISO 8601.
    """

    simulated: bool
    enrolled: int
    deleted: int
    no_consent: int
    excluded: int
    withdrew_before: int
    waiting: int
    allocated: int
    withdrew: int
    unfinished: int
    completed: int
    analysed: int
    orders: Mapping[int, int]
    consents: Mapping[str, int]
    first_day: str | None
    last_day: str | None


def flows(store: Store, trials: Sequence[TrialRow]) -> list[Flow]:
    """People and simulated participants, as far as there are any."""
    everyone, deleted = store.participants(), store.tombstones()
    return [
        _flow(store, [each for each in everyone if each.simulated is simulated], simulated, gone, trials)
        for simulated in (False, True)
        if (gone := sum(each.simulated is simulated for each in deleted))
        or any(each.simulated is simulated for each in everyone)
    ]


def _flow(
    store: Store, own: Sequence[Participant], simulated: bool, deleted: int, trials: Sequence[TrialRow]
) -> Flow:
    with_order = [each for each in own if each.cell is not None]
    without = [each for each in own if each.cell is None]
    days = sorted(session.opened_at[:10] for each in own for session in store.sessions(each.pseudonym))
    return Flow(
        simulated=simulated,
        enrolled=len(own) + deleted,
        deleted=deleted,
        no_consent=_in(without, "enrolled"),
        excluded=_in(without, "excluded"),
        withdrew_before=_in(without, "withdrawn"),
        waiting=_in(without, "consented"),
        allocated=len(with_order),
        withdrew=_in(with_order, "withdrawn"),
        unfinished=_in(with_order, "allocated"),
        completed=_in(with_order, "completed"),
        analysed=len({row.participant for row in trials if row.counted and row.simulated is simulated}),
        orders=dict(sorted(Counter(each.cell + 1 for each in with_order if each.cell is not None).items())),
        consents=dict(sorted(Counter(each.consent_version for each in own if each.consent_version).items())),
        first_day=days[0] if days else None,
        last_day=days[-1] if days else None,
    )


def _in(own: Iterable[Participant], state: str) -> int:
    return sum(each.state == state for each in own)
