"""Initial states of many worlds, and their overlaps."""

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import collision_bits
from avrgym.models.human import make_seated_joint_angles
from avrgym.models.robot import ROBOT_NAME_PREFIX
from avrgym.tasks.episodes import Episodes

HAND_AT_ROBOT_RAD = make_seated_joint_angles(right_shoulder_y=23.0, right_shoulder_x=-35.0, right_elbow_x=0.0)
"""Seated, with the right arm stretched down and forward to the mount of the Jaco on the wheelchair."""


def reset_episodes(
    environment: str,
    worlds: int,
    people: str = "revised",
    impairment: str = "none",
    *,
    num_threads: int = 1,
    by_region: bool = False,
    force_guard: bool = False,
    checked: bool = True,
) -> Episodes:
    """Return episodes that are reset with the seeds 0, 1, …; arguments as in ``Episodes``.

    Without ``checked`` initial states can overlap.
    """
    episodes = Episodes(
        environment,
        worlds,
        people=people,
        impairment=impairment,
        num_threads=num_threads,
        by_region=by_region,
        force_guard=force_guard,
    )
    if not checked:
        episodes._conflicts = lambda ids: {}
    episodes.reset(np.arange(worlds), [np.random.default_rng(seed) for seed in range(worlds)])
    return episodes


def first_step_forces(episodes: Episodes) -> FloatArray:
    """Return the contact forces (N,) on the people after one step with a zero action."""
    return episodes.step(np.zeros((episodes.simulation.num_worlds, episodes.action_size))).force_on_person_n


def deepest_overlap_m(episodes: Episodes) -> float:
    """Return the maximum overlap of robot or tool with a person or furniture, m; 0 without an overlap.

    Measures every pair of shapes, without a broad phase.
    """
    simulation = episodes.simulation
    geoms = simulation.get_geoms(np.arange(simulation.num_worlds))
    model = simulation.batch.get_model(0)
    data = mujoco.MjData(model)
    fastened = None if episodes.scene.mount.is_on_floor else ROBOT_NAME_PREFIX + episodes.scene.robot.base
    robot = [
        geom
        for bits in (collision_bits.ROBOT, collision_bits.TOOL, collision_bits.HULL)
        for geom in _of(model, bits)
    ]
    others = [*_of(model, collision_bits.PERSON), *_of(model, collision_bits.FURNITURE)]
    deepest = 0.0
    for world in range(simulation.num_worlds):
        model.geom_size[:] = geoms.size_m[world]
        data.geom_xpos[:], data.geom_xmat[:] = geoms.pos_w[world], geoms.rotation_matrix_w[world]
        for first in robot:
            for second in others:
                mounted = model.body(model.geom_bodyid[first]).name == fastened
                if mounted and model.geom_contype[second] == collision_bits.FURNITURE.contype:
                    continue
                deepest = max(deepest, -mujoco.mj_geomDistance(model, data, first, second, 0.001, None))
    return deepest


def _of(model: mujoco.MjModel, bits: collision_bits.CollisionBits) -> list[int]:
    kind = (model.geom_contype == bits.contype) & (model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)
    return np.nonzero(kind)[0].tolist()
