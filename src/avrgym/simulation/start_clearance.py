"""Checks the clearance between robot, tool, particles, person and furniture in initial states."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.transforms import norm
from avrgym.models import collision_bits, human
from avrgym.models.collision_bits import CollisionBits
from avrgym.models.human import LEFT_ARM_BODIES, RIGHT_ARM_BODIES
from avrgym.models.task_frame import exchange_side_in_name
from avrgym.people.arm_clearance import CHECKED_CAPSULE_PAIRS

MinClearances = dict[tuple[int, int], float]
"""Minimum distance of pairs of geoms in metres, by the ids of both geoms."""

MIN_PERSON_CLEARANCE_M = 0.01
"""Minimum clearance of robot, tool and particles from the person."""
MIN_FURNITURE_CLEARANCE_M = 0.005
"""Minimum clearance of robot, tool and particles from furniture."""
EXTRA_TREMOR_CLEARANCE_M = 0.03
"""Additional clearance for people with tremor, because their limbs overshoot."""
MAX_PADDING_DEPTH_M = 0.02
"""Maximum penetration of a person's arms into furniture, because armrests and mattresses are soft. Seat and backrest
are not checked."""

_SPHERE, _CAPSULE, _CYLINDER = (
    int(kind)
    for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
)


class NoClearanceError(ValueError):
    """Raised if no initial state with enough clearance was found. The message contains two bodies that overlap."""


@dataclass(frozen=True)
class WorldGeoms:
    """All geoms of n worlds, world frame: centres (n, G, 3), rotation matrices (n, G, 9) by row, sizes (n, G, 3)."""

    pos_w: FloatArray
    rotation_matrix_w: FloatArray
    size_m: FloatArray


@dataclass(frozen=True)
class ClearanceConflict:
    """Two bodies that are too close in an initial state. ``gap_m``: their distance, negative if they overlap.

    ``min_clearance_m``: the minimum allowed distance of these bodies.
    """

    body1: str
    body2: str
    gap_m: float
    min_clearance_m: float

    def __str__(self) -> str:
        where = f"{100.0 * abs(self.gap_m):.1f} cm {'inside' if self.gap_m < 0.0 else 'from'}"
        return f"{self.body1} is {where} {self.body2}"


class InitialClearanceChecker:
    """Measures the gaps between all bodies of a scene that must not overlap in the initial state."""

    def __init__(
        self, model: mujoco.MjModel, *, base: str | None, arms: bool, offered: bool, mirrored: bool = False
    ) -> None:
        """Find the pairs of geoms to check.

        Args:
            model: model of the scene.
            base: name of the robot's body that is mounted on furniture; ``None`` for a robot on the floor.
            arms: whether to check the overlap of the person's arms and furniture.
            offered: whether to check the contacts of the right arm with padding and with the rest of the body.
            mirrored: whether ``offered`` applies to the left arm instead.
        """
        self._model, self._data = copy(model), mujoco.MjData(model)
        self._geom_types = model.geom_type
        to_person = _robot_to_person(model)
        self._pairs = (
            to_person
            | _robot_to_furniture(model, base)
            | _robot_to_itself(model)
            | _arms_to_furniture(model, arms=arms, offered=offered, mirrored=mirrored)
        )
        self._person_pairs = len(to_person)
        self._first, self._second = np.array([*self._pairs]).T
        self._clearance_m = np.array([*self._pairs.values()])

    def find_conflicts(
        self, geoms: WorldGeoms, *, extra_clearance_m: float | None = None
    ) -> list[ClearanceConflict | None]:
        """Returns for each of n worlds the pair of bodies that is farthest below its minimum clearance, or ``None``.

        With ``extra_clearance_m``, only pairs of robot and person are checked. Their minimum clearance is increased by
        this distance.
        """
        reach = _bounding_radius_m(self._geom_types, geoms.size_m)
        count = len(self._pairs) if extra_clearance_m is None else self._person_pairs
        clearance_m = self._clearance_m[:count] + (extra_clearance_m or 0.0)
        first, second = self._first[:count], self._second[:count]
        apart = norm(geoms.pos_w[:, first] - geoms.pos_w[:, second])
        near = apart - reach[:, first] - reach[:, second] < clearance_m
        return [
            self._conflict(geoms, world, np.nonzero(pairs)[0], clearance_m)
            for world, pairs in enumerate(near)
        ]

    def _conflict(
        self, geoms: WorldGeoms, world: int, pairs: IntArray, clearance_m: FloatArray
    ) -> ClearanceConflict | None:
        """Returns the pair of ``pairs`` that is farthest below its minimum clearance; ``None`` if there is no such
        pair."""
        if not len(pairs):
            return None
        self._model.geom_size[:] = geoms.size_m[world]
        self._data.geom_xpos[:], self._data.geom_xmat[:] = geoms.pos_w[world], geoms.rotation_matrix_w[world]
        gaps = np.array([self._gap_m(pair, float(clearance_m[pair])) for pair in pairs])
        lacking = gaps - clearance_m[pairs]
        worst = lacking.argmin()
        if lacking[worst] >= 0.0:
            return None
        pair = pairs[worst]
        names = self._name(self._first[pair]), self._name(self._second[pair])
        return ClearanceConflict(*names, float(gaps[worst]), float(clearance_m[pair]))

    def _gap_m(self, pair: int, up_to_m: float) -> float:
        first, second = int(self._first[pair]), int(self._second[pair])
        return mujoco.mj_geomDistance(self._model, self._data, first, second, max(up_to_m, 0.0), None)

    def _name(self, geom: int) -> str:
        """Returns the name of a geom's body for error messages, such as ``the robot's forearm``."""
        owner, _, part = _body(self._model, geom).rpartition("/")
        words = (part if owner else self._model.geom(geom).name).replace("_", " ")
        return {"person": "the person's ", "robot": "the robot's "}.get(owner, "the ") + words


def _bounding_radius_m(geom_types: NDArray[np.int32], size_m: FloatArray) -> FloatArray:
    """Returns the radii (n, G) of the bounding spheres of geoms."""
    x, y, z = np.moveaxis(size_m, -1, 0)
    conditions = [geom_types == _SPHERE, geom_types == _CAPSULE, geom_types == _CYLINDER]
    return np.select(
        np.broadcast_arrays(*conditions), [x, x + y, np.hypot(x, y)], np.sqrt(x * x + y * y + z * z)
    )


def _robot_to_person(model: mujoco.MjModel) -> MinClearances:
    """Returns the minimum clearances of robot, tool and particles from the person."""
    return _pairs(_robot(model), _geoms(model, collision_bits.PERSON), MIN_PERSON_CLEARANCE_M)


def _robot_to_furniture(model: mujoco.MjModel, base: str | None) -> MinClearances:
    """Returns the minimum clearances of robot, tool and particles from furniture. A mounted base is excluded."""
    loose = [geom for geom in _robot(model) if _body(model, geom) != base]
    return _pairs(loose, _geoms(model, collision_bits.FURNITURE), MIN_FURNITURE_CLEARANCE_M)


def _robot_to_itself(model: mujoco.MjModel) -> MinClearances:
    """Returns the minimum clearances (0) between the links of a robot, in a scene with self-collision."""
    links = [
        geom
        for geom in _geoms(model, collision_bits.ROBOT)
        if model.geom_conaffinity[geom] & collision_bits.ROBOT.contype
    ]
    return {pair: 0.0 for pair in combinations(links, 2) if _may_collide(model, *pair)}


def _may_collide(model: mujoco.MjModel, first: int, second: int) -> bool:
    """Returns whether two geoms of a robot can collide in MuJoCo.

    Geoms of a parent and its child body cannot collide. Geoms of pairs that the model excludes cannot collide either.
    """
    bodies = [int(model.geom_bodyid[geom]) for geom in (first, second)]
    one, other = (int(model.body_weldid[body]) for body in bodies)
    parents = [int(model.body_weldid[model.body_parentid[body]]) for body in (one, other)]
    signature = (min(bodies) << 16) + max(bodies)
    return (
        one != other
        and one != parents[1]
        and other != parents[0]
        and signature not in model.exclude_signature
    )


def _robot(model: mujoco.MjModel) -> list[int]:
    """Returns the geoms of the robot, its tool and its particles."""
    return [
        geom
        for bits in (collision_bits.ROBOT, collision_bits.TOOL, collision_bits.HULL, collision_bits.PARTICLE)
        for geom in _geoms(model, bits)
    ]


def _arms_to_furniture(model: mujoco.MjModel, *, arms: bool, offered: bool, mirrored: bool) -> MinClearances:
    """Returns the minimum clearances of the arms from furniture, and of an offered arm from the rest of the body."""
    furniture = _geoms(model, collision_bits.FURNITURE)
    limbs = [f"{side}_{part}" for side in ("right", "left") for part in ("upper_arm", "forearm", "hand")]
    clearances = _pairs(_parts(model, limbs), furniture, -MAX_PADDING_DEPTH_M) if arms else {}
    if offered:
        kept_free = _geoms(model, collision_bits.NO_COLLISION)
        clearances |= _pairs(
            _parts(model, LEFT_ARM_BODIES if mirrored else RIGHT_ARM_BODIES), [*furniture, *kept_free], 0.0
        )
        pairs = CHECKED_CAPSULE_PAIRS
        if mirrored:
            pairs = tuple(
                (exchange_side_in_name(part), exchange_side_in_name(other)) for part, other in pairs
            )
        clearances |= _named_pairs(model, pairs, 0.0)
    return clearances


def _named_pairs(
    model: mujoco.MjModel, pairs: Iterable[tuple[str, str]], clearance_m: float
) -> MinClearances:
    return {(_parts(model, [first])[0], _parts(model, [second])[0]): clearance_m for first, second in pairs}


def _pairs(first: Iterable[int], second: Sequence[int], clearance_m: float) -> MinClearances:
    return {(a, b): clearance_m for a in first for b in second}


def _geoms(model: mujoco.MjModel, bits: CollisionBits) -> list[int]:
    """Returns the ids of all geoms with these collision bits, except the floor."""
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_contype[geom] == bits.contype
        and model.geom_group[geom] == collision_bits.COLLISION_GROUP
        and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE
    ]


def _parts(model: mujoco.MjModel, names: Iterable[str]) -> list[int]:
    """Returns the ids of geoms of the person's body with these names."""
    return [model.geom(human.PERSON_NAME_PREFIX + name).id for name in names]


def _body(model: mujoco.MjModel, geom: int) -> str:
    return model.body(model.geom_bodyid[geom]).name
