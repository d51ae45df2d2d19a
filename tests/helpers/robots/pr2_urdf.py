"""A robot's public description in xacro, expanded into the links and joints of its URDF.

Supports the features that the PR2's files use: properties, arithmetic, includes, and macros with text and one block.
Conditions on arguments are false, as by default. Elements for Gazebo and motors are ignored.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, parse

import numpy as np

from avrgym.geometry import transforms
from helpers.robots import jaco_xacro
from helpers.robots.jaco_xacro import PREFIX


@dataclass(frozen=True, eq=False)
class Link:
    """Mass in kg, centre of mass (3,) in m, inertia (3, 3) about it in kg m²; in the link's frame."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint's frame in its parent link: ``pos`` (3,), ``q`` (4,); ``limits`` as written, by attribute."""

    kind: str
    parent: str
    child: str
    pos: np.ndarray
    q: np.ndarray
    axis: np.ndarray
    limits: Mapping[str, float]

    def child_pose(self, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the child's poses in the parent, (N, 3) and (N, 4), for joint positions (N,)."""
        if self.kind == "prismatic":
            return self.pos + transforms.rotate(self.q, self.axis * value[..., None]), self.q
        turn = transforms.from_axis_angle(self.axis, value)
        return self.pos, transforms.multiply(self.q, turn)


@dataclass(frozen=True, eq=False)
class Description:
    """Links and joints by name."""

    links: Mapping[str, Link]
    joints: Mapping[str, Joint]

    def joint_above(self, link: str) -> str:
        """Return the name of a link's parent joint."""
        return next(name for name, joint in self.joints.items() if joint.child == link)

    def pose(self, link: str, base: str, values: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return a link's poses in an ancestor link, (N, 3) and (N, 4), for joint positions (N,); the default is 0."""
        pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
        while link != base:
            name = self.joint_above(link)
            joint = self.joints[name]
            pos, q = transforms.compose(*joint.child_pose(np.asarray(values.get(name, 0.0))), pos, q)
            link = joint.parent
        return pos, q

    def rigid_union(self, base: str, links: Iterable[str]) -> Link:
        """Return the combined inertia of links in the frame of ``base``, with all joints at zero."""
        poses = {name: self.pose(name, base, {}) for name in links}
        coms = {name: pos + transforms.rotate(q, self.links[name].com) for name, (pos, q) in poses.items()}
        masses = np.array([self.links[name].mass for name in poses])
        mass, com = float(masses.sum()), masses @ np.stack(list(coms.values())) / masses.sum()
        inertia = np.zeros((3, 3))
        for name, (_, q) in poses.items():
            frame, away = transforms.to_matrix(q), coms[name] - com
            inertia += frame @ self.links[name].inertia @ frame.T
            inertia += self.links[name].mass * (away @ away * np.eye(3) - np.outer(away, away))
        return Link(mass, com, inertia)


def read(file: Path) -> Description:
    """Expand a xacro file. Its includes are in the same package."""
    source = _Source(file.parent.parent)
    elements = list(source.expand(source.collect(file), {}))
    links = {e.attrib["name"]: _link(e) for e in elements if e.tag == "link"}
    joints = {e.attrib["name"]: _joint(e) for e in elements if e.tag == "joint"}
    return Description(links, joints)


class _Source:
    """Macros and properties of all files."""

    def __init__(self, package: Path) -> None:
        self._package = package
        self._macros: dict[str, Element] = {}
        self._properties: dict[str, str] = {}

    def collect(self, file: Path) -> Element:
        """Return a file's root, and collect macros and properties of the file and its includes."""
        root = parse(file).getroot()
        for element in root:
            if element.tag == f"{PREFIX}include":
                self.collect(self._package / element.attrib["filename"].partition(")/")[2])
            elif element.tag == f"{PREFIX}macro":
                self._macros[element.attrib["name"]] = element
            elif element.tag == f"{PREFIX}property":
                self._properties[element.attrib["name"]] = element.attrib["value"]
        return root

    def expand(self, parent: Element, scope: Mapping[str, str | Element]) -> Iterator[Element]:
        """Yield the children of an element with expanded macros and evaluated formulas."""
        for element in parent:
            name = element.tag.removeprefix(PREFIX)
            if element.tag == f"{PREFIX}insert_block":
                yield deepcopy(scope[element.attrib["name"]])  # type: ignore[misc]
            elif element.tag.startswith(PREFIX):
                if name in self._macros and not re.search("gazebo|transmission", name):
                    yield from self.expand(self._macros[name], self._arguments(element, scope))
            else:
                copy = Element(name, {key: self._text(value, scope) for key, value in element.attrib.items()})
                copy.extend(self.expand(element, scope))
                yield copy

    def _arguments(self, call: Element, scope: Mapping[str, str | Element]) -> Mapping[str, str | Element]:
        blocks = {block.tag: block for block in self.expand(call, scope)}
        return {key: self._text(value, scope) for key, value in call.attrib.items()} | blocks

    def _text(self, text: str, scope: Mapping[str, str | Element]) -> str:
        return re.sub(r"\$\{([^}]*)\}", lambda found: self._value(found[1], scope), text)

    def _value(self, formula: str, scope: Mapping[str, str | Element]) -> str:
        if isinstance(text := scope.get(formula), str):
            return text
        names = re.findall(r"[A-Za-z_]\w*", formula)
        known = {name: float(self._text(self._known(name, scope), scope)) for name in names}
        return repr(jaco_xacro.evaluate(formula.strip(), known))

    def _known(self, name: str, scope: Mapping[str, str | Element]) -> str:
        text = scope.get(name, self._properties.get(name))
        assert isinstance(text, str), name
        return text


def _link(element: Element) -> Link:
    if (inertial := element.find("inertial")) is None:
        return Link(0.0, np.zeros(3), np.zeros((3, 3)))
    ixx, ixy, ixz, iyy, iyz, izz = (
        float(_child(inertial, "inertia").attrib[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    mass = float(_child(inertial, "mass").attrib["value"])
    return Link(mass, _vector(_child(inertial, "origin"), "xyz"), inertia)


def _joint(element: Element) -> Joint:
    origin, axis, limit = (element.find(tag) for tag in ("origin", "axis", "limit"))
    return Joint(
        kind=element.attrib["type"],
        parent=_child(element, "parent").attrib["link"],
        child=_child(element, "child").attrib["link"],
        pos=_vector(origin, "xyz"),
        q=jaco_xacro.from_fixed_angles(_vector(origin, "rpy")),
        axis=_vector(axis, "xyz"),
        limits={} if limit is None else {key: float(value) for key, value in limit.attrib.items()},
    )


def _child(element: Element, tag: str) -> Element:
    child = element.find(tag)
    assert child is not None, tag
    return child


def _vector(element: Element | None, key: str) -> np.ndarray:
    text = "0 0 0" if element is None else element.attrib.get(key, "0 0 0")
    return np.array([float(number) for number in text.split()])
