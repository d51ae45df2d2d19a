"""Records demonstrations of a simulated operator. Other programs can imitate them.

The operator intends the actions of a policy.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import NumpyArray
from avrgym.learning.lerobot_dataset import DatasetEpisode
from avrgym.models.cameras import CameraSpec, list_image_formats
from avrgym.policies import registry
from avrgym.policies.simulated_operator import SimulatedOperator
from avrgym.system.random_streams import make_demonstration_rng
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import make_policy_instruction

MAX_ATTEMPTS_PER_SUCCESS = 10
"""Maximum number of attempts, divided by the required number of successful episodes."""
MAX_WORLDS = 16


@dataclass(frozen=True)
class DemonstrationCounts:
    """Number of successful episodes, and number of attempts, until now."""

    successes: int
    attempts: int


def simulate_demonstrations(
    world: Episodes,
    policy: registry.RobotPolicy,
    episodes: int,
    steps: int,
    seed: int,
    cameras: Sequence[CameraSpec] = (),
    report: Callable[[DemonstrationCounts], None] = lambda totals: None,
) -> Generator[DatasetEpisode]:
    """Yield the successful episodes of a simulated operator. Failed attempts are discarded, as a human operator would
    do.

    Args:
        world: N worlds. Their number does not change the episodes.
        policy: the policy whose actions the operator intends.
        episodes: number of successful episodes.
        steps: number of control steps of an episode.
        seed: determines people, initial states and the operator's noise.
        cameras: cameras that are rendered at the start of each control step.
        report: called after each attempt, with the totals.

    Raises:
        ValueError: if fewer than ``episodes`` attempts succeed, out of 10 × ``episodes`` attempts.
    """
    count = world.simulation.num_worlds
    successes = attempts = 0
    while successes < episodes:
        numbers = range(attempts, attempts + count)
        for episode in _run(world, policy, [*numbers], steps, seed, cameras):
            attempts += 1
            if bool(episode.successes[-1]):
                successes += 1
                yield episode
            report(DemonstrationCounts(successes, attempts))
            if successes == episodes:
                return
            if attempts == MAX_ATTEMPTS_PER_SUCCESS * episodes:
                raise ValueError(
                    f"{successes} of {attempts} attempts succeeded; use a policy with more success in this environment"
                )


def _run(
    world: Episodes,
    policy: registry.RobotPolicy,
    numbers: list[int],
    steps: int,
    seed: int,
    cameras: Sequence[CameraSpec],
) -> Generator[DatasetEpisode]:
    """Run one attempt in each world. Yields the recorded attempts in the order of ``numbers``."""
    generators = [make_demonstration_rng(seed, number) for number in numbers]
    observation = world.reset(np.arange(len(numbers)), generators)
    operator = SimulatedOperator(generators, world.action_size, world.settings.control_hz)
    found: dict[str, list[NumpyArray]] = {}
    with registry.open_policy(policy, world, generators) as act:
        for _ in range(steps):
            action = operator.compute_commands(act(observation).astype(float)).clip(-1.0, 1.0)
            images = world.render_images(cameras) if cameras else {}
            step = world.step(action)
            values = {
                "observations": observation,
                "actions": action,
                "rewards": step.reward,
                "successes": step.success,
                "forces_on_person_n": step.force_on_person_n,
                **images,
            }
            for name, value in values.items():
                found.setdefault(name, []).append(value)
            observation = step.observation
    arrays = {name: np.stack(values, axis=1) for name, values in found.items()}
    for row, number in enumerate(numbers):
        own = {name: array[row] for name, array in arrays.items()}
        person = world.people.get_person(row)
        yield DatasetEpisode(
            make_policy_instruction(world.environment_id, world.settings),
            **{name: own.pop(name) for name in [*own] if name not in list_image_formats(cameras)},
            images=own,
            episode_columns={
                "attempt": number,
                "seed": seed,
                "person/sex": person.sex,
                "person/torso_height_m": person.torso_height_m,
            },
        )
