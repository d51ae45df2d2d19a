"""Measures every robot in every task: starts that the base search reaches, and the oracle.

    python research/robots.py [environment ...]

The results are stored in robots.json; the reference page of the environments shows them. Without names, all
environments are measured. Results that the file contains are not measured again: delete them there to repeat them.
Reach: 1 000 people of the revised population. Oracle: 100 episodes with them.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import kinematics, transforms
from avrgym.learning.evaluation import evaluate
from avrgym.simulation.base_search import MAX_GOAL_ERROR_M, MAX_GOAL_ERROR_RAD
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
    """Calls ``find_initial_state`` and stores its arguments."""

    def __init__(self) -> None:
        self._placed_start = placement.find_initial_state
        self.arguments: tuple[Any, ...] = ()

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Initial states, as ``find_initial_state`` returns them."""
        self.arguments = arguments
        return self._placed_start(*arguments, **options)


def reach(environment: str) -> dict[str, float]:
    """Shares of the first draws of initial states.

    ``start``: the arm has the tool's start pose within 5 mm and 0.05 rad. ``goals``: from there it reaches the task's
    goal poses within the accuracy of the base search; a driving base may travel. ``clear``: nothing overlaps.
    """
    episodes = Episodes(environment, STARTS, people=PEOPLE, num_threads=1)
    recorder, worlds = PoseRecorder(), np.arange(STARTS)
    placement.find_initial_state, original = recorder, placement.find_initial_state
    try:
        episodes._draw(worlds, [random_streams.make_episode_rng(world) for world in worlds.tolist()])
    finally:
        placement.find_initial_state = original
    _, _, _, tool_pos_w, tool_q_w, goal_pos_w, goal_q_w, _ = recorder.arguments
    chain, joints = placement.make_arm_chain(episodes.scene), episodes.simulation.get_joint_positions()
    to_base = transforms.invert(*episodes.simulation.get_initial_base_pose())
    pos, q = transforms.compose(*to_base, tool_pos_w, np.broadcast_to(tool_q_w, (STARTS, 4)))
    reached_pos, reached_q = kinematics.forward_kinematics(chain, joints)
    off_rad = transforms.to_rotation_vector(transforms.multiply(reached_q, transforms.conjugate(q)))
    start = (_length(reached_pos - pos) < 0.005) & (_length(off_rad) < 0.05)
    plans, goals = placement.make_planning_chain(episodes.scene), []
    travel = np.zeros((STARTS, len(plans.lower_limit) - len(chain.lower_limit)))
    joints = np.concatenate([travel, joints], axis=-1)
    for goal in range(goal_pos_w.shape[1]):
        pos, q = transforms.compose(*to_base, goal_pos_w[:, goal], goal_q_w[:, goal])
        found = kinematics.inverse_kinematics(plans, pos, q, joints, iterations=GOAL_ITERATIONS)
        goals.append(
            (found.position_error_m < MAX_GOAL_ERROR_M) & (found.rotation_error_rad < MAX_GOAL_ERROR_RAD)
        )
    clear = 1.0 - len(episodes._conflicts(worlds)) / STARTS
    return {"start": float(start.mean()), "goals": float(np.mean(goals)), "clear": clear}


def _length(vectors: FloatArray) -> FloatArray:
    return np.linalg.norm(vectors, axis=-1)


def main() -> None:
    """Measure and store, one environment after the other."""
    for environment in sys.argv[1:] or ENVIRONMENTS:
        known = read(FIGURES_FILE).get(environment, {})
        if "success_rate" not in known:
            found = evaluate(environment, "oracle", PEOPLE, EPISODES, SEED)
            known = {**known, **chosen(found, FIGURES)}
            add(FIGURES_FILE, environment, known)
        if "start" not in known:
            add(FIGURES_FILE, environment, {**known, **reach(environment)})


if __name__ == "__main__":
    main()
