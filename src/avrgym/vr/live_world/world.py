"""The world that a participant sits in: one scene with a moving person, stepped tick by tick."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.human import Person
from avrgym.models.scene import SUBSTEPS, SceneConfig
from avrgym.safety.force_guard import ForceGuard
from avrgym.safety.retreat import Retreat
from avrgym.safety.withdrawal import Withdrawal
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.episodes import Episodes, Step
from avrgym.tasks.task import Task
from avrgym.vr.live_world.drivers import Driver, still
from avrgym.vr.live_world.scene_message import poses, scene_message
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.tracking.body import BodyPose, BodySolver, skeleton

BRAKED_TICKS = 30
"""So long the brakes hold between what drove the robot and its retreat, until it is at rest."""
Act = Callable[[FloatArray], FloatArray]
Amend = Callable[[], FloatArray | None]


@dataclass(frozen=True)
class ControlStep:
    """One finished control step: the observation (O,) it began with, its last action (7,), and what it gave.

    ``withdrawing``: the robot withdrew after success, or waited withdrawn.
    """

    observation: FloatArray
    action: FloatArray
    outcome: Step
    withdrawing: bool = False


class ControlSteps:
    """Control steps of 0.1 s of the first world, taken in ticks of 10 ms."""

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._observation = np.zeros((1, episodes.observation.size))
        self._action = np.zeros((1, episodes.action_size))
        self._substep = 0
        self._seen: FloatArray | None = None
        """The observation (1, O) of the present state, where the last control step ended with it."""
        self.begun: FloatArray | None = None
        """The action (7,) that the latest tick began with, if it gave the robot one."""
        self.braked = False
        """Whether the brakes hold the robot where its latest action is zero."""

    def tick(
        self, act: Act | None, amend: Amend = lambda: None, *, brakes: bool = False
    ) -> ControlStep | None:
        """Advance by 10 ms. With ``act``, from observations to actions, every tenth tick gives a control step.

        At the ticks between, ``amend`` may give another action (1, 7) for what is left of the step. With ``brakes`` an
        action of zeros brakes the robot.
        """
        self.begun = None
        if act is not None and self._substep == 0:
            self._begin_step(act, brakes)
        elif act is not None:
            self._amend_step(amend, brakes)
        self._seen = None
        self._episodes.simulation.step(1)
        if act is None:
            return None
        self._substep = (self._substep + 1) % SUBSTEPS
        if self._substep:
            return None
        outcome = self._episodes.evaluate_step(self._action)
        self._seen = outcome.observation
        return ControlStep(self._observation[0], self._action[0], outcome)

    def move(self, action: FloatArray | None, *, brakes: bool = False) -> None:
        """Advance by 10 ms outside all control steps; with an action (1, A) the robot goes so from now on."""
        self.begun = None
        if action is not None:
            self._command(action, brakes)
        self._seen = None
        self._episodes.simulation.step(1)

    def _begin_step(self, act: Act, brakes: bool) -> None:
        self._observation = self._episodes.observe() if self._seen is None else self._seen
        self._command(act(self._observation).astype(float), brakes)

    def _amend_step(self, amend: Amend, brakes: bool) -> None:
        action = amend()
        if action is not None:
            self._episodes.command_robot(action)
            self._note(action, brakes)

    def _command(self, action: FloatArray, brakes: bool) -> None:
        self._episodes.command(action)
        self._note(action, brakes)

    def _note(self, action: FloatArray, brakes: bool) -> None:
        self._action, self.begun = action, action[0]
        self.braked = brakes and not action.any()
        if self.braked:
            self._episodes.simulation.halt_robot()

    @property
    def moving(self) -> bool:
        """Whether the latest action moves the robot."""
        return bool(self._action.any())

    def drop(self) -> None:
        """Forget a control step that had begun, and its action."""
        self._substep = 0
        self._action = np.zeros_like(self._action)
        self.begun = self._seen = None


class LiveWorld:
    """One world whose person follows a participant and whose robot somebody drives when told to.

    A driver acts at 10 Hz, physics and person run at 100 Hz.
    """

    def __init__(self, environment_id: str, person: Person) -> None:
        """Compile the scene for a person.

        Raises:
            ValueError: for an unknown environment, naming what there is.
        """
        self._episodes = Episodes(
            environment_id, 1, person=person, moving=True, num_threads=1, by_region=True
        )
        self.guard = ForceGuard(self._episodes.simulation)
        self._solver = BodySolver(person, self._episodes.scene.posture)
        self._steps = ControlSteps(self._episodes)
        self.person = person
        self.joint_targets_rad = person.joint_angles_rad
        self.ticks = 0
        self.begin(seed=0)

    @property
    def action_begun(self) -> FloatArray | None:
        """The action (7,) that the latest tick began with, if it gave the robot one."""
        return self._steps.begun

    @property
    def braked(self) -> bool:
        """Whether the brakes hold the robot where its latest action is zero."""
        return self._steps.braked

    @property
    def bodies(self) -> tuple[str, ...]:
        """The bodies of the scene, in the order of their poses."""
        return self._episodes.simulation.bodies

    @property
    def simulation(self) -> Simulation:
        """The physics."""
        return self._episodes.simulation

    @property
    def environment(self) -> str:
        """The environment's id."""
        return self._episodes.environment_id

    @property
    def scene_config(self) -> SceneConfig:
        """What stands in the scene."""
        return self._episodes.scene

    @property
    def task(self) -> Task:
        """The task."""
        return self._episodes.task

    @property
    def time_s(self) -> float:
        """Simulated time since the world was made; it never jumps back."""
        return self.ticks * TICK_S

    def begin(self, seed: int) -> None:
        """Put robot, furniture and food at the start of an episode; the person stays as they sit.

        ``seed`` is that of the start, and of a policy's chance.

        Raises:
            NoRoomError: a ``ValueError``, where the person is in the way of every start.
        """
        self._episodes.person = replace(self.person, joint_angles_rad=self.joint_targets_rad)
        self._generators = [np.random.default_rng(seed)]
        self._episodes.begin(np.array([0]), self._generators)
        self.start = self._episodes.start(0)
        self._retreat = Retreat(self._episodes.simulation)
        self._withdrawal = Withdrawal(self._episodes.simulation)
        self.hold()

    def follow(self, pose: BodyPose) -> None:
        """Let the person's joints go where the participant's head and hands are."""
        self.joint_targets_rad = self._solver.solve(pose, self.joint_targets_rad)
        self._episodes.simulation.command_person(self.joint_targets_rad[None])

    def hold(self) -> None:
        """Stop the robot where it is; a control step that had begun is dropped."""
        self._episodes.simulation.halt_robot()
        self._steps.drop()
        self._retreated_ticks: int | None = None

    def retreat(self) -> None:
        """Stop the robot and let it take its tool away, once an episode; see ``safety.retreat``."""
        self.hold()
        self._retreated_ticks = 0

    @property
    def retreating(self) -> bool:
        """Whether the robot still takes its tool away."""
        return self._retreated_ticks is not None

    def prepare(self, driver: Driver) -> None:
        """Let somebody get ready to drive the robot of the present episode."""
        self._held, self._asked = False, still(self._episodes)
        driver.begin(self._episodes, self._generators)
        self.guard.begin()

    @property
    def withdrawing(self) -> bool:
        """Whether the robot withdraws after success, or waits withdrawn."""
        return bool(self._withdrawal.driving[0])

    def tick(
        self, driver: Driver | None, *, guarded: bool = False, withdraws: bool = False, held: bool = False
    ) -> ControlStep | None:
        """Advance by 10 ms. With a driver who is prepared the robot moves; every tenth tick gives a control step.

        ``guarded``: what the driver asks for goes through ``guard``, and what that makes of it counts as the action.
        ``withdraws``: after success in a task that ends with it the robot withdraws in place of the driver.
        ``held``: the brakes hold the robot in place of what the driver asks for, and in its retreat. A guard that acts
        moves it.
        """
        self.ticks += 1
        if self._retreated_ticks is not None:
            self._tick_retreat(self._retreated_ticks, held=held)
            return None
        if driver is None:
            return self._steps.tick(None)
        withdrew = self.withdrawing
        act, amend = (self._withdraw, _nothing) if withdrew else (driver.act, driver.amend)
        act, amend = self._unless_held(act, amend, held=held)
        if guarded:
            step = self._steps.tick(
                lambda seen: self.guard.act(act(seen)), lambda: self._amended(amend()), brakes=held
            )
        else:
            step = self._steps.tick(act, amend, brakes=held)
        self._held = held
        if step is None or not (withdraws and self.task.ends_with_success):
            return step
        self._withdrawal.see(step.outcome.success, step.outcome.events)
        return replace(step, withdrawing=withdrew)

    def _withdraw(self, _seen: FloatArray) -> FloatArray:
        return self._withdrawal.led(np.zeros((1, self._episodes.action_size)))

    def _unless_held(self, act: Act, amend: Amend, *, held: bool) -> tuple[Act, Amend]:
        """The same, but a robot that is held stands still; who drives it sees all that happens meanwhile."""

        def act_unless_held(seen: FloatArray) -> FloatArray:
            self._asked = act(seen)
            return still(self._episodes) if held else self._asked

        def amend_unless_held() -> FloatArray | None:
            asked = amend()
            self._asked = self._asked if asked is None else asked
            if held == self._held:
                return None if held else asked
            return still(self._episodes) if held else self._asked

        return act_unless_held, amend_unless_held

    def _amended(self, asked: FloatArray | None) -> FloatArray | None:
        return self.guard.given if self.guard.amend(asked)[0] else None

    def _tick_retreat(self, ticks: int, *, held: bool) -> None:
        """Every 0.1 s the robot is told where to go on; when it is told nothing more it has left."""
        if held:
            self._steps.move(still(self._episodes) if self._steps.moving else None, brakes=True)
            return
        due = ticks >= BRAKED_TICKS and (ticks - BRAKED_TICKS) % SUBSTEPS == 0
        action = self._retreat.action() if due else None
        self._retreated_ticks = None if due and action is None else ticks + 1
        self._steps.move(None if action is None else action[None])

    def state_vector(self) -> FloatArray:
        """The simulator's integration state."""
        return self._episodes.simulation.integration_state()

    @property
    def skeleton(self) -> messages.Skeleton:
        """The person's measures."""
        return skeleton(self.person, self._episodes.scene.posture)

    def body_poses(self) -> bytes:
        """Poses of ``bodies`` and marks as the protocol's ``State`` wants them."""
        return poses(self._episodes)

    def scene(self, number: int, registration: Registration) -> messages.Scene:
        """What the client has to draw; ``number`` is that of the scene in its address."""
        return scene_message(number, self._episodes, registration)


def _nothing() -> None:
    """No other action during a control step."""
