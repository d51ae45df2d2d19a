"""Nods and shakes are found, in every posture; other head motion gives no command."""

import numpy as np
import pytest

from avrgym.array_types import FloatArray
from avrgym.commands.head_motion import MIN_GESTURE_PAUSE_S, GazeTimer, HeadGestureDetector
from avrgym.commands.preferences import GestureThresholds
from avrgym.geometry import transforms

RATE_HZ = 50.0
TIMES_S = np.arange(0.0, 6.0, 1 / RATE_HZ)
POSTURES = ([0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.3, 2.5, 0.2])
"""Orientations of a head at rest as rotation vectors, radians: seated, reclined, turned."""


def gestures(
    angles_rad: FloatArray, rest: list[float], thresholds: GestureThresholds
) -> list[tuple[float, str]]:
    """Gestures in a head motion (T, 3) about the axes of the head, with their times."""
    q = transforms.multiply(
        transforms.from_rotation_vector(np.array(rest)), transforms.from_rotation_vector(angles_rad)
    )
    detector = HeadGestureDetector(thresholds)
    return [
        (float(time_s), name)
        for time_s, row in zip(TIMES_S, q, strict=True)
        for name, done in detector.update(row[None], float(time_s)).items()
        if done[0]
    ]


def cycles(axis: int, deg: float, hz: float, seconds: float) -> FloatArray:
    """Swings of ``deg`` peak to peak about one axis, from 3 s on."""
    angles = np.zeros((len(TIMES_S), 3))
    during = (TIMES_S >= 3.0) & (3.0 + seconds > TIMES_S)
    angles[during, axis] = 0.5 * np.radians(deg) * (np.cos(2 * np.pi * hz * (TIMES_S[during] - 3.0)) - 1.0)
    return angles


@pytest.mark.parametrize("rest", POSTURES)
@pytest.mark.parametrize(("axis", "name"), [(0, "nod"), (1, "shake")])
def test_gestures_are_found_once_in_every_posture(axis: int, name: str, rest: list[float]) -> None:
    ((time_s, found),) = gestures(cycles(axis, 12.0, 1.8, 2 / 1.8), rest, GestureThresholds())
    assert found == name
    assert 3.0 < time_s < 3.0 + 2 / 1.8 + 0.1


@pytest.mark.parametrize(
    "angles",
    [
        cycles(0, 4.0, 1.8, 3.0),
        cycles(0, 12.0, 1.8, 1 / 1.8),
        cycles(2, 20.0, 1.5, 3.0),
        cycles(0, 12.0, 6.0, 3.0),
        cycles(0, 12.0, 1.0, 3.0),
        cycles(0, 12.0, 1.5, 3.0) + cycles(1, 12.0, 1.5, 3.0),
        np.radians(60.0) * np.clip(TIMES_S - 3.0, 0.0, 1.0)[:, None] * [0.0, 1.0, 0.0],
    ],
    ids=["too small", "one cycle", "tilting", "tremor", "slow", "about two axes", "turn"],
)
def test_other_motion_gives_no_gesture(angles: FloatArray) -> None:
    assert gestures(angles, [0.0, 0.0, 0.0], GestureThresholds()) == []


def test_thresholds_fit_people_who_move_little() -> None:
    small = cycles(0, 4.0, 1.8, 2 / 1.8)
    assert [name for _, name in gestures(small, [0.0, 0.0, 0.0], GestureThresholds(swing_deg=3.0))] == ["nod"]


def test_a_long_nod_counts_again_only_after_a_pause() -> None:
    times_s = [
        time_s for time_s, _ in gestures(cycles(0, 12.0, 1.8, 3.0), [0.0, 0.0, 0.0], GestureThresholds())
    ]
    assert (np.diff(times_s) >= MIN_GESTURE_PAUSE_S - 1e-6).all()


def test_looking_must_last() -> None:
    timer = GazeTimer(GestureThresholds(gaze_s=1.0), heads=2)
    looks = []
    for step in range(12):
        timer.update(np.radians([5.0, 5.0 if step % 6 else 40.0]), 0.1)
        looks.append(timer.detect_gaze())
    assert np.sum(looks, axis=0).tolist() == [1, 0]
    assert timer.facing_away_duration_s.tolist() == [0.0, 0.0]
