"""States and actions for several test files."""

from dataclasses import replace
from typing import Any

import numpy as np

from avrgym.geometry import transforms
from avrgym.models.scene import MAX_TOOL_CONTACTS
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes


def resting_state(**changes: Any) -> State:
    """Return one world at rest without contacts. Other values default to zero."""
    point, unturned = np.zeros((1, 3)), transforms.IDENTITY_QUATERNION[None]
    plain = State(
        robot_torso_pos_w=point,
        joint_positions=np.zeros((1, 7)),
        base_displacement=np.zeros((1, 0)),
        end_effector_velocity_w=point,
        tool_velocity_w=point,
        tool_pos_w=point,
        tool_quat_w=unturned,
        tool_pad_pos_w=point,
        tool_pad_quat_w=unturned,
        head_pos_w=point,
        head_quat_w=unturned,
        mouth_pos_w=point,
        right_arm_pos_w=np.zeros((1, 3, 3)),
        right_arm_quat_w=np.tile(unturned, (1, 3, 1)),
        left_arm_pos_w=np.zeros((1, 3, 3)),
        left_arm_quat_w=np.tile(unturned, (1, 3, 1)),
        furniture_pos_w={},
        particle_pos_w=np.zeros((1, 0, 3)),
        particle_velocity_w=np.zeros((1, 0, 3)),
        cloth_pos_w=np.zeros((1, 0, 3)),
        person_capsule_ends_w=np.zeros((1, 1, 2, 3)),
        person_radius_m=np.zeros((1, 1)),
        robot_force_n=np.zeros(1),
        tool_force_n=np.zeros(1),
        total_force_n=np.zeros(1),
        links_force_n=np.zeros(1),
        cloth_force_n=np.zeros(1),
        tool_contact_pos_w=np.zeros((1, MAX_TOOL_CONTACTS, 3)),
        tool_contact_normal_w=np.zeros((1, MAX_TOOL_CONTACTS, 3)),
        tool_contact_force_n=np.zeros((1, MAX_TOOL_CONTACTS)),
    )
    return replace(plain, **changes)


def jerky_actions(rng: np.random.Generator, worlds: int, steps: int, joints: int = 7) -> np.ndarray:
    """Return actions at full speed that change direction at random every 0.5 s."""
    signs = np.sign(rng.uniform(-1, 1, (steps // 5 + 1, worlds, joints)))
    return np.repeat(signs, 5, axis=0)[:steps]


def assert_finite(episodes: Episodes, rng: np.random.Generator, steps: int) -> None:
    """Assert finite observations and rewards, and no physics warnings, under jerky actions."""
    worlds = episodes.simulation.num_worlds
    for action in jerky_actions(rng, worlds, steps, episodes.action_size):
        step = episodes.step(action)
        assert np.isfinite(step.observation).all()
        assert np.isfinite(step.reward).all()
    for world in range(worlds):
        warnings = [int(warning.number) for warning in episodes.simulation.batch.get_data(world).warning]
        assert not any(warnings), (world, warnings)
