"""Functions that add collision geoms, visual geoms and materials to a model."""

from collections.abc import Sequence
from typing import Any

import mujoco

from avrgym.models.collision_bits import COLLISION_GROUP, VISUAL_GROUP, CollisionBits
from avrgym.models.shapes import Mesh

BOX = mujoco.mjtGeom.mjGEOM_BOX
CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE


def add_collision_geom(
    body: mujoco.MjsBody, name: str, kind: mujoco.mjtGeom, bits: CollisionBits, **attributes: Any
) -> None:
    """Add an invisible collision geom; attributes as for ``MjsBody.add_geom``."""
    body.add_geom(
        name=name,
        type=kind,
        group=COLLISION_GROUP,
        contype=bits.contype,
        conaffinity=bits.conaffinity,
        **attributes,
    )


def add_visual_geom(body: mujoco.MjsBody, kind: mujoco.mjtGeom, material: str, **attributes: Any) -> None:
    """Add a visible geom without mass and collision; attributes as for ``MjsBody.add_geom``."""
    body.add_geom(
        type=kind, material=material, group=VISUAL_GROUP, contype=0, conaffinity=0, mass=0.0, **attributes
    )


def add_visual_mesh(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, material: str, mesh: Mesh, **attributes: Any
) -> None:
    """Add a visible mesh from ``shapes``; ``name`` is the name of the mesh asset."""
    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    add_visual_geom(body, mujoco.mjtGeom.mjGEOM_MESH, material, meshname=name, **attributes)


def add_material(
    spec: mujoco.MjSpec, name: str, rgb: Sequence[float], *, metallic: float = 0.0, roughness: float = 0.7
) -> str:
    """Adds a material of one colour, unless it exists. Returns its name."""
    if spec.material(name) is None:
        spec.add_material(name=name, rgba=[*rgb, 1.0], metallic=metallic, roughness=roughness)
    return name
