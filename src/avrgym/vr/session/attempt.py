"""One attempt at a trial: its recording and its results. A trial is repeated until an attempt is completed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.elementary import compute_c_library_fingerprint
from avrgym.models import human
from avrgym.models.body_names import TRACKED_BODY_PARTS
from avrgym.people.motor_model import MOTION_VERSION
from avrgym.recording import schema
from avrgym.recording.configuration import BodyModel, HeadsetCheck, TrialConfiguration, Versions
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.recording.reader import RecordingError
from avrgym.recording.writer import RecordingWriter
from avrgym.system.files import make_private_folder
from avrgym.system.used_plugins import UsedPlugin, get_avrgym_version
from avrgym.tasks.constants import SIMULATION_VERSION
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import XRPose
from avrgym.vr.session.plan import SessionPlan
from avrgym.vr.tracking.tracking_state import TrackingUpdate

ConfigurationFactory = Callable[[int], TrialConfiguration]
"""Function that returns the configuration of the attempt with a given number."""


@dataclass(frozen=True)
class AttemptResults:
    """Results of an attempt until now: success, force on the person (mean, maximum), and mean tool speed."""

    success: bool = False
    force_mean_n: float = 0.0
    force_max_n: float = 0.0
    tool_speed_mean_m_s: float = 0.0

    def add_step(self, step: FirstWorldStep, steps: int) -> "AttemptResults":
        """Returns the results after another control step. ``steps`` is the number of steps, including this one."""
        outcome = step.outcome
        force_n, speed_m_s = (
            float(outcome.force_on_person_n[0]),
            float(outcome.tool_speed_m_s[0]),
        )
        return AttemptResults(
            success=bool(outcome.success[0]),
            force_mean_n=self.force_mean_n + (force_n - self.force_mean_n) / steps,
            force_max_n=max(self.force_max_n, force_n),
            tool_speed_mean_m_s=self.tool_speed_mean_m_s + (speed_m_s - self.tool_speed_mean_m_s) / steps,
        )


class Attempt:
    """The running attempt at a trial, with its recording.

    Arguments in seconds are times on the session's clock. Recorded times start at 0 with the attempt.
    ``trial_number`` and ``number``: numbers of the trial and of the attempt, from 1. ``steps``: number of control
    steps. ``total_reward``: sum of their rewards. ``latest_step``: the latest control step.
    """

    def __init__(
        self,
        folder: Path,
        trial: int,
        configure: ConfigurationFactory,
        began_s: float,
        *,
        first_number: int = 1,
    ) -> None:
        """Open the recording of a new attempt. Its number is the first number without a file in ``folder``.

        Args:
            folder: the folder of recordings; created if it is missing.
            trial: the trial's number, from 1.
            configure: returns the configuration of the attempt with a given number.
            began_s: the current time.
            first_number: number of the first attempt in this folder; earlier attempts are in other folders.

        Raises:
            OSError: if no recording can be opened.
        """
        self.start_time_s = began_s
        self.steps, self.total_reward, self.attempt_results = 0, 0.0, AttemptResults()
        self.trial_number = trial
        self.latest_step: FirstWorldStep | None = None
        self._told_of_stall = False
        self._targets_rad: FloatArray | None = None
        self._records: list[tuple[str, int, schema.Record]] = []
        self._finished: schema.Outcome | None = None
        self.number, self._recording = _open(folder, trial, configure, first_number)

    @property
    def success(self) -> bool:
        """Whether the task has succeeded in this attempt until now."""
        return self.attempt_results.success

    @property
    def recording_file(self) -> Path:
        """The path of the recording's file."""
        return self._recording.path

    @property
    def recording_error(self) -> Exception | None:
        """The error that makes the recording incomplete; ``None`` without an error. A slow disk is not an error."""
        error = self._recording.disk_error
        return None if isinstance(error, TimeoutError) else error

    def pop_slow_disk_error(self) -> TimeoutError | None:
        """Returns the error of a slow disk once, then ``None``."""
        error = self._recording.disk_error
        if not isinstance(error, TimeoutError) or self._told_of_stall:
            return None
        self._told_of_stall = True
        return error

    def wait_for_writes(self) -> None:
        """Wait until most records are written. Call it in sessions that run faster than real time."""
        self._recording.wait_for_writes()

    def record(self, topic: str, record: schema.Record, now_s: float) -> None:
        """Add a record with the time ``now_s``. The next ``submit_records`` writes it."""
        self._records.append((topic, round((now_s - self.start_time_s) * 1e9), record))

    def submit_records(self) -> None:
        """Pass the records to the thread that writes them.

        Call it at the end of a tick. Otherwise both threads compete for Python's interpreter lock, and a tick needs
        twice the time.
        """
        recorded, self._records = self._records, []
        for record in recorded:
            self._recording.write(*record)
        if self._finished is not None:
            self._recording.write_robot_outcome(self._finished)
            self._finished = None

    def record_physics(self, world: LiveWorld, now_s: float) -> None:
        """Record the simulator's state after this tick, and the action if it changed."""
        if world.applied_action is not None:
            action = world.applied_action.tolist()
            self.record("/commands", schema.Command(self.steps + 1, action, world.is_braked), now_s)
        state = schema.Physics(self.steps, world.time_s, world.integration_state().tolist())
        self.record("/physics", state, now_s)

    def record_joint_targets(self, joint_targets_rad: FloatArray, now_s: float) -> None:
        """Record the person's joint targets if they have changed."""
        if self._targets_rad is None or not np.array_equal(joint_targets_rad, self._targets_rad):
            self._targets_rad = joint_targets_rad
            self.record("/body_targets", schema.BodyTargets(joint_targets_rad.tolist()), now_s)

    def record_pacing(self, world: LiveWorld, step: FirstWorldStep, now_s: float) -> None:
        """Record the state of the pacing layer, if the trial has this layer. Call it after ``record_step``."""
        pacing = world.pacing
        if pacing is None:
            return
        record = schema.Pacing(
            step=self.steps,
            mode=pacing.get_mode_name(0),
            speed_factor=float(pacing.speed_factor[0]),
            preferred_distance_m=float(pacing.preferred_distance_m[0]),
            preferred_side=float(pacing.preferred_side[0]),
            tool_distance_m=float(pacing.tool_distance_m[0]),
            tool_speed_m_s=float(step.outcome.tool_speed_m_s[0]),
        )
        self.record("/pacing", record, now_s)

    def record_step(self, step: FirstWorldStep, driver: str, idle: bool, now_s: float) -> None:
        """Count and record a finished control step; see ``schema.Control``."""
        outcome = step.outcome
        self.latest_step = step
        self.steps += 1
        self.total_reward += float(outcome.reward[0])
        self.attempt_results = self.attempt_results.add_step(step, self.steps)
        self.record("/control", make_control_record(self.steps, step, driver, idle), now_s)

    def record_robot_finish(self, now_s: float) -> None:
        """Records that the robot has finished; ``submit_records`` writes this record. After a crash, the attempt is
        then considered completed."""
        self._finished = self._outcome("completed", now_s)

    def record_frames(self, followed: TrackingUpdate) -> None:
        """Record tracking frames in the order of arrival.

        The newest frame moved all parts of the body, except the parts in the record's ``rejected_parts``.
        """
        deviating = [
            part
            for part in TRACKED_BODY_PARTS
            if part in followed.deviating_parts or part in followed.untracked_needed_parts
        ]
        for frame in followed.arrived_frames:
            tracking, applied = frame.tracking, frame is followed.newest_frame
            record = schema.TrackingFrame(
                sequence=tracking.sequence,
                client_time_ms=tracking.client_time_ms,
                received_time_s=frame.received_s - self.start_time_s,
                moved_person=applied,
                rejected=followed.is_stale or not frame.is_usable,
                rejected_parts=deviating if applied else [],
                untracked_parts=list(followed.untracked_parts) if applied else [],
                left_modality=tracking.left_modality,
                right_modality=tracking.right_modality,
                head=_recorded(tracking.head),
                left=_recorded(tracking.left),
                right=_recorded(tracking.right),
            )
            self.record("/tracking", record, frame.received_s)

    def close(self, result: schema.AttemptEnd, now_s: float) -> RecordingError | None:
        """Close the recording. Returns the error that makes it incomplete; ``None`` without an error."""
        self.submit_records()
        try:
            self._recording.close(self._outcome(result, now_s))
        except RecordingError as error:
            return error
        return None

    def _outcome(self, result: schema.AttemptEnd, now_s: float) -> schema.Outcome:
        return schema.Outcome(
            result=result,
            steps=self.steps,
            reward=self.total_reward,
            success=self.success,
            seconds=now_s - self.start_time_s,
        )


