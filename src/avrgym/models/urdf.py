"""Robots from URDF, and meshes of any format, for MuJoCo models."""

# trimesh's functions: their types are known only in part.
# pyright: reportUnknownMemberType=false

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np
import trimesh

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import add_material, add_visual_geom

CONTINUOUS_JOINT_RANGE_RAD = (-2.0 * np.pi, 2.0 * np.pi)
"""Range of continuous joints in the MuJoCo model: one turn in each direction."""
HINGE_ARMATURE_KG_M2, SLIDE_ARMATURE_KG = 0.05, 1.0
"""Motor inertia of hinges, and motor mass of slides; URDF does not contain them. The value for hinges is the armature
of the Jaco's wrist.
"""
DEFAULT_MESH_RGB = (0.75, 0.75, 0.77)
WORLD_LINK = "world"
SUPPORTED_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")


@dataclass(frozen=True)
class Urdf:
    """A URDF description.

    ``text`` is URDF (expanded xacro). ``find_mesh`` returns the file of a mesh name such as
    ``package://arm/meshes/base.dae``. Any format that trimesh reads is allowed (``.dae`` needs pycollada).
    """

    text: str
    find_mesh: Callable[[str], Path]

    def read_joint_limits(self, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Returns the speed limits (rad/s) and torque limits (N·m) of joints, (J,) each.

        Raises:
            ValueError: for a joint without limits.
        """
        found = {e.attrib["name"]: e.find("limit") for e in _read(self.text).iter("joint")}
        return tuple(
            np.array([_limit(name, found.get(name), key) for name in joints])
            for key in ("velocity", "effort")
        )  # type: ignore[return-value]

    def build_spec(self, *, appearance: bool) -> mujoco.MjSpec:
        """Returns the MuJoCo model. Its root body has the name of the root link.

        Gravity is compensated. A capsule replaces each collision shape. Continuous joints have a range of ±2π.
        ``appearance``: whether to add visual shapes.

        Raises:
            ValueError: for xacro, invalid URDF, and joint types that are not supported.
        """
        robot = _read(self.text)
        shapes = {link.attrib["name"]: _shapes(link) for link in robot.findall("link")}
        _make_importable(robot)
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
        for joint in spec.joints:
            joint.armature = (
                SLIDE_ARMATURE_KG if joint.type == mujoco.mjtJoint.mjJNT_SLIDE else HINGE_ARMATURE_KG_M2
            )
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            if not np.ptp(joint.range):
                joint.range, joint.limited = CONTINUOUS_JOINT_RANGE_RAD, mujoco.mjtLimited.mjLIMITED_TRUE
        for link, (seen, touched) in shapes.items():
            for number, shape in enumerate(touched):
                _add_capsule(spec.body(link), self._vertices(shape), shape, f"{link}_{number}")
            for number, shape in enumerate(seen if appearance else ()):
                self._add_visual(spec, link, shape, f"{link}_{number}")
        return spec

    def _vertices(self, shape: "_Shape") -> FloatArray:
        """Returns the points (V, 3) of a shape in the shape's frame."""
        if shape.mesh is None:
            return np.asarray(shape.primitive().vertices)
        return np.concatenate([part.vertices for part in read_mesh(self.find_mesh(shape.mesh))]) * shape.scale

    def _add_visual(self, spec: mujoco.MjSpec, link: str, shape: "_Shape", name: str) -> None:
        parts = (shape.primitive(),) if shape.mesh is None else read_mesh(self.find_mesh(shape.mesh))
        for number, part in enumerate(parts):
            add_trimesh(
                spec, spec.body(link), f"{name}_{number}", part,
                rgb=shape.rgb or compute_mesh_colour(part), scale=shape.scale, pos=shape.pos, quat=shape.q,
            )  # fmt: skip


@dataclass(frozen=True)
class _Shape:
    """Visual or collision shape of a link: the name of a mesh, or a primitive with the sizes in the URDF."""

    pos: FloatArray
    q: FloatArray
    rgb: tuple[float, float, float] | None
    mesh: str | None = None
    scale: FloatArray | float = 1.0
    kind: str = ""
    size: Mapping[str, str] | None = None

    def primitive(self) -> trimesh.Trimesh:
        size = self.size or {}
        if self.kind == "box":
            return trimesh.creation.box(extents=_numbers(size["size"]))
        if self.kind == "cylinder":
            return trimesh.creation.cylinder(float(size["radius"]), float(size["length"]), sections=28)
        return trimesh.creation.icosphere(subdivisions=2, radius=float(size["radius"]))


@cache
def read_mesh(file: Path) -> tuple[trimesh.Trimesh, ...]:
    """Read a mesh file. Returns its parts, each with one colour, in the frame of the file.

    Raises:
        ValueError: if the file cannot be read.
    """
    try:
        parts = trimesh.load_scene(file).dump()
    except Exception as error:  # trimesh and its dependencies may raise any exception
        hint = "; `pip install pycollada` for .dae" if file.suffix.lower() == ".dae" else ""
        raise ValueError(f"{file} cannot be read as a mesh: {error}{hint}") from error
    return tuple(part for part in parts if isinstance(part, trimesh.Trimesh))


def compute_mesh_colour(mesh: trimesh.Trimesh) -> tuple[float, float, float]:
    """Returns the colour of a mesh (red, green, blue), 0 to 1; grey if its file contains no colour."""
    colour = getattr(getattr(mesh.visual, "material", None), "main_color", None)
    return DEFAULT_MESH_RGB if colour is None else tuple(float(c) / 255.0 for c in colour[:3])  # type: ignore[return-value]


def add_trimesh(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    mesh: trimesh.Trimesh,
    *,
    rgb: Sequence[float],
    scale: FloatArray | float = 1.0,
    **attributes: Any,
) -> None:
    """Add a visual mesh; ``attributes`` are those of the mesh's geom."""
    material = add_material(spec, "rgb " + " ".join(f"{c:.3f}" for c in rgb), rgb, roughness=0.5)
    spec.add_mesh(
        name=name,
        uservert=(np.asarray(mesh.vertices) * scale).ravel(),
        userface=np.asarray(mesh.faces).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    add_visual_geom(body, mujoco.mjtGeom.mjGEOM_MESH, material, meshname=name, **attributes)


def compute_bounding_capsule(points: FloatArray) -> tuple[FloatArray, float]:
    """Returns the axis ends (2, 3) and the radius of a bounding capsule of points (V, 3), along their longest extent.

    The axis is in the middle of the bounding box along the principal axes.
    """
    points = points[np.unique(np.round(points, 4), axis=0, return_index=True)[1]]
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    along = points @ axes.T
    middle = 0.5 * (along.min(axis=0) + along.max(axis=0))
    across = np.sqrt(((along - middle)[:, 1:] ** 2).sum(axis=1))
    radius = float(across.max())
    half = max(0.5 * float(np.ptp(along[:, 0])) - radius, 1e-3)
    end = np.array([half, 0.0, 0.0])
    return np.stack([middle - end, middle + end]) @ axes, radius


def _add_capsule(body: mujoco.MjsBody, points: FloatArray, shape: _Shape, name: str) -> None:
    ends, radius = compute_bounding_capsule(points)
    ends = shape.pos + transforms.rotate(shape.q, ends)
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=ends.ravel(),
        size=[radius, 0, 0],
        mass=0.0,
        group=collision_bits.COLLISION_GROUP,
    )


def _read(text: str) -> Element:
    """Parse a URDF description. Returns its root element.

    Raises:
        ValueError: for invalid URDF, or for xacro; the message then contains the command that expands it.
    """
    if re.search(r"xmlns:xacro|<xacro:|\$\(find ", text):
        raise ValueError(
            "the file is xacro; allowed: URDF. Expand it: `pip install xacrodoc`, then "
            "`xacrodoc FILE.xacro -d FOLDER_OF_PACKAGES -o FILE.urdf` (in ROS: `xacro FILE.xacro > FILE.urdf`)"
        )
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(
            f"the URDF is not XML: {error}; allowed: the text of a URDF file, not its path"
        ) from error
    if robot.tag != "robot":
        raise ValueError(f"the root element of the URDF is <{robot.tag}>; allowed: <robot>")
    for joint in robot.findall("joint"):
        if joint.get("type") not in SUPPORTED_JOINT_TYPES:
            raise ValueError(
                f"joint {joint.get('name')!r} has the type {joint.get('type')!r}; "
                f"allowed: {', '.join(SUPPORTED_JOINT_TYPES)}"
            )
    return robot


def _make_importable(robot: Element) -> None:
    """Remove shapes, which are added separately, and keep the root as a body."""
    children = {joint.find("child").attrib["link"] for joint in robot.findall("joint")}  # type: ignore[union-attr]
    for link in robot.findall("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                link.remove(shape)
        if link.attrib["name"] not in children and link.attrib["name"] != WORLD_LINK:
            anchor = ElementTree.SubElement(robot, "joint", name="anchor", type="fixed")
            ElementTree.SubElement(anchor, "parent", link=WORLD_LINK)
            ElementTree.SubElement(anchor, "child", link=link.attrib["name"])
            ElementTree.SubElement(robot, "link", name=WORLD_LINK)
    extension = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(extension, "compiler", fusestatic="false", discardvisual="false")


def _shapes(link: Element) -> tuple[list[_Shape], list[_Shape]]:
    """Returns the visual and the collision shapes of a link."""
    seen, touched = ([_shape(found) for found in link.findall(kind)] for kind in ("visual", "collision"))
    return seen, touched


def _shape(found: Element) -> _Shape:
    origin, geometry = found.find("origin"), found.find("geometry")
    attributes = {} if origin is None else origin.attrib
    pos, rpy = (_numbers(attributes.get(key, "0 0 0")) for key in ("xyz", "rpy"))
    colour = found.find("material/color")
    rgb = None if colour is None else tuple(_numbers(colour.attrib["rgba"])[:3])
    assert geometry is not None
    (shape,) = geometry
    if shape.tag == "mesh":
        scale = _numbers(shape.attrib.get("scale", "1 1 1"))
        return _Shape(pos, _fixed_angles(rpy), rgb, shape.attrib["filename"], scale)
    return _Shape(pos, _fixed_angles(rpy), rgb, kind=shape.tag, size=shape.attrib)


def _fixed_angles(rpy: FloatArray) -> FloatArray:
    """Returns the quaternion (4,) of roll, pitch and yaw about fixed axes."""
    roll, pitch, yaw = (
        transforms.from_axis_angle(axis, angle) for axis, angle in zip(np.eye(3), rpy, strict=True)
    )
    return transforms.multiply(yaw, transforms.multiply(pitch, roll))


def _numbers(text: str) -> FloatArray:
    return np.array([float(number) for number in text.split()])


def _limit(joint: str, limit: Element | None, key: str) -> float:
    if limit is None or key not in limit.attrib:
        raise ValueError(
            f"joint {joint!r} of the URDF has no {key} limit; add {key}=… to its <limit> element"
        )
    return float(limit.attrib[key])
