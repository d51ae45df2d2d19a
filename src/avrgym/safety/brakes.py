"""Brakes of arm and drive: dry friction stops each joint and holds its position."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from avrgym.models.drive import DRIVE_JOINTS, MOTOR_ACTUATOR_GROUP
from avrgym.models.robot import ROBOT_NAME_PREFIX
from avrgym.models.scene import SceneConfig

BRAKE_TORQUE_FACTOR = 30.0
"""Holding torque of a brake, divided by the torque limit of its motor. With a small factor, contact forces can push a
braked arm back.
"""
BRAKED_SOLVER_TOLERANCE = 1e-8
"""Solver tolerance while brakes are engaged, with Newton's method. With a larger tolerance, braked joints creep."""


class Brakes:
    """The brakes of one robot in every world of a batch."""

    def __init__(self, batch: Batch, scene: SceneConfig) -> None:
        model, arm, drive = batch.get_model(0), scene.arm, scene.robot.drive
        joints = (*arm.joints, *(DRIVE_JOINTS if drive is not None else ()))
        self._dofs = np.array([model.joint(ROBOT_NAME_PREFIX + joint).dofadr[0] for joint in joints])
        limits = np.concatenate([arm.effort_limit, drive.effort_limit if drive is not None else ()])
        self._effort = BRAKE_TORQUE_FACTOR * limits
        self._default_solver = int(model.opt.solver), float(model.opt.tolerance)
        self._friction = batch.expand("dof_frictionloss")
        self._disabled_actuators = batch.expand("opt.disableactuator")
        self._solver, self._tolerance = batch.expand("opt.solver"), batch.expand("opt.tolerance")

    def engage(self) -> None:
        """Switch the motors off and apply the brakes."""
        self._disabled_actuators[:] = 1 << MOTOR_ACTUATOR_GROUP
        self._friction[:, self._dofs] = self._effort
        self._solver[:], self._tolerance[:] = mujoco.mjtSolver.mjSOL_NEWTON, BRAKED_SOLVER_TOLERANCE

    def release(self) -> None:
        """Release the brakes and switch the motors on."""
        self._disabled_actuators[:] = 0
        self._friction[:, self._dofs] = 0.0
        self._solver[:], self._tolerance[:] = self._default_solver
