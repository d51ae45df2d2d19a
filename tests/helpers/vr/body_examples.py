"""Poses of head and hands with the joint angles of the body solver, for tests of the client's solver.

``python -m helpers.vr.body_examples`` writes the examples of the client's tests.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import (
    LOWER_LIMITS_RAD,
    RECLINED_POSTURE,
    SEATED_POSE_RAD,
    SEATED_POSTURE,
    UPPER_LIMITS_RAD,
    Person,
)
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking import arm
from avrgym.vr.tracking.body import BodyPose, BodySolver, make_skeleton

FILE = Path(__file__).parents[3] / "client/tests/data/bodies.json"
COUNT, SEED = 60, 7
BODIES = (
    (Person("woman", 0.54), SEATED_POSTURE),
    (Person("man", 0.63, arm_scale=1.15), SEATED_POSTURE),
    (Person("woman", 0.48, arm_scale=0.88), RECLINED_POSTURE),
)
SITES = (("head_centre", "head"), ("left_hand_centre", "left_hand"), ("right_hand_centre", "right_hand"))


@dataclass(frozen=True)
class _Body:
    """A person's model and body solver."""

    solver: BodySolver
    model: mujoco.MjModel
    data: mujoco.MjData
    skeleton: dict[str, Any]


def examples(rng: np.random.Generator, count: int) -> Iterator[dict[str, Any]]:
    """Yield examples of three bodies: poses over the joint ranges, near the start, and unreachable ones."""
    bodies = [_body(*each) for each in BODIES]
    for number in range(count):
        start = SEATED_POSE_RAD + rng.uniform(0.0, 1.0) * (
            rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD) - SEATED_POSE_RAD
        )
        body, turn_rad = bodies[number % len(bodies)], arm.MAX_TICK_ROTATION_RAD * (1 + 5 * (number // 3 % 2))
        yield _solved(body, _pose(rng, body, start, number // 6 % 4), start, turn_rad)


def _body(person: Person, posture: human.Posture) -> _Body:
    model = human.compile_person_model(person, posture, moving=True)
    measures = msgspec.to_builtins(make_skeleton(person, posture))
    return _Body(BodySolver(person, posture), model, mujoco.MjData(model), measures)


def _pose(rng: np.random.Generator, body: _Body, start_rad: np.ndarray, kind: int) -> BodyPose:
    if kind == 0:
        head, left, right = (
            Pose(rng.uniform(-2.0, 2.0, 3), transforms.normalize(rng.normal(size=4))) for _ in SITES
        )
        return BodyPose(head, left if rng.uniform() < 0.8 else None, right)
    away = (
        0.2 * rng.normal(size=len(start_rad))
        if kind > 1
        else rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD) - start_rad
    )
    body.data.qpos[:] = np.clip(start_rad + away, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD)
    mujoco.mj_kinematics(body.model, body.data)
    return BodyPose(*(_site(body.data, *site) for site in SITES))


def _site(data: mujoco.MjData, site: str, body: str) -> Pose:
    pos_w = data.site(human.PERSON_NAME_PREFIX + site).xpos.copy()
    return Pose(pos_w, transforms.normalize(data.body(human.PERSON_NAME_PREFIX + body).xquat))


def _solved(body: _Body, pose: BodyPose, start_rad: np.ndarray, turn_rad: float) -> dict[str, Any]:
    def plain(pose: Pose | None) -> dict[str, Any] | None:
        return None if pose is None else {"position": pose.pos_w.tolist(), "q": pose.q_w.tolist()}

    return {
        "skeleton": body.skeleton,
        "pose": {"head": plain(pose.head_pose), "left": plain(pose.left), "right": plain(pose.right)},
        "start": start_rad.tolist(),
        "turn": turn_rad,
        "angles": body.solver.solve(pose, start_rad, turn_rad).tolist(),
    }


def write(path: Path, seed: int, count: int) -> None:
    """Write examples as JSON, one per line."""
    lines = [json.dumps(each) for each in examples(np.random.default_rng(seed), count)]
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", "utf-8")


if __name__ == "__main__":
    write(FILE, SEED, COUNT)
