"""Observations of the human agent: tool and goal in the frame of the hips, the person's body, and contact forces."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.human import JOINTS
from avrgym.people.cooperation import OFFERED_JOINTS, OfferedBodyPart
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.observation import (
    MAX_ANGLE_RAD,
    MAX_DISTANCE_M,
    MAX_FORCE_N,
    MAX_QUATERNION_COMPONENT,
    ObservationSpec,
)
from avrgym.tasks.registry import find_task_and_scene


@dataclass(frozen=True, kw_only=True)
class HumanObservationInputs:
    """The values from which N human observations are computed; world frame, metres, radians, newtons.

    Positions are (N, 3), quaternions (N, 4). ``tool_goal_offsets_w`` contains an array (N, 3) for each entry of
    ``HumanObserver.goals``. ``joint_angles_rad`` is (N, 20). ``arm_pos_w`` (N, 3, 3) are shoulder, elbow and wrist of
    the arm that people offer. ``total_force_n`` (N,) is the force of robot and tool, ``tool_force_n`` (N,) that of the
    tool.
    """

    hips_pos_w: FloatArray
    hips_quat_w: FloatArray
    tool_pos_w: FloatArray
    tool_quat_w: FloatArray
    tool_goal_offsets_w: Sequence[FloatArray]
    joint_angles_rad: FloatArray
    arm_pos_w: FloatArray
    head_pos_w: FloatArray
    head_quat_w: FloatArray
    total_force_n: FloatArray
    tool_force_n: FloatArray


class HumanObserver:
    """Computes the observation of a human agent, as in Assistive Gym; metres, radians, newtons.

    The entries are, in this order:

    - position (3) and quaternion (4) of the tool;
    - position of the tool relative to its goal (3), if the robot observes it;
    - all 20 joint angles;
    - if an arm is the offered body part, positions of its shoulder, elbow and wrist (9); otherwise position (3) and
      quaternion (4) of the head;
    - the force of robot and tool (1), and the force of the tool (1).
    """

    def __init__(self, offered: OfferedBodyPart, observation: ObservationSpec) -> None:
        """Define the entries for an offered body part and the robot's observation."""
        self._offered = offered
        self.goal_entries = [entry for entry in observation.entries if entry.scale is not None]
        body = [MAX_DISTANCE_M] * 9 if self._is_arm else [MAX_DISTANCE_M] * 3 + [MAX_QUATERNION_COMPONENT] * 4
        goals = [MAX_DISTANCE_M] * sum(entry.size for entry in self.goal_entries)
        tool, angles = [MAX_DISTANCE_M] * 3 + [MAX_QUATERNION_COMPONENT] * 4, [MAX_ANGLE_RAD] * len(JOINTS)
        self.bound = np.array(tool + goals + angles + body + [MAX_FORCE_N] * 2)
        """Bounds (O,) of the absolute value of each number of the observation."""
        scales = [entry.scale for entry in self.goal_entries for _ in range(entry.size)]
        self.scale = np.array(
            [None] * len(tool) + scales + [None] * len(angles + body + [MAX_FORCE_N] * 2), float
        )
        """Fixed scales (O,) for the normalisation of observations; NaN for values without a fixed scale."""

    @property
    def _is_arm(self) -> bool:
        return self._offered in ("arm", "left_arm")

    @property
    def size(self) -> int:
        """Length O of a human observation."""
        return len(self.bound)

    def compute(self, inputs: HumanObservationInputs) -> FloatArray:
        """Returns the observations (N, O) of the human agents."""
        turned_back = transforms.conjugate(inputs.hips_quat_w)
        parts = [
            transforms.rotate(turned_back, inputs.tool_pos_w - inputs.hips_pos_w),
            transforms.multiply(turned_back, inputs.tool_quat_w),
            *(transforms.rotate(turned_back, offset) for offset in inputs.tool_goal_offsets_w),
            inputs.joint_angles_rad,
            *self._body(inputs, turned_back),
            inputs.total_force_n,
            inputs.tool_force_n,
        ]
        return np.concatenate([part.reshape(len(turned_back), -1) for part in parts], axis=1)

    def _body(self, inputs: HumanObservationInputs, turned_back: FloatArray) -> list[FloatArray]:
        """Returns the entries of the offered body part, in the frame of the hips."""
        if self._is_arm:
            offset = inputs.arm_pos_w - inputs.hips_pos_w[:, None]
            return [transforms.rotate(turned_back[:, None], offset)]
        head = transforms.rotate(turned_back, inputs.head_pos_w - inputs.hips_pos_w)
        return [head, transforms.multiply(turned_back, inputs.head_quat_w)]

    def make_inputs(self, simulation: Simulation, task_state: Any) -> HumanObservationInputs:
        """Returns the inputs for the people of a simulation with moving joints."""
        state = simulation.get_state()
        hips_pos_w, hips_q_w = simulation.get_hips_pose()
        return HumanObservationInputs(
            hips_pos_w=hips_pos_w,
            hips_quat_w=hips_q_w,
            tool_pos_w=state.tool_pos_w,
            tool_quat_w=state.tool_quat_w,
            tool_goal_offsets_w=[entry.compute(state, task_state) for entry in self.goal_entries],
            joint_angles_rad=simulation.get_person_joint_angles_rad(),
            arm_pos_w=state.left_arm_pos_w if self._offered == "left_arm" else state.right_arm_pos_w,
            head_pos_w=state.head_pos_w,
            head_quat_w=state.head_quat_w,
            total_force_n=state.total_force_n,
            tool_force_n=state.tool_force_n,
        )


def make_human_observer(environment_id: str) -> tuple[HumanObserver, int]:
    """Returns the human observation of an environment, and the length of human actions.

    Raises:
        ValueError: for an unknown environment id. The message lists the ids.
    """
    task, scene = find_task_and_scene(environment_id)
    return HumanObserver(task.offered_body_part, task.make_observation_spec(scene)), len(
        OFFERED_JOINTS[task.offered_body_part]
    )
