"""Hands that switch tracking devices, with the resulting grip poses, for the client's tests.

``python -m helpers.vr.device_switch_examples`` writes the examples of the client's tests.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.vr.protocol.messages import Modality, XRPose
from avrgym.vr.protocol.webxr import GRIP_FROM_WRIST_AXES, HAND_CENTRE_FROM_WRIST
from avrgym.vr.tracking.hand_device_switches import HandDevice

Side = Literal["left", "right"]
Error = tuple[FloatArray, FloatArray]
"""Tracking error of a device in the axes of its pose: position (3,), quaternion (4,)."""

FILE = Path(__file__).parents[3] / "client/tests/data/switches.json"
COUNT, FRAMES, SEED = 16, 40, 11
FRAME_S = 1.0 / 72.0
SIDES: tuple[Side, ...] = ("left", "right")
NO_ERROR: Error = (np.zeros(3), transforms.IDENTITY_QUATERNION)


def compose(pose: XRPose, pos: FloatArray, q: FloatArray) -> XRPose:
    """Transform a relative pose by another pose."""
    x, y, z, w = pose.orientation
    there, there_q = np.empty(3), np.empty(4)
    mujoco.mju_mulPose(there, there_q, np.array(pose.position), np.array([w, x, y, z]), pos, q)
    (px, py, pz), (w, x, y, z) = there.tolist(), there_q.tolist()
    return XRPose((px, py, pz), (x, y, z, w))


def measured_pose(grip: XRPose, side: Side, modality: Modality, error: Error = NO_ERROR) -> XRPose:
    """Return the pose that a device reports for a grip."""
    if modality != "hand":
        return compose(grip, *error)
    wrist = transforms.invert(HAND_CENTRE_FROM_WRIST, GRIP_FROM_WRIST_AXES[side])
    return compose(compose(grip, *wrist), *error)


def random_error(rng: np.random.Generator, distance_m: float, angle_deg: float) -> Error:
    """Return an error of a given size in a random direction."""
    turn = transforms.from_axis_angle(
        transforms.normalize(rng.normal(size=3)), np.asarray(np.radians(angle_deg))
    )
    return distance_m * transforms.normalize(rng.normal(size=3)), turn


def random_grip(rng: np.random.Generator) -> XRPose:
    """Return a random grip within a person's reach."""
    x, y, z = rng.uniform((-0.5, 0.5, -0.6), (0.5, 1.3, 0.0)).tolist()
    qx, qy, qz, qw = transforms.normalize(rng.normal(size=4)).tolist()
    return XRPose((x, y, z), (qx, qy, qz, qw))


def examples() -> Iterator[dict[str, Any]]:
    """Return hands at rest, with tremor and in motion. Devices switch at random times, also after gaps."""
    rng = np.random.default_rng(SEED)
    return (_example(rng, SIDES[number % 2], 0.03 * (number % 4)) for number in range(COUNT))


def _example(rng: np.random.Generator, side: Side, step_m: float) -> dict[str, Any]:
    hand, grip, time_s = HandDevice(side), random_grip(rng), 0.0
    errors = {
        "hand": random_error(rng, rng.uniform(0.0, 0.2), rng.uniform(0.0, 90.0)),
        "controller": NO_ERROR,
    }
    modality: Modality = "controller"
    frames: list[dict[str, Any]] = []
    for _ in range(FRAMES):
        switches = rng.uniform() < 0.08
        time_s += FRAME_S + (rng.uniform(0.0, 3.0) if switches else 0.0)
        if switches:
            modality = "hand" if modality == "controller" else "controller"
        grip = compose(grip, rng.normal(scale=step_m + 1e-4, size=3), transforms.IDENTITY_QUATERNION)
        pose = measured_pose(grip, side, modality, errors[modality])
        followed = hand.correct_grip(pose, modality, time_s)
        frames.append({"ms": 1000.0 * time_s, "pose": pose, "modality": modality, "grip": followed})
    return {"side": side, "frames": msgspec.to_builtins(frames)}


def write(path: Path) -> None:
    """Write examples as JSON, one per line."""
    lines = [json.dumps(each) for each in examples()]
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", "utf-8")


if __name__ == "__main__":
    write(FILE)
