"""Distributions of people: those of the paper (section V), of the zoo, and of people files.

Each person is sampled from one row of uniform random numbers. The person in a world therefore does not depend on other
worlds.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import (
    constant_like,
    copy_as_float,
    find_indices_to_compute,
    get_namespace,
    interpolate,
)
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Person, Posture
from avrgym.people import shoulder_limits
from avrgym.people.anthropometric_bodies import sample_bodies
from avrgym.people.arm_clearance import Boxes, compute_arm_clearance_m, compute_person_capsules
from avrgym.people.motor_model import MOTION_VERSION
from avrgym.people.population_names import (
    ALLOWED_PEOPLE_TEXT,
    ANTHROPOMETRIC_POPULATION,
    ORIGINAL_POPULATION,
    PARTICIPANT_POPULATION,
    REVISED_POPULATION,
)
from avrgym.people.zoo.commanding_partners import COMMANDING_PARTNER_SETS
from avrgym.people.zoo.partners import (
    SINGLE_STYLE_PARTNER_SETS,
    ZOO_PARTNER_SETS,
    PartnerSet,
    sample_fitted_partners,
)

if TYPE_CHECKING:
    from avrgym.people.people_file import PeopleFile


MAX_POSE_ATTEMPTS = 8
NUM_RANDOM_NUMBERS = 2 + MAX_POSE_ATTEMPTS * len(JOINTS)
"""Number of uniform random numbers for one person: sex, torso height, and all sampled poses."""


JointRanges = Mapping[str, tuple[float, float]]
"""Minimum and maximum initial joint angle in degrees, by joint name."""


@dataclass(frozen=True)
class PeopleDistribution:
    """A distribution of people: ranges of torso height (metres) and waist angles (± degrees), behaviour and body sizes.

    People move if ``is_cooperating`` is true or if ``partners`` of the zoo are given, see ``people.cooperation`` and
    ``people.zoo``. All other people hold their initial pose. ``joint_ranges_by_task`` contains ranges of initial joint
    angles by task. These ranges replace the ranges of the task. ``motion_version``: 2 for
    ``population_names.motor_model``, 1 for ``people.motion_version_1``. If ``has_anthropometric_bodies`` is true,
    bodies are sampled by ``people.has_anthropometric_bodies``. Then the ranges of torso height are those of the
    measured people.
    """

    torso_height_man_m: tuple[float, float]
    torso_height_woman_m: tuple[float, float]
    max_waist_angle_deg: float
    is_cooperating: bool = False
    joint_ranges_by_task: Mapping[str, JointRanges] = field(default_factory=dict[str, JointRanges])
    partners: PartnerSet | None = None
    motion_version: int = MOTION_VERSION
    has_anthropometric_bodies: bool = False

    @property
    def is_moving(self) -> bool:
        """Whether these people move by themselves, because they cooperate or are partners of the zoo."""
        return self.is_cooperating or self.partners is not None

    def get_pose_distribution(self, task: str, default: "PoseDistribution") -> "PoseDistribution":
        """Returns the distribution of initial poses in a task: the task's distribution ``default``, changed by
        ``joint_ranges_by_task``.
        """
        rest_rad, spread_rad = default.rest_angles_rad.copy(), default.max_offset_rad.copy()
        for joint, (low_deg, high_deg) in self.joint_ranges_by_task.get(task, {}).items():
            rest_rad[JOINT_INDEX[joint]] = np.radians(0.5 * (low_deg + high_deg))
            spread_rad[JOINT_INDEX[joint]] = np.radians(0.5 * (high_deg - low_deg))
        return PoseDistribution(rest_rad, spread_rad)


_REVISED = PeopleDistribution((0.50, 0.70), (0.44, 0.64), max_waist_angle_deg=10.0)
POPULATION_DISTRIBUTIONS: Mapping[str, PeopleDistribution] = {
    ORIGINAL_POPULATION: PeopleDistribution((0.60, 0.60), (0.54, 0.54), max_waist_angle_deg=0.0),
    REVISED_POPULATION: _REVISED,
    PARTICIPANT_POPULATION: PeopleDistribution(
        (0.51, 0.58), (0.51, 0.58), max_waist_angle_deg=5.0, is_cooperating=True
    ),
    ANTHROPOMETRIC_POPULATION: PeopleDistribution(
        (0.54, 0.66),
        (0.49, 0.60),
        max_waist_angle_deg=5.0,
        is_cooperating=True,
        has_anthropometric_bodies=True,
    ),
    **{name: replace(_REVISED, partners=partners) for name, partners in ZOO_PARTNER_SETS.items()},
}
_STYLES: Mapping[str, PartnerSet] = {**SINGLE_STYLE_PARTNER_SETS, **COMMANDING_PARTNER_SETS}
_NAMED = POPULATION_DISTRIBUTIONS | {
    name: replace(_REVISED, partners=partners) for name, partners in _STYLES.items()
}
MOTION_VERSIONS = (1, MOTION_VERSION)
NAMED_DISTRIBUTIONS: Mapping[str, PeopleDistribution] = _NAMED | {
    f"{name}@{version}": replace(distribution, motion_version=version)
    for name, distribution in _NAMED.items()
    for version in MOTION_VERSIONS
}
"""All named distributions.

