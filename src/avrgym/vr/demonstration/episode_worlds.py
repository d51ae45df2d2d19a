"""Worlds of demonstration episodes: each contains another simulated person, sampled from the populations."""

from concurrent.futures import Executor, Future
from dataclasses import dataclass, field

from avrgym.models.human import SEXES, Person
from avrgym.people import impairments
from avrgym.people.population_names import ImpairmentName
from avrgym.people.populations import Population, find_populations
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.system import random_streams
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.session.trial_worlds import make_resting_person

MAX_PERSON_SAMPLES = 100
"""Maximum number of people that are sampled for one episode. A sampled person is rejected if the robot lacks space."""


@dataclass(frozen=True)
class DemonstrationPlan:
    """Settings of a demonstration session.

    ``population_names``: names of populations, used in turn. ``episodes``: number of episodes to record; ``None``:
    unlimited. ``steps``: maximum length of an episode in control steps. ``has_force_guard``: see
    ``safety.has_force_guard``. ``policy``: name of a policy that drives the robot until the operator takes over;
    ``operator``: no policy drives.
    """

    environment: str
    population_names: tuple[str, ...] = ("revised",)
    impairment: str = "none"
    episodes: int | None = None
    steps: int = EPISODE_STEPS
    seed: int = 0
    has_force_guard: bool = True
    settings: Settings = DEFAULT_SETTINGS
    policy: str = OPERATOR_POLICY_NAME
    populations: tuple[Population, ...] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        """Find environment and populations. Raises ``ValueError`` for an unknown name; the message lists the allowed
        names."""
        find_environment(self.environment)
        impairments.parse_impairment(self.impairment)
        found = [population for name in self.population_names for population in find_populations(name, TASKS)]
        object.__setattr__(self, "populations", tuple(found))


@dataclass(frozen=True)
class EpisodeWorld:
    """A world at the start of an episode, with its simulated person.

    ``person_sample_number``: number of the sampled person, from 0. ``seed``: seed of person and initial state.
    ``population_name`` and ``impairment``: names of population and impairment.
    """

    person_sample_number: int
    seed: int
    population_name: str
    impairment: ImpairmentName
    participant: SimulatedParticipant
    world: LiveWorld


class EpisodeWorldPreparation:
    """Builds the world of the next episode while the current episode runs."""

    def __init__(self, plan: DemonstrationPlan, workers: Executor, first_sample: int = 0) -> None:
        """Start to build the first world. ``first_sample``: number of its person."""
        self._plan, self._workers = plan, workers
        self._next_sample = first_sample
        self._request()

    @property
    def is_ready(self) -> bool:
        """Whether the next world is built."""
        return self._future.done()

    def pop_world(self) -> EpisodeWorld:
        """Returns the next world, and starts to build the world after it.

        If building the world raised an error, raises this error.
        """
        built = self._future.result()
        self._next_sample = built.person_sample_number + 1
        self._request()
        return built

    def close(self) -> None:
        """Stops the construction of worlds."""
        self._future.cancel()

    def _request(self) -> None:
        self._future: Future[EpisodeWorld] = self._workers.submit(build_world, self._plan, self._next_sample)


def build_world(plan: DemonstrationPlan, first_sample: int) -> EpisodeWorld:
    """Returns a world with a sampled person and enough space for the robot.

    ``first_sample``: number of the first person to try.

    Raises:
        NoClearanceError: if the robot lacks space next to ``MAX_PERSON_SAMPLES`` people. It is a ``ValueError``.
    """
    for sample in range(first_sample, first_sample + MAX_PERSON_SAMPLES - 1):
        try:
            return _build(plan, sample)
        except NoClearanceError:
            continue
    return _build(plan, first_sample + MAX_PERSON_SAMPLES - 1)


def _build(plan: DemonstrationPlan, sample: int) -> EpisodeWorld:
    random = random_streams.make_demonstration_session_rng(plan.seed, sample)
    seed, sex = int(random.integers(2**31)), SEXES[int(random.integers(len(SEXES)))]
    population = plan.populations[sample % len(plan.populations)]
    impairment = population.choose_impairment(impairments.parse_impairment(plan.impairment))
    traits = sample_participant_traits(
        sex, seed, population.distribution, impairment, population.trained_policy
    )
    participant = SimulatedParticipant(traits, seed)
    participant.adopt_posture(plan.environment, plan.settings)
    person = make_resting_person(plan.environment, Person(sex, traits.torso_height_m), plan.settings)
    world = LiveWorld(plan.environment, person, plan.settings)
    world.reset(seed)
    return EpisodeWorld(sample, seed, population.name, impairment, participant, world)
