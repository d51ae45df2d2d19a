"""``Episodes``: episodes in N worlds, with reset, control step and reward.

Gymnasium environments, training, evaluation, live trials and replay use this class.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray, NumpyArray
from avrgym.commands.preferences import TrialRules
from avrgym.commands.vocabulary import CommandName
from avrgym.geometry import transforms
from avrgym.geometry.arrays import get_namespace, to_device_of
from avrgym.models import robot as robot_model
from avrgym.models.cameras import CameraSpec
from avrgym.models.human import People, Person
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.people import cooperation
from avrgym.people.zoo.commanding_partners import DEFAULT_COMMAND_RULES
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.simulation.start_clearance import ClearanceConflict, InitialClearanceChecker, NoClearanceError
from avrgym.simulation.worlds import InitialState, Simulation, State
from avrgym.system.engine_names import THREADS
from avrgym.tasks import world_people
from avrgym.tasks.actions import DeviceActionValidator, validate_actions
from avrgym.tasks.control_loop import ControlLoop, StepOutcome
from avrgym.tasks.human_observation import HumanObserver
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import (
    EpisodeStart,
    StepResult,
    TaskState,
    compute_joint_strength_fractions,
    get_task_state_arrays,
    replace_task_states,
)
from avrgym.tasks.world_people import WorldPeople, clip_joint_angles

if TYPE_CHECKING:
    from avrgym.tasks.camera_images import CameraImageRenderer

ACTION_PENALTY_TERM = "action_squared"
"""Name of the reward term of the action penalty. The value of this term is different for the two agents, robot and
human.
"""
MAX_TOOL_POSITION_ERROR_M = 0.01
"""Maximum distance of the tool from its intended initial position, if settings move the base or the table."""
MAX_REACH_SAMPLES = 10
"""Maximum number of initial states that are sampled until the error is below ``MAX_TOOL_POSITION_ERROR_M``."""
MAX_START_SAMPLES = 100
"""Maximum number of initial states that are sampled until no bodies overlap."""


class Episodes:
    """Episodes in N worlds of one environment.

    Each world has its own random stream. Worlds do not affect each other.
    """

    def __init__(
        self,
        environment_id: str,
        num_worlds: int,
        *,
        people: str = "original",
        person: Person | None = None,
        impairment: str = "none",
        moving: bool = False,
        num_threads: int = 0,
        by_region: bool = False,
        human_actions: bool = False,
        engine: str = THREADS,
        on_device: bool = False,
        withdraw_after_success: bool = False,
        force_guard: bool = False,
        rules: TrialRules | None = None,
        settings: Settings = DEFAULT_SETTINGS,
    ) -> None:
        """Compile the scene, and create the worlds.

        Args:
            environment_id: environment id such as ``avrgym/FeedingJaco-v1``.
            num_worlds: number N of worlds.
            people: a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a people file, a trained human or a folder
                of trained humans.
            person: one fixed person for every episode, instead of ``people``.
            impairment: a name in ``people.impairments.IMPAIRMENTS``.
            moving: whether the caller moves people's joints, with ``Simulation.command_person``.
            num_threads: number of threads for physics; 0 means one per core.
            by_region: whether forces are measured by region of the body, see ``Simulation.compute_region_force_n``.
            human_actions: whether people execute actions, see ``command_people``. Otherwise a behaviour model moves
                them.
            engine: name of the physics engine, one of ``simulation.engines.engine.ENGINE_CHOICES``.
            on_device: whether control steps run on the engine's device. ``step`` then takes and returns tensors,
                without copies to the host. Call ``check_device_results`` once per episode. The host computes initial
                states.
            withdraw_after_success: whether the robot withdraws its tool after success, see ``safety.withdrawal``. This
                applies to tasks that end with success. Steps that the withdrawal controls have reward 0.
            force_guard: whether a force guard overrides actions that endanger people, see ``safety.force_guard``.
            rules: allowed commands and preferences of the people, see ``safety.pacing``. With ``None``, people that
                give commands have ``DEFAULT_COMMAND_RULES``; other people have no pacing layer.
            settings: settings of scene and control that differ from the defaults.

        Raises:
            ValueError: for unknown names (the message lists the allowed names), and for more worlds than memory allows.
            RuntimeError: if a package that the engine needs is not installed.
        """
        if withdraw_after_success and engine != THREADS:
            raise ValueError(
                f"withdraw_after_success is not possible with engine {engine!r}; allowed: {THREADS}"
            )
        if person is not None and person.absent_arms and engine != THREADS:
            raise ValueError(f"absent_arms is not possible with engine {engine!r}; allowed: {THREADS}")
        if force_guard and on_device:
            raise ValueError(
                f"force_guard is not possible on a device; set on_device=False, or use engine {THREADS!r}"
            )
        self._made_with = {
            "people": people,
            "person": person,
            "impairment": impairment,
            "moving": moving,
            "num_threads": num_threads,
            "by_region": by_region,
            "human_actions": human_actions,
            "engine": engine,
            "on_device": on_device,
            "withdraw_after_success": withdraw_after_success,
            "force_guard": force_guard,
            "rules": rules,
            "settings": settings,
        }
        self.environment_id = environment_id
        self.settings = settings
        self.task, self.scene = find_task_and_scene(environment_id, settings)
        self._people = WorldPeople(
            people,
            environment_id,
            self.scene,
            num_worlds,
            person=person,
            impairment=impairment,
            driven=moving,
            human_actions=human_actions,
            settings=settings,
        )
        if rules is None and self._people.commands is not None:
            rules = DEFAULT_COMMAND_RULES
        if rules is not None and engine != THREADS:
            raise ValueError(
                f"rules for pacing and people that give commands are not possible with engine {engine!r}; "
                f"allowed: {THREADS}"
            )
        acts_each_step = self._people.is_moving and (self._people.needs_host or on_device)
        if acts_each_step and settings.control_hz != DEFAULT_SETTINGS.control_hz:
            raise ValueError(
                f"control_hz is {settings.control_hz}; allowed for people with human actions, with trained policies "
                f"or on a device: control_hz={DEFAULT_SETTINGS.control_hz}"
            )
        if on_device and self._people.needs_host:
            raise ValueError(
                "on_device is not possible for people with human actions or trained policies; "
                "set on_device=False, or use other people"
            )
        self.action_size = len(self.scene.action_names)
        """Length A of an action, see ``SceneConfig.action_names``."""
        self.offered_joints = cooperation.OFFERED_JOINTS[self.task.offered_body_part]
        """Names of the people's joints that ``command_people`` moves."""
        self.observation_spec = self.task.make_observation_spec(self.scene)
        self.human_observer = HumanObserver(self.task.offered_body_part, self.observation_spec)
        self.simulation = Simulation(
            self.scene,
            num_worlds,
            moving=moving or self._people.is_moving or self.task.strength_share is not None,
            num_threads=num_threads,
            by_region=by_region or force_guard,
            interpolate_person_targets=self._people.interpolates_targets,
            engine=engine,
            on_device=on_device,
        )
        if person is not None:
            self.simulation.set_absent_arms(person.absent_arms)
        self._clearance = InitialClearanceChecker(
            self.simulation.model,
            base=None
            if self.scene.mount.is_on_floor
            else robot_model.ROBOT_NAME_PREFIX + self.scene.robot.base,
            arms=not (moving and person is not None),
            offered=self._people.has_random_arm_pose,
            mirrored=self.scene.scene_in_task_frame.task_frame.is_mirrored,
        )
        there = self.simulation.reference_array
        self._people.create_people(there)
        self.task_state = to_device_of(
            self.task.make_initial_task_state(
                self.people, np.zeros((num_worlds, self.task.num_random_numbers))
            ),
            there,
        )
        self._device_actions = (
            DeviceActionValidator(num_worlds, self.action_size, there) if on_device else None
        )
        self._start_positions = np.zeros((num_worlds, len(self.scene.arm.joints)))
        self._tool_error_m = np.zeros(num_worlds)
        self.num_initial_state_samples = np.zeros(num_worlds, dtype=int)
        """Number of samples (N,) until the current episodes had a valid initial state."""
        self._images: CameraImageRenderer | None = None
        self.control_loop = ControlLoop(
            self, force_guard=force_guard, withdraw_after_success=withdraw_after_success, rules=rules
        )
        """The control loop that steps the worlds."""

    def __getstate__(self) -> dict[str, Any]:
        """Returns arguments and state for copying and pickling. A copy continues bit-identically, and reads a people
        file again.
        """
        return {
            "environment_id": self.environment_id,
            "num_worlds": self.simulation.num_worlds,
            "made_with": self._made_with,
            "simulation": self.simulation.snapshot(),
            "people": self._people.snapshot(),
            "loop": self.control_loop.snapshot(),
            "task_state": self.task_state,
            "start_draws": self.num_initial_state_samples,
            "arm_start_rad": self._start_positions,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["environment_id"], state["num_worlds"], **state["made_with"])
        self.simulation.restore(state["simulation"])
        self._people.restore(state["people"])
        self.control_loop.restore(state["loop"])
        self.task_state, self.num_initial_state_samples = state["task_state"], state["start_draws"]
        self._start_positions = state["arm_start_rad"]

    @property
    def people(self) -> People:
        """Body parameters (N,) of the people in the current episodes."""
        return self._people.people

    def set_person(self, person: Person) -> None:
        """Use a fixed person in all worlds and all following episodes."""
        self._people.fixed_person = person
        self.simulation.set_absent_arms(person.absent_arms)

    def reset(self, ids: IntArray, generators: Sequence[np.random.Generator]) -> FloatArray:
        """Start episodes in worlds ``ids`` (n,), each sampled with its generator. Returns observations (n, O).

        Initial states with overlapping bodies are resampled, see ``simulation.start_clearance``.

        Raises:
            NoClearanceError: a ``ValueError``, after ``MAX_START_SAMPLES`` invalid initial states of a world.
        """
        generator_of = dict(zip(ids.tolist(), generators, strict=True))
        self.num_initial_state_samples[ids] = 0
        invalid = ids
        while len(invalid):
            self._draw(invalid, [generator_of[world] for world in invalid.tolist()])
            self.num_initial_state_samples[invalid] += 1
            conflicts, far = (
                self._conflicts(invalid),
                invalid[self._tool_error_m[invalid] > MAX_TOOL_POSITION_ERROR_M],
            )
            for world in far[self.num_initial_state_samples[far] >= MAX_REACH_SAMPLES].tolist():
                raise NoClearanceError(
                    f"{self.environment_id}: with {self.settings} the arm does not reach the tool's start position in "
                    f"{MAX_REACH_SAMPLES} initial states; in the last one the distance is "
                    f"{self._tool_error_m[world]:.2f} m; change these settings"
                )
            invalid = np.union1d(np.array([*conflicts], dtype=np.intp), far)
            for world in invalid[self.num_initial_state_samples[invalid] == MAX_START_SAMPLES].tolist():
                person = self.people.get_person(world)
                raise NoClearanceError(
                    f"{self.environment_id}: none of {MAX_START_SAMPLES} initial states has enough clearance "
                    f"next to a {person.sex} with a torso of {person.torso_height_m:.2f} m: "
                    f"in the last one {conflicts.get(world, 'the tool is out of reach')}; choose another person, mount "
                    "or task pose"
                )
        self.control_loop.reset(ids)
        return self.observe()[ids]

    def get_episode_start(self, world: int) -> EpisodeStart:
        """Returns the initial state of a world's episode, without the person. Call it before the first step."""
        pos_w, q_w = self.simulation.get_initial_base_pose()
        return EpisodeStart(
            robot_pos_w=pos_w[world].tolist(),
            robot_q_w=q_w[world].tolist(),
            joint_positions=self._start_positions[world].tolist(),
            placed_pos_w={
                name: pos[world].tolist() for name, pos in self.simulation.get_furniture_pos_w().items()
            },
            memory={
                name: array[world].tolist() for name, array in get_task_state_arrays(self.task_state).items()
            },
        )

    def reset_to_episode_start(self, start: EpisodeStart) -> None:
        """Start an episode in the first world from a stored initial state, with the person of ``set_person``.

        Raises:
            KeyError, TypeError, ValueError: for an initial state of another environment.
        """
        first = np.array([0])
        task_state = {
            name: np.array(start.memory[name], array.dtype).reshape(array[:1].shape)
            for name, array in get_task_state_arrays(self.task_state).items()
        }
        placed = {name: np.array([start.placed_pos_w[name]]) for name in self.scene.movable_bodies}
        pos_w, q_w, angles = (
            np.array([values], float)
            for values in (start.robot_pos_w, start.robot_q_w, start.joint_positions)
        )
        self._people.reset_to_fixed_person()
        self._put(
            first, InitialState(self.people, pos_w, q_w, angles, placed), type(self.task_state)(**task_state)
        )

    def _draw(self, ids: IntArray, generators: Sequence[np.random.Generator]) -> None:
        """Sample an initial state for each of the worlds ``ids`` (n,), and set the worlds to these states."""
        count = world_people.NUM_RANDOM_NUMBERS + self.task.num_random_numbers
        uniforms = np.stack([generator.random(count) for generator in generators])
        people = self._people.reset(ids, uniforms[:, : world_people.NUM_RANDOM_NUMBERS])
        for_task = uniforms[:, world_people.NUM_RANDOM_NUMBERS :]
        self._put(
            ids,
            self.task.sample_initial_states(self.scene, people, for_task),
            self.task.make_initial_task_state(people, for_task),
        )

    def _put(self, ids: IntArray, start: InitialState, task_state: TaskState) -> None:
        self.simulation.reset(ids, replace(start, people=self._with_strength(start.people)))
        self._tool_error_m[ids] = 0.0 if start.tool_position_error_m is None else start.tool_position_error_m
        self._start_positions[ids] = start.joint_positions
        self.task_state = replace_task_states(self.task_state, task_state, ids)

    def _with_strength(self, people: People) -> People:
        """Returns the people with their joint strength multiplied by ``Task.strength_share``, if the task has one."""
        share = self.task.strength_share
        if share is None:
            return people
        return replace(
            people, strength_share=people.strength_share[:, None] * compute_joint_strength_fractions(share)
        )

    def _conflicts(self, ids: IntArray) -> dict[int, ClearanceConflict]:
        """Returns pairs of bodies without enough clearance in worlds ``ids`` (n,), by world.

        If a behaviour model moves the people, the two extreme poses of their tremor are checked too.
        """
        found = self._insufficient_clearance(ids)
        if self._people.is_moving:
            for direction in (-1.0, 1.0):
                trembling = self.people.joint_angles_rad + direction * self.people.tremor_rad
                self.simulation.set_people_joint_angles(ids, clip_joint_angles(self.people, trembling)[ids])
                found |= self._insufficient_clearance(ids, self._people.extra_clearance_m)
            self.simulation.set_people_joint_angles(ids, self.people.joint_angles_rad[ids])
        return found

    def _insufficient_clearance(
        self, ids: IntArray, extra_clearance_m: float | None = None
    ) -> dict[int, ClearanceConflict]:
        conflicts = self._clearance.find_conflicts(
            self.simulation.get_geoms(ids), extra_clearance_m=extra_clearance_m
        )
        return {world: conflict for world, conflict in zip(ids.tolist(), conflicts, strict=True) if conflict}

    def step(self, actions: FloatArray, recorder: RegionLoadRecorder | None = None) -> StepOutcome:
        """Take one control step with actions (N, A), see ``ControlLoop.step``. Returns its result.

        Raises:
            ValueError: for actions that ``validate_actions`` rejects. The worlds are then unchanged.
        """
        return self.control_loop.step(actions, recorder)

    def validate_actions(self, actions: FloatArray) -> FloatArray:
        """Check actions (N, A). Returns them as an array.

        On a device, actions must be tensors on this device in single precision. ``check_device_results`` reports
        numbers that are not finite.

        Raises:
            ValueError: for a wrong shape, type or device, or numbers that are not finite.
        """
        if self._device_actions is not None:
            return self._device_actions.validate_actions(actions)
        return validate_actions(actions, (self.simulation.num_worlds, self.action_size))

    def command_robots(self, actions: FloatArray) -> None:
        """Command the robots with validated actions (N, A), and set the joint targets of moving people."""
        self.simulation.command_robot(actions)
        if self._people.trained_humans is not None:
            self.command_people(self._people.trained_humans.act(self.observe_humans()))
        if not self._people.moves_every_physics_step:
            self._command_people_by_themselves()

    def _command_people_by_themselves(self) -> None:
        if self._people.is_moving:
            self.simulation.command_person(*self._people.step(self.simulation.get_state))

    def generate_partner_commands(
        self, waiting: BoolArray, speed_factor: FloatArray
    ) -> Iterable[tuple[CommandName, BoolArray]]:
        """Returns the commands of simulated people for the next control step, each with a mask (N,) of worlds.

        ``waiting`` (N,) and ``speed_factor`` (N,) are the mask of waiting robots and the speed factors of the pacing
        layer.
        """
        if self._people.commands is None:
            return ()
        return self._people.commands.step(waiting, speed_factor, self.scene.control_step_s)

    def step_physics(self, substep: int, count: int) -> None:
        """Advances all worlds by ``count`` physics steps. The first is step ``substep`` of the control step.

        This also moves people with a behaviour model. ``count`` divides ``DEFAULT_SUBSTEPS``.
        """
        if self._people.moves_every_physics_step:
            targets = self._people.advance_joint_targets(self.simulation.get_state, count)
            self.simulation.step(count, targets)
            return
        if substep > 0 and substep % DEFAULT_SUBSTEPS == 0:
            self._command_people_by_themselves()
        self.simulation.step(count)

    def check_device_results(self) -> None:
        """Check all results on a device since the last check. Call it once per episode.

        Raises:
            RuntimeError: if the contacts or constraints of a world exceeded the engine's memory.
            ValueError: for actions that were not finite.
        """
        self.simulation.check_overflow()
        if self._device_actions is not None:
            self._device_actions.raise_if_invalid()

    def command_people(self, action: FloatArray) -> None:
        """Command the people's joints for the next control step.

        Args:
            action: (N, K), speed of each of ``offered_joints``, divided by its maximum
                ``people.motor_model.MAX_JOINT_SPEED_RAD_S``. Values are clipped to [−1, 1]. No joint exceeds its range.
        """
        self._people.command_joint_targets(action)

    def evaluate_step(self, actions: FloatArray, unrewarded: BoolArray | None = None) -> StepOutcome:
        """Returns the result of the finished control step, given its actions (N, A).

        This also removes particles that are no longer needed. Rewards and their terms become 0 in the worlds of the
        mask ``unrewarded`` (N,).
        """
        state = self.simulation.get_state()
        clipped = get_namespace(actions).clip(actions, -1.0, 1.0)
        result = self.task.evaluate_step(state, clipped, self.task_state)
        self.task_state = result.task_state
        self.simulation.remove_particles(result.removed_particles_mask)
        if unrewarded is not None:
            terms = {name: np.where(unrewarded, 0.0, term) for name, term in result.reward_terms.items()}
            result = replace(result, reward_terms=terms)
        return self._step(state, result, actions)

    def evaluate_state(self) -> StepOutcome:
        """Returns the result of a step with zero actions that ends in the current state. Task states do not change."""
        state = self.simulation.get_state()
        rest = to_device_of(
            np.zeros((self.simulation.num_worlds, self.action_size)), self.simulation.reference_array
        )
        return self.control_loop.add_interventions(
            self._step(state, self.task.evaluate_step(state, rest, self.task_state), rest), rest
        )

    def _step(self, state: State, result: StepResult, actions: FloatArray) -> StepOutcome:
        return StepOutcome(
            observation=self.observation_spec.compute(state, self.task_state),
            reward=self.task.compute_reward(result.reward_terms),
            reward_terms=result.reward_terms,
            success=result.success,
            distance_m=result.distance_m,
            force_on_person_n=result.force_on_person_n,
            tool_speed_m_s=transforms.norm(state.tool_velocity_w),
            num_events=result.num_events,
            executed_action=actions,
        )

    def get_state(self) -> State:
        """Returns the current physical state of all worlds, for tasks and experts."""
        return self.simulation.get_state()

    def observe(self) -> FloatArray:
        """Returns the observations (N, O) of the current state."""
        return self.observation_spec.compute(self.simulation.get_state(), self.task_state)

    def observe_humans(self) -> FloatArray:
        """Returns the observations (N, H) of the human agents, see ``HumanObserver``."""
        return self.human_observer.compute(self.human_observer.make_inputs(self.simulation, self.task_state))

    def compute_human_reward(self, step: StepOutcome, action: FloatArray, *, shared: bool) -> FloatArray:
        """Returns the reward (N,) of people with actions (N, K).

        If ``shared``, it is the reward of the robots. Otherwise the action penalty of the people replaces that of the
        robots.
        """
        weight = self.task.reward_weights.get(ACTION_PENALTY_TERM, 0.0)
        if shared or not weight:
            return step.reward
        acted = np.clip(action, -1.0, 1.0)
        return step.reward + weight * ((acted * acted).sum(axis=-1) - step.reward_terms[ACTION_PENALTY_TERM])

    def render_images(
        self, cameras: Sequence[CameraSpec], worlds: Iterable[int] | None = None
    ) -> dict[str, NumpyArray]:
        """Returns images (n, ...) of the current state of some or all worlds, by the names of their entries.

        The first call compiles the models with visual geometry. Rendering changes no state.

        Raises:
            RuntimeError: if rendering fails. The message contains a setting that may help.
        """
        if self._images is None or self._images.cameras != tuple(cameras):
            from avrgym.tasks.camera_images import CameraImageRenderer  # loads a graphics library

            self.close_renderer()
            self._images = CameraImageRenderer(self, cameras)
        return self._images.render_images(worlds)

    def close_renderer(self) -> None:
        """Free the graphics memory that ``render_images`` uses."""
        if self._images is not None:
            self._images.close()
            self._images = None

    def compute_marker_positions_w(self) -> FloatArray:
        """Returns the positions (N, ``task.markers.count``, 3) of the task's markers in the world frame."""
        if self.task.markers is None:
            return np.zeros((self.simulation.num_worlds, 0, 3))
        return self.task.markers.compute_positions_w(self.simulation.get_arm_poses(), self.task_state)

    def get_person(self, world: int) -> Person:
        """Returns the person in the current episode of a world."""
        person, fixed = self.people.get_person(world), self._people.fixed_person
        return person if fixed is None else replace(person, absent_arms=fixed.absent_arms)
