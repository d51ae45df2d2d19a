"""Detect nods, shakes, and gaze at the tool from the motion of N heads.

People signal "yes" and "no" with symmetric, cyclic head movements; other head movements in conversations are mostly
linear (Hadar et al., J. Nonverbal Behav. 9:214, 1985). A nod is therefore a number of swings in alternating directions
about the lateral axis of the head. A shake consists of such swings about its vertical axis. Thresholds are in
``commands.preferences.GestureThresholds``; ``research/head_gestures.py`` measures false alarms and misses.

- A turn of the head is a single swing. The turn back is another swing.
- Swings about the other axes must be at most half as large. A person that looks around rotates the head about several
  axes.
- Swings slower than ``MIN_GESTURE_HZ`` or faster than ``MAX_GESTURE_HZ`` are ignored. Tremor of the head has
  frequencies of 4 to 12 Hz (Bhatia et al., Mov. Disord. 33:75, 2018).
- Chewing moves the head at 0.94 to 2.17 Hz (Po et al., J. Dent. Res. 90:1206, 2011), but less than the smallest swing.
"""

from typing import Literal, NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.commands.preferences import GestureThresholds
from avrgym.geometry import transforms

MIN_SAMPLE_INTERVAL_S = 0.04
"""Minimum sampling interval in seconds. Headsets with 50 to 120 frames per second then give 22 to 25 samples per
second."""
GESTURE_WINDOW_S = 1.5
"""Duration in seconds of the time window in which a gesture is detected."""
MIN_GESTURE_HZ, MAX_GESTURE_HZ = 1.4, 3.5
"""Minimum and maximum frequency of a nod or shake. The heads of simulated people follow a moving spoon at up to 1.2
Hz."""
MIN_GESTURE_AXIS_RATIO = 2.0
"""Minimum ratio of head rotation about the axis of a gesture to head rotation about the other axes."""
MIN_GESTURE_PAUSE_S = 1.5
"""Minimum time in seconds between two gestures of the same head."""
_SAMPLES = round(GESTURE_WINDOW_S / MIN_SAMPLE_INTERVAL_S)

HeadGesture = Literal["nod", "shake"]


class HeadGestureDetector:
    """Detects nods and shakes from a stream of the orientations of N heads."""

    def __init__(self, thresholds: GestureThresholds, heads: int = 1) -> None:
        self._thresholds = thresholds
        self._q = np.tile([1.0, 0.0, 0.0, 0.0], (heads, _SAMPLES, 1))
        self._count, self._latest_s = 0, -np.inf
        self._quiet_until_s = np.full(heads, -np.inf)

    def update(self, q: FloatArray, time_s: float) -> dict[HeadGesture, BoolArray]:
        """Process the current orientations. Returns by gesture a boolean mask (N,): heads that complete this gesture.

        Args:
            q: (N, 4) quaternions w, x, y, z, in any fixed frame. The head's x axis points to its side, its y axis up.
            time_s: time of the measurement. A measurement within ``MIN_SAMPLE_INTERVAL_S`` of the previous measurement
                is ignored.
        """
        if time_s - self._latest_s < MIN_SAMPLE_INTERVAL_S - 1e-6:
            return {}
        if time_s - self._latest_s > GESTURE_WINDOW_S:
            self._count = 0
        self._latest_s = time_s
        self._q = np.concatenate([self._q[:, 1:], q[:, None]], axis=1)
        self._count += 1
        if self._count < _SAMPLES:
            return {}
        swings = find_head_swings(self._q, np.radians(self._thresholds.swing_deg))
        found: dict[HeadGesture, BoolArray] = {}
        names: tuple[HeadGesture, ...] = ("nod", "shake")
        for axis, name in enumerate(names):
            others = np.delete(swings.rms_rotation_rad, axis, axis=1).max(axis=-1)
            done = swings.swing_count[:, axis] >= self._thresholds.swings
            done &= swings.mean_swing_duration_s[:, axis] >= 0.5 / MAX_GESTURE_HZ
            done &= swings.mean_swing_duration_s[:, axis] <= 0.5 / MIN_GESTURE_HZ
            done &= swings.rms_rotation_rad[:, axis] >= MIN_GESTURE_AXIS_RATIO * others
            done &= time_s >= self._quiet_until_s
            self._quiet_until_s = np.where(done, time_s + MIN_GESTURE_PAUSE_S, self._quiet_until_s)
            found[name] = done
        return found


