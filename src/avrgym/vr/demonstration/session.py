"""Demonstration sessions: a human operator drives the robot in many short episodes, each with another simulated person.

An episode begins with the button ``start``. It ends with ``success`` or ``discard``, or at the time limit. The world of
the next episode is built in the meantime.
"""

from concurrent.futures import Executor

import msgspec
import numpy as np

from avrgym.models.human import Person
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.policies.registry import find_used_controller_plugin
from avrgym.recording import schema
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.schema import AttemptEnd
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.tasks.registry import find_environment, find_plugins, get_goal_description
from avrgym.tasks.settings import Settings
from avrgym.vr.demonstration.episode_worlds import DemonstrationPlan, EpisodeWorldPreparation
from avrgym.vr.demonstration.storage import DemonstrationFolder, EpisodeResult, EpisodeRow
from avrgym.vr.emulation.in_process_client import TRACKING_INTERVAL_TICKS
from avrgym.vr.live_world.drivers import OperatorDriver
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import MessageSender, ReceivedMessage
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.session.attempt import Attempt, make_attempt_configuration
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.reporting import STATUS_INTERVAL_TICKS, StateReporter, make_viewer_status
from avrgym.vr.tracking.tracking_state import TrackingState

DEMONSTRATION_RESULT_EVENT = "demonstration"
"""Name of the recorded event with the operator's assessment: ``success``, ``no success`` or ``discarded``."""
PERSON_UPDATE_INTERVAL_TICKS = 10
"""Interval in ticks at which the simulated person receives the pose of the robot's tool."""


