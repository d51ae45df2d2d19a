"""Error of the simulated head's pose: the paper's equations and those of this package.

python scripts/figures/body_alignment.py docs/pictures/body_alignment.svg
"""

import sys
from collections.abc import Callable, Mapping
from math import atan2, cos, pi, sin
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.rotation_matrices import from_euler_xyz, from_quaternion, to_euler_xyz
from avrgym.models.human import BODY_DIMENSIONS, SEATED_POSTURE, SEXES, Person
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking.body import compute_hips_frame, solve_torso_angles

POSES = 3000
HEIGHTS_M = (0.44, 0.70)
WAIST_DEG, HEAD_DEG = 25.0, 25.0
"""Each joint lies within ± this: poses that no way of sharing the yaw brings to the end of a joint's range."""


def literally(person: Person, head: Pose) -> FloatArray:
    """Angles (6,) of waist and head x, y, z as the paper's section III has them.

    The joints' conventions are the reference's, without which the person would bend backwards to reach forwards: the
    roll's sign is that of the joint, and the yaw is counted from its value when one sits upright. The head's joints
    take roll and pitch of the headset as they are.
    """
    x, y, z = head.pos_w - _waist_w(person)
    roll = atan2(y, z)
    pitch = atan2(x * cos(roll), z)
    yaw = atan2(cos(roll), sin(roll) * sin(pitch)) - 0.5 * pi
    head_roll, head_pitch, head_yaw = to_euler_xyz(from_quaternion(head.q_w))
    turn = head_yaw - yaw
    return np.array([-roll, pitch, 0.3 * turn, head_roll, head_pitch, 0.7 * turn])


def subtracted(person: Person, head: Pose) -> FloatArray:
    """The same, less what the waist has turned, angle by angle, as the reference's code has it."""
    angles = literally(person, head)
    angles[3:5] -= angles[:2]
    return angles


WAYS: Mapping[str, Callable[[Person, Pose], FloatArray]] = {
    "the paper's equations": literally,
    "with the reference's subtraction": subtracted,
    "ours": solve_torso_angles,
}


def head_of(person: Person, angles_rad: FloatArray) -> Pose:
    """Where the head's centre is with these angles (6,) of waist and head."""
    height_offset_m = BODY_DIMENSIONS[person.sex].head_centre_offset_z_m * _scale(person)
    torso = from_euler_xyz(*angles_rad[:3])
    head = torso @ from_euler_xyz(*angles_rad[3:])
    neck_m = (
        person.torso_height_m
        - BODY_DIMENSIONS[person.sex].waist_offset_z_m * _scale(person)
        - height_offset_m
    )
    return Pose(
        _waist_w(person) + neck_m * torso[:, 2] + height_offset_m * head[:, 2], transforms.from_matrix(head)
    )


def _scale(person: Person) -> float:
    return person.torso_height_m / BODY_DIMENSIONS[person.sex].torso_height_m


def _waist_w(person: Person) -> FloatArray:
    hips_w, _ = compute_hips_frame(person, SEATED_POSTURE)
    return np.add(hips_w, [0.0, 0.0, BODY_DIMENSIONS[person.sex].waist_offset_z_m * _scale(person)])


def people_in_poses(rng: np.random.Generator, count: int = POSES) -> list[tuple[Person, Pose]]:
    """People who sit, bend and look about, and where their heads then are."""
    spread = np.radians([WAIST_DEG] * 3 + [HEAD_DEG] * 3)
    people = [Person(SEXES[i % len(SEXES)], float(rng.uniform(*HEIGHTS_M))) for i in range(count)]
    return [(person, head_of(person, rng.uniform(-spread, spread))) for person in people]


def errors(
    way: Callable[[Person, Pose], FloatArray], heads: list[tuple[Person, Pose]]
) -> tuple[FloatArray, FloatArray]:
    """How far the head's centre comes from where it shall be, metres, and how far it is turned, radians; (n,) each."""
    reached = [head_of(person, way(person, head)) for person, head in heads]
    away = [np.linalg.norm(got.pos_w - head.pos_w) for got, (_, head) in zip(reached, heads, strict=True)]
    turned = [
        transforms.angle_between(got.q_w, head.q_w) for got, (_, head) in zip(reached, heads, strict=True)
    ]
    return np.array(away), np.array(turned)


STYLES = (("#b3541e", "--"), ("#7a7a2e", "-."), ("#1f5f8b", "-"))


def draw(path: Path) -> None:
    """Write the figure, and print the medians and 95th percentiles."""
    matplotlib.rcParams.update({"svg.hashsalt": "body alignment", "svg.fonttype": "none", "font.size": 9})
    heads = people_in_poses(np.random.default_rng(0))
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
    for (name, way), style in zip(WAYS.items(), STYLES, strict=True):
        away, turned = errors(way, heads)
        for panel, values in zip(panels, (1000.0 * away, np.degrees(turned)), strict=True):
            _draw_shares(panel, values, name, style)
        figures = [np.percentile(values, (50, 95)) for values in (1000.0 * away, np.degrees(turned))]
        print(f"{name}: median and 95 %: {figures[0].round(1)} mm, {figures[1].round(1)} degrees")
    panels[0].set_xlabel("from the head's centre, mm")
    panels[1].set_xlabel("from the head's orientation, degrees")
    panels[0].set_ylabel("share of poses, %")
    panels[1].legend(loc="lower right", frameon=False)
    figure.savefig(path, metadata={"Date": None})


def _draw_shares(panel: Axes, values: FloatArray, name: str, style: tuple[str, str]) -> None:
    colour, line = style
    shares = np.linspace(0.0, 100.0, 201)
    panel.plot(np.percentile(values, shares), shares, color=colour, linestyle=line, label=name)
    panel.grid(alpha=0.3)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
