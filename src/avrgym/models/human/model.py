"""MuJoCo model of the person: bodies, geoms and servos."""

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import CAPSULE, SPHERE, add_collision_geom
from avrgym.models.human.frames import (
    GEOMS,
    PARENT_BODIES,
    SEATED_POSTURE,
    SITE_BODIES,
    BodyLayout,
    Posture,
    compute_body_rotations,
    compute_people_layout,
)
from avrgym.models.human.joints import JOINT_ARMATURE_KG_M2, JOINTS, SERVO_INERTIA_KG_M2, X_AXIS, Y_AXIS
from avrgym.models.human.person import People, Person

PERSON_NAME_PREFIX = "person/"
"""Prefix of all names of the person in a scene."""


def compile_person_model(
    person: Person, posture: Posture = SEATED_POSTURE, *, moving: bool
) -> mujoco.MjModel:
    """Returns the compiled model of a person without a scene; see ``add_person``."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_person(spec, person, posture, moving=moving)
    return spec.compile()


def add_person(
    spec: mujoco.MjSpec, person: Person, posture: Posture = SEATED_POSTURE, *, moving: bool
) -> None:
    """Add a person to a scene, with the hips fixed to the world.

    A moving person has 20 actuated joints with position servos of limited torque. Gravity is compensated (muscle tone).
    A static person has no joints, and the pose of ``person.joint_angles_rad``.
    """
    frames = compute_people_layout(People.from_persons([person]), posture)
    rotations = compute_body_rotations(person.joint_angles_rad[None], posture)
    bodies: dict[str, mujoco.MjsBody] = {}
    for name, parent in PARENT_BODIES.items():
        owner = spec.worldbody if parent is None else bodies[parent]
        bodies[name] = owner.add_body(
            name=PERSON_NAME_PREFIX + name, pos=frames.body_pos[name][0], gravcomp=1.0
        )
        driven = moving and any(joint.body == name for joint in JOINTS.values())
        if not driven:
            bodies[name].quat = rotations[name][0]
    _add_geoms(bodies, frames, float(np.atleast_1d(frames.dimensions.mass_kg)[0]))
    for name, body in SITE_BODIES.items():
        bodies[body].add_site(
            name=PERSON_NAME_PREFIX + name, pos=frames.site_pos[name][0], size=[0.005] * 3, group=4
        )
    if moving:
        _add_joints(spec, bodies)


def _add_geoms(bodies: dict[str, mujoco.MjsBody], frames: BodyLayout, mass_kg: float) -> None:
    for name, geom in GEOMS.items():
        add_collision_geom(
            bodies[geom.body],
            PERSON_NAME_PREFIX + name,
            SPHERE if geom.axis is None else CAPSULE,
            collision_bits.PERSON,
            pos=frames.geom_pos[name][0],
            size=frames.geom_size[name][0],
            quat=_capsule_quaternion(geom.axis),
            mass=geom.mass_fraction * mass_kg,
        )


PERSON_SERVO_FREQUENCY_RAD_S = 40.0
"""Natural frequency of the position servos. The simulated head follows the headset with a delay of about 2 / 40 s = 50
ms.
"""


def _add_joints(spec: mujoco.MjSpec, bodies: dict[str, mujoco.MjsBody]) -> None:
    for name, joint in JOINTS.items():
        bodies[joint.body].add_joint(
            name=PERSON_NAME_PREFIX + name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            range=np.radians([joint.lower_limit_deg, joint.upper_limit_deg]),
            armature=JOINT_ARMATURE_KG_M2[joint.body],
        )
        actuator = spec.add_actuator(
            name=PERSON_NAME_PREFIX + name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=PERSON_NAME_PREFIX + name,
            forcerange=[-joint.torque_limit_n_m, joint.torque_limit_n_m],
            ctrlrange=np.radians([joint.lower_limit_deg, joint.upper_limit_deg]),
        )
        stiffness = PERSON_SERVO_FREQUENCY_RAD_S**2 * SERVO_INERTIA_KG_M2[joint.body]
        actuator.set_to_position(kp=stiffness, dampratio=1.0)


def convert_to_speed_servos(spec: mujoco.MjSpec) -> None:
    """Changes a moving person's servos: their inputs become target speeds in rad/s instead of target angles."""
    for name in JOINTS:
        actuator, joint = spec.actuator(PERSON_NAME_PREFIX + name), spec.joint(PERSON_NAME_PREFIX + name)
        actuator.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        actuator.actlimited, actuator.actrange = True, joint.range
        actuator.ctrllimited = False


def _capsule_quaternion(axis: tuple[float, float, float] | None) -> FloatArray:
    turns = {X_AXIS: (Y_AXIS, 0.5 * np.pi), Y_AXIS: (X_AXIS, -0.5 * np.pi)}
    if axis not in turns:
        return transforms.IDENTITY_QUATERNION
    return transforms.from_axis_angle(turns[axis][0], turns[axis][1])
