"""The simulated person: a man and a woman, scaled by torso height, static or moving.

The person's model frame is the world's: x to their left, y to their back, z up. Dimensions, mass shares and
joint ranges are those of the 50th percentile man and woman of the 2020 reference (after Tilley, *The Measure
of Man and Woman*, 2002). One layout function gives body and geom frames for any number of people at once; the
compiled model of one person and the per-world fields of many come from it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models import contacts
from avrgym.models.parts import CAPSULE, SPHERE, add_collision

Array = NDArray[np.float64]
Sex = Literal["man", "woman"]
SEXES: tuple[Sex, ...] = ("man", "woman")
TORSO_HEIGHT_RANGE_M = (0.40, 0.75)
PREFIX = "person/"
BODY_FROM_DEVICE_AXES = transforms.from_matrix([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""Axes of a device (x right, y up, −z ahead) and of the body part it sits on (x left, −y ahead, z up).

It serves the headset and the grip alike: of a fist around an upright rod, the grip's −z points to the thumb
and its y from the knuckles to the wrist, as −y and z of our hand (WebXR Device API, ``gripSpace``)."""
HEADSET_AHEAD_M = 0.08
"""The headset's pose lies about 8 cm in front of the centre of the head (2020 reference)."""


@dataclass(frozen=True)
class Proportions:
    """Measures of one sex at its reference torso height; metres and kilograms.

    Every field may also be an array (N,): the same measures of N people.
    """

    torso_height: float
    mass: float
    hips_radius: float
    hips_length: float
    hips_drop: float
    waist_rise: float
    waist_radius: float
    waist_length: float
    chest_rise: float
    chest_radius: float
    chest_length: float
    shoulder_rise: float
    shoulder_radius: float
    shoulder_length: float
    shoulder_side: float
    upper_arm_radius: float
    upper_arm_length: float
    forearm_radius: float
    forearm_length: float
    hand_radius: float
    neck_rise: float
    neck_radius: float
    neck_length: float
    head_rise: float
    head_centre_rise: float
    mouth_forward: float
    thigh_side: float
    thigh_radius: float
    thigh_length: float
    shin_radius: float
    shin_length: float
    foot_radius: float
    foot_length: float
    seated_hips_height: float


MAN = Proportions(
    torso_height=0.60, mass=78.4,
    hips_radius=0.1335, hips_length=0.094, hips_drop=0.08125,
    waist_rise=0.08125, waist_radius=0.1205, waist_length=0.049,
    chest_rise=0.156, chest_radius=0.127, chest_length=0.056,
    shoulder_rise=0.1415, shoulder_radius=0.106, shoulder_length=0.032, shoulder_side=0.106 + 0.073,
    upper_arm_radius=0.043, upper_arm_length=0.279,
    forearm_radius=0.033, forearm_length=0.257, hand_radius=0.043,
    neck_rise=0.1515, neck_radius=0.06, neck_length=0.124,
    head_rise=0.137, head_centre_rise=0.07425, mouth_forward=0.11,
    thigh_side=0.089, thigh_radius=0.08, thigh_length=0.424,
    shin_radius=0.05, shin_length=0.403, foot_radius=0.05, foot_length=0.215,
    seated_hips_height=0.65275,
)  # fmt: skip

WOMAN = Proportions(
    torso_height=0.54, mass=62.5,
    hips_radius=0.127, hips_length=0.117, hips_drop=0.075,
    waist_rise=0.075, waist_radius=0.11, waist_length=0.009,
    chest_rise=0.150, chest_radius=0.127, chest_length=0.010,
    shoulder_rise=0.132, shoulder_radius=0.092, shoulder_length=0.028, shoulder_side=0.092 + 0.067,
    upper_arm_radius=0.0355, upper_arm_length=0.264,
    forearm_radius=0.027, forearm_length=0.234, hand_radius=0.0355,
    neck_rise=0.132, neck_radius=0.05, neck_length=0.121,
    head_rise=0.12, head_centre_rise=0.063, mouth_forward=0.10,
    thigh_side=0.092, thigh_radius=0.0775, thigh_length=0.391,
    shin_radius=0.045, shin_length=0.367, foot_radius=0.045, foot_length=0.195,
    seated_hips_height=0.635,
)  # fmt: skip