They include single styles of the zoo, such as ``zoo/train/startled``, and versions of the motion model, such as
``participants@1``. Names without a version use the newest version.
"""

MIN_ARM_CLEARANCE_M = 0.01
"""Minimum distance of a sampled arm from the body and the furniture (paper's code)."""

ARMREST_HALF_GAP_M, ARMREST_ABDUCTION_RAD = 0.248, float(np.radians(30.0))
"""Half the distance between the padded armrests of the wheelchair.

The second value is the abduction of arms that lie on the armrests.
"""

RIGHT_ARM_JOINT_MASK = np.array([name.startswith("right_") for name in JOINTS])
WAIST_JOINT_MASK = np.array([joint.body == "torso" for joint in JOINTS.values()])


@dataclass(frozen=True, eq=False)
class PoseDistribution:
    """Distribution of initial joint angles: uniform in ``rest_angles_rad`` (20,) ± ``max_offset_rad`` (20,).

    A random right arm is resampled until its pose is within the shoulder limits and has enough clearance.
    """

    rest_angles_rad: FloatArray
    max_offset_rad: FloatArray

    @property
    def has_random_arm_pose(self) -> bool:
        """Whether the initial pose of the right arm is random."""
        return bool(self.max_offset_rad[RIGHT_ARM_JOINT_MASK].any())


def find_distribution(name_or_path: str, tasks: Collection[str]) -> PeopleDistribution:
    """Returns the distribution with this name, or the one in this people file. A file may contain poses for any of
    ``tasks``.

    Raises:
        ValueError: for an unknown name (the message lists the distributions), or for an invalid file.
    """
    if name_or_path in NAMED_DISTRIBUTIONS:
        return NAMED_DISTRIBUTIONS[name_or_path]
    if not Path(name_or_path).is_file():
        name, _, version = name_or_path.rpartition("@")
        if name in _NAMED:
            allowed = ", ".join(f"{name}@{known}" for known in MOTION_VERSIONS)
            raise ValueError(
                f"unknown motion version {version!r} of population {name!r}; allowed: {name}, {allowed}"
            )
        raise ValueError(f"unknown population {name_or_path!r}; allowed: {ALLOWED_PEOPLE_TEXT}")
    from avrgym.people.people_file import read_people

    return make_distribution(read_people(Path(name_or_path), tasks))


def make_distribution(people: "PeopleFile") -> PeopleDistribution:
    """Returns the distribution of people that a people file defines."""
    heights = people.torso_height_m
    partners = sample_fitted_partners(people.behaviour) if people.behaviour else None
    return PeopleDistribution(heights.man, heights.woman, 0.0, people.cooperating, people.poses, partners)


def sample_people(
    distribution: PeopleDistribution,
    pose: PoseDistribution,
    posture: Posture,
    furniture: Boxes | None,
    uniforms: FloatArray,
) -> People:
    """Returns n people, sampled from uniform numbers (n, ``NUM_RANDOM_NUMBERS``). Both sexes are equally likely.

    A random arm pose is rejected if it violates the shoulder limits. It is also rejected if the arm is within 1 cm of
    body or furniture. If all ``MAX_POSE_ATTEMPTS`` poses are rejected, the last pose is used, with the shoulders
    clipped to their limits.
    """
    xp = get_namespace(uniforms)
    is_woman = uniforms[:, 0] < 0.5
    man = interpolate(distribution.torso_height_man_m, uniforms[:, 1])
    woman = interpolate(distribution.torso_height_woman_m, uniforms[:, 1])
    spread = pose.max_offset_rad + np.where(
        WAIST_JOINT_MASK, np.radians(distribution.max_waist_angle_deg), 0.0
    )
    shares = uniforms[:, 2:].reshape(len(uniforms), MAX_POSE_ATTEMPTS, len(JOINTS))
    rest, spread, lower, upper = (
        constant_like(each, uniforms)
        for each in (pose.rest_angles_rad, spread, human.LOWER_LIMITS_RAD, human.UPPER_LIMITS_RAD)
    )
    poses = xp.clip(rest + spread * (2.0 * shares - 1.0), lower, upper)
    people = People.make_unimpaired(is_woman, xp.where(is_woman, woman, man), poses[:, 0])
    if distribution.has_anthropometric_bodies:
        of_sex = xp.where(is_woman, 2.0 * uniforms[:, 0], 2.0 * uniforms[:, 0] - 1.0)
        people = replace(people, **sample_bodies(is_woman, uniforms[:, 1], of_sex)._asdict())
        poses = _on_armrests(people, poses, posture)
        people = replace(people, joint_angles_rad=poses[:, 0])
    return _resample_crowded_poses(people, poses, posture, furniture) if pose.has_random_arm_pose else people


def _on_armrests(people: People, poses: FloatArray, posture: Posture) -> FloatArray:
    """Returns the poses (n, ``MAX_POSE_ATTEMPTS``, 20), changed for seated people who are too wide for the armrests.

    Both upper arms of these people are abducted by at least ``ARMREST_ABDUCTION_RAD``.
    """
    if posture.hips_pos_w is not None:
        return poses
    xp, p = get_namespace(poses), human.compute_people_layout(people, posture).dimensions
    half_width = get_namespace(poses).ones_like(people.stature_m) * (
        p.shoulder_offset_x_m + p.upper_arm_radius_m
    )
    wide = (half_width > ARMREST_HALF_GAP_M)[:, None]
    poses = copy_as_float(poses)
    for joint, raised in (
        ("right_shoulder_y", ARMREST_ABDUCTION_RAD),
        ("left_shoulder_y", -ARMREST_ABDUCTION_RAD),
    ):
        angle = poses[..., JOINT_INDEX[joint]]
        limited = xp.clip(angle, raised, None) if raised > 0.0 else xp.clip(angle, None, raised)
        poses[..., JOINT_INDEX[joint]] = xp.where(wide, limited, angle)
    return poses


def _resample_crowded_poses(
    people: People, poses: FloatArray, posture: Posture, furniture: Boxes | None
) -> People:
    """Returns the people in their first allowed pose out of ``poses`` (n, ``MAX_POSE_ATTEMPTS``, 20), see
    ``sample_people``.
    """
    xp, angles = get_namespace(poses), copy_as_float(poses[:, 0])
    crowded = ~_has_room(people, posture, furniture)
    for attempt in range(1, MAX_POSE_ATTEMPTS):
        (rows,) = find_indices_to_compute(crowded)
        if not len(rows):
            break
        angles[rows] = xp.where(crowded[rows, None], poses[rows, attempt], angles[rows])
        now = replace(people, joint_angles_rad=angles)
        again = People(**{name: array[rows] for name, array in vars(now).items()})
        crowded[rows] = crowded[rows] & ~_has_room(again, posture, furniture)
    angles = xp.where(crowded[:, None], shoulder_limits.clip_shoulders(angles), angles)
    return replace(people, joint_angles_rad=angles)


def _has_room(people: People, posture: Posture, furniture: Boxes | None) -> BoolArray:
    segments_w, radii_m = compute_person_capsules(people, posture)
    room = compute_arm_clearance_m(segments_w, radii_m, furniture) >= MIN_ARM_CLEARANCE_M
    return room & shoulder_limits.are_shoulders_within_limits(people.joint_angles_rad)


def repeat_person(person: Person, count: int) -> People:
    """Returns ``count`` copies of one person as arrays (``count``, ...)."""
    return People.from_persons([person] * count)
