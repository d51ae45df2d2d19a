"""Cloth that a tool holds: a triangle mesh with stretching and bending stiffness (a flex of MuJoCo).

Each vertex is a body with three slide joints. The joint values are the vertex position in the world frame. The scene
needs the integrator ``discrete``. This integrator integrates the stiffness implicitly; steps of 10 ms are therefore
stable.
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
        start: vertices (V, 3) at rest and at the start of an episode, in the tool's frame, metres.
        faces: triangles (F, 3), indices of vertices.
        held: indices of the vertices that the tool holds.
        mass_kg: mass of all vertices.
        thickness_m: thickness of the shell; its bending stiffness is proportional to the cube.
        young_pa, poisson: elastic modulus and Poisson's ratio.
        damping_s: Rayleigh damping, in seconds.
        radius_m: radius of the triangles in contacts.
        friction: sliding friction on skin.
        rgb: colour.
    """

    name: str
    start: FloatArray
    faces: NDArray[np.int64]
    held: tuple[int, ...]
    mass_kg: float
    thickness_m: float
    young_pa: float
    poisson: float
    damping_s: float
    radius_m: float
    friction: float
    rgb: tuple[float, float, float]

    @property
    def bodies(self) -> tuple[str, ...]:
        """Body names. The slide joints of each are ``<body>_x``, ``_y`` and ``_z``."""
        return tuple(f"{self.name}_{i}" for i in range(len(self.start)))


HOLD_TIME_S = 0.02
"""Time constant of the constraints between held vertices and the tool."""
_STRETCH_AND_BEND = 3
_NARROW_INERTIA_M2 = 1e-4
"""Rotational inertia of a vertex per mass. Vertices do not rotate, but MuJoCo requires an inertia."""


def add_holds(body: mujoco.MjsBody, cloth: Cloth) -> None:
    """Add sites to a tool's body, one for each vertex of the cloth that the tool holds."""
    for vertex in cloth.held:
        body.add_site(name=_site_name(cloth, vertex), pos=cloth.start[vertex], size=[0.002] * 3, group=4)


def add_cloth(spec: mujoco.MjSpec, cloth: Cloth, prefix: str, appearance: bool) -> None:
    """Add the cloth to the world. ``prefix`` is the name prefix of the tool's sites, see ``add_holds``."""
    mass = cloth.mass_kg / len(cloth.start)
    for name, place in zip(cloth.bodies, cloth.start, strict=True):
        body = spec.worldbody.add_body(name=name, pos=place, mass=mass, explicitinertial=True)
        body.inertia = [_NARROW_INERTIA_M2 * mass] * 3
        for letter, axis, start in zip("xyz", np.eye(3), place, strict=True):
            body.add_joint(name=f"{name}_{letter}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, ref=start)
    _add_flex(spec, cloth, appearance)
    for vertex in cloth.held:
        name = cloth.bodies[vertex]
        spec.body(name).add_site(name=name, size=[0.002] * 3, group=4)
        spec.add_equality(
            name=_site_name(cloth, vertex),
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=prefix + _site_name(cloth, vertex),
            name2=name,
            solref=[HOLD_TIME_S, 1.0],
        )


def _site_name(cloth: Cloth, vertex: int) -> str:
    return f"{cloth.name}_hold_{vertex}"


def _add_flex(spec: mujoco.MjSpec, cloth: Cloth, appearance: bool) -> None:
    bits = collision_bits.CLOTH
    flex = spec.add_flex(
        name=cloth.name, dim=2, radius=cloth.radius_m, young=cloth.young_pa, poisson=cloth.poisson,
        thickness=cloth.thickness_m, damping=cloth.damping_s, elastic2d=_STRETCH_AND_BEND, selfcollide=0,
        contype=bits.contype, conaffinity=bits.conaffinity, friction=[cloth.friction, 0.005, 0.0001],
        group=collision_bits.VISUAL_GROUP,
    )  # fmt: skip
    flex.vertbody, flex.elem = list(cloth.bodies), cloth.faces.ravel().tolist()
    if appearance:
        flex.material = [add_material(spec, cloth.name, cloth.rgb, roughness=0.9)]
