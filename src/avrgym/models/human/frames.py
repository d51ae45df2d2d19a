"""Forward kinematics of N people: frames of bodies, geoms and sites from measures, posture and joint angles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace, get_namespace_and_floats
from avrgym.models.body_names import Sex, Side
from avrgym.models.human.anthropometry import BodyDimensions, scale_girths, select_unscaled_dimensions
from avrgym.models.human.joints import JOINTS, X_AXIS, Y_AXIS, Z_AXIS, make_seated_joint_angles
from avrgym.models.human.person import People, Person

DEVICE_TO_BODY_QUAT = transforms.from_matrix([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""Rotation from device axes (x right, y up, −z forward) to body axes (x left, −y forward, z up).

The rotation is the same for the headset and for the grip (WebXR Device API, ``gripSpace``). In a fist around an upright
rod, −z of the grip and −y of the hand point to the thumb. Axis y of the grip and axis z of the hand point from the
knuckles to the wrist.
"""
HEADSET_OFFSET_M = 0.08
"""Distance of the headset's origin in front of the head's centre in metres (paper's code)."""


MOUTH_HEIGHT_M = 0.03
"""Height of the mouth above the head joints, metres; not scaled (paper's code)."""

CRANIUM_RADIUS_M, JAW_RADIUS_M, JAW_HEIGHT_M, JAW_TO_MOUTH_DISTANCE_M = 0.090, 0.062, 0.025, 0.028
"""Sizes of the head's collision spheres, in metres. The front of the jaw is 2.8 cm behind the mouth, which leaves space
for a spoon.
"""


PARENT_BODIES: Mapping[str, str | None] = {
    "hips": None,
    "torso": "hips",
    "head": "torso",
    **{f"{side}_{part}": f"{side}_{parent}" if parent in ("upper_arm", "forearm", "thigh", "shin") else parent
       for side in ("right", "left")
       for part, parent in (("upper_arm", "torso"), ("forearm", "upper_arm"), ("hand", "forearm"),
                            ("thigh", "hips"), ("shin", "thigh"), ("foot", "shin"))},
}  # fmt: skip
BODIES = tuple(PARENT_BODIES)

RIGHT_ARM_BODIES = ("right_upper_arm", "right_forearm", "right_hand")
LEFT_ARM_BODIES = ("left_upper_arm", "left_forearm", "left_hand")
ARM_BODIES: Mapping[Side, tuple[str, ...]] = {"left": LEFT_ARM_BODIES, "right": RIGHT_ARM_BODIES}
"""Names of the bodies and geoms of each arm. The frames of these bodies are at shoulder, elbow and wrist."""


@dataclass(frozen=True)
class Posture:
    """Posture of a person: rotations about x of the hips and of the legs, which are not actuated.

    ``hips_pos_w`` is the origin of the hips in the world frame. If it is ``None``, the person sits, and the origin
    depends on the sex. ``height_offset_m`` is the height of seat or bed above its default height; it is added to the
    origin.
    """

    hips_pos_w: tuple[float, float, float] | None
    hips_deg: float
    thigh_deg: float
    shin_deg: float
    has_shoes: bool = True
    height_offset_m: float = 0.0

    @property
    def is_seated(self) -> bool:
        """Returns whether the person is on a seat, not in bed."""
        return self.hips_pos_w is None

    def compute_hips_origin(self, p: BodyDimensions) -> FloatArray:
        """Returns the origin of the hips, (3,) or (N, 3); world frame."""
        if self.hips_pos_w is None:
            return _vector(0.0, 0.03, p.seated_hips_height_m + self.height_offset_m)
        pos_w = constant_like(np.add(self.hips_pos_w, [0.0, 0.0, self.height_offset_m]), p.mass_kg)
        return get_namespace(p.mass_kg).broadcast_to(pos_w, (*np.shape(p.mass_kg), 3))

    @property
    def backrest_normal(self) -> FloatArray:
        """Returns the normal of the backrest (3,), towards the person; world frame."""
        angle = float(np.radians(self.hips_deg))
        return np.array([0.0, -np.cos(angle), -np.sin(angle)])

    def compute_body_rotations_deg(self) -> dict[str, float]:
        """Returns the rotations about x of the hips and leg bodies, by body, in degrees."""
        legs = {"thigh": self.thigh_deg, "shin": self.shin_deg}
        return {"hips": self.hips_deg} | {
            f"{s}_{part}": a for s in ("right", "left") for part, a in legs.items()
        }


