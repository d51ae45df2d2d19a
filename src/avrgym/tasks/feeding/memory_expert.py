"""Memory-based expert for feeding: maintains a distance while the mouth moves. Recurrent policies imitate it.

In a collision of the head with the spoon, the inertia of the whole arm causes a high force. The spoon therefore waits
until the mouth is at rest.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.feeding.feedback_expert import compute_feeding_target
from avrgym.tasks.task import RunningEpisodes, TaskState

MAX_RESTING_MOUTH_SPEED_M_S = 0.04
"""Maximum speed of a mouth that is treated as at rest."""
MAX_STANDOFF_M = 0.06
"""Standoff of the spoon from a mouth that moves at twice ``MAX_RESTING_MOUTH_SPEED_M_S`` or more. It is smaller at
lower speeds.
"""


class FeedingMemoryExpert:
    """Acts like the feedback expert, but the spoon has a standoff while the mouth moves."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Start with the current poses of the spoons and the mouths."""
        self._mouth_w = episodes.get_state().mouth_pos_w
        self._follow = FeedbackExpert(episodes, self._target)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        return self._follow(observation)

    def _target(self, state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
        speed_m_s = norm(state.mouth_pos_w - self._mouth_w) / planner.scene.control_step_s
        self._mouth_w = state.mouth_pos_w
        return compute_feeding_target(state, task_state, planner, compute_standoff_from_mouth_m(speed_m_s))


def compute_standoff_from_mouth_m(mouth_m_s: FloatArray) -> FloatArray:
    """Returns the standoff (N,) of spoons in metres from mouths with speeds ``mouth_m_s`` (N,)."""
    return MAX_STANDOFF_M * np.clip(mouth_m_s / MAX_RESTING_MOUTH_SPEED_M_S - 1.0, 0.0, 1.0)
