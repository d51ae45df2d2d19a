"""How an arm takes its tool away from a person: slowly, straight away from them, with no link coming near them.

Ten times a second the joints' speeds solve a small quadratic programme: the tool goes as it shall, as nearly as the
arm can, while every link keeps out of the person by velocity dampers (Faverjon and Tournassoud, IEEE Int. Conf.
Robotics and Automation, 1987): the nearer, the slower it may come nearer, and within ``KEPT_M`` not at all.
"""

from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.models import human, robot
from avrgym.models.collision_bits import COLLISION_GROUP, FURNITURE, PERSON
from avrgym.models.scene import CONTROL_STEP_S, TOOL
from avrgym.simulation.worlds import Simulation

SPEED_M_S = 0.08
"""How fast the tool leaves: near the head it stays below 0.1 m/s, and servos overshoot a little."""
CLEAR_M = 0.32
"""The tool has left when it is so far from the mouth,"""
FREE_M = 0.10
"""and tool and links so far from the person."""
LONGEST_S = 6.0
KEPT_M = 0.01
NEAR_M = 0.15
"""Links farther than this from the person move as they like."""
LEVER_M = 0.2
"""Turning the tool by one radian counts as much as moving it by this."""
DAMPING = 0.03
STOPPING_S = 0.3
"""What is this much time away, a person or the end of a joint's range, is come to no faster."""
SOFTNESS = 1e-6
"""Keeps the programme solvable where links are near in many places at once."""


class Near(NamedTuple):
    """Where the arm is near the person or furniture, L pairs of geoms.

    ``gap_m`` (L,), negative where they touch; ``away_w`` (L, 3) from there to the arm; ``rows`` (L, J) turn the joints'
    speeds into the speed at which a gap widens; ``of_hand`` (L,): whether it lies between person and hand or tool.
    """

    gap_m: FloatArray
    away_w: FloatArray
    rows: FloatArray
    of_hand: BoolArray