SEATED_POSTURE = Posture(hips_pos_w=None, hips_deg=0.0, thigh_deg=-90.0, shin_deg=80.0)
RECLINED_POSTURE = Posture(
    hips_pos_w=(0.0, 0.0, 0.7), hips_deg=-30.0, thigh_deg=-60.0, shin_deg=0.0, has_shoes=False
)
"""Posture in a bed with the backrest raised by 60° (paper's code). ``SEATED_POSTURE`` is the posture in a
wheelchair.
"""


@dataclass(frozen=True, eq=False)
class BodyLayout:
    """Poses and sizes of the bodies, geoms and sites of N people, by name. The values are computed on demand.

    Positions (N, 3) are in metres. Lengths along the body are scaled by ``length_scale`` (N,), arm lengths by
    ``arm_scale``. ``chest_depth_change_m`` (N,) is the radius of the chest minus that of the sex's reference. With a
    thicker chest, the body is farther from the backrest. The back does not move.
    """

    dimensions: BodyDimensions
    length_scale: FloatArray
    arm_scale: FloatArray
    posture: Posture
    chest_depth_change_m: FloatArray

    @cached_property
    def body_pos(self) -> Mapping[str, FloatArray]:
        """Returns the body positions (N, 3) by body name, in the frame of the parent body."""
        positions = _body_positions(self.dimensions, self.length_scale, self.arm_scale, self.posture)
        outward = constant_like(self.posture.backrest_normal, self.length_scale)
        return positions | {"hips": positions["hips"] + self.chest_depth_change_m[..., None] * outward}

    @property
    def geom_pos(self) -> Mapping[str, FloatArray]:
        """Returns the geom positions (N, 3) by geom name, in the frame of their body."""
        return self._geoms[0]

    @property
    def geom_size(self) -> Mapping[str, FloatArray]:
        """Returns the capsule sizes (N, 3) by geom name: radius, half length, 0."""
        return self._geoms[1]

    @cached_property
    def site_pos(self) -> Mapping[str, FloatArray]:
        """Returns the site positions (N, 3) by site name, in the frame of their body."""
        return _sites(self.dimensions, self.length_scale)

    @cached_property
    def _geoms(self) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        return _geoms(self.dimensions, self.length_scale, self.arm_scale)


def compute_body_layout(
    is_woman: BoolArray,
    torso_height_m: FloatArray,
    posture: Posture = SEATED_POSTURE,
    arm_scale: FloatArray | float = 1.0,
    stature_and_bmi: tuple[FloatArray, FloatArray] | None = None,
) -> BodyLayout:
    """Returns the layout of N people. Lengths along the body are proportional to the torso height; radii are not.

    Lengths of upper arms and forearms are also proportional to ``arm_scale`` (N,). ``stature_and_bmi`` are stature and
    body mass index (N,). Both determine radii and mass; see ``anthropometry.scale_girths``.
    """
    reference = select_unscaled_dimensions(is_woman, torso_height_m)
    scale = torso_height_m / reference.torso_height_m
    p = reference if stature_and_bmi is None else scale_girths(reference, is_woman, *stature_and_bmi)
    chest_depth_change_m = (p.chest_radius_m - reference.chest_radius_m) * get_namespace(scale).ones_like(
        scale
    )
    return BodyLayout(p, scale, arm_scale * scale, posture, chest_depth_change_m)


def compute_people_layout(people: People, posture: Posture = SEATED_POSTURE) -> BodyLayout:
    """Returns the body layout of N ``people`` in a posture, with their own arm lengths and girths."""
    stature_and_bmi = people.stature_m, people.bmi_kg_m2
    return compute_body_layout(
        people.is_woman, people.torso_height_m, posture, people.arm_scale, stature_and_bmi
    )


def _body_positions(
    p: BodyDimensions, h: FloatArray, arm_h: FloatArray, posture: Posture
) -> dict[str, FloatArray]:
    shoulder_z = (p.chest_offset_z_m + p.shoulder_offset_z_m) * h
    positions = {
        "hips": posture.compute_hips_origin(p),
        "torso": _vector(0.0, 0.0, p.waist_offset_z_m * h),
        "head": _vector(0.0, 0.0, (p.chest_offset_z_m + p.neck_offset_z_m + p.head_offset_z_m) * h),
    }
    for side, sign in (("right", -1.0), ("left", 1.0)):
        positions |= {
            f"{side}_upper_arm": _vector(sign * p.shoulder_offset_x_m, 0.0, shoulder_z),
            f"{side}_forearm": _vector(0.0, 0.0, -p.upper_arm_length_m * arm_h),
            f"{side}_hand": _vector(0.0, 0.0, -(p.forearm_radius_m + p.forearm_length_m * arm_h)),
            f"{side}_thigh": _vector(sign * p.thigh_offset_x_m, 0.0, -p.hip_joint_depth_m * h),
            f"{side}_shin": _vector(0.0, 0.0, -p.thigh_length_m * h),
            f"{side}_foot": _vector(0.0, 0.0, -p.shin_length_m * h),
        }
    return positions


