"""What the rewards of two versions of the world add up to, term by term, as the tables of docs/policies.md.

python scripts/figures/reward_tables.py [EPISODES]      100 episodes unless said otherwise

Both versions judge the same steps: oracles with Revised people, packaged policies with those they were trained on.
"""

import sys
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from avrgym.learning.evaluation import MAX_WORLDS
from avrgym.learning.seed_streams import SHOWING, episode_generators
from avrgym.policies.registry import acting, find
from avrgym.robots.registry import ROBOTS
from avrgym.simulation.world_version import WORLD_VERSIONS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.known import EPISODE_STEPS
from avrgym.tasks.registry import TASKS, find_task

Array = NDArray[np.float64]
POLICIES: Mapping[str, str] = {"oracle": "revised", "original": "original", "revised": "revised"}
"""Whom each policy meets."""
SUCCESS = "success"


def tables(episodes: int) -> Iterator[str]:
    """One table a task: a row a term, in each cell what it adds to an episode's reward in each version."""
    for task in TASKS:
        sums = {
            f"{robot} {policy}": added_up(f"avrgym/{task}{robot}-v1", policy, people, episodes)
            for robot in ROBOTS
            for policy, people in POLICIES.items()
        }
        yield from (f"### {task}", "")
        yield "| | " + " | ".join(sums) + " |"
        yield "|---" * (len(sums) + 1) + "|"
        for name in dict.fromkeys(name for found in sums.values() for part in found for name in part):
            yield f"| {_label(name)} | " + " | ".join(_cell(name, found) for found in sums.values()) + " |"
        yield ""


def added_up(
    environment: str, policy: str, people: str, episodes: int, seed: int = 0
) -> list[dict[str, float]]:
    """Means over episodes: the share of successes, the reward, and its terms with their weights; by version."""
    parts = [
        _run(environment, policy, people, range(first, min(first + MAX_WORLDS, episodes)), seed)
        for first in range(0, episodes, MAX_WORLDS)
    ]
    return [
        {name: float(np.concatenate([part[version][name] for part in parts]).mean()) for name in found}
        for version, found in enumerate(parts[0])
    ]


def _run(environment: str, policy: str, people: str, numbers: range, seed: int) -> list[dict[str, Array]]:
    world = Episodes(environment, len(numbers), distribution=people)
    generators = episode_generators(SHOWING, seed, numbers)
    observation = world.begin(np.arange(len(numbers)), generators)
    tasks = [find_task(world.task.name, version) for version in WORLD_VERSIONS]
    memories = [world.task_state for _ in tasks]
    sums: list[dict[str, Array]] = [{SUCCESS: np.zeros(0), "reward": np.zeros(len(numbers))} for _ in tasks]
    with acting(find(policy, environment), world, generators) as act:
        for _ in range(EPISODE_STEPS):
            action = act(observation).astype(float)
            world.command(action)
            world.simulation.step()
            state = world.simulation.state()
            for number, (task, found) in enumerate(zip(tasks, sums, strict=True)):
                outcome = task.evaluate_step(state, action, memories[number])
                memories[number] = outcome.task_state
                found[SUCCESS] = outcome.success.astype(float)
                found["reward"] += task.reward(outcome.terms)
                for name, weight in task.weights.items():
                    found[name] = found.get(name, 0.0) + weight * outcome.terms[name]
            observation = world.evaluate_step(action).observation
    return sums


def _label(name: str) -> str:
    return name if name in (SUCCESS, "reward") else f"`{name}`"


def _cell(name: str, versions: list[dict[str, float]]) -> str:
    texts = [_figure(name, found[name]) if name in found else "–" for found in versions]
    return texts[0] if len(set(texts)) == 1 else " → ".join(texts)


def _figure(name: str, value: float) -> str:
    return f"{100.0 * value:.0f} %" if name == SUCCESS else f"{value:.1f}".replace("-0.0", "0.0")


if __name__ == "__main__":
    for line in tables(int(sys.argv[1]) if sys.argv[1:] else 100):
        print(line, flush=True)
