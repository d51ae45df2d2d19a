"""Fit a training population to the participants of a study.

The result is a TOML file (see ``people.people_file``): torso heights, poses in each task, cooperation, and behaviour
(see ``fit_behaviour``). For n participants with values from a to b, the range is:

    low = a - (b - a) / (n - 1),  high = b + (b - a) / (n - 1)

This range covers all participants. For uniformly distributed values of width W, the expected values of ``low`` and
``high`` are the bounds of the distribution. On average, the smallest and the largest of n values are W / (n + 1) from
these bounds. Their distance from each other is W (n - 1) / (n + 1) on average (David and Nagaraja, *Order Statistics*,
3rd ed., 2003, chapter 2).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import tomlkit

from avrgym.analysis.fit_behaviour import FittedBehaviour, fit_behaviour
from avrgym.analysis.recorded_motion import RecordedMotion, read_recorded_motion
from avrgym.array_types import FloatArray
from avrgym.models.human import JOINT_INDEX, JOINTS, TORSO_HEIGHT_RANGE_M, Sex
from avrgym.people.people_file import FittedStudy, PeopleFile, TorsoHeights, ValueRange
from avrgym.recording.reader import Recording
from avrgym.study.checking.tracking_loss import describe_excess_tracking_loss
from avrgym.study.export.exported_attempts import ExportedAttempt, list_completed_attempts
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import write_atomically
from avrgym.tasks.registry import TASKS

FITTED_JOINT_NAMES = tuple(name for name in JOINTS if not name.startswith("left_"))
"""Joints with fitted ranges: waist, head and right arm. The left arm has the initial pose of the task."""
REACHING_JOINT_INDICES = {
    "mouth": [JOINT_INDEX[name] for name, joint in JOINTS.items() if joint.body in ("torso", "head")],
    "arm": [JOINT_INDEX[name] for name in JOINTS if name.startswith(("right_shoulder", "right_elbow"))],
    "left_arm": [],
    "nothing": [],
}
"""Joint indices by the body part that a person moves to the tool. The left arm is not fitted."""
MIN_VOLUNTARY_MOTION_DEG = 5.0
"""Smallest joint motion that is considered voluntary, in degrees. Postural sway of a sitting person is smaller."""
INITIAL_POSE_DURATION_S = 1.0
RECOMMENDED_PARTICIPANTS = 8
"""Number of participants in the paper. A people file that is fitted to fewer participants contains a warning."""


@dataclass(frozen=True)
class TrialPose:
    """Torso height and joint angles (20,) of the person in one completed trial. Angles are in degrees.

    ``initial_angles_deg``: mean over the first second of the robot's motion. ``mean_angles_deg``: mean over the whole
    trial. ``max_joint_motion_deg``: the largest motion (maximum − minimum) of a joint in ``REACHING_JOINT_INDICES``
    of the task. ``motion``: ``None`` if the recording contains no simulation states.
    """

    participant: str
    sex: Sex
    task: str
    torso_height_m: float
    initial_angles_deg: FloatArray
    mean_angles_deg: FloatArray
    max_joint_motion_deg: float
    motion: RecordedMotion | None


@dataclass(frozen=True)
class FittedPopulation:
    """A fitted population, and remarks about the fit.

    ``behaviour``: behaviour parameters; ``None`` if fewer than two participants have recordings with simulation states.
    ``omitted_recordings``: an error message for each omitted recording.
    """

    people_file: PeopleFile
    behaviour: FittedBehaviour | None
    remarks: str
    omitted_recordings: tuple[str, ...]


def fit_people(
    folder: Path, progress: Callable[[int, int], None] = lambda done, count: None
) -> FittedPopulation:
    """Returns a training population that is fitted to the participants with completed trials.

    Simulated participants are used only if there are no people. Missing, damaged and modified recordings are omitted.
    Trials with more tracking loss than the design allows are also omitted.

    Args:
        folder: the study's folder.
        progress: called after each recording with the number of recordings read and their total number.

    Raises:
        StudyError: if the folder contains no study, or fewer than two participants have usable trials.
    """
    with StudyStore(folder) as store:
        fetch_recordings(store)
        attempts = [each for each in list_completed_attempts(store) if not each.trial.practice]
        simulated = all(each.participant.simulated for each in attempts)
        chosen = [each for each in attempts if each.participant.simulated == simulated]
        trials, left_out = _read_poses(chosen, progress)
        title = store.design.title
    sexes = {trial.participant: trial.sex for trial in trials}
    if len(sexes) < 2:
        broken = f" Unusable recordings: {'; '.join(left_out)}." if left_out else ""
        raise StudyError(
            f"{folder}: the fit needs at least 2 participants with completed trials, found {len(sexes)}.{broken}"
        )
    men = list(sexes.values()).count("man")
    source = FittedStudy(title, men, len(sexes) - men, len(trials), simulated)
    motions = [trial.motion for trial in trials if trial.motion is not None]
    behaviour = fit_behaviour(motions) if len({each.participant for each in motions}) > 1 else None
    remarks = _remarks(source) + _behaviour_remarks(behaviour)
    return FittedPopulation(_fitted(trials, source, behaviour), behaviour, remarks, tuple(left_out))


def write_people_file(fit: FittedPopulation, out: Path) -> None:
    """Write the fitted population to the new TOML file ``out``. Raises ``FileExistsError`` if ``out`` exists."""
    if out.exists():
        raise FileExistsError(f"{out} already exists; choose another file with --out FILE")
    write_atomically(out, _toml_text(fit).encode())


def _toml_text(fit: FittedPopulation) -> str:
    """Returns the fit as TOML, with the remarks as comments at the top."""
    document = tomlkit.document()
    for line in fit.remarks.splitlines():
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    document.update(msgspec.to_builtins(fit.people_file))  # pyright: ignore[reportUnknownMemberType]
    return tomlkit.dumps(document)  # pyright: ignore[reportUnknownMemberType]


def compute_covering_range(values: Sequence[float], limits: ValueRange) -> ValueRange:
    """Returns the covering range (see the module docstring) of two or more values, clipped to ``limits``."""
    low, high = min(values), max(values)
    margin = (high - low) / (len(values) - 1)
    return max(low - margin, limits[0]), min(high + margin, limits[1])


# Reading


def _read_poses(
    attempts: Sequence[ExportedAttempt], progress: Callable[[int, int], None]
) -> tuple[list[TrialPose], list[str]]:
    """Returns the poses in all usable recordings, and an error message for each unusable recording."""
    trials: list[TrialPose] = []
    left_out: list[str] = []
    for number, attempt in enumerate(attempts, start=1):
        try:
            trials.append(_read_pose(attempt))
        except StudyError as error:
            left_out.append(str(error))
        progress(number, len(attempts))
    return trials, left_out


def _read_pose(attempt: ExportedAttempt) -> TrialPose:
    """Returns the pose in a recording. Raises ``StudyError`` with the name of the recording if it is unusable."""
    recording = attempt.read_complete_recording()
    held = describe_excess_tracking_loss(recording, attempt.store.design)
    if held is not None:
        raise StudyError(f"{attempt.attempt.recording}: {held}")
    try:
        return _trial_pose(attempt, recording)
    except (KeyError, ValueError) as error:
        raise StudyError(
            f"{attempt.attempt.recording} contains no usable pose of the person: {error}"
        ) from error


def _trial_pose(attempt: ExportedAttempt, recording: Recording) -> TrialPose:
    times_s, targets_deg = _targets(recording)
    offered = REACHING_JOINT_INDICES[TASKS[attempt.trial.task].offered_body_part]
    return TrialPose(
        participant=attempt.participant.pseudonym,
        sex=recording.configuration.person.sex,
        task=attempt.trial.task,
        torso_height_m=recording.configuration.person.torso_height_m,
        initial_angles_deg=_mean(times_s, targets_deg, times_s[0] + INITIAL_POSE_DURATION_S),
        mean_angles_deg=_mean(times_s, targets_deg, times_s[-1]),
        max_joint_motion_deg=float(np.ptp(targets_deg[:, offered], axis=0).max(initial=0.0)),
        motion=_motion(attempt.participant.pseudonym, recording),
    )


def _motion(participant: str, recording: Recording) -> RecordedMotion | None:
    try:
        return read_recorded_motion(participant, recording)
    except ValueError:
        return None


def _targets(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Returns times (n + 1,) in seconds and joint targets (n, 20) in degrees during the robot's motion.

    The last time is the end of the robot's motion.
    """
    events, control = recording.messages_by_topic["/events"], recording.messages_by_topic["/control"]
    begins = [time_ns for time_ns, event in events if (event.name, event.detail) == ("phase", "trial")]
    targets = recording.messages_by_topic["/body_targets"]
    if not begins or not control or not targets or targets[0][0] > begins[0]:
        raise ValueError(
            "the recording has no trial phase, no control steps, or no joint targets at the start of the trial; "
            "allowed: recordings with all three"
        )
    times_ns = np.array([time_ns for time_ns, _ in targets])
    first = int(np.searchsorted(times_ns, begins[0], side="right")) - 1
    last = int(np.searchsorted(times_ns, control[-1][0], side="left"))
    times_s = np.array([begins[0], *times_ns[first + 1 : last], control[-1][0]]) / 1e9
    return times_s, np.degrees([record.joint_targets for _, record in targets[first:last]])