ARM_SEGMENTS = "upper_arm", "forearm"


def _geoms(
    p: BodyDimensions, h: FloatArray, arm_h: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Returns positions and sizes of the capsules of ``GEOMS``, by name. A size is radius, half length, 0."""
    zero = get_namespace(h).zeros_like(h)
    chest_z = p.chest_offset_z_m * h
    shoulder_z = chest_z + p.shoulder_offset_z_m * h - (p.shoulder_radius_m - 0.055)
    position = {
        "hips": _vector(zero, zero, -p.hip_joint_depth_m * h),
        "waist": _vector(zero, zero, zero),
        "chest": _vector(zero, zero, chest_z),
        "right_shoulder": _vector(-0.47 * p.shoulder_offset_x_m, zero, shoulder_z),
        "left_shoulder": _vector(0.47 * p.shoulder_offset_x_m, zero, shoulder_z),
        "neck": _vector(zero, zero, (p.chest_offset_z_m + p.neck_offset_z_m) * h + 0.5 * p.neck_length_m * h),
        "cranium": _vector(zero, zero, p.head_centre_offset_z_m * h + 0.015),
        "jaw": _vector(
            zero, JAW_TO_MOUTH_DISTANCE_M + JAW_RADIUS_M - p.mouth_forward_offset_m, zero + JAW_HEIGHT_M
        ),
    }
    size = {
        "hips": _vector(p.hips_radius_m, 0.5 * p.hips_length_m, zero),
        "waist": _vector(p.waist_radius_m, 0.5 * p.waist_length_m, zero),
        "chest": _vector(p.chest_radius_m, 0.5 * p.chest_length_m, zero),
        "right_shoulder": _vector(p.shoulder_radius_m, 0.5 * p.shoulder_length_m, zero),
        "left_shoulder": _vector(p.shoulder_radius_m, 0.5 * p.shoulder_length_m, zero),
        "neck": _vector(p.neck_radius_m, 0.5 * p.neck_length_m * h, zero),
        "cranium": _vector(zero + CRANIUM_RADIUS_M, zero, zero),
        "jaw": _vector(zero + JAW_RADIUS_M, zero, zero),
    }
    for side in ("right", "left"):
        for part in ("upper_arm", "forearm", "thigh", "shin"):
            length = getattr(p, f"{part}_length_m") * (arm_h if part in ARM_SEGMENTS else h)
            position[f"{side}_{part}"] = _vector(zero, zero, -0.5 * length)
            size[f"{side}_{part}"] = _vector(getattr(p, f"{part}_radius_m"), 0.5 * length, zero)
        position[f"{side}_hand"] = _vector(zero, zero, -p.hand_radius_m)
        size[f"{side}_hand"] = _vector(p.hand_radius_m, zero, zero)
        foot_length = p.foot_length_m * h
        position[f"{side}_foot"] = _vector(zero, -0.3 * foot_length, zero)
        size[f"{side}_foot"] = _vector(p.foot_radius_m, 0.5 * foot_length - 0.5 * p.foot_radius_m, zero)
    return position, size


def _sites(p: BodyDimensions, h: FloatArray) -> dict[str, FloatArray]:
    zero = get_namespace(h).zeros_like(h)
    return {
        "head_centre": _vector(zero, zero, p.head_centre_offset_z_m * h),
        "mouth": _vector(zero, -p.mouth_forward_offset_m, zero + MOUTH_HEIGHT_M),
        "right_hand_centre": _vector(zero, zero, -p.hand_radius_m),
        "left_hand_centre": _vector(zero, zero, -p.hand_radius_m),
    }


SITE_BODIES = {
    "head_centre": "head",
    "mouth": "head",
    "right_hand_centre": "right_hand",
    "left_hand_centre": "left_hand",
}


@dataclass(frozen=True)
class CollisionGeom:
    """A collision geom of the person: its body, its capsule axis in the body's frame (``None`` for a sphere), and its
    share of the person's mass.
    """

    body: str
    axis: tuple[float, float, float] | None
    mass_fraction: float


GEOMS: Mapping[str, CollisionGeom] = {
    "hips": CollisionGeom("hips", X_AXIS, 0.14),
    "waist": CollisionGeom("torso", X_AXIS, 0.13),
    "chest": CollisionGeom("torso", X_AXIS, 0.10),
    "right_shoulder": CollisionGeom("torso", X_AXIS, 0.05),
    "left_shoulder": CollisionGeom("torso", X_AXIS, 0.05),
    "neck": CollisionGeom("torso", Z_AXIS, 0.01),
    "cranium": CollisionGeom("head", None, 0.05),
    "jaw": CollisionGeom("head", None, 0.02),
    **{f"{side}_{part}": CollisionGeom(f"{side}_{part}", axis, share)
       for side in ("right", "left")
       for part, axis, share in (("upper_arm", Z_AXIS, 0.033), ("forearm", Z_AXIS, 0.019), ("hand", None, 0.0065),
                                 ("thigh", Z_AXIS, 0.105), ("shin", Z_AXIS, 0.0475), ("foot", Y_AXIS, 0.014))},
}  # fmt: skip


def compute_body_mass_fractions() -> FloatArray:
    """Returns the share (B,) of the person's mass in each of ``BODIES``."""
    return np.array(
        [sum(geom.mass_fraction for geom in GEOMS.values() if geom.body == name) for name in BODIES]
    )


def compute_body_rotations(
    joint_angles_rad: FloatArray, posture: Posture = SEATED_POSTURE
) -> dict[str, FloatArray]:
    """Returns the rotations (N, 4) of all bodies relative to their parents, by body, for joint angles (N, 20)."""
    return {body: compute_body_rotation(body, joint_angles_rad, posture) for body in BODIES}


def compute_body_rotation(
    body: str, joint_angles_rad: FloatArray, posture: Posture = SEATED_POSTURE
) -> FloatArray:
    """Returns the rotation (N, 4) of one body relative to its parent, for joint angles (N, 20)."""
    xp, angles = get_namespace_and_floats(joint_angles_rad)
    turns = [(joint.axis, angles[..., i]) for i, joint in enumerate(JOINTS.values()) if joint.body == body]
    if body in posture.compute_body_rotations_deg():
        turn = float(np.radians(posture.compute_body_rotations_deg()[body]))
        turns.append((X_AXIS, xp.full(angles.shape[:-1], turn, dtype=angles.dtype, device=angles.device)))
    rotation = xp.broadcast_to(constant_like(transforms.IDENTITY_QUATERNION, angles), (*angles.shape[:-1], 4))
    for axis, angle in turns:
        rotation = transforms.multiply(rotation, transforms.from_axis_angle(axis, angle))
    return rotation


def compute_body_frames(
    people: People, posture: Posture = SEATED_POSTURE, bodies: Sequence[str] = BODIES
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Returns positions (N, 3) and quaternions (N, 4) of bodies and their ancestors, by body; world frame."""
    local_pos = compute_people_layout(people, posture).body_pos
    pos_w: dict[str, FloatArray] = {}
    q_w: dict[str, FloatArray] = {}
    for body in _carrying(bodies):
        local_q, parent = compute_body_rotation(body, people.joint_angles_rad, posture), PARENT_BODIES[body]
        pos_w[body], q_w[body] = (
            (local_pos[body], local_q)
            if parent is None
            else transforms.compose(pos_w[parent], q_w[parent], local_pos[body], local_q)
        )
    return pos_w, q_w


def _carrying(bodies: Sequence[str]) -> list[str]:
    """Returns the names of bodies and their ancestors in the kinematic tree, parents first."""
    found: set[str] = set()
    for body in bodies:
        carrier: str | None = body
        while carrier is not None:
            found.add(carrier)
            carrier = PARENT_BODIES[carrier]
    return [body for body in PARENT_BODIES if body in found]


_STANDING = Posture(hips_pos_w=(0.0, 0.0, 0.0), hips_deg=0.0, thigh_deg=0.0, shin_deg=0.0)
BIND_POSE_RAD = make_seated_joint_angles(
    right_shoulder_y=42.0, left_shoulder_y=-42.0, right_elbow_x=-45.0, left_elbow_x=-45.0
)


@lru_cache(maxsize=8)
def compute_bind_frames(
    sex: Sex,
    torso_height_m: float,
    arm_scale: float = 1.0,
    stature_m: float | None = None,
    bmi_kg_m2: float | None = None,
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Returns the body poses to which the skins are bound: positions (3,) and quaternions (4,) by body.

    The person stands with the hips at the origin, and with half raised and half bent arms. The result is cached: do not
    modify it.
    """
    person = Person(sex, torso_height_m, BIND_POSE_RAD, "fair", arm_scale, stature_m, bmi_kg_m2)
    pos, q = compute_body_frames(People.from_persons([person]), _STANDING)
    return {body: pos[body][0] for body in BODIES}, {body: q[body][0] for body in BODIES}


def _vector(x: float | FloatArray, y: float | FloatArray, z: float | FloatArray) -> FloatArray:
    xp, *parts = get_namespace_and_floats(x, y, z)
    return xp.stack(xp.broadcast_arrays(*parts), axis=-1)