PROPORTIONS: Mapping[Sex, Proportions] = {"man": MAN, "woman": WOMAN}

MOUTH_RISE = 0.03
"""The mouth above the head joints, metres; unscaled, as the reference gives it in the head's frame."""

CRANIUM_RADIUS, JAW_RADIUS, JAW_RISE, MOUTH_DEPTH = 0.090, 0.062, 0.025, 0.028
"""Collision spheres of the head. The jaw ends 2.8 cm behind the mouth: a spoon can enter an open mouth."""

PARENTS: Mapping[str, str | None] = {
    "hips": None,
    "torso": "hips",
    "head": "torso",
    **{f"{side}_{part}": f"{side}_{parent}" if parent in ("upper_arm", "forearm", "thigh", "shin") else parent
       for side in ("right", "left")
       for part, parent in (("upper_arm", "torso"), ("forearm", "upper_arm"), ("hand", "forearm"),
                            ("thigh", "hips"), ("shin", "thigh"), ("foot", "shin"))},
}  # fmt: skip
BODIES = tuple(PARENTS)

RIGHT_ARM = ("right_upper_arm", "right_forearm", "right_hand")
"""Bodies, and the geom of the same name in each: their frames are shoulder, elbow and wrist."""

SKIN_TONES: Mapping[str, tuple[float, float, float]] = {
    "light": (0.90, 0.74, 0.65),
    "fair": (0.83, 0.65, 0.54),
    "medium": (0.75, 0.56, 0.43),
    "olive": (0.64, 0.46, 0.34),
    "brown": (0.48, 0.33, 0.24),
    "dark": (0.31, 0.21, 0.16),
}
"""How people look in pictures: red, green, blue from 0 to 1."""

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Joint:
    """A hinge: its body, its axis in that body, its range in degrees and the person's torque (N m).

    Ranges: facts of the reference, with the wider shoulder abduction it uses in VR. Torques: isometric maxima
    of healthy adults, rounded (Chaffin, Andersson and Martin, *Occupational Biomechanics*, 2006).
    """

    body: str
    axis: tuple[float, float, float]
    lower_deg: float
    upper_deg: float
    torque_n_m: float


def _arm(side: str) -> dict[str, Joint]:
    right = side == "right"
    shoulder_y = (-180.0, 198.0) if right else (-198.0, 180.0)
    wrist_y = (-27.0, 47.0) if right else (-47.0, 27.0)
    return {
        f"{side}_shoulder_y": Joint(f"{side}_upper_arm", Y, *shoulder_y, 60.0),
        f"{side}_shoulder_x": Joint(f"{side}_upper_arm", X, -188.0, 61.0, 60.0),
        f"{side}_shoulder_z": Joint(f"{side}_upper_arm", Z, -90.0, 90.0, 40.0),
        f"{side}_elbow_x": Joint(f"{side}_forearm", X, -128.0, 0.0, 50.0),
        f"{side}_forearm_z": Joint(f"{side}_forearm", Z, -90.0, 90.0, 10.0),
        f"{side}_wrist_x": Joint(f"{side}_hand", X, -81.0, 90.0, 10.0),
        f"{side}_wrist_y": Joint(f"{side}_hand", Y, *wrist_y, 10.0),
    }


