"""Measures how simulated people move, in both versions of the motion: speeds, accelerations and jerks of head and hand.

    python research/motion.py [WORLDS]      prints the table of the note on even motion

Adaptive policies bring the tool in FeedingJaco (head) and ScratchItchJaco (hand) for 8 s; 4 worlds by default. Every
10 ms the joint angles of the neck and the position of the right wrist are read. A cell contains the median over worlds
of the largest value.
"""

import sys
from collections.abc import Iterator

import numpy as np

from avrgym.models.human import JOINT_INDEX
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.people.zoo.styles import STYLES
from avrgym.policies import registry
from avrgym.tasks.episodes import Episodes
from papers_results import row

STEPS = 80
HEAD = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]
PEOPLE = ("participants", *(f"zoo/train/{style}" for style in STYLES))
VERSIONS = ("1", "2")


def table(worlds: int) -> Iterator[str]:
    """Largest speeds, accelerations and jerks of each population, in both versions."""
    yield row("people", "head rad/s", "head rad/s²", "head rad/s³", "hand m/s", "hand m/s²", "hand m/s³")
    yield row(*["---"] * 7)
    for people in PEOPLE:
        found = [measured(f"{people}@{version}", worlds) for version in VERSIONS]
        pairs = (f"{before:.3g} → {after:.3g}" for before, after in zip(*found, strict=True))
        yield row(people, *pairs)


def measured(people: str, worlds: int) -> list[float]:
    """Median over worlds of the largest speed, acceleration and jerk of the head, then of the hand."""
    head = path("avrgym/FeedingJaco-v1", people, worlds)[0]
    hand = path("avrgym/ScratchItchJaco-v1", people, worlds)[1]
    return [largest(places, order) for places in (head, hand) for order in (1, 2, 3)]


def largest(places: np.ndarray, order: int) -> float:
    """Median over worlds of the largest norm of a derivative of places (T, N, 3)."""
    derivative = np.diff(places, n=order, axis=0) / PHYSICS_STEP_S**order
    return float(np.median(np.linalg.norm(derivative, axis=-1).max(axis=0)))


def path(environment: str, people: str, worlds: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the neck and positions of the right wrist, (T, N, 3) each."""
    episodes = Episodes(environment, worlds, people=people, num_threads=1)
    policy = registry.resolve_policy("adaptive", environment)
    generators = [np.random.default_rng(seed) for seed in range(worlds)]
    observation = episodes.reset(np.arange(worlds), generators)
    act = registry.make_action_function(policy, episodes, generators)
    heads, hands = [], []
    for _ in range(STEPS):
        action = act(observation)
        episodes.command_robots(action)
        for substep in range(DEFAULT_SUBSTEPS):
            episodes.step_physics(substep, 1)
            heads.append(episodes.simulation.get_person_joint_angles_rad()[:, HEAD])
            hands.append(episodes.simulation.get_arm_poses().right_arm_pos_w[:, 2])
        observation = episodes.evaluate_step(action).observation
    return np.array(heads), np.array(hands)


if __name__ == "__main__":
    for line in table(int(sys.argv[1]) if len(sys.argv) > 1 else 4):
        print(line, flush=True)
