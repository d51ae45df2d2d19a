"""Episodes of N worlds: how they begin, one control step, what it was worth.

The Gymnasium environments and the live VR trial both run on this.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import choose_index, moved_to, namespace
from avrgym.models import robot
from avrgym.models.human import People, Person
from avrgym.people import cooperation, distributions, impairments, shoulder_limits
from avrgym.people.arm_clearance import furniture_boxes
from avrgym.people.distributions import Pose
from avrgym.people.population_names import Impairment
from avrgym.people.populations import Population, TrainedHumans
from avrgym.people.zoo import partners
from avrgym.robots.registry import find_robot
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.simulation.room import SWING_M, Conflict, NoRoomError, Room
from avrgym.simulation.worlds import Simulation, Start, State
from avrgym.system.engines import THREADS
from avrgym.tasks.actions import DeviceActions, checked_actions
from avrgym.tasks.company import find_company
from avrgym.tasks.control_loop import ControlLoop, Step
from avrgym.tasks.human_view import HumanView
from avrgym.tasks.minds import Minds
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.tasks.task import EpisodeStart, StepResult, TaskState, replace_worlds, state_arrays

EFFORT = "action_squared"
"""The reward term of an agent's own effort."""
MOST_DRAWS = 100
"""How often a start is drawn anew where things would stand in each other."""
_WHO, _CHANCE = 2, 3
"""Which of the uniform numbers of a mind say who of several kinds is met, and what chance a trained human acts with:
those that no mind of a trained human uses."""
_CHANGING = ("people", "task_state", "draws", "_arm_start_rad")
"""What of ``Episodes`` its episodes change, beside the simulation and the people's minds."""


