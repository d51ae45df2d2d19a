"""What the person observes as an agent: tool and goal in the frame of their hips, their body, and forces on them."""

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import JOINTS
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.observation import FORCE_N, REACH_M, TURN_RAD, UNIT

Array = NDArray[np.float64]


class HumanView:
    """The parts of the person's observation, in their order, as in Assistive Gym; metres, radians, newtons.

    Tool (3) and its rotation (4), the tool from its goal (3) where the robot observes that, all 20 joint angles,
    shoulder, elbow and wrist (9) where an arm is offered, else the head (3) and its rotation (4), all force of robot
    and tool (1) and that of the tool (1).
    """

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._hips = episodes.simulation.bodies.index(human.PREFIX + "hips")
        self._goals = [entry for entry in episodes.observation.entries if entry.scale is not None]
        body = [REACH_M] * 9 if self._offers_arm else [REACH_M] * 3 + [UNIT] * 4
        goals = [REACH_M] * sum(entry.size for entry in self._goals)
        tool, angles = [REACH_M] * 3 + [UNIT] * 4, [TURN_RAD] * len(JOINTS)
        self.bound = np.array(tool + goals + angles + body + [FORCE_N] * 2)
        """What no number exceeds either way, (O,)."""

    @property
    def _offers_arm(self) -> bool:
        return self._episodes.task.offered == "arm"

    def of(self) -> Array:
        """The observation (O,) of the person of the first world as it is."""
        episodes, state = self._episodes, self._episodes.simulation.state()
        hips = episodes.simulation.body_poses(0)[self._hips]
        hips_pos_w, turned_back = hips[:3], transforms.conjugate(hips[3:])
        parts = [
            transforms.rotate(turned_back, state.tool_pos_w[0] - hips_pos_w),
            transforms.multiply(turned_back, state.tool_q_w[0]),
            *(
                transforms.rotate(turned_back, entry.of(state, episodes.task_state)[0])
                for entry in self._goals
            ),
            episodes.simulation.person_angles_rad()[0],
            *self._body(state, hips_pos_w, turned_back),
            state.total_force_n[:1],
            state.tool_force_n[:1],
        ]
        return np.concatenate([part.ravel() for part in parts])

    def _body(self, state: State, hips_pos_w: Array, turned_back: Array) -> list[Array]:
        """What of themselves they offer, in the frame of their hips."""
        if self._offers_arm:
            return [transforms.rotate(turned_back, state.right_arm_pos_w[0] - hips_pos_w)]
        head = transforms.rotate(turned_back, state.head_pos_w[0] - hips_pos_w)
        return [head, transforms.multiply(turned_back, state.head_q_w[0])]