def _mean(times_s: FloatArray, values: FloatArray, until_s: float) -> FloatArray:
    """Returns the time average (20,) of joint targets ``values`` (n, 20) until ``until_s``.

    Row i applies from ``times_s[i]`` to ``times_s[i + 1]``. The result has the unit of ``values``.
    """
    lasted_s = np.diff(np.minimum(times_s, until_s))
    return lasted_s @ values / lasted_s.sum()


# Fitting


def _fitted(
    trials: Sequence[TrialPose], source: FittedStudy, behaviour: FittedBehaviour | None
) -> PeopleFile:
    moving = bool(
        np.median(_participant_means((t.participant, t.max_joint_motion_deg) for t in trials))
        > MIN_VOLUNTARY_MOTION_DEG
    )
    poses = {task: _pose([t for t in trials if t.task == task], moving) for task in TASKS}
    return PeopleFile(
        cooperating=moving,
        torso_height_m=TorsoHeights(man=_heights(trials, "man"), woman=_heights(trials, "woman")),
        poses={task: pose for task, pose in poses.items() if pose},
        source=source,
        behaviour=() if behaviour is None else behaviour.list_participant_estimates(),
    )


def _participant_means(values: Iterable[tuple[str, float]]) -> list[float]:
    """Returns the mean value of each participant. ``values``: (pseudonym, value) of each trial."""
    values_by_participant: dict[str, list[float]] = {}
    for participant, value in values:
        values_by_participant.setdefault(participant, []).append(value)
    return [float(np.mean(own)) for own in values_by_participant.values()]


