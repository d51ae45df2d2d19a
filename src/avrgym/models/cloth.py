"""Cloth that is attached to a tool: a triangle mesh with stretching and bending stiffness (a MuJoCo flex).

Each vertex is a body with three slide joints. The joint values are the vertex position in the world frame. The scene
needs the integrator ``discrete``, which integrates the stiffness implicitly. Physics steps of 10 ms are then stable.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.models import collision_bits
from avrgym.models.geoms import add_material


@dataclass(frozen=True, eq=False)
class Cloth:
    """A sheet of cloth. It collides with people only, and not with itself.

    Attributes:
        name: name of the flex, and prefix of the names of the vertices' bodies.
        initial_pos: stress-free initial positions (V, 3) of the vertices; tool's frame, metres.
        faces: triangles (F, 3), indices of vertices.
        attached_vertices: indices of the vertices that are attached to the tool.
        mass_kg: total mass of the cloth, distributed over the vertices.
        thickness_m: thickness of the shell; its bending stiffness is proportional to the cube.
        young_modulus_pa, poisson_ratio: elastic constants of the material.
        damping_s: Rayleigh damping, in seconds.
        contact_radius_m: distance from the triangles at which contacts begin.
        friction: sliding friction on skin.
        rgb: colour: red, green and blue, 0 to 1.
    """

    name: str
    initial_pos: FloatArray
    faces: NDArray[np.int64]
    attached_vertices: tuple[int, ...]
    mass_kg: float
    thickness_m: float
    young_modulus_pa: float
    poisson_ratio: float
    damping_s: float
    contact_radius_m: float
    friction: float
    rgb: tuple[float, float, float]

    @property
    def bodies(self) -> tuple[str, ...]:
        """Returns the names of the vertices' bodies. The slide joints are ``<body>_x``, ``<body>_y``, ``<body>_z``."""
        return tuple(f"{self.name}_{i}" for i in range(len(self.initial_pos)))


ATTACHMENT_TIME_CONSTANT_S = 0.02
"""Time constant of the constraints between attached vertices and the tool."""
_STRETCH_AND_BEND = 3
_NARROW_INERTIA_M2 = 1e-4
"""Rotational inertia of a vertex divided by its mass, in m². Vertices do not rotate, but MuJoCo requires an inertia."""


def add_attachment_sites(body: mujoco.MjsBody, cloth: Cloth) -> None:
    """Add sites to a tool's body, one for each attached vertex of the cloth."""
    for vertex in cloth.attached_vertices:
        body.add_site(
            name=_site_name(cloth, vertex), pos=cloth.initial_pos[vertex], size=[0.002] * 3, group=4
        )


def add_cloth(spec: mujoco.MjSpec, cloth: Cloth, prefix: str, appearance: bool) -> None:
    """Add the cloth to the world. ``prefix`` is the name prefix of the tool's sites, see ``add_attachment_sites``."""
    mass = cloth.mass_kg / len(cloth.initial_pos)
    for name, place in zip(cloth.bodies, cloth.initial_pos, strict=True):
        body = spec.worldbody.add_body(name=name, pos=place, mass=mass, explicitinertial=True)
        body.inertia = [_NARROW_INERTIA_M2 * mass] * 3
        for letter, axis, start in zip("xyz", np.eye(3), place, strict=True):
            body.add_joint(name=f"{name}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, ref=start)
    _add_flex(spec, cloth, appearance)
    for vertex in cloth.attached_vertices:
        name = cloth.bodies[vertex]
        spec.body(name).add_site(name=name, size=[0.002] * 3, group=4)
        spec.add_equality(
            name=_site_name(cloth, vertex),
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=prefix + _site_name(cloth, vertex),
            name2=name,
            solref=[ATTACHMENT_TIME_CONSTANT_S, 1.0],
        )


def _site_name(cloth: Cloth, vertex: int) -> str:
    return f"{cloth.name}_hold_{vertex}"


def _add_flex(spec: mujoco.MjSpec, cloth: Cloth, appearance: bool) -> None:
    bits = collision_bits.CLOTH
    flex = spec.add_flex(
        name=cloth.name, dim=2, radius=cloth.contact_radius_m, young=cloth.young_modulus_pa,
        poisson=cloth.poisson_ratio,
        thickness=cloth.thickness_m, damping=cloth.damping_s, elastic2d=_STRETCH_AND_BEND, selfcollide=0,
        contype=bits.contype, conaffinity=bits.conaffinity, friction=[cloth.friction, 0.005, 0.0001],
        group=collision_bits.VISUAL_GROUP,
    )  # fmt: skip
    flex.vertbody, flex.elem = list(cloth.bodies), cloth.faces.ravel().tolist()
    if appearance:
        flex.material = [add_material(spec, cloth.name, cloth.rgb, roughness=0.9)]
