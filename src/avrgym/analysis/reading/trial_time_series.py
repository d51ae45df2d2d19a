"""Read time series of a trial from its recording: control steps and body posture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Posture
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control
from avrgym.vr.session.attempt import read_package_versions

WAIST_JOINT_INDICES = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]


@dataclass(frozen=True, eq=False)
class BodyPostureSeries:
    """Body posture at each of n control steps. ``torso_height_m``: torso height of the body model.

    ``head_centre_pos_w`` (n, 3): head centre in metres in the world frame. ``waist_angles_rad`` (n, 3): waist angles.
    """

    torso_height_m: float
    head_centre_pos_w: FloatArray
    waist_angles_rad: FloatArray


@dataclass(frozen=True, eq=False)
class TrialTimeSeries:
    """Time series of a trial: times (n,) in seconds, control steps (n,), reward weights, and body posture (``None`` if
    missing)."""

    times_s: Sequence[float]
    control_steps: Sequence[Control]
    reward_weights: Mapping[str, float]
    posture_series: BodyPostureSeries | None


def read_trial_time_series(recording: Recording, posture: Posture) -> TrialTimeSeries:
    """Returns the time series in a recording. Missing series are empty; a missing body posture is ``None``."""
    control = recording.messages_by_topic["/control"]
    return TrialTimeSeries(
        [time_ns / 1e9 for time_ns, _ in control],
        [step for _, step in control],
        recording.configuration.reward_weights,
        _body(recording, posture),
    )


def describe_version_differences(recording: Recording) -> str:
    """Returns a text with the recorded versions that differ from the installed versions; empty if none differs."""
    recorded, present = recording.configuration.versions, read_package_versions()
    pairs = [
        ("AVR Gym", recorded.avrgym, present.avrgym),
        ("MuJoCo", recorded.mujoco, present.mujoco),
    ]
    return ", ".join(f"{name} {then} (now {now})" for name, then, now in pairs if then != now)


def compute_head_centres(people: People, posture: Posture) -> FloatArray:
    """Returns the head centres (n, 3) of people in ``posture``, in metres in the world frame."""
    pos_w, q_w = human.compute_body_frames(people, posture, ("head",))
    centre = human.compute_body_layout(people.is_woman, people.torso_height_m).site_pos["head_centre"]
    return pos_w["head"] + transforms.rotate(q_w["head"], centre)


def _body(recording: Recording, posture: Posture) -> BodyPostureSeries | None:
    """Returns the body posture from the recorded joint targets.

    Returns ``None`` if targets are missing, or if the joints differ from the current body model.
    """
    configuration = recording.configuration
    person = configuration.person
    control, targets = recording.messages_by_topic["/control"], recording.messages_by_topic["/body_targets"]
    if configuration.joint_names != tuple(JOINTS) or not control or not targets:
        return None
    angles = _targets_at(targets, [time_ns for time_ns, _ in control])
    if angles.shape[1] != len(JOINTS):
        return None
    people = People.make_unimpaired(
        np.full(len(angles), person.sex == "woman"), np.full(len(angles), person.torso_height_m), angles
    )
    return BodyPostureSeries(
        person.torso_height_m, compute_head_centres(people, posture), angles[:, WAIST_JOINT_INDICES]
    )


def _targets_at(targets: Sequence[tuple[int, Any]], times_ns: Sequence[int]) -> FloatArray:
    """Returns the latest joint targets (n, 20) in radians at each time.

    Before the time of the first targets, the first targets are used.
    """
    begins_ns = [time_ns for time_ns, _ in targets]
    present = np.maximum(np.searchsorted(begins_ns, times_ns, side="right") - 1, 0)
    return np.array([targets[int(index)][1].joint_targets for index in present])