class DemonstrationSession:
    """Runs and records the episodes at 100 Hz; implements ``RealTimeSession``.

    ``stage``: ``preparing`` (the next world is built), ``is_ready`` (waits for the start), ``running`` or ``finished``.
    ``world``: the current world.
    """

    def __init__(
        self,
        plan: DemonstrationPlan,
        folder: DemonstrationFolder,
        send: MessageSender,
        workers: Executor,
        *,
        driver: OperatorDriver | None = None,
        driven_by: str = "",
    ) -> None:
        """Build the first world.

        Args:
            plan: settings of the session.
            folder: stores the episodes. Episodes of earlier sessions in this folder are included in the number of
                episodes.
            send: receives all messages for clients.
            workers: builds the worlds.
            driver: drives the robot; default: the operator alone. A ``CorrectedDriver`` must have the policy of
                ``plan``.
            driven_by: name of the driver in the table; default: the role that drove last.

        Raises:
            ValueError: if no world can be built with these settings.
        """
        self.plan, self._folder, self._send = plan, folder, send
        self.scenes: list[tuple[str, Person, Settings]] = []
        self._worlds = EpisodeWorldPreparation(plan, workers, folder.num_samples)
        self._driven_by = driven_by
        self._driver = driver or OperatorDriver()
        self._failure_message = ""
        self._plugins = find_plugins(plan.environment)
        used = find_used_controller_plugin(plan.policy)
        if used is not None:
            self._plugins = (*self._plugins, used)
        self._reporter = StateReporter(send)
        self.attempt: Attempt | None = None
        self._mark = ""
        self._now_s, self._ticks = 0.0, 0
        self._floor = Registration(np.zeros(3), 0.0)
        self.stage: messages.DemonstrationStage = "preparing"
        self._enter_next_world()

    @property
    def world(self) -> LiveWorld:
        """The world of the running or next episode."""
        return self._current.world

    @property
    def is_at_rest(self) -> bool:
        """Whether no episode runs. The robot and the person then do not move."""
        return self.stage != "running"

    def send_initial_state(self, send: MessageSender, role: messages.Role, now_s: float) -> None:
        """Send welcome, scene, phase and progress to a new connection with this role."""
        name = self.plan.environment
        send(messages.Welcome(messages.PROTOCOL_VERSION, name, role, haptics=True, sounds=True))
        send(self._scene())
        send(self._phase())
        send(self._progress())

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Handle a message of a client; ignores messages that only other sessions use."""
        match message:
            case messages.DemonstrationCommand():
                self._press(message.button)
            case messages.VelocityCommand():
                self._refuse(self._driver.apply_velocity_command(message, now_s), message.source)
            case messages.ControllerPoseCommand():
                self._refuse(self._driver.apply_controller_pose(message, now_s), "demonstrator")
            case messages.DemonstratorDisconnected():
                self._release("driver_left")
            case messages.ExperimenterCommand(name="stop"):
                self._driver.stop_robot()
            case messages.ExperimenterCommand(name="skip"):
                self._press("discard")
            case messages.ExperimenterCommand(name="end"):
                self._end_episode("discarded")
                self._change_stage("finished")
            case _:
                pass

    def tick(self, now_s: float) -> None:
        """Advance the session by 10 ms. ``now_s``: the time on the session's clock."""
        self._now_s = now_s
        self._ticks += 1
        if self._driver.is_overdue(now_s):
            self._release("driver_stale")
        step = None
        if self.stage in ("ready", "running"):
            step = self._advance()
        elif self.stage == "preparing" and self._worlds.is_ready:
            self._enter_next_world()
        if self._ticks % STATUS_INTERVAL_TICKS == 0:
            self._send(self._status())
        if self.attempt is not None:
            self.attempt.submit_records()
        if step is not None:
            self._finish_step(step)

    def close(self, now_s: float) -> None:
        """End the session. A running episode is stored as interrupted."""
        self._now_s = now_s
        self._end_episode("interrupted")
        self._driver.close()
        self._worlds.close()

    def wait_for_writes(self) -> None:
        """Wait until most records are written. Call it in sessions that run faster than real time."""
        if self.attempt is not None:
            self.attempt.wait_for_writes()

    # Buttons and driver ----------------------------------------------------------------------------------------------

    def _press(self, button: messages.DemonstrationButton) -> None:
        if button == "start" and self.stage == "ready":
            self._begin_episode()
        elif button == "success" and self.stage == "running":
            self._mark = "success"
        elif button == "discard" and self.stage in ("ready", "running"):
            self._end_episode("discarded")
            self._leave_world()

    def _refuse(self, problem: str, role: messages.OperatorRole) -> None:
        if problem:
            self._send(
                messages.Problem(problem, "demonstrator" if role == "demonstrator" else "experimenter")
            )

    def _release(self, event: str) -> None:
        """Stop the robot, because its operator left or sends nothing. ``event``: name of the recorded event."""
        driver = self._driver.active_operator
        self._driver.stop_robot()
        if self.attempt is not None and driver:
            force_n = float(self.world.simulation.get_tool_net_force_n()[0])
            self._record_event(event, f"{driver}; contact force of the tool {force_n:.1f} N")

    # Episodes --------------------------------------------------------------------------------------------------------

    def _enter_next_world(self) -> None:
        self._current = self._worlds.pop_world()
        world, participant = self._current.world, self._current.participant
        self._tracking = TrackingState()
        self.scenes.append((world.environment_id, world.person, world.settings))
        world.prepare_driver(self._driver, force_guard=self.plan.has_force_guard)
        scene = self._scene()
        participant.receive(scene)
        self._send(scene)
        self._change_stage("ready")

    def _leave_world(self) -> None:
        planned = self.plan.episodes
        if planned is not None and self._folder.count_episodes("completed") >= planned:
            self._change_stage("finished")
        elif self._worlds.is_ready:
            self._enter_next_world()
        else:
            self._change_stage("preparing")

    def _advance(self) -> FirstWorldStep | None:
        world, attempt = self.world, self.attempt
        moving = self.stage == "running"
        if self._ticks % TRACKING_INTERVAL_TICKS == 0:
            frame = self._current.participant.make_tracking_frame(self._now_s, moving=moving)
            self._tracking.add_frame(frame, self._now_s)
            if self._tracking.registration is None and frame.head is not None:
                self._tracking.determine_registration(frame.head, world.person, world.scene_config.posture)
        followed = self._tracking.update(world.task.tracked_body_parts, self._now_s)
        if followed.target_pose is not None:
            world.follow_pose(followed.target_pose)
        if attempt is not None:
            attempt.record_frames(followed)
            attempt.record_joint_targets(world.joint_targets_rad, self._now_s)
        step = world.tick(self._driver if moving else None)
        if attempt is not None:
            attempt.record_physics(world, self._now_s)
        self._reporter.tick(world, self._tracking, step)
        if moving and self._ticks % PERSON_UPDATE_INTERVAL_TICKS == 0:
            self._current.participant.receive(self._reporter.make_state(world, self._tracking))
        return step

    def _begin_episode(self) -> None:
        world = self.world
        world.stop_robot()
        try:
            self.attempt = Attempt(
                self._folder.recordings_folder,
                self._folder.count_episodes("completed") + 1,
                self._configuration,
                self._now_s,
            )
        except OSError as error:
            self._send(
                messages.Problem(
                    f"the episode cannot be recorded: {error}; check the disk, and start the episode again",
                    "experimenter",
                )
            )
            return
        self._tracking.pop_arrived_frames()
        self.attempt.record_physics(world, self._now_s)
        world.prepare_driver(self._driver, force_guard=self.plan.has_force_guard)
        self._mark = self._failure_message = ""
        self._record_event("phase", "trial")
        self._change_stage("running")

    def _finish_step(self, step: FirstWorldStep) -> None:
        attempt = self.attempt
        if attempt is None:
            return
        attempt.record_step(step, self._driver.latest_operator, self._driver.is_idle, self._now_s)
        self._record_policy_failure()
        if attempt.recording_error is not None:
            self._send(
                messages.Problem(
                    f"the recording failed, and the episode has ended: {attempt.recording_error}",
                    "experimenter",
                )
            )
            self._end_episode("interrupted")
            self._leave_world()
        elif self._mark or attempt.steps >= self.plan.steps:
            self._end_episode("completed")
            self._leave_world()

    def _record_policy_failure(self) -> None:
        """Record and report the start and the end of each failure of the policy."""
        failure = self._driver.failure_message
        if failure == self._failure_message:
            return
        self._failure_message = failure
        self._record_event("controller_failed" if failure else "controller_drives", failure)
        if failure:
            problem = f"the robot holds its position, because its policy failed: {failure}; drive it yourself"
            self._send(messages.Problem(problem, "experimenter"))

    def _end_episode(self, result: EpisodeResult) -> None:
        """End a running episode. Store its recording and its row in the table."""
        attempt, self.attempt = self.attempt, None
        self._driver.stop_robot()
        if attempt is None:
            return
        marked = result == "completed" and self._mark == "success"
        mark = ("success" if marked else "no success") if result == "completed" else result
        attempt.record("/events", schema.Event(DEMONSTRATION_RESULT_EVENT, mark), self._now_s)
        if result != "completed":
            attempt.record("/events", schema.Event("robot_holds", result), self._now_s)
        end: AttemptEnd = "repeated" if result == "discarded" else result
        failure = attempt.close(end, self._now_s)
        if failure is not None:
            self._send(messages.Problem(f"the recording is incomplete: {failure}", "experimenter"))
            result = "interrupted"
        person = self.world.person
        row = EpisodeRow(
            episode=attempt.trial_number,
            attempt=attempt.number,
            recording=str(attempt.recording_file.relative_to(self._folder.folder)),
            environment=self.plan.environment,
            people=self._current.population_name,
            impairment=self._current.impairment,
            sample=self._current.person_sample_number,
            seed=self._current.seed,
            sex=person.sex,
            torso_height_m=person.torso_height_m,
            result=result,
            success=marked,
            task_success=attempt.success,
            steps=attempt.steps,
            driven_by=self._driven_by or self._driver.latest_operator,
        )
        self._folder.append_episode(row)

    def _configuration(self, number: int) -> TrialConfiguration:
        plan, world = self.plan, self.world
        trial = TrialPlan(
            plan.environment, plan.policy, self._current.seed, practice=False, questionnaire_items=()
        )
        session = SessionPlan(
            [trial],
            world.person.sex,
            0.0,
            is_simulated=True,
            trial_steps=plan.steps,
            has_force_guard=plan.has_force_guard,
            withdraw_tool_after_success=False,
            settings=plan.settings,
        )
        registration = self._tracking.registration or self._floor
        place = registration.xr_from_world()
        made = make_attempt_configuration(
            session, 0, number, world, place, self._folder.folder.name, self._plugins
        )
        return msgspec.structs.replace(made, trial_number=self._folder.count_episodes("completed") + 1)

    def _record_event(self, name: str, detail: str) -> None:
        if self.attempt is not None:
            self.attempt.record("/events", schema.Event(name, detail), self._now_s)

    # Messages --------------------------------------------------------------------------------------------------------

    def _change_stage(self, stage: messages.DemonstrationStage) -> None:
        self.stage = stage
        self._send(self._phase())
        self._send(self._progress())

    def _scene(self) -> messages.Scene:
        return self.world.make_scene_message(len(self.scenes) - 1, self._floor)

    def _phase(self) -> messages.PhaseDescription:
        text = f"{self.plan.environment}: {self.stage}"
        return messages.PhaseDescription(
            name="viewing", text=text, trial=0, trials=0, practice=False, seconds=None
        )

    def _progress(self) -> messages.DemonstrationProgress:
        folder = self._folder
        return messages.DemonstrationProgress(
            stage=self.stage,
            goal=get_goal_description(find_environment(self.plan.environment)[0], self.plan.settings),
            episodes=self.plan.episodes,
            completed=folder.count_episodes("completed"),
            successes=folder.count_episodes("completed", success=True),
            discarded=folder.count_episodes("discarded"),
            seconds=self.plan.steps / self.plan.settings.control_hz,
            policy="" if self.plan.policy == OPERATOR_POLICY_NAME else self.plan.policy,
        )

    def _status(self) -> messages.SessionStatus:
        attempt, world = self.attempt, self.world
        return make_viewer_status(
            world.simulation,
            attempt.latest_step if attempt else None,
            environment=self.plan.environment,
            torso_height_m=world.person.torso_height_m,
            episode=self._folder.count_episodes("completed") + 1,
            step=attempt.steps if attempt else 0,
            steps=self.plan.steps,
            reward=attempt.total_reward if attempt else 0.0,
            success=attempt.success if attempt else False,
            operated=True,
            idle=self._driver.is_idle,
            retracting=world.guard is not None and bool(world.guard.retracting_mask[0]),
        )