JOINTS: Mapping[str, Joint] = {
    "waist_x": Joint("torso", X, -30.0, 75.0, 200.0),
    "waist_y": Joint("torso", Y, -30.0, 30.0, 150.0),
    "waist_z": Joint("torso", Z, -30.0, 30.0, 100.0),
    "head_x": Joint("head", X, -50.0, 50.0, 30.0),
    "head_y": Joint("head", Y, -34.0, 34.0, 30.0),
    "head_z": Joint("head", Z, -70.0, 70.0, 20.0),
    **_arm("right"),
    **_arm("left"),
}
"""The 20 driven joints (paper, section III), in the order of every array of joint angles; hinges of one body
follow each other, the first outermost."""

JOINT_INDEX = {name: i for i, name in enumerate(JOINTS)}
LOWER_RAD = np.radians([joint.lower_deg for joint in JOINTS.values()])
UPPER_RAD = np.radians([joint.upper_deg for joint in JOINTS.values()])
TORQUE_N_M = np.array([joint.torque_n_m for joint in JOINTS.values()])


@dataclass(frozen=True)
class Posture:
    """What carries the person: rotations about x of the hips in the world and of the undriven legs.

    ``hips_pos_w`` is the origin of the hips, or ``None`` where they rest on a seat: then it depends on the sex.
    ``shoes``: whether the person wears any.
    """

    hips_pos_w: tuple[float, float, float] | None
    hips_deg: float
    thigh_deg: float
    shin_deg: float
    shoes: bool = True

    def hips(self, p: Proportions) -> Array:
        """The origin of the hips, (3,) or (N, 3), world frame."""
        if self.hips_pos_w is None:
            return _vector(0.0, 0.03, p.seated_hips_height)
        return np.broadcast_to(self.hips_pos_w, (*np.shape(p.mass), 3))

    def turns_deg(self) -> dict[str, float]:
        """Rotation about x of the hips and each leg's bodies that turn, by body."""
        legs = {"thigh": self.thigh_deg, "shin": self.shin_deg}
        return {"hips": self.hips_deg} | {
            f"{s}_{part}": a for s in ("right", "left") for part, a in legs.items()
        }


SEATED = Posture(hips_pos_w=None, hips_deg=0.0, thigh_deg=-90.0, shin_deg=80.0)
RECLINED = Posture(hips_pos_w=(0.0, 0.0, 0.7), hips_deg=-30.0, thigh_deg=-60.0, shin_deg=0.0, shoes=False)
"""In a wheelchair, and in a bed whose backrest is raised by 60° (reference)."""


def joint_angles(**degrees: float) -> Array:
    """The seated pose (20,) in radians, elbows at −90°, with the named joints set in degrees.

    Raises:
        ValueError: for a name that is no driven joint.
    """
    pose = {"right_elbow_x": -90.0, "left_elbow_x": -90.0} | degrees
    unknown = sorted(set(pose) - set(JOINTS))
    if unknown:
        raise ValueError(f"unknown joint {unknown[0]!r}; the driven joints are {', '.join(JOINTS)}")
    return np.radians([pose.get(name, 0.0) for name in JOINTS])


SEATED_RAD = joint_angles()


@dataclass(frozen=True)
class Person:
    """One person: sex, torso height (hip bone to head centre), joint angles (20,) in radians, tone of the skin.

    Raises:
        ValueError: when a value is outside what the model allows.
    """

    sex: Sex = "woman"
    torso_height_m: float = 0.54
    joint_angles_rad: Array = field(default_factory=lambda: SEATED_RAD.copy())
    skin_tone: str = "fair"

    def __post_init__(self) -> None:
        if self.sex not in SEXES:
            raise ValueError(f"unknown sex {self.sex!r}; the models are {' and '.join(SEXES)}")
        if self.skin_tone not in SKIN_TONES:
            raise ValueError(f"unknown skin tone {self.skin_tone!r}; there are {', '.join(SKIN_TONES)}")
        check_torso_height(self.torso_height_m)
        if np.shape(self.joint_angles_rad) != (len(JOINTS),):
            raise ValueError(
                f"joint angles must have shape ({len(JOINTS)},), not {np.shape(self.joint_angles_rad)}"
            )


