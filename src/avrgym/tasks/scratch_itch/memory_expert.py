"""Memory-based expert for scratching: stores whether the robot's arm has moved (swung) to the front of the person.
Recurrent policies imitate it.

The robot reaches the inner side of the forearm from the front, over the lap. On a direct path the robot's elbow would
touch the person. The arm therefore first makes a fixed joint-space motion to a point in front of the wrist and above
it.
"""

from typing import NamedTuple

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.tasks.experts.feedback import TURN_SPEED_RAD_S, FeedbackExpert, FeedbackPlanner
from avrgym.tasks.scratch_itch.expert import SWING_SPEED_M_S, compute_skin_directions_w
from avrgym.tasks.scratch_itch.feedback_expert import (
    BlendRange,
    compute_blended_target,
    compute_front_approach_weight,
    compute_scratching_target,
)
from avrgym.tasks.scratch_itch.reward import compute_itch_limb_frame
from avrgym.tasks.task import Controller, RunningEpisodes


class SwingMotion(NamedTuple):
    """A swing to the front: a fixed joint-space motion.

    ``joint_displacements`` (J,) are the changes of the joint positions, in radians. ``inward_range`` and
    ``not_downward_range`` are ranges of the skin normals for which the swing is used, see
    ``compute_front_approach_weight``.
    """

    joint_displacements: tuple[float, ...]
    inward_range: BlendRange
    not_downward_range: BlendRange


SWING_BY_ROBOT = {
    "Jaco": SwingMotion(
        (-2.27, -0.57, 0.89, -0.2, -0.1, -0.62, 0.0), inward_range=(0.5, 0.8), not_downward_range=(-0.8, -0.6)
    ),
    "PR2": SwingMotion(
        (-0.85, -0.6, -0.9, 0.0, 2.6, 0.75, 0.0), inward_range=(0.3, 0.6), not_downward_range=(-0.7, -0.5)
    ),
}
"""Swings by name of the robot. For the Jaco, they are the median of the feedback expert's motions to the front; for the
PR2, the mean of the planned detours.
"""
FRONT_APPROACH_WEIGHT_THRESHOLD = 0.5
"""Value of ``compute_front_approach_weight`` above which the arm first swings to the front of the person."""
SWING_COMPLETE_FRACTION = 0.85
"""Completed share of the swing at which the swing ends."""


def make_memory_expert(episodes: RunningEpisodes) -> Controller:
    """Returns the expert with a swing to the front for robots in ``SWING_BY_ROBOT``, otherwise the feedback expert."""
    swing = SWING_BY_ROBOT.get(episodes.scene.robot.name)
    return (
        FeedbackExpert(episodes, compute_scratching_target)
        if swing is None
        else SwingToFrontExpert(episodes, swing)
    )


class SwingToFrontExpert:
    """Swings the arm to the front of the person if necessary. Afterwards, acts like the feedback expert."""

    def __init__(self, episodes: RunningEpisodes, swing: SwingMotion) -> None:
        """Start with the current poses of the robots and the people."""
        self._episodes, self._planner = episodes, FeedbackPlanner(episodes)
        self._swing, self._first = swing, self._planner.joint_positions
        self._way = np.array(swing.joint_displacements)
        self._swung = np.zeros(len(self._first), dtype=bool)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        planner, state, task_state = self._planner, self._episodes.get_state(), self._episodes.task_state
        planner.reset_preferred_posture()
        self._swung |= self._swing_progress() > SWING_COMPLETE_FRACTION
        out_w, _ = compute_skin_directions_w(task_state, compute_itch_limb_frame(state, task_state)[1])
        in_front = compute_front_approach_weight(
            out_w, self._swing.inward_range, self._swing.not_downward_range
        )
        pos_w, q_w, speed = compute_blended_target(state, task_state, planner, in_front * self._swung)
        joint_positions = planner.plan_straight_line_step(pos_w, q_w, speed, TURN_SPEED_RAD_S)
        swings = (in_front > FRONT_APPROACH_WEIGHT_THRESHOLD) & ~self._swung
        if swings.any():
            swing = planner.plan_joint_space_step(self._first + self._way, SWING_SPEED_M_S, np.pi)
            joint_positions = np.where(swings[:, None], swing, joint_positions)
        return planner.compute_action_to_joint_positions(joint_positions)

    def _swing_progress(self) -> FloatArray:
        """Returns the completed share (N,) of the swing."""
        displacement = self._way
        return ((self._planner.joint_positions - self._first) * displacement).sum(axis=-1) / (
            displacement * displacement
        ).sum()