class Episodes:
    """N worlds of one environment, each with a random stream of its own, so that none affects another."""

    def __init__(
        self,
        environment_id: str,
        num_worlds: int,
        *,
        distribution: str = "original",
        person: Person | None = None,
        impairment: str = "none",
        moving: bool = False,
        num_threads: int = 0,
        by_region: bool = False,
        steered: bool = False,
        engine: str = THREADS,
        on_device: bool = False,
        withdraw_after_success: bool = False,
        force_guard: bool = False,
    ) -> None:
        """Compile the scene.

        Args:
            environment_id: such as ``avrgym/FeedingJaco-v1``.
            num_worlds: N.
            distribution: whom to meet, a name in ``people.distributions.NAMED_DISTRIBUTIONS``, a file of people, a
                trained human or a folder of them.
            person: one fixed person for every episode instead.
            impairment: a name in ``people.impairments.IMPAIRMENTS``.
            moving: whether the people's joints are driven from outside, with ``command_person``.
            num_threads: threads for the physics; 0 takes one per core.
            steered: whether people go where ``steer_people`` has them go, in place of moving by themselves, trained
                humans too.
            by_region: whether forces are measured by region of the body, see ``Simulation.region_force_n``.
            engine: where physics runs, one of ``simulation.engines.engine.ENGINES``.
            on_device: whether control steps stay on that engine's device: ``step`` takes and gives tensors, and copies
                nothing to the host; ``check`` then has to be asked. Episodes begin on the host all the same.
            withdraw_after_success: whether the robot withdraws its tool once a task that ``ends_with_success`` is
                complete, see ``safety.withdrawal``. Steps that the withdrawal drives are not rewarded: their reward
                and its terms are 0.
            force_guard: whether a force guard overrides actions that endanger people, see ``safety.force_guard``.

        Raises:
            ValueError: for an unknown environment, distribution, impairment or engine, naming what there is,
                or for more worlds than there is memory for.
            RuntimeError: where what the engine needs is not installed.
        """
        if withdraw_after_success and engine != THREADS:
            raise ValueError(f"withdraw_after_success needs the engine {THREADS}, not {engine}")
        if force_guard and on_device:
            raise ValueError(
                f"force_guard reads forces on the host; allowed with {engine}: force_guard without on_device"
            )
        task, robot = find_environment(environment_id)
        self._made_with = {
            "distribution": distribution,
            "person": person,
            "impairment": impairment,
            "moving": moving,
            "num_threads": num_threads,
            "by_region": by_region,
            "steered": steered,
            "engine": engine,
            "on_device": on_device,
            "withdraw_after_success": withdraw_after_success,
            "force_guard": force_guard,
        }
        self.environment_id = environment_id
        self.task = TASKS[task]
        self.person = person
        asked: Impairment = impairments.find_impairment(impairment)
        self._kinds = [
            replace(kind, impairment=kind.impaired(asked))
            for kind in find_company(distribution, environment_id)
        ]
        trained = [kind.trained for kind in self._kinds if kind.trained is not None]
        if on_device and (trained or steered):
            raise ValueError(
                f"who is steered, or trained, acts on threads; allowed with {engine}: other people"
            )
        self._humans = TrainedHumans(trained, num_worlds) if trained and not (steered or moving) else None
        steered = steered or self._humans is not None
        partners_there = any(kind.distribution.partners is not None for kind in self._kinds)
        self._swing_m = (
            SWING_M if partners_there or any(kind.impairment == "tremor" for kind in self._kinds) else 0.0
        )
        self._moved_by_themselves = not moving and (
            steered
            or any(
                kind.distribution.moving or kind.impairment in impairments.MOVING_IMPAIRMENTS
                for kind in self._kinds
            )
        )
        self.scene = self.task.scene(find_robot(robot))
        self.action_size = len(self.scene.arm.joints)
        """How many numbers an action has: one for each joint of the arm."""
        self.offered_joints = cooperation.OFFERED_JOINTS[self.task.offered]
        """The person's joints that ``steer_people`` drives, by name."""
        self.observation = self.task.observation(self.scene)
        self.human_view = HumanView(self.task.offered, self.observation)
        self._furniture = furniture_boxes(self.scene.furniture)
        self.simulation = Simulation(
            self.scene,
            num_worlds,
            moving=moving or self._moved_by_themselves or self.task.strength_share is not None,
            num_threads=num_threads,
            by_region=by_region or force_guard,
            gliding=self._moved_by_themselves and (steered or partners_there),
            engine=engine,
            on_device=on_device,
        )
        self._room = self._room_of_scene(led=moving and person is not None)
        there = self.simulation.exemplar
        self._meet(distributions.repeat_person(person or Person(), num_worlds))
        self.task_state = moved_to(
            self.task.init_state(self.people, np.zeros((num_worlds, self.task.uniforms))), there
        )
        self._minds = Minds(
            self._kinds[0].distribution,
            self.people,
            self.task.offered,
            self.scene.posture,
            steered=steered,
            beside=there,
        )
        self._device_actions = DeviceActions(num_worlds, self.action_size, there) if on_device else None
        self._arm_start_rad = np.zeros((num_worlds, len(self.scene.arm.joints)))
        self.draws = np.zeros(num_worlds, dtype=int)
        """How often the starts of the present episodes were drawn, (N,)."""
        self.loop = ControlLoop(self, force_guard=force_guard, withdraw_after_success=withdraw_after_success)
        """Steps the worlds."""

    def __getstate__(self) -> dict[str, Any]:
        """How it was made, and where its episodes are: a copy goes on to the same bits.

        A file of people is read again by the copy.
        """
        return {
            "environment_id": self.environment_id,
            "num_worlds": self.simulation.num_worlds,
            "made_with": self._made_with,
            "simulation": self.simulation.saved(),
            "minds": self._minds.saved(),
            "humans": None if self._humans is None else self._humans.saved(),
            "loop": self.loop.saved(),
            "changing": {name: getattr(self, name) for name in _CHANGING},
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["environment_id"], state["num_worlds"], **state["made_with"])
        self.simulation.go_on_from(state["simulation"])
        self._minds.go_on_from(state["minds"])
        if self._humans is not None:
            self._humans.go_on_from(state["humans"])
        self.loop.restore(state["loop"])
        for name, value in state["changing"].items():
            setattr(self, name, value)
        self._meet(self.people)

    def _meet(self, people: People) -> None:
        """Have these people in the worlds: as they began, on the host, and as steps see them, where those are."""
        self.people = people
        self._people = moved_to(people, self.simulation.exemplar)

    def begin(self, ids: IntArray, generators: Sequence[np.random.Generator]) -> FloatArray:
        """Begin episodes in worlds ``ids`` (n,), each drawn from its generator; give observations (n, O).

        A start where things stand in each other is drawn again from the generator's next numbers, see
        ``simulation.room``.

        Raises:
            NoRoomError: a ``ValueError``, when ``MOST_DRAWS`` starts of a world all were such.
        """
        drawn_from = dict(zip(ids.tolist(), generators, strict=True))
        self.draws[ids] = 0
        crowded = ids
        while len(crowded):
            self._draw(crowded, [drawn_from[world] for world in crowded.tolist()])
            self.draws[crowded] += 1
            conflicts = self._conflicts(crowded)
            crowded = np.array(sorted(conflicts), dtype=np.intp)
            for world in crowded[self.draws[crowded] == MOST_DRAWS].tolist():
                person = self.people.person(world)
                raise NoRoomError(
                    f"{self.environment_id}: none of {MOST_DRAWS} starts has room beside a {person.sex} with a torso "
                    f"of {person.torso_height_m:.2f} m: in the last one {conflicts[world]}"
                )
        self.loop.reset(ids)
        return self.observe()[ids]

    def start(self, world: int) -> EpisodeStart:
        """The start of a world's episode, without its person. Valid until the first step is evaluated."""
        pos_w, q_w = self.simulation.robot_base()
        return EpisodeStart(
            robot_pos_w=pos_w[world].tolist(),
            robot_q_w=q_w[world].tolist(),
            arm_angles_rad=self._arm_start_rad[world].tolist(),
            placed_pos_w={name: pos[world].tolist() for name, pos in self.simulation.placed_pos_w().items()},
            memory={name: array[world].tolist() for name, array in state_arrays(self.task_state).items()},
        )

    def begin_as(self, start: EpisodeStart) -> None:
        """Begin an episode in the first world from a stored start, with the fixed person.

        Raises:
            KeyError, TypeError, ValueError: for a start of another environment.
        """
        first = np.array([0])
        task_state = {
            name: np.array(start.memory[name], array.dtype).reshape(array[:1].shape)
            for name, array in state_arrays(self.task_state).items()
        }
        placed = {name: np.array([start.placed_pos_w[name]]) for name in self.scene.movable}
        pos_w, q_w, angles = (
            np.array([values], float) for values in (start.robot_pos_w, start.robot_q_w, start.arm_angles_rad)
        )
        self._meet(distributions.repeat_person(self.person or Person(), 1))
        self._put(first, Start(self.people, pos_w, q_w, angles, placed), type(self.task_state)(**task_state))

    def _draw(self, ids: IntArray, generators: Sequence[np.random.Generator]) -> None:
        """Draw a start for each of worlds ``ids`` (n,) and put them into it."""
        parts = np.cumsum(
            [
                distributions.NUM_UNIFORMS,
                impairments.NUM_UNIFORMS,
                cooperation.NUM_UNIFORMS,
                self.task.uniforms,
            ]
        )
        uniforms = np.stack([generator.random(int(parts[-1])) for generator in generators])
        for_people, for_impairments, for_minds, for_task = np.split(uniforms, parts[:-1], axis=1)
        of_kind = choose_index(for_minds[:, _WHO], len(self._kinds))
        who = self._draw_people(self._kinds[0], for_people, for_impairments, for_minds)
        for number, kind in enumerate(self._kinds[1:], start=1):
            (rows,) = np.nonzero(of_kind == number)
            others = self._draw_people(kind, for_people[rows], for_impairments[rows], for_minds[rows])
            who = replace_worlds(who, others, rows)
        self._meet(replace_worlds(self.people, who, ids))
        self._minds.begin(ids, who, for_minds)
        if self._humans is not None:
            self._humans.begin(ids, of_kind, for_minds[:, _CHANCE])
        self._put(ids, self.task.start(self.scene, who, for_task), self.task.init_state(who, for_task))

    def _put(self, ids: IntArray, start: Start, task_state: TaskState) -> None:
        self.simulation.reset(ids, replace(start, people=self._with_strength(start.people)))
        self._arm_start_rad[ids] = start.arm_angles_rad
        self.task_state = replace_worlds(self.task_state, task_state, ids)

    def _with_strength(self, people: People) -> People:
        """The people with what strength the task leaves them."""
        share = self.task.strength_share
        return people if share is None else replace(people, strength_share=share * people.strength_share)

    def _conflicts(self, ids: IntArray) -> dict[int, Conflict]:
        """What lacks room, in those of worlds ``ids`` (n,) where anything does, by world.

        People who tremble reach two other poses within their first moment; in the zoo anybody may.
        """
        found = self._lacking_room(ids)
        if self._moved_by_themselves:
            for direction in (-1.0, 1.0):
                trembling = self.people.joint_angles_rad + direction * self.people.tremor_rad
                self.simulation.pose_people(ids, _possible(self.people, trembling)[ids])
                found |= self._lacking_room(ids, self._swing_m)
            self.simulation.pose_people(ids, self.people.joint_angles_rad[ids])
        return found

    def _lacking_room(self, ids: IntArray, swing_m: float | None = None) -> dict[int, Conflict]:
        conflicts = self._room.conflicts(self.simulation.geoms(ids), swing_m=swing_m)
        return {world: conflict for world, conflict in zip(ids.tolist(), conflicts, strict=True) if conflict}

    def step(self, actions: FloatArray, recorder: RegionLoadRecorder | None = None) -> Step:
        """Take one control step of 0.1 s with actions (N, J), see ``ControlLoop.step``.

        Raises:
            ValueError: for actions that ``checked`` rejects; nothing has moved then.
        """
        return self.loop.step(actions, recorder)

    def checked(self, actions: FloatArray) -> FloatArray:
        """Returns actions (N, J) that can be executed.

        On a device, actions must be tensors of its precision there; ``check`` reports numbers that are not finite.

        Raises:
            ValueError: for another shape, type or device, or numbers that are not finite.
        """
        if self._device_actions is not None:
            return self._device_actions.checked(actions)
        return checked_actions(actions, (self.simulation.num_worlds, self.action_size))

    def command(self, actions: FloatArray) -> None:
        """Command the robots with checked actions (N, J), and people who move by themselves with their targets."""
        self.simulation.command_robot(actions)
        if self._humans is not None:
            self.steer_people(self._humans.act(self.observe_as_human()))
        if self._moved_by_themselves:
            targets = self._minds.live(self.simulation.state, self._people, self._possible)
            self.simulation.command_person(targets)

    def check(self) -> None:
        """Check the results so far on a device; call it once an episode.

        Raises:
            RuntimeError: see ``Engine.check``.
            ValueError: for actions that were not finite.
        """
        self.simulation.check()
        if self._device_actions is not None:
            self._device_actions.raise_invalid()

    def steer_people(self, action: FloatArray) -> None:
        """Say where steered people go in the control step that is commanded next.

        Args:
            action: (N, K), how fast each of ``offered_joints`` goes, -1 to 1 of the speed of unhurried people, see
                ``people.zoo.movement``; what lies beyond is clipped, and no joint goes where it cannot.
        """
        self._minds.steer(self.offered_joints, action, self._possible)

    def evaluate_step(self, actions: FloatArray, unrewarded: BoolArray | None = None) -> Step:
        """Evaluate the control step that ends now, executed with actions (N, J); remove particles that left the task.

        Rewards and their terms become 0 in the worlds ``unrewarded`` (N,).
        """
        state = self.simulation.state()
        clipped = namespace(actions).clip(actions, -1.0, 1.0)
        result = self.task.evaluate_step(state, clipped, self.task_state)
        self.task_state = result.task_state
        self.simulation.park(result.gone)
        if unrewarded is not None:
            terms = {name: np.where(unrewarded, 0.0, term) for name, term in result.terms.items()}
            result = replace(result, terms=terms)
        return self._step(state, result, actions)

    def assess(self) -> Step:
        """Evaluate the present state as after a step of zero actions; the tasks' states do not change."""
        state = self.simulation.state()
        rest = moved_to(np.zeros((self.simulation.num_worlds, self.action_size)), self.simulation.exemplar)
        return self.loop.annotate(
            self._step(state, self.task.evaluate_step(state, rest, self.task_state), rest), rest
        )

    def _step(self, state: State, result: StepResult, actions: FloatArray) -> Step:
        return Step(
            observation=self.observation.of(state, self.task_state),
            reward=self.task.reward(result.terms),
            reward_terms=result.terms,
            success=result.success,
            distance_m=result.distance_m,
            force_on_person_n=result.force_on_person_n,
            tool_speed_m_s=transforms.norm(state.tool_velocity_w),
            events=result.events,
            executed_action=actions,
        )

    def state(self) -> State:
        """What tasks and experts see now."""
        return self.simulation.state()

    def observe(self) -> FloatArray:
        """Observations (N, O) of the present state."""
        return self.observation.of(self.simulation.state(), self.task_state)

    def observe_as_human(self) -> FloatArray:
        """What the people observe of the present state, (N, H), see ``HumanView``; of people whose joints move."""
        return self.human_view.of(self.human_view.seen_in(self.simulation, self.task_state))

    def human_reward(self, step: Step, action: FloatArray, *, shared: bool) -> FloatArray:
        """The reward (N,) of people who acted (N, K) in a step: the robots', or, not shared, with their own effort.

        Then their own squared action stands in the place of the robots'.
        """
        weight = self.task.weights.get(EFFORT, 0.0)
        if shared or not weight:
            return step.reward
        acted = np.clip(action, -1.0, 1.0)
        return step.reward + weight * ((acted * acted).sum(axis=-1) - step.reward_terms[EFFORT])

    def marks_w(self) -> FloatArray:
        """Where the task's marks are now, (N, ``task.marks.count``, 3), world frame; none without marks."""
        if self.task.marks is None:
            return np.zeros((self.simulation.num_worlds, 0, 3))
        return self.task.marks.places(self.simulation.right_arm(), self.task_state)

    def person_in(self, world: int) -> Person:
        """The person of a world's present episode."""
        return self.people.person(world)

    def _possible(self, joint_angles_rad: FloatArray) -> FloatArray:
        return _possible(self._people, joint_angles_rad)

    def _room_of_scene(self, *, led: bool) -> Room:
        """What measures the room here; ``led`` people hold their arms as they do, whatever the furniture."""
        return Room(
            self.simulation.model,
            base=None if self.scene.mount.on_floor else robot.PREFIX + self.scene.robot.base,
            arms=not led,
            offered=self.person is None and any(self._pose_of(kind).spreads_arm for kind in self._kinds),
        )

    def _pose_of(self, kind: Population) -> Pose:
        return kind.distribution.pose_in(self.task.name, self.task.pose)

    def _draw_people(
        self, kind: Population, uniforms: FloatArray, for_impairments: FloatArray, for_minds: FloatArray
    ) -> People:
        """People (n,) of a kind, in their bodies."""
        if self.person is not None:
            who = distributions.repeat_person(self.person, len(uniforms))
        else:
            who = distributions.sample_people(
                kind.distribution, self._pose_of(kind), self.scene.posture, self._furniture, uniforms
            )
        if kind.distribution.partners is not None:
            who = partners.apply_partner_bodies(who, kind.distribution.partners.draw(for_minds[:, :2]))
        return impairments.apply_impairment(who, kind.impairment, for_impairments)


def _possible(people: People, joint_angles_rad: FloatArray) -> FloatArray:
    """Joint angles (N, 20) brought to where these people's joints can go."""
    return shoulder_limits.clip(impairments.clip_to_ranges(people, joint_angles_rad))
