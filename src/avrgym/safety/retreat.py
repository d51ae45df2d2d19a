"""Retreat: the arm moves its tool slowly away from a person. All its links avoid contact.

Ten times a second, a quadratic programme computes the joint speeds. The tool follows its desired velocity closely.
Velocity dampers keep every link away from the person (Faverjon and Tournassoud, IEEE Int. Conf. Robotics and
Automation, 1987): the allowed closing speed decreases with the gap, and is zero at ``MIN_GAP_M``.
"""

from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.models import human, robot
from avrgym.models.collision_bits import COLLISION_GROUP, FURNITURE, PERSON
from avrgym.models.drive import DRIVE_JOINTS
from avrgym.models.scene import CONTROL_STEP_S, SCENE_TOOL_BODY
from avrgym.simulation.worlds import Simulation

RETREAT_TOOL_SPEED_M_S = 0.08
"""Speed of the tool during the retreat. Together with the overshoot of the servos, the speed remains below 0.1 m/s."""
FINAL_MOUTH_DISTANCE_M = 0.32
"""Distance between tool and mouth at the end of the retreat."""
FINAL_PERSON_DISTANCE_M = 0.10
"""Distance of tool and hand from the person at the end of the retreat."""
MAX_RETREAT_DURATION_S = 6.0
"""Maximum duration of a retreat. Afterwards, ``Retreat.compute_next_action`` returns ``None``."""
MIN_GAP_M = 0.01
"""Gap between arm and person at which the allowed closing speed is zero."""
MAX_CONSIDERED_GAP_M = 0.15
"""Maximum gap between arm and person that limits the joint speeds."""
CHARACTERISTIC_LENGTH_M = 0.2
"""Length that converts a rotation error of the tool (rad) to a position error (m)."""
JOINT_SPEED_WEIGHT = 0.03
"""Weight of squared joint speeds in the quadratic programme."""
MIN_CLOSING_TIME_S = 0.3
"""Minimum time in which a gap, or the distance to a joint limit, may decrease to zero."""
QP_REGULARIZATION = 1e-6
"""Regularization of the quadratic programme. With it, a solution exists even if many links are near the person."""


class SmallGaps(NamedTuple):
    """L small gaps between geoms of the arm and geoms of the person or furniture.

    Attributes:
        gap_m: gaps (L,), negative if the geoms overlap.
        direction_to_arm_w: unit vectors (L, 3) towards the arm, world frame.
        gap_jacobian: matrix (L, J) that maps joint speeds to the opening speeds of the gaps.
        is_hand: boolean mask (L,): gaps between the person and the hand or tool.
    """

    gap_m: FloatArray
    direction_to_arm_w: FloatArray
    gap_jacobian: FloatArray
    is_hand: BoolArray