def make_control_record(number: int, step: FirstWorldStep, driver: str, idle: bool) -> schema.Control:
    """Returns the record of the attempt's control step with this number, from 1."""
    outcome = step.outcome
    return schema.Control(
        step=number,
        observation=step.observation.tolist(),
        action=step.action.tolist(),
        reward=float(outcome.reward[0]),
        reward_terms={name: float(term[0]) for name, term in outcome.reward_terms.items()},
        success=bool(outcome.success[0]),
        distance_m=float(outcome.distance_m[0]),
        force_on_person_n=float(outcome.force_on_person_n[0]),
        driver=driver,
        idle=idle,
    )


def read_package_versions() -> Versions:
    """Returns the versions of Python and of the installed packages, for a recording."""
    return Versions(get_avrgym_version(), mujoco.__version__)


def make_attempt_configuration(
    plan: SessionPlan,
    index: int,
    attempt: int,
    world: LiveWorld,
    xr_from_world: XRPose,
    session: str,
    plugins: Sequence[UsedPlugin],
    headset: HeadsetCheck | None = None,
    input_profile: InputProfile = DEFAULT_INPUT_PROFILE,
) -> TrialConfiguration:
    """Returns the configuration of an attempt at the trial with this ``index`` in the plan."""
    trial, person = plan.trials[index], world.person
    return TrialConfiguration(
        session=session,
        environment=trial.environment,
        policy=trial.policy,
        seed=trial.seed,
        practice=trial.practice,
        goal=plan.find_goal_text(trial),
        needed_parts=tuple(world.task.tracked_body_parts),
        trial_number=index + 1,
        attempt_number=attempt,
        planned_steps=plan.trial_steps,
        simulated=plan.is_simulated,
        motion_version=MOTION_VERSION,
        person=BodyModel(person.sex, person.torso_height_m, person.skin_tone, person.arm_scale),
        start_angles_rad=tuple(person.joint_angles_rad.tolist()),
        episode_start=world.episode_start,
        joint_names=tuple(human.JOINTS),
        body_names=tuple(world.bodies),
        xr_from_world=schema.Pose(list(xr_from_world.position), list(xr_from_world.orientation)),
        language=plan.texts.language,
        force_guard=plan.has_force_guard,
        withdraw_after_success=plan.withdraw_tool_after_success,
        free_movement_s=plan.free_movement_s,
        stop_rules=plan.stop_rules.rules,
        headset_check=headset,
        consent=plan.consent,
        proxy_consent=plan.proxy_consent,
        respondent=plan.respondent,
        input_profile=input_profile,
        settings=plan.find_trial_settings(trial),
        trial_rules=trial.rules,
        furniture=plan.furniture,
        reward_weights=dict(world.task.reward_weights),
        items=tuple(plan.find_questionnaire_items(trial)),
        versions=read_package_versions(),
        plugins=tuple(plugins),
        world_version=SIMULATION_VERSION,
        c_library=compute_c_library_fingerprint(),
    )


def _open(
    folder: Path, trial: int, configure: ConfigurationFactory, number: int
) -> tuple[int, RecordingWriter]:
    """Create the recording of a new attempt. Returns the attempt's number and the recording.

    The number is the first, starting from ``number``, for which no file exists.
    """
    make_private_folder(folder)
    while True:
        path = folder / f"trial-{trial:02}_attempt-{number}.mcap"
        try:
            return number, RecordingWriter(path, configure(number))
        except FileExistsError:
            number += 1


def _recorded(pose: XRPose | None) -> schema.Pose | None:
    return None if pose is None else schema.Pose(list(pose.position), list(pose.orientation))
