"""Dry runs of a study: simulated participants go the way of people, through session, store and recordings.

They take part in processes of their own, in simulated time. After each trial they take a break: they leave VR, come
back and are measured again. So what a trial gives follows from the seeds alone, wherever an earlier run ended.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrgym.models.human import SEXES
from avrgym.people import impairments
from avrgym.people.population_names import Impairment
from avrgym.people.populations import Population, find_populations, population_label
from avrgym.policies.registry import HumanOperator
from avrgym.policies.trained import PolicyError
from avrgym.recording.schema import Answer
from avrgym.study.checking.preflight import load_study_policy, policies_needed
from avrgym.study.design.design import FILE
from avrgym.study.people.participants import add_note, enrol, record_consent, record_inclusion
from avrgym.study.sessions.visit import StudyVisit, has_remaining
from avrgym.study.storage.rows import Participant
from avrgym.study.storage.states import UNKNOWN, StudyError
from avrgym.study.storage.store import Store
from avrgym.system import random_streams
from avrgym.system.jobs import cores, run_all
from avrgym.tasks.registry import TASKS
from avrgym.tasks.world_people import environment_populations
from avrgym.vr.emulation.in_process_client import ANSWER_AFTER_S, STATE_EVERY_TICKS, InProcessClient
from avrgym.vr.emulation.simulated_participant import (
    PARTICIPANTS,
    SimulatedParticipant,
    Traits,
    draw_traits,
)

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

AGES_YEARS = (19, 24)
"""Of the paper's participants."""
LEFT_STUDY = ("excluded", "withdrawn", UNKNOWN)


@dataclass(frozen=True)
class DryRun:
    """Whom simulated participants are drawn from: a seed, people by name and as kinds, and an impairment."""

    seed: int
    people: str = "participants"
    kinds: tuple[Population, ...] = (Population("participants", PARTICIPANTS),)
    impairment: Impairment = "none"

    def __str__(self) -> str:
        words = f"simulated with seed {self.seed}"
        words += "" if self.people == "participants" else f", people {population_label(self.people)}"
        return words + ("" if self.impairment == "none" else f", impairment {self.impairment}")


def find_dry_run(seed: int, people: str, impairment: str) -> DryRun:
    """The cast of people and an impairment by name; ``ValueError`` names what is allowed."""
    return DryRun(seed, people, find_populations(people, TASKS), impairments.find_impairment(impairment))


def simulate_study(
    folder: Path,
    participants: int,
    seed: int,
    progress: Callable[[int, int], None] = lambda completed, planned: None,
    jobs: int | None = None,
    people: str = "participants",
    impairment: str = "none",
    cluster: "Cluster | None" = None,
) -> None:
    """Let so many simulated participants complete a study; those of an earlier run are among them and go on.

    Args:
        folder: the study's.
        participants: how many simulated participants the study shall have, 1 or more.
        seed: of their bodies, habits and answers; that of the earlier run, if there was one.
        progress: told again and again how many of their trials are completed, and how many there are.
        jobs: how many take part at the same time, each in a process; without it as many as there are cores. What
            each gives does not depend on it.
        people: what participants are like, a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a file of people, a
            trained human or a folder of them.
        impairment: of all of them, a name in ``people.impairments.IMPAIRMENTS``.
        cluster: on whose workers they take part instead of in processes here; each has to see the study's folder.

    Raises:
        ValueError: for unknown people or impairments, naming what is allowed; nothing is stored then.
        StudyError: when an earlier run had another seed or other people, or a participant's session does not get on.
        PolicyError: when a policy of the design is missing; nothing is stored then.
    """
    cast = find_dry_run(seed, people, impairment)
    with Store(folder) as store:
        if cluster is not None and store.database.is_sqlite and cluster.several_computers():
            raise StudyError(
                "computers cannot share a study's file of SQLite: name a PostgreSQL database in study.toml, or take "
                "--cluster local"
            )
        for environment, policy in policies_needed(store):
            environment_populations(people, environment)
            if isinstance(load_study_policy(store, environment, policy), HumanOperator):
                raise PolicyError(
                    f"{policy}: nobody drives the robot in a dry run; leave it out of a copy of the study"
                )
        pseudonyms = [simulated_participant(store, index, cast) for index in range(participants)]
        unfinished = [name for name in pseudonyms if store.participant(name).state == "allocated"]
        arguments = [(store.folder.resolve(), name, cast) for name in unfinished]

        def tell(_: int) -> None:
            progress(*_trials(store, pseudonyms))

        if cluster is None:
            run_all(simulate_participant, arguments, jobs or cores(), tell)
        else:
            cluster.run_all(_simulate_where_seen, arguments, tell)


