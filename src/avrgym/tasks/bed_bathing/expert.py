"""Planning expert for bed bathing: wipes along upper arm and forearm with light pressure, at several angles."""

from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing.reward import LIMB_GEOM_INDICES, are_enough_markers_wiped
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import RunningEpisodes

UPPER_ARM, FOREARM = 0, 1
SWEEPS = (
    (UPPER_ARM, np.radians(12.0), 0.0, 1.0),
    (FOREARM, np.radians(12.0), 0.0, 1.0),
    (FOREARM, np.radians(80.0), 1.0, 0.0),
    (UPPER_ARM, np.radians(74.0), 1.0, 0.0),
    (UPPER_ARM, np.radians(43.0), 0.0, 1.0),
    (FOREARM, np.radians(46.0), 0.0, 1.0),
    (FOREARM, np.radians(125.0), 1.0, 0.0),
    (UPPER_ARM, np.radians(125.0), 1.0, 0.0),
)
"""The sweeps of the cloth. Each has four values: limb, angle around the limb, first and last position along the limb.

The angle is 0 at the limb's top and positive outwards. The position is 0 at the end near the shoulder, and 1 at the
other end.
"""
MIN_SWEEPS = 4
"""Minimum number of sweeps. Further sweeps follow until enough markers are wiped."""
APPROACH_PHASE, TOUCH_PHASE, WIPE_PHASE, LIFT_PHASE, REST_PHASE = range(5)

LIMB_END_MARGIN_M = 0.065
"""Minimum distance of the cloth's middle from the limb's ends. The cloth then does not touch the next limb."""
CARRY_SPEED_M_S, WIPE_SPEED_M_S, TURN_SPEED_RAD_S = 0.30, 0.12, 1.2
LIFT_HEIGHT_M, TOUCH_DEPTH_M = 0.03, 0.004
TARGET_FORCE_N, MAX_FORCE_N, CONTACT_FORCE_N = 5.0, 15.0, 1.0
DEPTH_GAIN_M_PER_N = 0.0003
DEPTH_RANGE_M = (-0.015, 0.03)
ARRIVAL_TOLERANCE_M, ARRIVAL_TOLERANCE_RAD = 0.012, 0.15
CHARACTERISTIC_LENGTH_M = 0.1
"""Length that converts a rotation error of the cloth (rad) to a distance (m)."""
MIN_PROGRESS_M, MAX_STEPS_WITHOUT_PROGRESS = 0.003, 6


