"""Detects that the participant has slid on the seat. The virtual seat and room then move to the participant.

The simulated hips are fixed, and the torso only bends. After sliding, the distance from the hips to the tracked head is
longer than the torso. The simulated head cannot reach it. If the participant only leans, the head remains within the
torso's reach.
"""

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.rotation_matrices import from_euler_xyz, from_quaternion
from avrgym.models.human import Person, Posture
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking.body import (
    HEAD_JOINT_INDICES,
    WAIST_JOINT_INDICES,
    compute_resting_head_centre,
    make_skeleton,
)

HEAD_SAMPLE_INTERVAL_TICKS = 10
SAMPLES_PER_WINDOW = 11
"""Number of samples in one second, including both ends."""
STEADY_HEAD_RANGE_M = 0.03
SLIDING_THRESHOLD_M = 0.02
"""Distance in metres between the tracked head at rest and the simulated head above which the participant has slid."""
MAX_SEATED_SHIFT_M = 0.6
MAX_HEAD_RISE_M = 0.1
"""Maximum distance and maximum height of the head relative to its rest position, in metres. Above these limits, the
participant has left the seat."""
SEAT_SPEED_M_S = 0.05
"""Speed of the virtual seat and room. It is low, because the participant sees the motion of the whole scene."""


@dataclass(frozen=True)
class SeatMotion:
    """A motion of the participant's floor in the world at constant speed: shift (3,) in metres and duration in
    seconds."""

    shift_w: FloatArray
    duration_s: float


class SlidingMonitor:
    """Monitors the position of the head at rest, to detect that the participant has slid on the seat."""

    def __init__(self, person: Person, posture: Posture) -> None:
        measures = make_skeleton(person, posture)
        w, x, y, z = measures.hips_q_w
        self._hips_axes_w = from_quaternion(np.array([w, x, y, z]))
        self._waist_w = np.array(measures.hips_pos_w) + self._hips_axes_w @ np.array(measures.waist)
        self._neck_t, self._head_centre_m = np.array(measures.neck), measures.head_centre_m
        self._rest_w = compute_resting_head_centre(person, posture)
        self._seen: deque[FloatArray] = deque(maxlen=SAMPLES_PER_WINDOW)

    def update(self, head: Pose, joint_angles_rad: FloatArray) -> SeatMotion | None:
        """Returns the motion of the room if the participant has slid, otherwise ``None``.

        Arguments are the tracked head pose and the solved joint angles (20,).
        """
        self._seen.append(head.pos_w)
        if (
            len(self._seen) < SAMPLES_PER_WINDOW
            or np.ptp(np.array(self._seen), axis=0).max() > STEADY_HEAD_RANGE_M
        ):
            return None
        error_m = float(np.linalg.norm(head.pos_w - self.compute_head_centre_w(joint_angles_rad)))
        if error_m <= SLIDING_THRESHOLD_M or head.pos_w[2] - self._rest_w[2] > MAX_HEAD_RISE_M:
            return None
        return self._glide(head)

    def reset(self) -> None:
        """Delete all samples of the head's position."""
        self._seen.clear()

    def compute_head_centre_w(self, joint_angles_rad: FloatArray) -> FloatArray:
        """Returns the head's centre (3,), in metres in the world frame, for joint angles (20,) in radians."""
        waist, head = (
            joint_angles_rad[WAIST_JOINT_INDICES].tolist(),
            joint_angles_rad[HEAD_JOINT_INDICES].tolist(),
        )
        torso_axes_w = self._hips_axes_w @ from_euler_xyz(*waist)
        up_w = (torso_axes_w @ from_euler_xyz(*head))[:, 2]
        return self._waist_w + torso_axes_w @ self._neck_t + self._head_centre_m * up_w

    def _glide(self, head: Pose) -> SeatMotion | None:
        """Returns the shortest horizontal motion after which the torso reaches the head joints.

        Returns ``None`` if this motion is too small or too large.
        """
        away = (head.pos_w - self._rest_w) * [1.0, 1.0, 0.0]
        distance_m = float(np.linalg.norm(away))
        if distance_m <= SLIDING_THRESHOLD_M:
            return None
        direction = away / distance_m
        neck_w = head.pos_w - self._head_centre_m * from_quaternion(head.q_w)[:, 2] - self._waist_w
        along_m = float(neck_w @ direction)
        too_far = float(neck_w @ neck_w - self._neck_t @ self._neck_t)
        shift_m = along_m - sqrt(max(along_m * along_m - too_far, 0.0))
        if not SLIDING_THRESHOLD_M < shift_m <= MAX_SEATED_SHIFT_M:
            return None
        self.reset()
        return SeatMotion(-shift_m * direction, shift_m / SEAT_SPEED_M_S)