def check_torso_height(torso_height_m: float) -> None:
    """Raise ``ValueError`` for a torso height that no seated adult has."""
    low, high = TORSO_HEIGHT_RANGE_M
    if not low <= torso_height_m <= high:
        raise ValueError(f"torso height {torso_height_m:.3f} m is outside {low:.2f} to {high:.2f} m")


@dataclass(frozen=True)
class People:
    """N people as arrays: ``is_woman`` (N,) bool, ``torso_height_m`` (N,), ``joint_angles_rad`` (N, 20).

    Impairments: ``range_share`` and ``strength_share`` (N,) of the joints' ranges and torques, ``tremor_rad``
    (N, 20) by which the joints' targets tremble either way.
    """

    is_woman: NDArray[np.bool_]
    torso_height_m: Array
    joint_angles_rad: Array
    range_share: Array
    strength_share: Array
    tremor_rad: Array

    @classmethod
    def of(cls, persons: Iterable[Person]) -> "People":
        """Stack single persons."""
        persons = list(persons)
        return cls.unimpaired(
            np.array([person.sex == "woman" for person in persons]),
            np.array([person.torso_height_m for person in persons], float),
            np.stack([np.asarray(person.joint_angles_rad, float) for person in persons]),
        )

    @classmethod
    def unimpaired(
        cls, is_woman: NDArray[np.bool_], torso_height_m: Array, joint_angles_rad: Array
    ) -> "People":
        """People with full ranges and strength and without tremor."""
        full = np.ones(len(is_woman))
        return cls(is_woman, torso_height_m, joint_angles_rad, full, full, np.zeros_like(joint_angles_rad))

    def person(self, index: int) -> Person:
        """One of them."""
        sex = SEXES[int(self.is_woman[index])]
        return Person(sex, float(self.torso_height_m[index]), self.joint_angles_rad[index].copy())


@dataclass(frozen=True)
class Layout:
    """Frames and sizes of N people, by the names of bodies, geoms and sites without prefix.

    Each (N, 3), metres; ``body_pos`` in the parent body, ``geom_pos`` and ``site_pos`` in their body.
    """

    body_pos: Mapping[str, Array]
    geom_pos: Mapping[str, Array]
    geom_size: Mapping[str, Array]
    site_pos: Mapping[str, Array]


def proportions_of(is_woman: NDArray[np.bool_]) -> Proportions:
    """The unscaled measures of N people, each field an array (N,)."""
    measures: dict[str, Any] = {
        each.name: np.where(is_woman, getattr(WOMAN, each.name), getattr(MAN, each.name))
        for each in fields(Proportions)
    }
    return Proportions(**measures)


def layout(is_woman: NDArray[np.bool_], torso_height_m: Array, posture: Posture = SEATED) -> Layout:
    """Where everything is in N people; lengths along the body scale with the torso height, radii do not."""
    p = proportions_of(is_woman)
    h = torso_height_m / p.torso_height
    return Layout(_body_positions(p, h, posture), *_geoms(p, h), _sites(p, h))


def _body_positions(p: Proportions, h: Array, posture: Posture) -> dict[str, Array]:
    shoulder_z = (p.chest_rise + p.shoulder_rise) * h
    positions = {
        "hips": posture.hips(p),
        "torso": _vector(0.0, 0.0, p.waist_rise * h),
        "head": _vector(0.0, 0.0, (p.chest_rise + p.neck_rise + p.head_rise) * h),
    }
    for side, sign in (("right", -1.0), ("left", 1.0)):
        positions |= {
            f"{side}_upper_arm": _vector(sign * p.shoulder_side, 0.0, shoulder_z),
            f"{side}_forearm": _vector(0.0, 0.0, -p.upper_arm_length * h),
            f"{side}_hand": _vector(0.0, 0.0, -(p.forearm_radius + p.forearm_length * h)),
            f"{side}_thigh": _vector(sign * p.thigh_side, 0.0, -p.hips_drop * h),
            f"{side}_shin": _vector(0.0, 0.0, -p.thigh_length * h),
            f"{side}_foot": _vector(0.0, 0.0, -p.shin_length * h),
        }
    return positions


