"""The brakes of an arm's joints: dry friction takes each joint's speed away and then holds it where it came to rest."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from avrgym.models.robot import MOTORS, PREFIX, Arm

HOLDING = 30.0
"""Times the torque of a joint's motor: what its brake holds. With once, what an arm presses can push it back; with ten
times, a washcloth wedged between a backrest and a head did once in 200 stops."""
SOLVER_TOLERANCE = 1e-8
"""With brakes on. Friction that holds without creeping needs Newton's method and this tolerance, MuJoCo's own."""


class Brakes:
    """Those of one arm in every world of a batch; they hold ``HOLDING`` times the torque of the motors."""

    def __init__(self, batch: Batch, arm: Arm) -> None:
        model = batch.get_model(0)
        self._dofs = np.array([model.joint(PREFIX + joint).dofadr[0] for joint in arm.joints])
        self._torque_n_m = HOLDING * arm.torque_limit_n_m
        self._released = int(model.opt.solver), float(model.opt.tolerance)
        self._friction_n_m = batch.expand("dof_frictionloss")
        self._idle = batch.expand("opt.disableactuator")
        self._solver, self._tolerance = batch.expand("opt.solver"), batch.expand("opt.tolerance")

    def put_on(self) -> None:
        """Stop the arms and hold them; their motors are off."""
        self._idle[:] = 1 << MOTORS
        self._friction_n_m[:, self._dofs] = self._torque_n_m
        self._solver[:], self._tolerance[:] = mujoco.mjtSolver.mjSOL_NEWTON, SOLVER_TOLERANCE

    def release(self) -> None:
        """Let the arms move."""
        self._idle[:] = 0
        self._friction_n_m[:, self._dofs] = 0.0
        self._solver[:], self._tolerance[:] = self._released