class Retreat:
    """Retreat controller of the arm in one world. The retreat starts with the first call of ``compute_next_action``."""

    def __init__(
        self,
        simulation: Simulation,
        world: int = 0,
        *,
        mouth_distance_m: float = FINAL_MOUTH_DISTANCE_M,
        person_distance_m: float = FINAL_PERSON_DISTANCE_M,
        steps: int = 0,
        step_s: float = CONTROL_STEP_S,
    ) -> None:
        """Find the geoms of arm and person. This takes milliseconds: create the object before an episode.

        Args:
            simulation: the physics of N worlds.
            world: the index of the world.
            mouth_distance_m: the distance between mouth and tool at which the retreat is complete.
            person_distance_m: the distance of tool and hand from the person at which the retreat is complete.
            steps: number of finished steps of the retreat.
            step_s: duration of a step in seconds.
        """
        self._simulation, self._world = simulation, world
        self._mouth_distance_m, self._person_distance_m = mouth_distance_m, person_distance_m
        self._drives = simulation.scene.robot.drive is not None
        self._model = model = copy(simulation.batch.get_model(world))
        self._data = mujoco.MjData(model)
        joints = [model.joint(robot.ROBOT_NAME_PREFIX + name) for name in simulation.scene.arm.joints]
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._drive_dofs = np.array(
            [model.joint(robot.ROBOT_NAME_PREFIX + name).dofadr[0] for name in DRIVE_JOINTS if self._drives],
            dtype=int,
        )
        limited = np.array([model.jnt_limited[joint.id] for joint in joints], bool)
        self._range = np.where(limited[:, None], [joint.range for joint in joints], [-np.inf, np.inf])
        self._speed_limit = simulation.scene.speed_limit
        scene = simulation.scene
        first = model.joint(robot.ROBOT_NAME_PREFIX + scene.robot.get_first_moving_joint(scene.arm))
        self._links, self._hand = (_moved_by(model, joint.id) for joint in (first, joints[-1]))
        geoms = [model.geom(human.PERSON_NAME_PREFIX + name).id for name in human.GEOMS]
        self._person = {geom for geom in geoms if model.geom_contype[geom]}  # an absent arm makes no contact
        self._obstacles = [*self._person, *np.flatnonzero(model.geom_contype == FURNITURE.contype).tolist()]
        self._tool = model.body(SCENE_TOOL_BODY).id
        self._head, self._mouth = (
            model.site(human.PERSON_NAME_PREFIX + name).id for name in ("head_centre", "mouth")
        )
        self._steps, self._step_s = steps, step_s

    def restart(self) -> None:
        """Start another retreat from the current state: reset the number of steps."""
        self._steps = 0

    def compute_next_action(self) -> FloatArray | None:
        """Returns the action (A,) for the next step. Returns ``None`` if the retreat is complete, or after
        ``MAX_RETREAT_DURATION_S``."""
        near = self._measure()
        if self._steps * self._step_s >= MAX_RETREAT_DURATION_S or self._is_clear(near):
            return None
        self._steps += 1
        return self._speeds(self._desired_velocity_w(near), near) / self._speed_limit

    def compute_action_for_velocity(self, velocity_w: FloatArray) -> FloatArray:
        """Returns the action (A,) that moves the tool with a velocity (3,) and without rotation.

        As in ``compute_next_action``, every link stays away from the person.
        """
        return self._speeds(velocity_w, self._measure()) / self._speed_limit

    def _measure(self) -> SmallGaps:
        """Copies the current state of the world, and returns its small gaps."""
        self._data.qpos[:] = self._simulation.get_qpos(self._world)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return self._near()

    def _is_clear(self, near: SmallGaps) -> bool:
        from_mouth_w = self._data.xpos[self._tool] - self._data.site_xpos[self._mouth]
        return float(np.linalg.norm(from_mouth_w)) > self._mouth_distance_m and bool(
            (near.gap_m[near.is_hand] > self._person_distance_m).all()
        )

    def _desired_velocity_w(self, near: SmallGaps) -> FloatArray:
        """Returns the desired velocity (3,) of the tool: away from the head, and from the body if the hand is near."""
        away = _unit(self._data.xpos[self._tool] - self._data.site_xpos[self._head])
        if near.is_hand.any():
            nearest = np.where(near.is_hand, near.gap_m, np.inf).argmin()
            away = (
                away
                + max(0.0, 2.0 - 2.0 * near.gap_m[nearest] / self._person_distance_m)
                * near.direction_to_arm_w[nearest]
            )
        return RETREAT_TOOL_SPEED_M_S * _unit(away)

    def _speeds(self, velocity_w: FloatArray, near: SmallGaps) -> FloatArray:
        """Returns the speeds (A,) of joints and drive that best achieve a tool velocity without rotation.

        The speeds respect the limits of gaps and joint ranges.
        """
        jacobian = self._jacobian(self._tool, self._data.xpos[self._tool])
        jacobian[3:] *= CHARACTERISTIC_LENGTH_M
        positions = self._simulation.get_joint_positions()[self._world]
        joints = np.eye(len(self._dofs), len(self._speed_limit))
        down, up = positions - self._range[:, 0], self._range[:, 1] - positions
        rows = np.concatenate([near.gap_jacobian, joints, -joints])
        room = np.concatenate([near.gap_m - MIN_GAP_M, down, up])
        least = -np.clip(room / MIN_CLOSING_TIME_S, 0.0, 10.0)
        speeds = _solved(jacobian, np.concatenate([velocity_w, np.zeros(3)]), rows, least)
        excess = (
            np.abs(speeds / self._speed_limit).max(),
            np.linalg.norm(jacobian[:3] @ speeds) / RETREAT_TOOL_SPEED_M_S,
        )
        return speeds / max(1.0, *excess)

    def _near(self) -> SmallGaps:
        pairs: list[tuple[float, FloatArray, FloatArray, bool]] = []
        ends_w = np.empty(6)
        for link in self._links:
            for obstacle in self._obstacles:
                gap_m = mujoco.mj_geomDistance(
                    self._model, self._data, obstacle, link, MAX_CONSIDERED_GAP_M, ends_w
                )
                if gap_m < MAX_CONSIDERED_GAP_M and gap_m != 0.0:
                    away_w = (ends_w[3:] - ends_w[:3]) / gap_m
                    jacobian = self._jacobian(int(self._model.geom_bodyid[link]), ends_w[3:])
                    is_hand = link in self._hand and obstacle in self._person
                    pairs.append((gap_m, away_w, away_w @ jacobian[:3], is_hand))
        if not pairs:
            return SmallGaps(
                np.zeros(0), np.zeros((0, 3)), np.zeros((0, len(self._speed_limit))), np.zeros(0, bool)
            )
        return SmallGaps(*(np.array(column) for column in zip(*pairs, strict=True)))

    def _jacobian(self, body: int, pos_w: FloatArray) -> FloatArray:
        """Returns the Jacobian (6, A) of a point of a body: from speeds of joints and drive to the linear and angular
        velocity."""
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], pos_w, body)
        if not self._drives:
            return jacobian[:, self._dofs]
        x, y, turn = jacobian[:, self._drive_dofs].T
        yaw = self._simulation.get_base_displacement()[self._world, 2]
        return np.column_stack([jacobian[:, self._dofs], np.cos(yaw) * x + np.sin(yaw) * y, turn])


