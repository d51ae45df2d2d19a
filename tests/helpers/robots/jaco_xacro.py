"""Kinova's public description of the Jaco, read from the xacro files that ``rtb-data`` ships."""

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any
from xml.etree import ElementTree

import numpy as np

from avrgym.geometry import transforms
from avrgym.robots.jaco.robot import MESH_FOLDER

FOLDER = MESH_FOLDER.parent / "urdf"
PREFIX = "{http://www.ros.org/wiki/xacro}"
CONSTANTS = {"J_PI": math.pi}
OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
}


def evaluate(formula: str, names: Mapping[str, float]) -> float:
    """Evaluate an arithmetic formula with named numbers."""
    return _value(ast.parse(formula, mode="eval").body, names)


def _value(node: ast.expr, names: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id=name):
            return names[name]
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATORS[type(op)](_value(left, names), _value(right, names))
        case ast.UnaryOp(op=op, operand=operand):
            return OPERATORS[type(op)](_value(operand, names))
    raise ValueError(ast.dump(node))


def numbers(text: str) -> np.ndarray:
    """Return numbers that are separated by spaces; each can be ``${formula}``."""
    formulas = re.sub(r"\$\{([^}]*)\}", lambda found: f"({found[1].replace(' ', '')})", text)
    return np.array([evaluate(formula, CONSTANTS) for formula in formulas.split()])


@cache
def _properties() -> dict[str, str]:
    root = ElementTree.parse(FOLDER / "j2s7s300.xacro").getroot()
    return {element.attrib["name"]: element.attrib["value"] for element in root.iter(f"{PREFIX}property")}


def text(name: str) -> str:
    """Return a property of the arm as text."""
    return _properties()[name]


def vector(name: str) -> np.ndarray:
    """Return a property of the arm as a vector."""
    return numbers(text(name))


def number(name: str) -> float:
    """Return a property of the arm as a number."""
    return float(vector(name)[0])


def origin(joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Return a joint's frame in its parent: position (3,), quaternion (4,)."""
    return vector(f"{joint}_origin_xyz"), from_fixed_angles(vector(f"{joint}_origin_rpy"))


def from_fixed_angles(angles_rad: np.ndarray) -> np.ndarray:
    """Return the quaternion (4,) of rotations about the fixed axes x, y and z, in this order."""
    roll, pitch, yaw = (
        transforms.from_axis_angle(axis, angle) for axis, angle in zip(np.eye(3), angles_rad, strict=True)
    )
    return transforms.multiply(yaw, transforms.multiply(pitch, roll))


def forward(angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the end effector's poses in the base frame for joint angles (N, 7)."""
    pos, q = np.zeros(3), transforms.IDENTITY_QUATERNION
    for joint in range(1, 8):
        pos, q = transforms.compose(pos, q, *origin(f"joint_{joint}"))
        axis = vector(f"joint_{joint}_axis_xyz")
        q = transforms.multiply(q, transforms.from_axis_angle(axis, angles_rad[:, joint - 1]))
    return transforms.compose(pos, q, *origin("joint_end_effector"))


def masses() -> dict[int, float]:
    """Return the masses of links, kg, by the number of their mesh."""
    text = (FOLDER / "kinova_inertial.xacro").read_text()
    found = re.findall(
        r'<xacro:unless value="\$\{mesh_no\s*-?\s*(\d*)\}">.*?<mass value="([\d.]+)"', text, re.DOTALL
    )
    return {int(mesh or 0): float(mass) for mesh, mass in found}


def arm_mass() -> float:
    """Return the total mass of base, seven links and three fingers of two links each, kg."""
    by_mesh = masses()
    links = ["base", *range(1, 8)]
    return sum(by_mesh[int(number(f"link_{link}_mesh_no"))] for link in links) + 3 * (
        by_mesh[57] + by_mesh[58]
    )