def _heights(trials: Sequence[TrialPose], sex: Sex) -> ValueRange:
    """Returns the range of torso heights of one sex in metres.

    If fewer than two participants have this sex, returns the range of all participants.
    """
    own = _participant_means((t.participant, t.torso_height_m) for t in trials if t.sex == sex)
    both = _participant_means((t.participant, t.torso_height_m) for t in trials)
    low, high = compute_covering_range(own if len(own) > 1 else both, TORSO_HEIGHT_RANGE_M)
    return round(low, 4), round(high, 4)


def _pose(trials: Sequence[TrialPose], moving: bool) -> dict[str, ValueRange]:
    """Returns the angle range of each joint in degrees; empty if there are fewer than two participants.

    ``moving``: whether participants move in trials. If so, angles are means over the first second, otherwise over whole
    trials.
    """
    if len({trial.participant for trial in trials}) < 2:
        return {}
    ranges: dict[str, ValueRange] = {}
    for name in FITTED_JOINT_NAMES:
        angles = (
            (t.participant, (t.initial_angles_deg if moving else t.mean_angles_deg)[JOINT_INDEX[name]])
            for t in trials
        )
        limits = JOINTS[name].lower_limit_deg, JOINTS[name].upper_limit_deg
        low, high = compute_covering_range(_participant_means(angles), limits)
        ranges[name] = round(low, 2), round(high, 2)
    return ranges


def _remarks(source: FittedStudy) -> str:
    who = "simulated participants" if source.simulated else "participants"
    lines = [
        f"People fitted by `avrgym fit-people` to {source.participants} {who} of the study {source.study!r}.",
        "For n participants with values from a to b, the range is a - (b - a) / (n - 1) to b + (b - a) / (n - 1).",
        "Torso heights are in metres, joint angles in degrees. Joints without a range keep the task's pose.",
    ]
    if source.participants < RECOMMENDED_PARTICIPANTS:
        lines.append(_small_sample_text(source.participants))
    for sex, count in (("man", source.men), ("woman", source.women)):
        if count < 2:
            lines.append(
                f"Fewer than two participants have sex {sex!r}: the range of torso heights is that of all participants."
            )
    return "\n".join(lines)


def _behaviour_remarks(behaviour: FittedBehaviour | None) -> str:
    """Returns a text with the group mean and standard deviation of each behaviour parameter."""
    if behaviour is None:
        return "\nBehaviour is not fitted: it needs two participants whose recordings contain the world's states."
    lines = [
        f"{name}: {each.group_mean:.3g} ± {each.group_sd:.2g}"
        for name, each in behaviour.estimates_by_parameter.items()
    ]
    return "\n".join(["", "Behaviour, mean ± standard deviation of the group:", *lines])


def _small_sample_text(count: int) -> str:
    """Returns a warning about a small sample.

    The range of n participants covers on average (n - 1) / (n + 1) of the population.
    """
    share = (count - 1) / (count + 1)
    return (
        f"Only {count} participants: on average, {share:.0%} of other people are within their extremes. "
        "The ranges are imprecise."
    )