class Retreat:
    """The retreat of one world's arm from wherever it is when it is first asked for an action."""

    def __init__(
        self,
        simulation: Simulation,
        world: int = 0,
        *,
        clear_m: float = CLEAR_M,
        free_m: float = FREE_M,
        steps: int = 0,
    ) -> None:
        """Find the arm's links and the person. That takes milliseconds: before an episode, not during one.

        Args:
            simulation: the physics of N worlds.
            world: which of them.
            clear_m: the distance from the mouth at which the tool has left.
            free_m: the distance from the person at which tool and hand have left.
            steps: control steps that it has taken already.
        """
        self._simulation, self._world = simulation, world
        self._clear_m, self._free_m = clear_m, free_m
        self._model = model = copy(simulation.batch.get_model(world))
        self._data = mujoco.MjData(model)
        joints = [model.joint(robot.PREFIX + name) for name in simulation.scene.arm.joints]
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        limited = np.array([model.jnt_limited[joint.id] for joint in joints], bool)
        self._range_rad = np.where(limited[:, None], [joint.range for joint in joints], [-np.inf, np.inf])
        self._links, self._hand = (_moved_by(model, joint.id) for joint in (joints[0], joints[-1]))
        self._person = {model.geom(human.PREFIX + name).id for name in human.GEOMS}
        self._obstacles = [*self._person, *np.flatnonzero(model.geom_contype == FURNITURE.contype).tolist()]
        self._tool = model.body(TOOL).id
        self._head, self._mouth = (model.site(human.PREFIX + name).id for name in ("head_centre", "mouth"))
        self._steps = steps

    def action(self) -> FloatArray | None:
        """The action (J,) for the next control step; ``None`` when the tool has left or ``LONGEST_S`` are over."""
        self._data.qpos[:] = self._simulation.qpos(self._world)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        near = self._near()
        if self._steps * CONTROL_STEP_S >= LONGEST_S or self._has_left(near):
            return None
        self._steps += 1
        return self._speeds_rad_s(self._wish_w(near), near) / self._simulation.scene.arm.speed_limit_rad_s

    def _has_left(self, near: Near) -> bool:
        from_mouth_w = self._data.xpos[self._tool] - self._data.site_xpos[self._mouth]
        return float(np.linalg.norm(from_mouth_w)) > self._clear_m and bool(
            (near.gap_m[near.of_hand] > self._free_m).all()
        )

    def _wish_w(self, near: Near) -> FloatArray:
        """The tool's velocity (3,): away from the head, and the more from what else of the person the hand is near."""
        away = _unit(self._data.xpos[self._tool] - self._data.site_xpos[self._head])
        if near.of_hand.any():
            nearest = np.where(near.of_hand, near.gap_m, np.inf).argmin()
            away = away + max(0.0, 2.0 - 2.0 * near.gap_m[nearest] / self._free_m) * near.away_w[nearest]
        return SPEED_M_S * _unit(away)

    def _speeds_rad_s(self, velocity_w: FloatArray, near: Near) -> FloatArray:
        """The joints' speeds (J,) that move the tool so and turn it little, as nearly as person and joints let them."""
        jacobian = self._jacobian(self._tool, self._data.xpos[self._tool])
        jacobian[3:] *= LEVER_M
        angles_rad, joints = self._simulation.arm_angles_rad()[self._world], np.eye(len(self._dofs))
        down_rad, up_rad = angles_rad - self._range_rad[:, 0], self._range_rad[:, 1] - angles_rad
        rows = np.concatenate([near.rows, joints, -joints])
        room = np.concatenate([near.gap_m - KEPT_M, down_rad, up_rad])
        least = -np.clip(room / STOPPING_S, 0.0, 10.0)
        speeds = _solved(jacobian, np.concatenate([velocity_w, np.zeros(3)]), rows, least)
        limit = self._simulation.scene.arm.speed_limit_rad_s
        excess = np.abs(speeds / limit).max(), np.linalg.norm(jacobian[:3] @ speeds) / SPEED_M_S
        return speeds / max(1.0, *excess)

    def _near(self) -> Near:
        pairs: list[tuple[float, FloatArray, FloatArray, bool]] = []
        ends_w = np.empty(6)
        for link in self._links:
            for obstacle in self._obstacles:
                gap_m = mujoco.mj_geomDistance(self._model, self._data, obstacle, link, NEAR_M, ends_w)
                if gap_m < NEAR_M and gap_m != 0.0:
                    away_w = (ends_w[3:] - ends_w[:3]) / gap_m
                    jacobian = self._jacobian(int(self._model.geom_bodyid[link]), ends_w[3:])
                    of_hand = link in self._hand and obstacle in self._person
                    pairs.append((gap_m, away_w, away_w @ jacobian[:3], of_hand))
        if not pairs:
            return Near(np.zeros(0), np.zeros((0, 3)), np.zeros((0, len(self._dofs))), np.zeros(0, bool))
        return Near(*(np.array(column) for column in zip(*pairs, strict=True)))

    def _jacobian(self, body: int, pos_w: FloatArray) -> FloatArray:
        """The linear and angular velocity (6, J) of a point of a body by the joints' speeds."""
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], pos_w, body)
        return jacobian[:, self._dofs]


def _solved(task: FloatArray, wish: FloatArray, rows: FloatArray, least: FloatArray) -> FloatArray:
    """The q (J,) that brings ``task`` (6, J) q nearest to ``wish`` (6,), with ``rows`` (L, J) q at least ``least``.

    Damped least squares, corrected by what the dual programme, which has but bounds, says of the limits. Without an
    answer to that, 0, which is always allowed.
    """
    weighed = np.linalg.inv(task.T @ task + DAMPING**2 * np.eye(task.shape[1]))
    free = weighed @ task.T @ wish
    count = len(rows)
    dual = rows @ weighed @ rows.T + SOFTNESS * np.eye(count)
    forces, factor = np.zeros(count), np.empty((count, count + 7))
    lower, upper = np.zeros(count), np.full(count, 1e6)
    rank = mujoco.mju_boxQP(forces, factor, None, dual, rows @ free - least, lower, upper)
    return np.zeros_like(free) if rank < 0 else free + weighed @ rows.T @ forces


def _moved_by(model: mujoco.MjModel, joint: int) -> list[int]:
    """The geoms that a joint moves and that touch people."""
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
