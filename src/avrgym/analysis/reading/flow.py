"""Who came how far in a study, as flow diagrams of participants show it, and what else only the database knows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from avrgym.analysis.reading.observations import Observations
from avrgym.study.design.design import Design
from avrgym.study.storage.rows import Participant
from avrgym.study.storage.states import UNKNOWN
from avrgym.study.storage.store import Store

WITHDRAWN = "participant withdrawn"
"""The event of a withdrawal, whose detail is the reason."""


@dataclass(frozen=True, kw_only=True)
class Flow:
    """How many people, or simulated participants, came how far; each step is what is left of the one before.

    ``analysed`` are those with anything that counts; ``analysed_unfinished`` of them have not completed the study, and
    ``completed_without_data`` completed it with nothing that counts. ``excluded_by`` says how often each answer to an
    inclusion question excluded somebody, ``withdrew_before_for`` and ``withdrew_for`` how often each reason was given.

    ``enrolled`` counts also those whose data were ``deleted``, of whom nothing else is known. ``orders`` says how
    many were given each order of trials, ``consents`` how many agreed to each version of the consent text as their
    latest one. ``reconsented`` and ``declined`` count re-consents to another version. Days
    are those of sessions, ISO 8601. Of those ``unknown``, and of those ``unknown_before`` an order, it is not known
    whether they consented or withdrew, because the database was lost.
    """

    simulated: bool
    enrolled: int
    deleted: int
    no_consent: int
    excluded: int
    withdrew_before: int
    unknown_before: int = 0
    waiting: int
    allocated: int
    withdrew: int
    unknown: int = 0
    unfinished: int
    completed: int
    analysed: int
    orders: Mapping[int, int]
    consents: Mapping[str, int]
    reconsented: int = 0
    declined: int = 0
    first_day: str | None
    last_day: str | None
    analysed_unfinished: int = 0
    completed_without_data: int = 0
    excluded_by: Mapping[str, int] = field(default_factory=dict[str, int])
    withdrew_before_for: Mapping[str, int] = field(default_factory=dict[str, int])
    withdrew_for: Mapping[str, int] = field(default_factory=dict[str, int])


def flows(store: Store, seen: Observations) -> list[Flow]:
    """People and simulated participants, as far as there are any."""
    everyone, deleted = store.participants(), store.tombstones()
    return [
        _flow(store, [each for each in everyone if each.simulated is simulated], simulated, gone, seen)
        for simulated in (False, True)
        if (gone := sum(each.simulated is simulated for each in deleted))
        or any(each.simulated is simulated for each in everyone)
    ]


def _flow(
    store: Store, own: Sequence[Participant], simulated: bool, deleted: int, seen: Observations
) -> Flow:
    with_order = [each for each in own if each.cell is not None]
    without = [each for each in own if each.cell is None]
    analysed = [each for each in own if each.pseudonym in seen.analysed]
    completed = [each for each in with_order if each.state == "completed"]
    decisions = [store.consents(each.pseudonym) for each in own]
    days = sorted(session.opened_at[:10] for each in own for session in store.sessions(each.pseudonym))
    return Flow(
        simulated=simulated,
        enrolled=len(own) + deleted,
        deleted=deleted,
        no_consent=_in(without, "enrolled"),
        excluded=_in(without, "excluded"),
        withdrew_before=_in(without, "withdrawn"),
        unknown_before=_in(without, UNKNOWN),
        waiting=_in(without, "consented"),
        allocated=len(with_order),
        withdrew=_in(with_order, "withdrawn"),
        unknown=_in(with_order, UNKNOWN),
        unfinished=_in(with_order, "allocated"),
        completed=len(completed),
        analysed=len(analysed),
        orders=dict(sorted(Counter(each.cell + 1 for each in with_order if each.cell is not None).items())),
        consents=dict(sorted(Counter(each.consent_version for each in own if each.consent_version).items())),
        reconsented=sum(any(each.agreed for each in made[1:]) for made in decisions),
        declined=sum(any(not each.agreed for each in made) for made in decisions),
        first_day=days[0] if days else None,
        last_day=days[-1] if days else None,
        analysed_unfinished=len(analysed) - _in(analysed, "completed"),
        completed_without_data=len(completed) - _in(analysed, "completed"),
        excluded_by=Counter(answer for each in own for answer in _excluding(store.design, each)),
        withdrew_before_for=Counter(_reasons(store, without)),
        withdrew_for=Counter(_reasons(store, with_order)),
    )


def _excluding(design: Design, participant: Participant) -> Iterator[str]:
    """The answers to inclusion questions that excluded a participant."""
    if participant.state != "excluded":
        return
    questions = {question.id: question for question in design.inclusion}
    for name, answer in (participant.inclusion or {}).items():
        question = questions.get(name)
        if question is None or question.required != answer:
            yield f"{question.text if question else name} {'Yes' if answer else 'No'}"


def _reasons(store: Store, own: Sequence[Participant]) -> Iterator[str]:
    """Why each participant withdrew, as the experimenter stored it."""
    gone = {each.number for each in own if each.state == "withdrawn"}
    stored = {each.participant: each.detail for each in store.events() if each.name == WITHDRAWN}
    return (stored.get(number) or "no reason stored" for number in sorted(gone))


def _in(own: Iterable[Participant], state: str) -> int:
    return sum(each.state == state for each in own)