def _geoms(p: Proportions, h: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    """Capsules lie along the axis that ``GEOMS`` names; their size is radius, half length, 0."""
    zero = np.zeros_like(h)
    chest_z = p.chest_rise * h
    shoulder_z = chest_z + p.shoulder_rise * h - (p.shoulder_radius - 0.055)
    position = {
        "hips": _vector(zero, zero, -p.hips_drop * h),
        "waist": _vector(zero, zero, zero),
        "chest": _vector(zero, zero, chest_z),
        "right_shoulder": _vector(-0.47 * p.shoulder_side, zero, shoulder_z),
        "left_shoulder": _vector(0.47 * p.shoulder_side, zero, shoulder_z),
        "neck": _vector(zero, zero, (p.chest_rise + p.neck_rise) * h + 0.5 * p.neck_length * h),
        "cranium": _vector(zero, zero, p.head_centre_rise * h + 0.015),
        "jaw": _vector(zero, MOUTH_DEPTH + JAW_RADIUS - p.mouth_forward, zero + JAW_RISE),
    }
    size = {
        "hips": _vector(p.hips_radius, 0.5 * p.hips_length, zero),
        "waist": _vector(p.waist_radius, 0.5 * p.waist_length, zero),
        "chest": _vector(p.chest_radius, 0.5 * p.chest_length, zero),
        "right_shoulder": _vector(p.shoulder_radius, 0.5 * p.shoulder_length, zero),
        "left_shoulder": _vector(p.shoulder_radius, 0.5 * p.shoulder_length, zero),
        "neck": _vector(p.neck_radius, 0.5 * p.neck_length * h, zero),
        "cranium": _vector(zero + CRANIUM_RADIUS, zero, zero),
        "jaw": _vector(zero + JAW_RADIUS, zero, zero),
    }
    for side in ("right", "left"):
        for part in ("upper_arm", "forearm", "thigh", "shin"):
            length = getattr(p, f"{part}_length") * h
            position[f"{side}_{part}"] = _vector(zero, zero, -0.5 * length)
            size[f"{side}_{part}"] = _vector(getattr(p, f"{part}_radius"), 0.5 * length, zero)
        position[f"{side}_hand"] = _vector(zero, zero, -p.hand_radius)
        size[f"{side}_hand"] = _vector(p.hand_radius, zero, zero)
        foot_length = p.foot_length * h
        position[f"{side}_foot"] = _vector(zero, -0.3 * foot_length, zero)
        size[f"{side}_foot"] = _vector(p.foot_radius, 0.5 * foot_length - 0.5 * p.foot_radius, zero)
    return position, size


def _sites(p: Proportions, h: Array) -> dict[str, Array]:
    zero = np.zeros_like(h)
    return {
        "head_centre": _vector(zero, zero, p.head_centre_rise * h),
        "mouth": _vector(zero, -p.mouth_forward, zero + MOUTH_RISE),
        "right_hand_centre": _vector(zero, zero, -p.hand_radius),
        "left_hand_centre": _vector(zero, zero, -p.hand_radius),
    }


SITE_BODY = {
    "head_centre": "head",
    "mouth": "head",
    "right_hand_centre": "right_hand",
    "left_hand_centre": "left_hand",
}


@dataclass(frozen=True)
class Geom:
    """A collision geom: its body, the axis of a capsule (``None``: a sphere), its share of the mass."""

    body: str
    axis: tuple[float, float, float] | None
    mass_share: float


GEOMS: Mapping[str, Geom] = {
    "hips": Geom("hips", X, 0.14),
    "waist": Geom("torso", X, 0.13),
    "chest": Geom("torso", X, 0.10),
    "right_shoulder": Geom("torso", X, 0.05),
    "left_shoulder": Geom("torso", X, 0.05),
    "neck": Geom("torso", Z, 0.01),
    "cranium": Geom("head", None, 0.05),
    "jaw": Geom("head", None, 0.02),
    **{f"{side}_{part}": Geom(f"{side}_{part}", axis, share)
       for side in ("right", "left")
       for part, axis, share in (("upper_arm", Z, 0.033), ("forearm", Z, 0.019), ("hand", None, 0.0065),
                                 ("thigh", Z, 0.105), ("shin", Z, 0.0475), ("foot", Y, 0.014))},
}  # fmt: skip


def mass_shares() -> Array:
    """What each of ``BODIES`` weighs as a share of the person, (B,)."""
    return np.array([sum(geom.mass_share for geom in GEOMS.values() if geom.body == name) for name in BODIES])


def body_rotations(joint_angles_rad: Array, posture: Posture = SEATED) -> dict[str, Array]:
    """Each body's rotation in its parent, (N, 4), of people with joint angles (N, 20)."""
    return {body: body_rotation(body, joint_angles_rad, posture) for body in BODIES}


def body_rotation(body: str, joint_angles_rad: Array, posture: Posture = SEATED) -> Array:
    """One body's rotation in its parent, (N, 4), of people with joint angles (N, 20)."""
    angles = np.asarray(joint_angles_rad, float)
    turns = [(joint.axis, angles[..., i]) for i, joint in enumerate(JOINTS.values()) if joint.body == body]
    if body in posture.turns_deg():
        turns.append((X, np.full(angles.shape[:-1], np.radians(posture.turns_deg()[body]))))
    rotation = np.broadcast_to(transforms.IDENTITY_QUATERNION, (*angles.shape[:-1], 4))
    for axis, angle in turns:
        rotation = transforms.multiply(rotation, transforms.from_axis_angle(axis, angle))
    return rotation


def body_frames(people: People, posture: Posture = SEATED) -> tuple[dict[str, Array], dict[str, Array]]:
    """World frames of all bodies of N people: positions (N, 3) and quaternions (N, 4) by body name."""
    local_pos = layout(people.is_woman, people.torso_height_m, posture).body_pos
    local_q = body_rotations(people.joint_angles_rad, posture)
    pos_w, q_w = {"hips": local_pos["hips"]}, {"hips": local_q["hips"]}
    for body, parent in PARENTS.items():
        if parent is not None:
            pos_w[body], q_w[body] = transforms.compose(
                pos_w[parent], q_w[parent], local_pos[body], local_q[body]
            )
    return pos_w, q_w


_STANDING = Posture(hips_pos_w=(0.0, 0.0, 0.0), hips_deg=0.0, thigh_deg=0.0, shin_deg=0.0)
BIND_RAD = joint_angles(right_shoulder_y=42.0, left_shoulder_y=-42.0, right_elbow_x=-45.0, left_elbow_x=-45.0)


def bind_frames(sex: Sex, torso_height_m: float) -> tuple[dict[str, Array], dict[str, Array]]:
    """Where the skin is bound to the bodies: standing, hips at the origin, arms half raised and half bent.

    Positions (3,) and quaternions (4,) by body name.
    """
    pos, q = body_frames(People.of([Person(sex, torso_height_m, BIND_RAD)]), _STANDING)
    return {body: pos[body][0] for body in BODIES}, {body: q[body][0] for body in BODIES}


def person_model(person: Person, posture: Posture = SEATED, *, moving: bool) -> mujoco.MjModel:
    """A person alone; see ``add_person``."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_person(spec, person, posture, moving=moving)
    return spec.compile()


def add_person(spec: mujoco.MjSpec, person: Person, posture: Posture = SEATED, *, moving: bool) -> None:
    """Add a person to a scene, hips fixed to the world.

    A moving person has the 20 driven joints, each with a position servo of limited torque, weightless by
    gravity compensation (muscle tone holds the posture). A static one is welded in its pose.
    """
    frames = layout(np.array([person.sex == "woman"]), np.array([person.torso_height_m]), posture)
    rotations = body_rotations(person.joint_angles_rad[None], posture)
    bodies: dict[str, mujoco.MjsBody] = {}
    for name, parent in PARENTS.items():
        owner = spec.worldbody if parent is None else bodies[parent]
        bodies[name] = owner.add_body(name=PREFIX + name, pos=frames.body_pos[name][0], gravcomp=1.0)
        driven = moving and any(joint.body == name for joint in JOINTS.values())
        if not driven:
            bodies[name].quat = rotations[name][0]
    _add_geoms(bodies, frames, PROPORTIONS[person.sex].mass)
    for name, body in SITE_BODY.items():
        bodies[body].add_site(name=PREFIX + name, pos=frames.site_pos[name][0], size=[0.005] * 3, group=4)
    if moving:
        _add_joints(spec, bodies)


def _add_geoms(bodies: dict[str, mujoco.MjsBody], frames: Layout, mass_kg: float) -> None:
    for name, geom in GEOMS.items():
        add_collision(
            bodies[geom.body],
            PREFIX + name,
            SPHERE if geom.axis is None else CAPSULE,
            contacts.PERSON,
            pos=frames.geom_pos[name][0],
            size=frames.geom_size[name][0],
            quat=_capsule_quaternion(geom.axis),
            mass=geom.mass_share * mass_kg,
        )


SERVO_FREQUENCY_RAD_S = 40.0
"""Bandwidth of the person's position servos: tracking lags about 2 / 40 s = 50 ms behind the headset."""


def _add_joints(spec: mujoco.MjSpec, bodies: dict[str, mujoco.MjsBody]) -> None:
    for name, joint in JOINTS.items():
        bodies[joint.body].add_joint(
            name=PREFIX + name,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            range=np.radians([joint.lower_deg, joint.upper_deg]),
            armature=ARMATURE_KG_M2[joint.body],
        )
        actuator = spec.add_actuator(
            name=PREFIX + name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target=PREFIX + name,
            forcerange=[-joint.torque_n_m, joint.torque_n_m],
            ctrlrange=np.radians([joint.lower_deg, joint.upper_deg]),
        )
        stiffness = SERVO_FREQUENCY_RAD_S**2 * SERVO_INERTIA_KG_M2[joint.body]
        actuator.set_to_position(kp=stiffness, dampratio=1.0)


ARMATURE_KG_M2: Mapping[str, float] = {
    "torso": 0.1, "head": 0.02,
    **{f"{side}_{part}": value for side in ("right", "left")
       for part, value in (("upper_arm", 0.02), ("forearm", 0.01), ("hand", 0.005))},
}  # fmt: skip
SERVO_INERTIA_KG_M2: Mapping[str, float] = {
    "torso": 3.0, "head": 0.07,
    **{f"{side}_{part}": value for side in ("right", "left")
       for part, value in (("upper_arm", 0.25), ("forearm", 0.07), ("hand", 0.012))},
}  # fmt: skip
"""Moment of inertia that each body's servos are tuned for, about its joint, armature included."""


def _capsule_quaternion(axis: tuple[float, float, float] | None) -> Array:
    turns = {X: (Y, 0.5 * np.pi), Y: (X, -0.5 * np.pi)}
    if axis not in turns:
        return transforms.IDENTITY_QUATERNION
    return transforms.from_axis_angle(turns[axis][0], turns[axis][1])


def _vector(x: float | Array, y: float | Array, z: float | Array) -> Array:
    return np.stack(
        np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float), np.asarray(z, float)), axis=-1
    )
