"""Robots that press people on purpose, and how hard they get."""

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import kinematics, transforms
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from helpers.simulation.initial_states import reset_episodes

MAX_FORCE_N = 500.0
"""Of all contacts together, up to ten at once where a hand is wedged between forearm, chest and thighs: that of each is
derived in ``models.yielding``, how many there are is measured."""

MOTIONS = ("random", "constant", "at the person")


def peak_forces(
    environment: str, worlds: int, people: str, impairment: str, motion: str, *, steps: int
) -> FloatArray:
    """The largest force (N,) on each person in so many steps.

    ``how`` the robot moves: anew at ``random`` in each step; each joint one way all the time, ``constant``; or with
    every joint that brings the tool closer ``at the person``'s head, shoulder, elbow or wrist.
    """
    episodes = reset_episodes(environment, worlds, people, impairment)
    random = np.random.default_rng(worlds)
    constant = random.choice([-1.0, 1.0], (worlds, 7))
    aim = random.integers(4, size=worlds)
    peak = np.zeros(worlds)
    for _ in range(steps):
        if motion == "at the person":
            action = actions_towards(episodes, aim)
        else:
            action = constant if motion == "constant" else random.uniform(-1.0, 1.0, (worlds, 7))
        peak = np.maximum(peak, episodes.step(action).force_on_person_n)
    return peak


def actions_towards(episodes: Episodes, aim: IntArray) -> FloatArray:
    """Actions (N, 7) that bring the tools closer to what is aimed at, each joint as fast as it goes."""
    state = episodes.simulation.state()
    parts = np.concatenate([state.head_pos_w[:, None], state.right_arm_pos_w], axis=1)
    way_w = parts[np.arange(len(aim)), aim] - state.tool_pos_w
    _, base_q = episodes.simulation.robot_base()
    way = transforms.rotate(transforms.conjugate(base_q), way_w)
    *_, jacobian = kinematics.jacobian(placement.arm_chain(episodes.scene), state.arm_angles_rad)
    return np.sign(np.einsum("nij,ni->nj", jacobian[:, :3], way))