class HeadSwings(NamedTuple):
    """Swings about the three axes of N heads. All arrays are (N, 3).

    ``swing_count``: number of swings. ``mean_swing_duration_s``: their mean duration. ``rms_rotation_rad``:
    root-mean-square of the rotation.
    """

    swing_count: IntArray
    mean_swing_duration_s: FloatArray
    rms_rotation_rad: FloatArray


def find_head_swings(q: FloatArray, swing_rad: float) -> HeadSwings:
    """Returns the swings in a time window. A swing is a rotation in one direction by at least ``swing_rad``.

    Args:
        q: (N, T, 4) orientations at intervals of ``MIN_SAMPLE_INTERVAL_S``.
        swing_rad: minimum angle of a swing, peak to peak.
    """
    turned = transforms.to_rotation_vector(transforms.multiply(transforms.conjugate(q[:, :1]), q))
    highest = lowest = turned[:, 0]
    direction, number = np.zeros(highest.shape), np.zeros(highest.shape, dtype=np.intp)
    first, last = np.zeros(highest.shape), np.zeros(highest.shape)
    for sample in range(1, turned.shape[1]):
        angle = turned[:, sample]
        highest, lowest = np.maximum(highest, angle), np.minimum(lowest, angle)
        rises = (direction <= 0.0) & (angle - lowest >= swing_rad)
        falls = (direction >= 0.0) & (highest - angle >= swing_rad) & ~rises
        turns = rises | falls
        direction = np.where(rises, 1.0, np.where(falls, -1.0, direction))
        highest, lowest = np.where(turns, angle, highest), np.where(turns, angle, lowest)
        first = np.where(turns & (number == 0), sample, first)
        last = np.where(turns, sample, last)
        number = number + turns
    duration_s = MIN_SAMPLE_INTERVAL_S * (last - first) / np.maximum(number - 1, 1)
    around = turned - turned.mean(axis=1, keepdims=True)
    return HeadSwings(number, duration_s, np.sqrt((around * around).mean(axis=1)))


class GazeTimer:
    """Timers (N,) in seconds of the time for which each of N heads faces the tool (``facing_duration_s``) or does not
    (``facing_away_duration_s``)."""

    def __init__(self, thresholds: GestureThresholds, heads: int = 1) -> None:
        self._thresholds = thresholds
        self.facing_duration_s, self.facing_away_duration_s = np.zeros(heads), np.zeros(heads)

    def update(self, angle_rad: FloatArray, step_s: float) -> None:
        """Update the timers after a step of ``step_s`` seconds. ``angle_rad`` (N,): angle between head direction and
        tool."""
        facing = angle_rad <= np.radians(self._thresholds.gaze_deg)
        self.facing_duration_s = np.where(facing, self.facing_duration_s + step_s, 0.0)
        self.facing_away_duration_s = np.where(facing, 0.0, self.facing_away_duration_s + step_s)

    def detect_gaze(self) -> BoolArray:
        """Returns a boolean mask (N,): heads that have faced the tool for ``gaze_s``. Resets the timers of these
        heads."""
        due = self.facing_duration_s >= self._thresholds.gaze_s
        self.facing_duration_s = np.where(due, 0.0, self.facing_duration_s)
        return due

    def detect_gaze_away(self) -> BoolArray:
        """Returns a boolean mask (N,): heads that have not faced the tool for ``gaze_s``. Resets the timers of these
        heads."""
        due = self.facing_away_duration_s >= self._thresholds.gaze_s
        self.facing_away_duration_s = np.where(due, 0.0, self.facing_away_duration_s)
        return due
