"""Measure the detection of nods and shakes on head motion of simulated people.

``python research/head_gestures.py [--worlds N] [--seed S]`` prints, for each behaviour style of the held-out zoo, the
false alarms per minute while a robot feeds people who give no gestures, and the share of missed gestures. The last
lines are totals over all styles with other thresholds. Gestures are added to the same head motion: 6 to 20° peak to
peak, 1 to 3 Hz, two or three cycles, one every four seconds.
"""

import argparse

import numpy as np

from avrgym.commands.head_motion import MIN_SAMPLE_INTERVAL_S, HeadGestureDetector
from avrgym.commands.preferences import GestureThresholds
from avrgym.geometry import transforms
from avrgym.people.zoo.styles import STYLES
from avrgym.policies import registry
from avrgym.tasks.episodes import Episodes

ENVIRONMENT, STEPS = "avrgym/FeedingJaco-v1", 200
INTERVAL_S, LATEST_S = 4.0, 0.6
"""Time between two gestures, and the latest detection after the end of a gesture."""
THRESHOLDS = [
    GestureThresholds(swing_deg=deg, swings=swings) for swings in (2, 3, 4) for deg in (3.0, 6.0, 9.0)
]
UP_IS_Y = transforms.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(0.5 * np.pi))
"""Rotation from the axes of the detector to those of the model's head, whose vertical axis is z."""


class Source:
    """Actions of a policy for ``ControlLoop.tick``."""

    def __init__(self, act):
        self.act = act

    def update_action(self):
        return None


def head_motion(people: str, worlds: int, seed: int) -> np.ndarray:
    """Orientations (T, N, 4) of the heads of N people in an episode, at intervals of ``MIN_SAMPLE_INTERVAL_S``."""
    episodes = Episodes(ENVIRONMENT, worlds, people=people, num_threads=1)
    generators = [np.random.default_rng([seed, world]) for world in range(worlds)]
    episodes.reset(np.arange(worlds), generators)
    found = []
    ticks, every = STEPS * episodes.scene.substeps, round(MIN_SAMPLE_INTERVAL_S / 0.01)
    with registry.open_policy(registry.resolve_policy("revised", ENVIRONMENT), episodes, generators) as act:
        source = Source(lambda observation: act(observation).astype(float))
        for tick in range(ticks):
            episodes.control_loop.tick(source)
            if tick % every == 0:
                found.append(transforms.multiply(episodes.get_state().head_quat_w, UP_IS_Y))
    return np.array(found)


def detections(q: np.ndarray, thresholds: GestureThresholds) -> list[tuple[float, int, str]]:
    """Time, head and name of each detected gesture."""
    detector = HeadGestureDetector(thresholds, q.shape[1])
    found = []
    for sample, row in enumerate(q):
        for name, done in detector.update(row, sample * MIN_SAMPLE_INTERVAL_S).items():
            found += [(sample * MIN_SAMPLE_INTERVAL_S, int(head), name) for head in np.flatnonzero(done)]
    return found


def with_gestures(
    q: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, list[tuple[float, float, int, str]]]:
    """The motion with added gestures, and for each one its start, end, head and name."""
    times_s = np.arange(len(q)) * MIN_SAMPLE_INTERVAL_S
    turned, added = np.zeros((*q.shape[:2], 3)), []
    for head in range(q.shape[1]):
        for start_s in np.arange(3.0, times_s[-1] - INTERVAL_S, INTERVAL_S):
            swing, hz, cycles = np.radians(rng.uniform(6.0, 20.0)), rng.uniform(1.0, 3.0), rng.integers(2, 4)
            axis = int(rng.integers(2))
            during = (times_s >= start_s) & (times_s <= start_s + cycles / hz)
            phase = 2.0 * np.pi * hz * (times_s[during] - start_s)
            turned[during, head, axis] = 0.5 * swing * (np.cos(phase) - 1.0 if axis == 0 else np.sin(phase))
            added.append((start_s, start_s + cycles / hz, head, ("nod", "shake")[axis]))
    return transforms.multiply(q, transforms.from_rotation_vector(turned)), added


def main() -> None:
    """Print one line for each style."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    motions = {
        style: head_motion(f"zoo/unseen/{style}", arguments.worlds, arguments.seed) for style in STYLES
    }
    print(f"{'':14} {'minutes':>7} {'false/min':>9} {'gestures':>8} {'missed':>7} {'as other':>8}")
    rows = {style: measured(q, GestureThresholds(), arguments.seed) for style, q in motions.items()}
    for style, row in rows.items():
        print_row(style, row)
    for thresholds in THRESHOLDS:
        row = sum(measured(q, thresholds, arguments.seed) for q in motions.values())
        print_row(f"{thresholds.swing_deg:g}°, {thresholds.swings} swings", row)


def measured(q: np.ndarray, thresholds: GestureThresholds, seed: int) -> np.ndarray:
    """Minutes, false alarms, gestures, missed ones, and those detected as the other gesture."""
    minutes = q.shape[1] * len(q) * MIN_SAMPLE_INTERVAL_S / 60.0
    moved, added = with_gestures(q, np.random.default_rng(seed))
    found = detections(moved, thresholds)
    hits = wrong = 0
    for start_s, end_s, head, name in added:
        names = {each for time_s, who, each in found if who == head and start_s < time_s < end_s + LATEST_S}
        hits += name in names
        wrong += bool(names - {name})
    return np.array([minutes, len(detections(q, thresholds)), len(added), len(added) - hits, wrong])


def print_row(name: str, row: np.ndarray) -> None:
    """Print one line of the table."""
    minutes, alarms, gestures, missed, wrong = row
    rates = f"{alarms / minutes:9.2f} {gestures:8.0f} {missed / gestures:7.1%} {wrong / gestures:8.1%}"
    print(f"{name:14} {minutes:7.1f} {rates}", flush=True)


if __name__ == "__main__":
    main()