def _simulate_where_seen(folder: Path, pseudonym: str, cast: DryRun) -> None:
    """``simulate_participant`` on a computer that may be another than the one where the study was opened."""
    if not (folder / FILE).is_file():
        raise StudyError(
            f"{folder} is not there on {socket.gethostname()}: every node of the cluster has to see the study's "
            "folder at the same path"
        )
    simulate_participant(folder, pseudonym, cast)


def simulate_participant(folder: Path, pseudonym: str, cast: DryRun) -> None:
    """Let one simulated participant go through all trials that remain, in this process, unless they are withdrawn."""
    with Store(folder) as store:
        try:
            _attend(store, pseudonym, cast)
        except RuntimeError:
            if store.participant(pseudonym).state not in LEFT_STUDY:
                raise


def _attend(store: Store, pseudonym: str, cast: DryRun) -> None:
    with StudyVisit(store, pseudonym) as visit:
        chance = _random(cast.seed, visit.stored.participant)
        _answer(visit, "before_session", chance)
        while has_remaining(store, pseudonym):
            _run_trial(visit, cast)
            if visit.called_off:
                raise StudyError(f"{visit.stored} was ended elsewhere")
        _answer(visit, "after_session", chance)


def draw_participant_traits(participant: Participant, cast: DryRun) -> Traits:
    """Body and habits of a simulated participant."""
    random = _random(cast.seed, participant.number)
    seed, kind = int(random.integers(2**31)), cast.kinds[int(random.integers(len(cast.kinds)))]
    return draw_traits(
        participant.sex, seed, kind.distribution, kind.effective_impairment(cast.impairment), kind.trained
    )


def _answer(visit: StudyVisit, when: str, chance: np.random.Generator) -> None:
    """Answer what is asked about the session; these answers are chance, also those that a crash left nothing to ask."""
    asked = visit.items(when)
    for item in visit.store.design.items_at(when, seed=visit.stored.participant):
        value = int(chance.integers(1, item.points + 1))
        if item in asked:
            visit.record(Answer(item.id, value, ANSWER_AFTER_S), when).result()


def _run_trial(visit: StudyVisit, cast: DryRun) -> None:
    """Run the first trial that remains as a session in VR of its own."""
    plan = visit.plan()
    number = plan.first_trial
    traits = draw_participant_traits(visit.store.participant(visit.pseudonym), cast)
    participant = SimulatedParticipant(traits, plan.trials[number - 1].seed, plan.furniture)
    client = InProcessClient(participant, lambda text: None)
    reached = replace(plan, trials=plan.trials[:number])
    session = visit.session(reached, client.hear, state_every_ticks=STATE_EVERY_TICKS)
    client.run(session)


def simulated_participant(store: Store, index: int, cast: DryRun) -> str:
    """The pseudonym of the simulated participant with this index, who takes part from now on if not before."""
    present = [
        person for person in store.participants() if person.simulated and person.state not in LEFT_STUDY
    ]
    if index < len(present):
        pseudonym = present[index].pseudonym
    else:
        age_years = int(_random(cast.seed, index).integers(AGES_YEARS[0], AGES_YEARS[1] + 1))
        pseudonym = enrol(store, SEXES[index % len(SEXES)], age_years=age_years, simulated=True)
    _admit(store, pseudonym, cast)
    return pseudonym


def _admit(store: Store, pseudonym: str, cast: DryRun) -> None:
    """Do what is still to be done before a first session."""
    note = str(cast)
    notes = [written.text for written in store.notes(pseudonym)]
    if not notes:
        add_note(store, pseudonym, note)
    elif notes[0] != note:
        raise StudyError(
            f"{pseudonym} is {notes[0]!r}; a run with another seed or other people does not go on with them"
        )
    participant = store.participant(pseudonym)
    if participant.state == "enrolled" or participant.must_reconsent(store.design.consent.version):
        record_consent(store, pseudonym)
    if store.participant(pseudonym).state == "consented":
        record_inclusion(store, pseudonym, {each.id: each.required for each in store.design.inclusion})


def _trials(store: Store, pseudonyms: list[str]) -> tuple[int, int]:
    trials = [trial for name in pseudonyms for trial in store.trials(name)]
    return sum(trial.state == "completed" for trial in trials), len(trials)


def _random(seed: int, number: int) -> np.random.Generator:
    return random_streams.simulated_answers(seed, number)