def _solved(task: FloatArray, wish: FloatArray, rows: FloatArray, least: FloatArray) -> FloatArray:
    """Solve the quadratic programme: ``task`` (6, J) q closest to ``wish`` (6,), subject to ``rows`` (L, J) q ≥
    ``least``.

    Returns joint speeds q (J,): the damped least squares solution, corrected by the solution of the dual programme. If
    the dual programme has no solution, returns 0, which meets all constraints.
    """
    weighed = np.linalg.inv(task.T @ task + JOINT_SPEED_WEIGHT**2 * np.eye(task.shape[1]))
    free = weighed @ task.T @ wish
    count = len(rows)
    dual = rows @ weighed @ rows.T + QP_REGULARIZATION * np.eye(count)
    forces, factor = np.zeros(count), np.empty((count, count + 7))
    lower, upper = np.zeros(count), np.full(count, 1e6)
    rank = mujoco.mju_boxQP(forces, factor, None, dual, rows @ free - least, lower, upper)
    return np.zeros_like(free) if rank < 0 else free + weighed @ rows.T @ forces


def _moved_by(model: mujoco.MjModel, joint: int) -> list[int]:
    """Returns the geoms that a joint moves and that can touch people."""
    moved = {int(model.jnt_bodyid[joint])}
    for body in range(model.nbody):
        if int(model.body_parentid[body]) in moved:
            moved.add(body)
    return [
        geom
        for geom in range(model.ngeom)
        if int(model.geom_bodyid[geom]) in moved
        and model.geom_group[geom] == COLLISION_GROUP
        and model.geom_conaffinity[geom] & PERSON.contype
    ]


def _unit(vector: FloatArray) -> FloatArray:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
