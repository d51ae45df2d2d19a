"""Dry run of a study: simulated participants use the same sessions, database and recordings as people.

Each simulated participant runs in a separate process, in simulated time. After each trial, the participant leaves VR,
returns and is calibrated again. Results therefore depend only on the seeds, and not on interruptions of an earlier run.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrgym.models.human import SEXES
from avrgym.people import impairments
from avrgym.people.motor_model import MOTION_VERSION
from avrgym.people.population_names import ImpairmentName
from avrgym.people.populations import Population, find_populations, format_population_label
from avrgym.policies.registry import HumanOperator
from avrgym.policies.trained_policies import PolicyError
from avrgym.recording.schema import Answer
from avrgym.study.checking.preflight import list_environment_policy_pairs, load_study_policy
from avrgym.study.design.design import DESIGN_FILE
from avrgym.study.people.participants import (
    add_note,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
)
from avrgym.study.sessions.study_visit import StudyVisit, has_unfinished_trials
from avrgym.study.storage.database_rows import Participant, StudySession
from avrgym.study.storage.sessions import end_open_sessions, may_be_running
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE, StudyError
from avrgym.study.storage.store import StudyStore, find_participant, find_rows
from avrgym.system import random_streams
from avrgym.system.parallel_calls import count_available_cores, starmap
from avrgym.tasks.registry import TASKS
from avrgym.tasks.world_people import find_environment_populations
from avrgym.vr.emulation.in_process_client import ANSWER_DELAY_S, STATE_INTERVAL_TICKS, InProcessClient
from avrgym.vr.emulation.simulated_participant import (
    PARTICIPANT_DISTRIBUTION,
    ParticipantTraits,
    SimulatedParticipant,
    sample_participant_traits,
)

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

AGE_RANGE_YEARS = (19, 24)
"""Ages (years) of the youngest and the oldest participant in the paper."""
DROPOUT_STATES = ("excluded", "withdrawn", UNKNOWN_PARTICIPATION_STATE)
"""States of participants that do not continue the study."""


@dataclass(frozen=True)
class DryRunSettings:
    """Settings of a dry run.

    ``population_name``: name of the population. ``populations``: the populations with this name. Each participant is
    sampled from one of them. ``impairment``: impairment of all participants.
    """

    seed: int
    population_name: str = "participants"
    populations: tuple[Population, ...] = (Population("participants", PARTICIPANT_DISTRIBUTION),)
    impairment: ImpairmentName = "none"

    def __str__(self) -> str:
        words = f"simulated with seed {self.seed}, motion {MOTION_VERSION}"
        words += (
            ""
            if self.population_name == "participants"
            else f", people {format_population_label(self.population_name)}"
        )
        return words + ("" if self.impairment == "none" else f", impairment {self.impairment}")


def make_dry_run_settings(seed: int, people: str, impairment: str) -> DryRunSettings:
    """Returns the settings of a dry run. ``people``: name of a population. ``impairment``: name of an impairment.

    Raises ``ValueError`` for an unknown name, and for a population with another version of the motion model.
    """
    populations = find_populations(people, TASKS)
    if any(each.distribution.motion_version != MOTION_VERSION for each in populations):
        name = people.partition("@")[0]
        raise ValueError(
            f"dry runs have motion version {MOTION_VERSION}; {people} has another version; allowed: {name}"
        )
    return DryRunSettings(seed, people, populations, impairments.parse_impairment(impairment))


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
    """Simulate the participants of a study. Participants of an earlier dry run continue.

    Args:
        folder: the study's folder.
        participants: number of simulated participants, including those of an earlier run.
        seed: seed of bodies, behaviour and answers. It must equal the seed of an earlier run.
        progress: called after each participant, with the numbers of completed and planned trials.
        jobs: number of processes; default: number of cores. It does not affect the results.
        people: the population: a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a people file, a
            trained human or a folder of trained humans.
        impairment: the impairment of all participants, a name in ``people.impairments.IMPAIRMENTS``.
        cluster: run on the workers of this cluster. They need access to the study's folder.

    Raises:
        ValueError: for an unknown population or impairment. Nothing is stored then.
        StudyError: if an earlier run had another seed or population, or if a session fails.
        PolicyError: if a policy of the design is missing. Nothing is stored then.
    """
    dry_run = make_dry_run_settings(seed, people, impairment)
    with StudyStore(folder) as store:
        if cluster is not None and store.database.is_sqlite and cluster.has_remote_nodes():
            raise StudyError(
                "several computers cannot share a SQLite database: set a PostgreSQL url in study.toml, or use "
                "--cluster local"
            )
        for environment, policy in list_environment_policy_pairs(store):
            find_environment_populations(people, environment)
            if isinstance(load_study_policy(store, environment, policy), HumanOperator):
                raise PolicyError(
                    f"{policy} needs a human operator, but a dry run has none; "
                    "remove this policy in a copy of the study"
                )
        pseudonyms = [find_or_enrol_participant(store, index, dry_run) for index in range(participants)]
        unfinished = [name for name in pseudonyms if store.read_participant(name).state == "allocated"]
        arguments = [(store.folder.resolve(), name, dry_run) for name in unfinished]

        def report(_: int) -> None:
            progress(*_trials(store, pseudonyms))

        if cluster is None:
            starmap(simulate_participant, arguments, jobs or count_available_cores(), report)
        else:
            cluster.starmap(_simulate_on_worker, arguments, report)


def _simulate_on_worker(folder: Path, pseudonym: str, dry_run: DryRunSettings) -> None:
    """Run ``simulate_participant`` on a worker of a cluster."""
    if not (folder / DESIGN_FILE).is_file():
        raise StudyError(
            f"{folder} is missing on {socket.gethostname()}: each node of the cluster needs the study's folder at the "
            "same path"
        )
    simulate_participant(folder, pseudonym, dry_run)


def simulate_participant(folder: Path, pseudonym: str, dry_run: DryRunSettings) -> None:
    """Run the remaining trials of a simulated participant in this process. Stop if the participant withdraws."""
    with StudyStore(folder) as store:
        try:
            _run_visits(store, pseudonym, dry_run)
        except RuntimeError:
            if store.read_participant(pseudonym).state not in DROPOUT_STATES:
                raise


def _run_visits(store: StudyStore, pseudonym: str, dry_run: DryRunSettings) -> None:
    """Run sessions until the participant has completed the study. A session ends at the maximum time in VR."""
    _end_killed_sessions(store, pseudonym)
    while store.read_participant(pseudonym).state == "allocated":
        before = len(store.read_remaining_trials(pseudonym))
        _run_visit(store, pseudonym, dry_run)
        unfinished = has_unfinished_trials(store, pseudonym)
        if unfinished and len(store.read_remaining_trials(pseudonym)) == before:
            limit = store.design.sessions.max_headset_minutes
            raise StudyError(
                f"{pseudonym} completed no trial within max_headset_minutes = {limit:g}; set a higher limit in "
                f"{DESIGN_FILE}"
            )


def _end_killed_sessions(store: StudyStore, pseudonym: str) -> None:
    """End the open sessions of a killed dry run. Their running trials are then planned again."""
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        sessions = find_rows(connection, StudySession, participant=participant.number, state="open")
        if not any(may_be_running(store, session) for session in sessions):
            end_open_sessions(store, connection, participant, attempts="interrupted", sessions="interrupted")


def _run_visit(store: StudyStore, pseudonym: str, dry_run: DryRunSettings) -> None:
    with StudyVisit(store, pseudonym) as visit:
        rng = _random(dry_run.seed, visit.stored_session.participant)
        for _ in range(sum(each.state == "closed" for each in store.read_sessions(pseudonym))):
            _draw_answers(store, visit.stored_session.participant, rng)
        _answer(visit, "before_session", rng)
        while has_unfinished_trials(store, pseudonym) and not visit.headset_time.is_limit_reached:
            _run_trial(visit, dry_run)
            if visit.is_ended_elsewhere:
                raise StudyError(f"another process ended {visit.stored_session}; run the command again")
        _answer(visit, "after_session", rng)


def sample_dry_run_traits(participant: Participant, dry_run: DryRunSettings) -> ParticipantTraits:
    """Returns the sampled body and behaviour of a simulated participant."""
    rng = _random(dry_run.seed, participant.number)
    seed = int(rng.integers(2**31))
    population = dry_run.populations[int(rng.integers(len(dry_run.populations)))]
    impairment = population.choose_impairment(dry_run.impairment)
    return sample_participant_traits(
        participant.sex, seed, population.distribution, impairment, population.trained_policy
    )


def _answer(visit: StudyVisit, when: str, rng: np.random.Generator) -> None:
    """Store random answers about the session. Already answered items also consume random numbers."""
    asked = visit.find_unanswered_items(when)
    for item in visit.store.design.list_items_at_moment(when, seed=visit.stored_session.participant):
        value = int(rng.integers(1, item.points + 1))
        if item in asked:
            visit.record_answer(Answer(item.id, value, ANSWER_DELAY_S), when).result()


def _draw_answers(store: StudyStore, participant: int, rng: np.random.Generator) -> None:
    """Consume the random numbers of the answers about one session."""
    for when in ("before_session", "after_session"):
        for item in store.design.list_items_at_moment(when, seed=participant):
            rng.integers(1, item.points + 1)


def _run_trial(visit: StudyVisit, dry_run: DryRunSettings) -> None:
    """Run the first remaining trial in a separate VR session."""
    plan = visit.plan_remaining_trials()
    number = plan.first_trial_number
    traits = sample_dry_run_traits(visit.store.read_participant(visit.pseudonym), dry_run)
    participant = SimulatedParticipant(traits, plan.trials[number - 1].seed, plan.furniture)
    client = InProcessClient(participant, lambda text: None)
    reached = replace(plan, trials=plan.trials[:number])
    session = visit.create_session(reached, client.receive, state_interval_ticks=STATE_INTERVAL_TICKS)
    client.run(session)


def find_or_enrol_participant(store: StudyStore, index: int, dry_run: DryRunSettings) -> str:
    """Returns the pseudonym of the simulated participant with this index (from 0). A missing one is enrolled."""
    present = [
        person
        for person in store.read_participants()
        if person.simulated and person.state not in DROPOUT_STATES
    ]
    if index < len(present):
        pseudonym = present[index].pseudonym
    else:
        age_years = int(_random(dry_run.seed, index).integers(AGE_RANGE_YEARS[0], AGE_RANGE_YEARS[1] + 1))
        pseudonym = enrol_participant(store, SEXES[index % len(SEXES)], age_years=age_years, simulated=True)
    _consent_and_include(store, pseudonym, dry_run)
    return pseudonym


def _consent_and_include(store: StudyStore, pseudonym: str, dry_run: DryRunSettings) -> None:
    """Store consent and inclusion answers if they are missing."""
    note = str(dry_run)
    notes = [written.text for written in store.read_notes(pseudonym)]
    if not notes:
        add_note(store, pseudonym, note)
    elif notes[0] != note:
        raise StudyError(
            f"{pseudonym} was {notes[0]!r}, but this run has {note!r}; allowed: the same seed, people and motion"
        )
    participant = store.read_participant(pseudonym)
    if participant.state == "enrolled" or participant.must_reconsent(store.design.consent.version):
        record_consent(store, pseudonym)
    if store.read_participant(pseudonym).state == "consented":
        record_inclusion_answers(
            store, pseudonym, {each.id: each.required for each in store.design.inclusion}
        )


def _trials(store: StudyStore, pseudonyms: list[str]) -> tuple[int, int]:
    trials = [trial for name in pseudonyms for trial in store.read_trials(name)]
    return sum(trial.state == "completed" for trial in trials), len(trials)


def _random(seed: int, number: int) -> np.random.Generator:
    return random_streams.make_simulated_answer_rng(seed, number)
