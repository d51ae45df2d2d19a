"""What people observe as agents: tool and goal in the frame of their hips, their body, and forces on them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models.human import JOINTS
from avrgym.people.behaviour import OFFERED_JOINTS, Offered
from avrgym.robots.registry import find_robot
from avrgym.simulation.worlds import Simulation, State
from avrgym.tasks.observation import FORCE_N, REACH_M, TURN_RAD, UNIT, Observation
from avrgym.tasks.registry import TASKS, find_environment

Array = NDArray[np.float64]


class HumanView:
    """The parts of a person's observation, in their order, as in Assistive Gym; metres, radians, newtons.

    Tool (3) and its rotation (4), the tool from its goal (3) where the robot observes that, all 20 joint angles,
    shoulder, elbow and wrist (9) where an arm is offered, else the head (3) and its rotation (4), all force of robot
    and tool (1) and that of the tool (1).
    """

    def __init__(self, offered: Offered, observation: Observation) -> None:
        """Of people who offer something, where a robot has such an observation."""
        self._arm = offered == "arm"
        self._goals = [entry for entry in observation.entries if entry.scale is not None]
        body = [REACH_M] * 9 if self._arm else [REACH_M] * 3 + [UNIT] * 4
        goals = [REACH_M] * sum(entry.size for entry in self._goals)
        tool, angles = [REACH_M] * 3 + [UNIT] * 4, [TURN_RAD] * len(JOINTS)
        self.bound = np.array(tool + goals + angles + body + [FORCE_N] * 2)
        """What no number exceeds either way, (O,)."""
        scales = [entry.scale for entry in self._goals for _ in range(entry.size)]
        self.scale = np.array(
            [None] * len(tool) + scales + [None] * len(angles + body + [FORCE_N] * 2), float
        )
        """The fixed scales, (O,), not a number where there is none, as of ``Observation``."""

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return len(self.bound)

    def of(self, simulation: Simulation, task_state: Any) -> Array:
        """The observations (N, O) of the people as they are."""
        state = simulation.state()
        hips_pos_w, hips_q_w = simulation.hips()
        turned_back = transforms.conjugate(hips_q_w)
        parts = [
            transforms.rotate(turned_back, state.tool_pos_w - hips_pos_w),
            transforms.multiply(turned_back, state.tool_q_w),
            *(transforms.rotate(turned_back, entry.of(state, task_state)) for entry in self._goals),
            simulation.person_angles_rad(),
            *self._body(state, hips_pos_w, turned_back),
            state.total_force_n,
            state.tool_force_n,
        ]
        return np.concatenate([part.reshape(len(hips_q_w), -1) for part in parts], axis=1)

    def _body(self, state: State, hips_pos_w: Array, turned_back: Array) -> list[Array]:
        """What of themselves they offer, in the frame of their hips."""
        if self._arm:
            offset = state.right_arm_pos_w - hips_pos_w[:, None]
            return [transforms.rotate(turned_back[:, None], offset)]
        head = transforms.rotate(turned_back, state.head_pos_w - hips_pos_w)
        return [head, transforms.multiply(turned_back, state.head_q_w)]


def human_view_of(environment_id: str) -> tuple[HumanView, int]:
    """What people observe in an environment, and how many numbers their actions have.

    Raises:
        ValueError: for an unknown environment, naming the ids there are.
    """
    name, robot = find_environment(environment_id)
    task = TASKS[name]
    observation = task.observation(task.scene(find_robot(robot)))
    return HumanView(task.offered, observation), len(OFFERED_JOINTS[task.offered])
