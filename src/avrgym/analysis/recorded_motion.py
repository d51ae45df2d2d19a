"""Motion of person and tool in a recorded trial: observations and joint angles for fitting behaviour models."""

from dataclasses import dataclass

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.rotation_matrices import from_euler_xyz, to_euler_xyz
from avrgym.models.human import JOINT_INDEX, Person, Posture
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.recording.reader import Recording
from avrgym.recording.recorded_world import rebuild_world
from avrgym.tasks.registry import find_task_and_scene

MOTION_JOINT_NAMES = ("waist_x", "waist_y", "head_x", "head_z", "right_elbow_x")
"""Joints with fitted motion. Their angles are determined by the tracking of head and hands."""
WAIST_X_COLUMN, WAIST_Y_COLUMN, HEAD_X_COLUMN, HEAD_Z_COLUMN, ELBOW_COLUMN = range(len(MOTION_JOINT_NAMES))
_COLUMNS = [JOINT_INDEX[name] for name in MOTION_JOINT_NAMES]
_WAIST, _HEAD = ([JOINT_INDEX[f"{part}_{axis}"] for axis in "xyz"] for part in ("waist", "head"))

MIN_MOTION_SAMPLES = 20
"""Minimum number of samples of a motion (two seconds)."""


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Motion in a trial, from the start of free movement to the last control step.

    Attributes:
        participant: pseudonym.
        person: body and initial joint angles.
        offered_body_part: name of the body part that the person moves to the tool.
        posture: posture of the person in the task.
        tool_pos_w, head_pos_w, mouth_pos_w: positions (K, 3) every 0.1 s, in metres in the world frame.
        right_arm_pos_w: positions (K, 3, 3) of right shoulder, elbow and wrist.
        joint_angles_rad: angles (10 K, 5) of the ``MOTION_JOINT_NAMES`` every 0.01 s. Head angles include the yaw of
            the waist.
        first_robot_motion_sample: index of the first of the K samples with robot motion.
    """

    participant: str
    person: Person
    offered_body_part: OfferedBodyPart
    posture: Posture
    tool_pos_w: FloatArray
    head_pos_w: FloatArray
    mouth_pos_w: FloatArray
    right_arm_pos_w: FloatArray
    joint_angles_rad: FloatArray
    first_robot_motion_sample: int


def read_recorded_motion(participant: str, recording: Recording) -> RecordedMotion:
    """Returns the motion in the recording of a completed trial.

    Raises:
        ValueError: if simulation states or joint targets are missing, if the motion is shorter than two seconds, or if
            the world cannot be created.
    """
    states, targets = recording.messages_by_topic["/physics"], recording.messages_by_topic["/body_targets"]
    control, events = recording.messages_by_topic["/control"], recording.messages_by_topic["/events"]
    begins = [time_ns / 1e9 for time_ns, event in events if (event.name, event.detail) == ("phase", "trial")]
    count = int(control[-1][0] / 1e9 / PHYSICS_STEP_S + 1e-6) // DEFAULT_SUBSTEPS if control else 0
    if not begins or not targets or len(states) < count * DEFAULT_SUBSTEPS or count < MIN_MOTION_SAMPLES:
        raise ValueError(
            "the recording contains no simulation states, no joint targets or less than 2 s of motion; "
            "allowed: recordings with states, targets and at least 2 s of motion"
        )
    task, scene = find_task_and_scene(recording.configuration.environment)
    simulation = rebuild_world(recording.configuration).simulation
    perceived: list[tuple[FloatArray, ...]] = []
    for _, physics in states[: count * DEFAULT_SUBSTEPS : DEFAULT_SUBSTEPS]:
        simulation.set_integration_state(np.array(physics.state, float))
        now = simulation.get_state()
        perceived.append((now.tool_pos_w[0], now.head_pos_w[0], now.mouth_pos_w[0], now.right_arm_pos_w[0]))
    tool_w, head_w, mouth_w, right_arm_w = (np.stack(each) for each in zip(*perceived, strict=True))
    times_s = np.array([time_ns for time_ns, _ in targets]) / 1e9
    ticks_s = PHYSICS_STEP_S * np.arange(count * DEFAULT_SUBSTEPS)
    rows = np.maximum(np.searchsorted(times_s, ticks_s + 1e-6, side="right") - 1, 0)
    angles_rad = np.array([record.joint_targets for _, record in targets])[rows]
    return RecordedMotion(
        participant=participant,
        person=recording.configuration.start_person,
        offered_body_part=task.offered_body_part,
        posture=scene.posture,
        tool_pos_w=tool_w,
        head_pos_w=head_w,
        mouth_pos_w=mouth_w,
        right_arm_pos_w=right_arm_w,
        joint_angles_rad=_channels(angles_rad),
        first_robot_motion_sample=min(
            int(begins[0] / PHYSICS_STEP_S) // DEFAULT_SUBSTEPS, count - MIN_MOTION_SAMPLES
        ),
    )


def _channels(joint_angles_rad: FloatArray) -> FloatArray:
    """Returns the angles (T, 5) of the ``MOTION_JOINT_NAMES`` from joint angles (T, 20).

    The yaw of the waist is added to the rotation of the head, because inverse kinematics divides yaw between both.
    """
    channels = joint_angles_rad[:, _COLUMNS].copy()
    for channel, yaw_rad, head_rad in zip(
        channels, joint_angles_rad[:, _WAIST[2]].tolist(), joint_angles_rad[:, _HEAD].tolist(), strict=True
    ):
        angles = to_euler_xyz(from_euler_xyz(0.0, 0.0, yaw_rad) @ from_euler_xyz(*head_rad))
        channel[HEAD_X_COLUMN], channel[HEAD_Z_COLUMN] = angles[0], angles[2]
    return channels
