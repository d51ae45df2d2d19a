"""Describe the loss of a database in sentences, for the report, the methods section and exports."""

from collections.abc import Iterator, Sequence

from avrgym.study.storage.database_rows import Participant, StudyEvent
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT
from avrgym.study.storage.sites import ROW_ID_STRIDE
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE
from avrgym.study.storage.store import StudyStore

PARTICIPATION_CONFIRMED_EVENT = "participation confirmed"
"""Name of the event for a consent that the experimenter confirmed from other records after a data loss."""


def describe_data_loss(store: StudyStore) -> tuple[str, ...]:
    """Returns sentences about each rebuild of the database, and about participants with an unknown state."""
    return tuple(_sentences(store))


def _sentences(store: StudyStore) -> Iterator[str]:
    sites = {site.number: site.name for site in store.read_sites()}
    events, people = store.read_events(), store.read_participants()
    for event in events:
        if event.name == DATABASE_REBUILT_EVENT:
            yield (
                f"The study's database{_of_site(sites, event)} was lost and rebuilt from the recordings at "
                f"{event.recorded_at} (UTC); {event.detail}. A plan is confirmatory only if a trusted time stamp "
                "proves its date."
            )
    unknown = [each.pseudonym for each in people if each.state == UNKNOWN_PARTICIPATION_STATE]
    if unknown:
        yield (
            "Consent, withdrawal or deletion is unknown since the loss of the database; these participants are in no "
            f"analysis: {', '.join(unknown)}."
        )
    if confirmed := _confirmed(people, events):
        yield (
            "After the loss of the database the experimenter confirmed from other records that they consented and did "
            f"not withdraw: {', '.join(confirmed)}."
        )


def _of_site(sites: dict[int, str], event: StudyEvent) -> str:
    name = sites.get(event.id // ROW_ID_STRIDE)
    return f" of the site {name}" if name else ""


def _confirmed(people: Sequence[Participant], events: Sequence[StudyEvent]) -> list[str]:
    numbers = {event.participant for event in events if event.name == PARTICIPATION_CONFIRMED_EVENT}
    return [each.pseudonym for each in people if each.number in numbers]