class BedBathingExpert:
    """Makes several sweeps: approach, touch, wipe, lift. If the arm is stuck, the rest of the sweep is skipped.

    A target of the cloth below the skin produces the contact force. While the force is low, the target moves deeper.
    """

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Start the first sweep in all worlds."""
        self._episodes = episodes
        self._planner = MotionPlanner(episodes)
        count = episodes.simulation.num_worlds
        self._limb, self._angle, self._first, self._last = (np.array(c) for c in zip(*SWEEPS, strict=True))
        self._sweep, self._phase, self._waited = np.zeros((3, count), dtype=np.intp)
        self._depth_m, self._left_m = np.zeros(count), np.full(count, np.inf)

    def __call__(self, observation: FloatArray) -> FloatArray:
        state, sweep, phase = self._episodes.get_state(), self._sweep, self._phase
        self._press(state)
        share = np.where(phase <= TOUCH_PHASE, self._first[sweep], self._last[sweep])
        above = np.where((phase == APPROACH_PHASE) | (phase >= LIFT_PHASE), LIFT_HEIGHT_M, -self._depth_m)
        pos_w, q_w = compute_cloth_pose(state, self._limb[sweep], self._angle[sweep], share, above)
        speed = np.where(phase == APPROACH_PHASE, CARRY_SPEED_M_S, WIPE_SPEED_M_S)
        speed = speed * np.clip(2.0 - state.tool_force_n / MAX_FORCE_N, 0.2, 1.0)
        action = self._planner.compute_action_to_pose(pos_w, q_w, speed, TURN_SPEED_RAD_S)
        self._advance(state, pos_w, q_w)
        return action

    def _press(self, state: State) -> None:
        deeper = self._depth_m + DEPTH_GAIN_M_PER_N * (TARGET_FORCE_N - state.tool_force_n)
        self._depth_m = np.where(self._phase == WIPE_PHASE, np.clip(deeper, *DEPTH_RANGE_M), TOUCH_DEPTH_M)

    def _advance(self, state: State, pos_w: FloatArray, q_w: FloatArray) -> None:
        """Start the next phase when the cloth arrives at the target pose, or if wiping is stuck. After the phase of
        lifting, start the next sweep.
        """
        away, turn = (
            norm(self._planner.tool_pos_w - pos_w),
            transforms.angle_between(self._planner.tool_quat_w, q_w),
        )
        arrived = (away < ARRIVAL_TOLERANCE_M) & (turn < ARRIVAL_TOLERANCE_RAD)
        arrived = np.where(self._phase == TOUCH_PHASE, state.tool_force_n > CONTACT_FORCE_N, arrived)
        stuck = self._is_stuck(away + CHARACTERISTIC_LENGTH_M * turn)
        self._waited[arrived | stuck], self._left_m[arrived | stuck] = 0, np.inf
        on = arrived | (stuck & (self._phase == WIPE_PHASE))
        over = ((on & (self._phase == LIFT_PHASE)) | (stuck & ~on)) & (self._phase != REST_PHASE)
        planned = np.where(are_enough_markers_wiped(self._episodes.task_state), MIN_SWEEPS, len(SWEEPS))
        rests = over & (self._sweep + 1 >= planned)
        self._phase = np.where(
            over, np.where(rests, REST_PHASE, APPROACH_PHASE), np.minimum(self._phase + on, REST_PHASE)
        )
        self._sweep = self._sweep + (over & ~rests)

    def _is_stuck(self, left_m: FloatArray) -> BoolArray:
        """Returns a boolean mask (N,) of worlds without progress for more than ``MAX_STEPS_WITHOUT_PROGRESS`` control
        steps.
        """
        nearer = left_m < self._left_m - MIN_PROGRESS_M
        self._left_m = np.where(nearer, left_m, self._left_m)
        self._waited = np.where(nearer, 0, self._waited + 1)
        return self._waited > MAX_STEPS_WITHOUT_PROGRESS


def compute_cloth_pose(
    state: State, limb: IntArray, angle_rad: FloatArray, share: FloatArray, above_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns cloth positions (N, 3) and rotations (N, 4) in the world frame. The wiping face is towards a limb.

    Args:
        state: physical state of N worlds.
        limb: 0 for the upper arm, 1 for the forearm (N,).
        angle_rad: angle around the limb (N,), 0 at its top, positive outwards.
        share: position along the limb (N,), 0 at the end near the shoulder, 1 at the other end.
        above_m: distance of the wiping face from the skin (N,).
    """
    at = compute_limb_frame(state, limb)
    normal = (
        elementary.cos(angle_rad)[:, None] * at.up_direction_w
        + elementary.sin(angle_rad)[:, None] * at.outward_direction_w
    )
    far_m = LIMB_END_MARGIN_M + share * (at.length_m - 2.0 * LIMB_END_MARGIN_M)
    pos_w = (
        at.shoulder_end_pos_w
        + far_m[:, None] * at.limb_direction_w
        + (at.radius_m + above_m)[:, None] * normal
    )
    axes = [-normal, -at.limb_direction_w, transforms.cross(normal, at.limb_direction_w)]
    return pos_w, transforms.from_matrix(np.stack(axes, axis=-1))


class LimbFrame(NamedTuple):
    """Frames of N limbs in the world frame.

    ``shoulder_end_pos_w`` is the position (N, 3) of the end near the shoulder. ``limb_direction_w``,
    ``up_direction_w`` and ``outward_direction_w`` are unit vectors (N, 3). ``length_m`` and ``radius_m`` (N,) are the
    limbs' lengths and radii.
    """

    shoulder_end_pos_w: FloatArray
    limb_direction_w: FloatArray
    up_direction_w: FloatArray
    outward_direction_w: FloatArray
    length_m: FloatArray
    radius_m: FloatArray


def compute_limb_frame(state: State, limb: IntArray) -> LimbFrame:
    """Returns the frames of the limbs ``limb`` (N,) in N worlds: 0 for the upper arm, 1 for the forearm."""
    world, geom = np.arange(len(limb)), np.array(LIMB_GEOM_INDICES)[limb]
    end_w, start_w = state.person_capsule_ends_w[world, geom].swapaxes(0, 1)
    length_m = norm(end_w - start_w)
    along_w = (end_w - start_w) / length_m[:, None]
    up_w = transforms.normalize([0.0, 0.0, 1.0] - along_w * along_w[:, 2:])
    outwards_w = transforms.cross(along_w, up_w)
    return LimbFrame(start_w, along_w, up_w, outwards_w, length_m, state.person_radius_m[world, geom])
