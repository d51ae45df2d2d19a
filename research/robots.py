"""Measures every robot in every task: starts that the base search reaches, and the oracle.

    python research/robots.py [environment ...]

Each result is stored in robots.json; the reference page of the environments shows them. Without names, environments
that have no result are measured. Reach: 1 000 people of the revised population. Oracle: 100 episodes with them.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import kinematics, transforms
from avrgym.learning.evaluation import evaluate
from avrgym.simulation.base_search import GOAL_ACCURACY_M, GOAL_ACCURACY_RAD
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from figures_file import add, chosen, read

FIGURES_FILE = Path(__file__).with_suffix(".json")
STARTS, EPISODES, SEED, PEOPLE = 1000, 100, 0, "revised"
GOAL_ITERATIONS = 60
FIGURES = (
    "episodes", "success_rate", "success_ci95", "reward_mean", "force_mean_newton", "episodes_over_limit"
)  # fmt: skip


class PoseRecorder:
    """Calls ``find_start`` and stores its arguments."""

    def __init__(self) -> None:
        self._placed_start = placement.find_start
        self.arguments: tuple[Any, ...] = ()

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Initial states, as ``find_start`` returns them."""
        self.arguments = arguments
        return self._placed_start(*arguments, **options)


def reach(environment: str) -> dict[str, float]:
    """Shares of the first draws of initial states.

    ``start``: the arm has the tool's start pose within 5 mm and 0.05 rad. ``goals``: from there it reaches the task's
    goal poses within the accuracy of the base search. ``clear``: nothing overlaps.
    """
    episodes = Episodes(environment, STARTS, people=PEOPLE, num_threads=1)
    recorder, worlds = PoseRecorder(), np.arange(STARTS)
    placement.find_start, original = recorder, placement.find_start
    try:
        episodes._draw(worlds, [random_streams.episode(world) for world in worlds.tolist()])
    finally:
        placement.find_start = original
    _, _, _, tool_pos_w, tool_q_w, goal_pos_w, goal_q_w, _ = recorder.arguments
    chain, joints = placement.arm_chain(episodes.scene), episodes.simulation.joint_positions()
    to_base = transforms.invert(*episodes.simulation.robot_base())
    pos, q = transforms.compose(*to_base, tool_pos_w, np.broadcast_to(tool_q_w, (STARTS, 4)))
    reached_pos, reached_q = kinematics.forward_kinematics(chain, joints)
    off_rad = transforms.to_rotation_vector(transforms.multiply(reached_q, transforms.conjugate(q)))
    start = (_length(reached_pos - pos) < 0.005) & (_length(off_rad) < 0.05)
    goals = []
    for goal in range(goal_pos_w.shape[1]):
        pos, q = transforms.compose(*to_base, goal_pos_w[:, goal], goal_q_w[:, goal])
        found = kinematics.inverse_kinematics(chain, pos, q, joints, iterations=GOAL_ITERATIONS)
        goals.append(
            (found.position_error_m < GOAL_ACCURACY_M) & (found.rotation_error_rad < GOAL_ACCURACY_RAD)
        )
    clear = 1.0 - len(episodes._conflicts(worlds)) / STARTS
    return {"start": float(start.mean()), "goals": float(np.mean(goals)), "clear": clear}


def _length(vectors: FloatArray) -> FloatArray:
    return np.linalg.norm(vectors, axis=-1)


def main() -> None:
    """Measure and store, one environment after the other."""
    named = sys.argv[1:] or [each for each in ENVIRONMENTS if each not in read(FIGURES_FILE)]
    for environment in named:
        found = evaluate(environment, "oracle", PEOPLE, EPISODES, SEED)
        add(FIGURES_FILE, environment, {**chosen(found, FIGURES), **reach(environment)})


if __name__ == "__main__":
    main()
