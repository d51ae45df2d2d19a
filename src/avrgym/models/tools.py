"""Tools of robots, with the food, water or cloth that they carry.

The origin of a tool's frame is the tool centre point. Its x axis points away from the hand. Its z axis points up when
the tool is level.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import collision_bits
from avrgym.models.cloth import Cloth
from avrgym.models.geoms import SPHERE, add_collision_geom, add_material, add_visual_geom

TOOL_BODY = "tool"
"""Name of the tool's body, without the robot's prefix."""


@dataclass(frozen=True, eq=False)
class Particles:
    """Small spheres on a tool: food or water.

    ``initial_pos`` are their initial centres (K, 3) in the tool's frame, metres. ``is_fluid`` particles have no
    friction.
    """

    name: str
    initial_pos: FloatArray
    radius_m: float
    mass_kg: float
    rgb: tuple[float, float, float]
    is_fluid: bool = False

    @property
    def bodies(self) -> tuple[str, ...]:
        """Returns the body names. The slide joints of each body are ``<body>_x``, ``<body>_y`` and ``<body>_z``."""
        return tuple(f"{self.name}_{i}" for i in range(len(self.initial_pos)))


@dataclass(frozen=True, eq=False)
class CollisionHull:
    """Collision shape that replaces a tool's thin walls in contacts with people.

    ``replaced_geoms`` are the names of the replaced geoms. The shape has a type, a centre ``pos`` and a MuJoCo
    ``size``, in the tool's frame.
    """

    replaced_geoms: tuple[str, ...]
    shape: mujoco.mjtGeom
    pos: tuple[float, float, float]
    size: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Tool:
    """A tool of the robot, with particles or cloth.

    Attributes:
        name: name of the tool, such as ``spoon``.
        build: adds the tool to a body of a model. The last argument: whether to add visual geoms.
        grip_pos: point that the hand holds (3,), tool's frame, metres.
        particles: food or water on the tool.
        contact_body: name of the body in contact with people, if it moves relative to the tool.
        hull: collision shape that replaces thin walls.
        mouth_part_outline: points (P, 3) on the outside of the part that enters the mouth, tool's frame, metres.
        cloth: cloth that is attached to the tool.
        grip_tool_name: name of another tool with the same handle. Robots use the grip of that tool. ``None``: the
            tool has its own grip.
        mirror_axis: normal of the tool's plane of symmetry, 0 to 2 for x to z.
    """

    name: str
    build: Callable[[mujoco.MjSpec, mujoco.MjsBody, bool], None]
    grip_pos: tuple[float, float, float]
    particles: Particles | None
    contact_body: str = TOOL_BODY
    hull: CollisionHull | None = None
    mouth_part_outline: FloatArray | None = None
    cloth: Cloth | None = None
    grip_tool_name: str | None = None
    mirror_axis: int = 1

    @property
    def grip_name(self) -> str:
        """Returns the name of the grip for this tool in ``Robot.grips``."""
        return self.grip_tool_name or self.name


_GRAIN = {"condim": 1, "friction": [0.6, 0.005, 0.0001]}
"""Contact parameters of food. Pieces slide on each other without friction, but not on tools."""
_FLUID = {"condim": 1, "priority": 1, "solimp": [0.9, 0.9, 0.001, 0.5, 2.0]}
"""Contact parameters of water: one constraint per contact, independent of the other surface. The soft impedance reduces
the number of solver iterations.
"""


def add_particles(spec: mujoco.MjSpec, particles: Particles, appearance: bool) -> None:
    """Add the particles to the world, each with three slide joints.

    Particles do not rotate, which halves the number of coordinates. Joint values are positions in the world frame.
    """
    material = add_material(spec, particles.name, particles.rgb, roughness=0.6)
    for name in particles.bodies:
        body = spec.worldbody.add_body(name=name)
        for letter, axis in zip("xyz", np.eye(3), strict=True):
            body.add_joint(name=f"{name}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        add_collision_geom(
            body, name, SPHERE, collision_bits.PARTICLE,
            size=[particles.radius_m, 0, 0], mass=particles.mass_kg, **(_FLUID if particles.is_fluid else _GRAIN),
        )  # fmt: skip
        if appearance:
            add_visual_geom(body, SPHERE, material, size=[particles.radius_m, 0, 0])
