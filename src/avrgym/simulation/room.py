"""Whether things have room where an episode begins: robot, tool and what it carries, the person, the furniture."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.transforms import norm
from avrgym.models import collision_bits, human
from avrgym.models.collision_bits import CollisionBits
from avrgym.models.human import RIGHT_ARM
from avrgym.people.arm_clearance import PAIRS

Rooms = dict[tuple[int, int], float]
"""How far two geoms must be apart at least, metres, by their ids."""

PERSON_ROOM_M = 0.01
"""What robot, tool and what it carries keep from the person."""
FURNITURE_ROOM_M = 0.005
"""What they keep from furniture."""
SWING_M = 0.03
"""How much more room trembling people need, whose limbs overshoot the poses between which they swing."""
PADDING_M = 0.02
"""How deep arms may lie in furniture: armrests and mattresses are soft. What people sit and lie on is not judged."""

_SPHERE, _CAPSULE, _CYLINDER = (
    int(kind)
    for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
)


class NoRoomError(ValueError):
    """No start was found where things do not stand in each other; says which ones do."""


@dataclass(frozen=True)
class Geoms:
    """All geoms of n worlds: centres (n, G, 3), orientations (n, G, 9) row by row, sizes (n, G, 3); world frame."""

    pos_w: FloatArray
    mat_w: FloatArray
    size_m: FloatArray


@dataclass(frozen=True)
class Conflict:
    """Two things that lack room, by name: their gap, negative where they overlap, and the least that is allowed."""

    first: str
    second: str
    gap_m: float
    room_m: float

    def __str__(self) -> str:
        where = f"{100.0 * abs(self.gap_m):.1f} cm {'inside' if self.gap_m < 0.0 else 'from'}"
        return f"{self.first} is {where} {self.second}"


class Room:
    """Measures the gaps between all things of a scene that must keep apart when an episode begins."""

    def __init__(self, model: mujoco.MjModel, *, base: str | None, arms: bool, offered: bool) -> None:
        """Find the pairs.

        Args:
            model: the scene.
            base: the body by which the robot is fastened to furniture, if it is.
            arms: whether the person's arms must keep out of the furniture.
            offered: whether the right arm must leave even padding and the rest of the body alone.
        """
        self._model, self._data = copy(model), mujoco.MjData(model)
        self._kinds = model.geom_type
        to_person = _of_robot(model)
        self._pairs = to_person | _of_loose(model, base) | _of_arms(model, arms=arms, offered=offered)
        self._to_person = len(to_person)
        self._first, self._second = np.array([*self._pairs]).T
        self._room_m = np.array([*self._pairs.values()])

    def conflicts(self, geoms: Geoms, *, swing_m: float | None = None) -> list[Conflict | None]:
        """In each of n worlds the pair that lacks most room, or nothing.

        With ``swing_m`` only the room that the robot leaves the person is looked at, who needs so much more of it.
        """
        reach = _reach_m(self._kinds, geoms.size_m)
        count = len(self._pairs) if swing_m is None else self._to_person
        room_m = self._room_m[:count] + (swing_m or 0.0)
        first, second = self._first[:count], self._second[:count]
        apart = norm(geoms.pos_w[:, first] - geoms.pos_w[:, second])
        near = apart - reach[:, first] - reach[:, second] < room_m
        return [
            self._conflict(geoms, world, np.nonzero(pairs)[0], room_m) for world, pairs in enumerate(near)
        ]

    def _conflict(self, geoms: Geoms, world: int, pairs: IntArray, room_m: FloatArray) -> Conflict | None:
        """The pair that lacks most room, of those whose bounding spheres do."""
        if not len(pairs):
            return None
        self._model.geom_size[:] = geoms.size_m[world]
        self._data.geom_xpos[:], self._data.geom_xmat[:] = geoms.pos_w[world], geoms.mat_w[world]
        gaps = np.array([self._gap_m(pair, float(room_m[pair])) for pair in pairs])
        lacking = gaps - room_m[pairs]
        worst = lacking.argmin()
        if lacking[worst] >= 0.0:
            return None
        pair = pairs[worst]
        names = self._name(self._first[pair]), self._name(self._second[pair])
        return Conflict(*names, float(gaps[worst]), float(room_m[pair]))

    def _gap_m(self, pair: int, up_to_m: float) -> float:
        first, second = int(self._first[pair]), int(self._second[pair])
        return mujoco.mj_geomDistance(self._model, self._data, first, second, max(up_to_m, 0.0), None)

    def _name(self, geom: int) -> str:
        """As people say it."""
        owner, _, part = _body(self._model, geom).rpartition("/")
        words = (part if owner else self._model.geom(geom).name).replace("_", " ")
        return {"person": "the person's ", "robot": "the robot's "}.get(owner, "the ") + words


def _reach_m(kinds: NDArray[np.int32], size_m: FloatArray) -> FloatArray:
    """The radii (n, G) of spheres around geoms."""
    x, y, z = np.moveaxis(size_m, -1, 0)
    conditions = [kinds == _SPHERE, kinds == _CAPSULE, kinds == _CYLINDER]
    return np.select(
        np.broadcast_arrays(*conditions), [x, x + y, np.hypot(x, y)], np.sqrt(x * x + y * y + z * z)
    )


def _of_robot(model: mujoco.MjModel) -> Rooms:
    """What robot, tool and what it carries keep from the person."""
    return _between(_robot(model), _geoms(model, collision_bits.PERSON), PERSON_ROOM_M)


def _of_loose(model: mujoco.MjModel, base: str | None) -> Rooms:
    """What all of that, but for a fastened base, keeps from furniture."""
    loose = [geom for geom in _robot(model) if _body(model, geom) != base]
    return _between(loose, _geoms(model, collision_bits.FURNITURE), FURNITURE_ROOM_M)


def _robot(model: mujoco.MjModel) -> list[int]:
    """The geoms of the robot, its tool and what that carries."""
    return [
        geom
        for bits in (collision_bits.ROBOT, collision_bits.TOOL, collision_bits.HULL, collision_bits.PARTICLE)
        for geom in _geoms(model, bits)
    ]


def _of_arms(model: mujoco.MjModel, *, arms: bool, offered: bool) -> Rooms:
    """What the person's arms keep from the furniture, and an offered one from the rest of the body too."""
    furniture = _geoms(model, collision_bits.FURNITURE)
    limbs = [f"{side}_{part}" for side in ("right", "left") for part in ("upper_arm", "forearm", "hand")]
    rooms = _between(_parts(model, limbs), furniture, -PADDING_M) if arms else {}
    if offered:
        kept_free = _geoms(model, collision_bits.NO_COLLISION)
        rooms |= _between(_parts(model, RIGHT_ARM), [*furniture, *kept_free], 0.0)
        rooms |= _between_parts(model, PAIRS, 0.0)
    return rooms


def _between_parts(model: mujoco.MjModel, pairs: Iterable[tuple[str, str]], room_m: float) -> Rooms:
    return {(_parts(model, [first])[0], _parts(model, [second])[0]): room_m for first, second in pairs}


def _between(first: Iterable[int], second: Sequence[int], room_m: float) -> Rooms:
    return {(a, b): room_m for a in first for b in second}


def _geoms(model: mujoco.MjModel, bits: CollisionBits) -> list[int]:
    """The geoms of a kind, whatever may touch them; the floor is not among them, which no start comes near."""
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_contype[geom] == bits.contype
        and model.geom_group[geom] == collision_bits.COLLISION_GROUP
        and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE
    ]


def _parts(model: mujoco.MjModel, names: Iterable[str]) -> list[int]:
    """Geoms of the person's body."""
    return [model.geom(human.PREFIX + name).id for name in names]


def _body(model: mujoco.MjModel, geom: int) -> str:
    return model.body(model.geom_bodyid[geom]).name
