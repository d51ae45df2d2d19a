"""Contact forces of robots that move against people."""

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import kinematics, transforms
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from helpers.simulation.initial_states import reset_episodes

MAX_FORCE_N = 500.0
"""Maximum sum over all contacts, measured with up to ten simultaneous contacts of a hand."""

MOTIONS = ("random", "constant", "at the person")


def peak_forces(
    environment: str, worlds: int, people: str, impairment: str, motion: str, *, steps: int
) -> FloatArray:
    """Return the peak contact force (N,) on each person.

    Motions: ``random`` actions in each step; ``constant`` joint velocities; or joint velocities towards head, shoulder,
    elbow or wrist, ``at the person``.
    """
    episodes = reset_episodes(environment, worlds, people, impairment)
    random = np.random.default_rng(worlds)
    constant = random.choice([-1.0, 1.0], (worlds, episodes.action_size))
    aim = random.integers(4, size=worlds)
    peak = np.zeros(worlds)
    for _ in range(steps):
        if motion == "at the person":
            action = actions_towards(episodes, aim)
        else:
            action = constant if motion == "constant" else random.uniform(-1.0, 1.0, constant.shape)
        peak = np.maximum(peak, episodes.step(action).force_on_person_n)
    return peak


def actions_towards(episodes: Episodes, aim: IntArray) -> FloatArray:
    """Return actions (N, A) at full speed that move the tools towards the aimed body part."""
    state = episodes.simulation.get_state()
    parts = np.concatenate([state.head_pos_w[:, None], state.right_arm_pos_w], axis=1)
    way_w = parts[np.arange(len(aim)), aim] - state.tool_pos_w
    _, base_q = episodes.simulation.get_base_pose()
    way = transforms.rotate(transforms.conjugate(base_q), way_w)
    chain, drives = placement.make_arm_chain(episodes.scene), episodes.scene.robot.drive is not None
    jacobian = kinematics.compute_action_jacobian(chain, state.joint_positions, drives=drives)
    return np.sign(np.einsum("nij,ni->nj", jacobian[:, :3], way))
