"""Feedback expert for lifting."""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.simulation.worlds import RightArm, State
from avrgym.tasks.experts.feedback import FeedbackExpert, ToolTarget, funnel_standoff_m
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import Controller, RunningEpisodes
from avrgym_example.arm_manipulation.reward import ArmState, taken_w, to_armrest, under_w

Heading = tuple[float, float, float]

HEADING_W: dict[bool, Heading] = {False: (1.0, 0.0, 0.0), True: (1.0, -0.4, 0.0)}
"""Direction of the handle in the world frame, for a mounted robot and for a robot on the floor."""
TOUCHING_M, BEFORE_M, FREE_M = 0.045, 0.08, 0.03
"""Depth of the hook below the forearm's axis in contact, and during a lateral approach."""
PUSH_M, OVER_M, PUSH_M_S = 0.05, 0.02, 0.12
"""How far ahead of the forearm the hook aims, how far above its goal, and how fast it goes."""
UPWARDS = 2.0
"""Lift relative to the bending of the elbow."""
HIGH_M = 0.04
"""So little below its goal the forearm is also pushed to the person's left."""


def cradling_q_w(arm: RightArm, heading_w: Heading) -> FloatArray:
    """Rotation (N, 4) of the hook: stops past the forearm, handle along a direction."""
    z_w = -under_w(arm)
    x_w = transforms.normalize(heading_w - z_w * (z_w * heading_w).sum(axis=-1)[:, None])
    return transforms.from_matrix(np.stack([x_w, transforms.cross(z_w, x_w), z_w], axis=-1))


def lifting(episodes: RunningEpisodes) -> Controller:
    """The expert: it depends on the present state only."""
    return FeedbackExpert(episodes, partial(lift, heading_w=HEADING_W[episodes.scene.mount.on_floor]))


def lift(state: State, task_state: ArmState, planner: MotionPlanner, heading_w: Heading) -> ToolTarget:
    """Come below the forearm, then push its lower side up and, once it is high, to the person's left."""
    down_w, way = under_w(state), to_armrest(state)
    before = funnel_standoff_m(state.tool_pos_w - taken_w(state), down_w, FREE_M, BEFORE_M)
    push = np.where(before > 0.0, 0.0, np.clip(way[:, 1] + OVER_M, 0.0, PUSH_M))
    up_w = transforms.normalize([0.0, 0.0, UPWARDS] - down_w)
    goal_w = taken_w(state) + (TOUCHING_M + before)[:, None] * down_w + push[:, None] * up_w
    goal_w[:, 0] += np.where(way[:, 1] < HIGH_M, np.clip(way[:, 0], -PUSH_M, PUSH_M), 0.0)
    return goal_w, cradling_q_w(state, heading_w), np.full(len(goal_w), PUSH_M_S)
