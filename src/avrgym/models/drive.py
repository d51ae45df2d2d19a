"""Mobile bases: a differential drive, which can move at the same time as the arm."""

from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray

MOTOR_ACTUATOR_GROUP = 1
"""MuJoCo's actuator group for the motors of the moving arm and of the drive. Brakes disable this group."""
_SLIDE, _HINGE = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
DRIVE_ACTION_NAMES = ("forward", "turn")
"""Names of an action's components for the drive. They follow the components for the arm."""


@dataclass(frozen=True)
class DifferentialDrive:
    """A differential drive: two driven wheels on one axle. The base moves forward and turns, but not sideways.

    The wheels' axle is at the origin of the robot's base; forward is the base's x axis.

    Attributes:
        speed_limit_m_s: limit of the forward speed, and of the speed of each wheel.
        turn_limit_rad_s: limit of the turn rate of the base.
        track_width_m: distance between the wheels.
        force_limit_n: limit of the driving force of both wheels together.
        lateral_force_limit_n: limit of the wheels' friction force against sideways motion.
    """

    speed_limit_m_s: float
    turn_limit_rad_s: float
    track_width_m: float
    force_limit_n: float
    lateral_force_limit_n: float

    @property
    def speed_limit(self) -> FloatArray:
        """Returns the speeds (2,) for an action of 1: forward in m/s, turn in rad/s."""
        return np.array([self.speed_limit_m_s, self.turn_limit_rad_s])

    @property
    def effort_limit(self) -> FloatArray:
        """Returns the limits (3,) of forward and sideways force in N, and of torque in N·m."""
        return np.array(
            [self.force_limit_n, self.lateral_force_limit_n, 0.5 * self.track_width_m * self.force_limit_n]
        )


DRIVE_JOINTS = ("drive_x", "drive_y", "drive_yaw")
"""Joints of a mobile base: slides along x and y of the base's initial pose, and a hinge about z."""
DRIVE_SERVOS = ("drive_forward", "drive_sideways", "drive_turn")
"""Velocity servos of a mobile base, in the base's own frame. The sideways command is always 0."""
DRIVE_SERVO_FREQUENCY_RAD_S = 100.0
"""Damping of the drive's servos divided by the robot's mass or inertia, 1/s. It is the highest value without
oscillation at the force limit, with physics steps of 10 ms. Under a load, the base drifts slowly until it is braked.
"""


def add_drive(spec: mujoco.MjSpec, base: mujoco.MjsBody, drive: DifferentialDrive) -> None:
    """Add planar joints to the base, and velocity servos in the base's own frame."""
    for name, kind, axis in zip(DRIVE_JOINTS, (_SLIDE, _SLIDE, _HINGE), np.eye(3), strict=True):
        base.add_joint(name=name, type=kind, axis=axis)
    base.add_site(name="drive")
    mass = spec.compile().body(base.name).subtreemass[0]
    masses = (mass, mass, mass * (0.5 * drive.track_width_m) ** 2)
    directions = np.eye(6)[[0, 1, 5]]
    for name, gear, limit, moved in zip(DRIVE_SERVOS, directions, drive.effort_limit, masses, strict=True):
        servo = spec.add_actuator(
            name=name,
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target="drive",
            gear=gear,
            forcerange=[-limit, limit],
            forcelimited=True,
            group=MOTOR_ACTUATOR_GROUP,
        )
        servo.set_to_velocity(kv=DRIVE_SERVO_FREQUENCY_RAD_S * moved)
