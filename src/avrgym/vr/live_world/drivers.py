"""Drivers command the robot of a live world: policies, external controllers and human operators.

If a driver is late or fails, it returns zero actions. It does not raise an error.
"""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import SimpleQueue
from typing import Protocol

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.policies import controllers, registry
from avrgym.policies.cartesian_control import CartesianController
from avrgym.policies.controllers import Controller, ExternalController
from avrgym.policies.registry import ActionFunction, AnyPolicy, HumanOperator, ScriptedPolicy
from avrgym.policies.tool_servo import ToolServo
from avrgym.policies.trained_policies import Policy
from avrgym.tasks.episodes import Episodes
from avrgym.vr.protocol.messages import ControllerPoseCommand, OperatorRole, VelocityCommand, XRPose
from avrgym.vr.protocol.webxr import Pose, compute_controller_pose

RandomGenerators = Sequence[np.random.Generator]
"""Random generators of the episodes, one for each world."""

CONTROLLER_RESPONSE_TIMEOUT_S = 0.08
"""Maximum response time of an external controller in seconds. A control step lasts 0.1 s."""
SIMULATED_CONTROLLER_TIMEOUT_S = 10.0
"""Maximum response time in seconds in sessions in simulated time, which wait for the action."""
OPERATOR_COMMAND_TIMEOUT_S = 0.2
"""The robot stops if the operator sends no command for this time in seconds."""

EMPTY_ACTION = np.zeros((1, 0))
"""The action (1, 0) before the first episode. The number of joints is then unknown."""


def make_zero_action(episodes: Episodes) -> FloatArray:
    """Returns the action (1, A) with all values zero. It stops the robot."""
    return np.zeros((1, episodes.action_size))


class Driver(Protocol):
    """Commands the robot of a live world in all episodes of a session."""

    @property
    def failure_message(self) -> str:
        """Message of the current ``ControllerError``; empty without an error."""
        ...

    @property
    def is_idle(self) -> bool:
        """Whether the robot holds its position because there is no action."""
        ...

    def reset(self, episodes: Episodes, generators: RandomGenerators) -> None:
        """Prepare for the episode that has just started. ``generators`` contains the episode's random generator."""
        ...

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the action (1, A) at the start of a control step, from the observation (1, O) at this time."""
        ...

    def update_action(self) -> FloatArray | None:
        """Returns another action (1, A) at a later tick of the control step, or ``None`` to continue."""
        ...

    def close(self) -> None:
        """Stop the driver, and end its thread if it has one."""
        ...


def make_driver(policy: AnyPolicy, *, background: bool) -> Driver:
    """Returns the driver for a policy. ``background``: whether an external controller computes while the session
    continues."""
    if isinstance(policy, HumanOperator):
        return OperatorDriver()
    if isinstance(policy, ExternalController):
        return ThreadedDriver(policy, background=background)
    return SynchronousDriver(policy)


def _prepare(policy: AnyPolicy, episodes: Episodes) -> None:
    """Compiles the scene for rendering if the policy has cameras. If rendering is impossible, ``act`` reports the
    error."""
    with suppress(RuntimeError, ValueError):
        registry.warm_up_renderer(policy, episodes)


class SynchronousDriver:
    """Drives the robot with a policy of AVR Gym. Its action is computed within the tick."""

    def __init__(self, policy: Policy | ScriptedPolicy) -> None:
        self.failure_message = ""
        self._policy = policy
        self._act: ActionFunction | None = None

    @property
    def is_idle(self) -> bool:
        """Whether the robot holds its position because there is no action."""
        return self.failure_message != ""

    def reset(self, episodes: Episodes, generators: RandomGenerators) -> None:
        """Prepare for the episode that has just started. ``generators`` contains the episode's random generator."""
        self.failure_message, self._act = "", None
        self._episode, self._zero_action = (episodes, generators), make_zero_action(episodes)
        _prepare(self._policy, episodes)

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the action (1, A) at the start of a control step, from the observation (1, O) at this time."""
        try:
            act = self._act = self._act or registry.make_action_function(self._policy, *self._episode)
            action = controllers.compute_checked_action(lambda: act(observation), self._zero_action.shape)
        except Exception as error:  # an expert may fail in a rare state
            self.failure_message = str(controllers.to_controller_error(error))
            return self._zero_action
        self.failure_message = ""
        return action

    def update_action(self) -> FloatArray | None:
        """Returns ``None``: the action does not change within a control step."""

    def close(self) -> None:
        """Does nothing, because this driver has no thread."""


class ThreadedDriver:
    """Drives the robot with an external controller that runs in its own thread.

    The latest action remains active until the controller returns the next action. After a failure or a timeout, the
    robot holds its position. Late actions are ignored. The timeout is ``CONTROLLER_RESPONSE_TIMEOUT_S`` with
    ``background``, otherwise ``SIMULATED_CONTROLLER_TIMEOUT_S``. If the controller is still busy at the next episode,
    a new controller replaces it.
    """

    def __init__(self, factory: ExternalController, *, background: bool) -> None:
        self._controller_factory, self._background = factory, background
        self._limit_s = CONTROLLER_RESPONSE_TIMEOUT_S if background else SIMULATED_CONTROLLER_TIMEOUT_S
        self._timeout_message = f"late: no answer within {1000 * self._limit_s:.0f} ms"
        self._worker = ControllerThread(factory)
        self._ready = self._pending = None
        self._zero_action = EMPTY_ACTION
        self._hold("")

    @property
    def is_idle(self) -> bool:
        """Whether the robot holds its position because there is no action."""
        return self.failure_message != ""

    def reset(self, episodes: Episodes, generators: RandomGenerators) -> None:
        """Prepare for the episode that has just started. ``generators`` contains the episode's random generator."""
        if self._worker.is_busy:
            self._worker.close()
            self._worker = ControllerThread(self._controller_factory)
        seed, environment = registry.draw_controller_seed(generators[0]), episodes.environment_id
        self._ready = self._request(
            lambda controller: controllers.reset_controller(controller, seed, environment)
        )
        self._pending, self._zero_action = None, make_zero_action(episodes)
        self._episodes = episodes
        _prepare(self._controller_factory, episodes)
        self._hold("")

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the action (1, A) at the start of a control step, from the observation (1, O) at this time."""
        self._poll()
        if self._ready is None or not self._ready.is_done:
            self._hold(self._timeout_message)
        elif self._ready.failure_message:
            self._hold(self._ready.failure_message)
        elif self._pending is None:
            self._ask(observation)
            self._poll()
        return self._action

    def _ask(self, observation: FloatArray) -> None:
        """Requests the action for an observation (1, O) from the controller."""
        try:
            (row,) = registry.make_controller_observations(
                self._controller_factory, self._episodes, observation.copy()
            )
        except (RuntimeError, ValueError) as error:  # no image can be rendered
            self._hold(str(controllers.to_controller_error(error)))
            return
        count = self._zero_action.shape[1]
        self._pending = self._request(
            lambda controller: controllers.compute_controller_action(controller, row, count)
        )

    def update_action(self) -> FloatArray | None:
        """Returns the controller's action (1, A) if it has changed since the last call, else ``None``."""
        before = self._action
        self._poll()
        return None if self._action is before else self._action

    def close(self) -> None:
        """Close the controller after its last request."""
        waits = not self._background and not self._worker.is_busy
        self._worker.close()
        if waits:
            self._worker.join(self._limit_s)

    def _request(self, work: "ControllerCall") -> "ControllerRequest":
        request = self._worker.submit(work)
        if not self._background:
            request.wait(self._limit_s)
        return request

    def _poll(self) -> None:
        """Applies an action that has arrived. A late action is ignored."""
        pending = self._pending
        if pending is None:
            return
        if pending.is_done:
            self._pending = None
        if pending.elapsed_s > self._limit_s:
            self._hold(self._timeout_message)
        elif self._pending is None and pending.failure_message:
            self._hold(pending.failure_message)
        elif self._pending is None and pending.action is not None:
            self._action, self.failure_message = pending.action[None], ""

    def _hold(self, failure: str) -> None:
        self._action, self.failure_message = self._zero_action, failure


ControllerCall = Callable[[Controller], FloatArray | None]
"""A function that calls a controller, and returns the controller's action (``None`` without an action)."""


class ControllerRequest:
    """A request to an external controller, with its answer.

    ``answer``: the controller's action; ``None`` without an action. ``failure_message``: the error message; empty
    without an error. Both are set before ``is_done`` becomes true.
    """

    def __init__(self, work: ControllerCall) -> None:
        self._work, self._requested_s, self._ended_s = work, time.monotonic(), 0.0
        self._done = threading.Event()
        self.action: FloatArray | None = None
        self.failure_message = ""

    @property
    def is_done(self) -> bool:
        """Whether the controller has answered or failed."""
        return self._done.is_set()

    @property
    def elapsed_s(self) -> float:
        """Time in seconds from the request to its end, or until now if it is not done."""
        return (self._ended_s if self.is_done else time.monotonic()) - self._requested_s

    def run(self, get_controller: Callable[[], Controller]) -> None:
        """Call the controller. Stores its answer or its failure."""
        try:
            answer = self._work(get_controller())
        except (Exception, SystemExit) as error:  # external code may raise anything
            self.failure_message = str(controllers.to_controller_error(error))
        else:
            self.action = answer
        self._ended_s = time.monotonic()
        self._done.set()

    def wait(self, timeout_s: float) -> None:
        """Wait until the request is done, at most ``timeout_s``."""
        self._done.wait(timeout_s)


class ControllerThread:
    """Runs requests to one controller in order, in its own thread. The first request creates the controller."""

    def __init__(self, factory: ExternalController) -> None:
        self._controller_factory = factory
        self._controller: Controller | None = None
        self._latest: ControllerRequest | None = None
        self._queue: SimpleQueue[ControllerRequest | None] = SimpleQueue()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=factory.name, daemon=True)
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether at least one request is not done."""
        return self._latest is not None and not self._latest.is_done

    def submit(self, work: ControllerCall) -> ControllerRequest:
        """Adds a request to the end of the queue. Returns the request."""
        self._latest = request = ControllerRequest(work)
        self._queue.put(request)
        return request

    def close(self) -> None:
        """Close the controller after the requests in the queue, and end the thread."""
        if self._controller is not None and not self._closed:
            self.submit(controllers.close_controller)
        self._closed = True
        self._queue.put(None)

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread, at most ``timeout_s``."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while (request := self._queue.get()) is not None:
            request.run(self._get_controller)

    def _get_controller(self) -> Controller:
        self._controller = self._controller or self._controller_factory.make_controller()
        return self._controller


class OperatorDriver:
    """Drives the robot with the commands of one human operator at a time. Without commands, it does not move.

    The experimenter commands velocities of the hand. A demonstrator can also steer the tool with a controller, see
    ``policies.tool_servo``. The first operator with a command controls the robot. Control ends when this operator
    releases the robot, or sends no command for ``OPERATOR_COMMAND_TIMEOUT_S``.

    ``active_operator``: the role that controls the robot now, or ``None``. ``latest_operator``: the role that drove
    last in this control step.
    """

    failure_message = ""

    def __init__(self) -> None:
        self._hand: CartesianController | None = None
        self._servo: ToolServo | None = None
        self._zero_action = EMPTY_ACTION
        self._velocity: tuple[FloatArray, FloatArray] | None = None
        self._controller: Pose | None = None
        self._clutch: tuple[XRPose, float] | None = None
        self._commanded_s = 0.0
        self._changed = False
        self._refused: set[OperatorRole] = set()
        self.active_operator: OperatorRole | None = None
        self.latest_operator: str = "operator"

    @property
    def is_idle(self) -> bool:
        """Whether the robot holds its position because there is no command."""
        return self.active_operator is None

    def reset(self, episodes: Episodes, generators: RandomGenerators) -> None:
        """Prepare for the episode that has just started."""
        self._hand, self._zero_action = CartesianController(episodes.simulation), make_zero_action(episodes)
        self._servo = ToolServo(episodes.simulation, self._hand.arm_chain)
        self.latest_operator = "operator"
        self.stop_robot()

    def apply_velocity_command(self, command: VelocityCommand, now_s: float) -> str:
        """Apply a velocity command to the robot's hand. ``now_s``: the current time on the session's clock.

        Returns the reason if the command is rejected, once for each series of commands; otherwise an empty text.
        """
        if not command.engaged:
            self._leave(command.source)
        elif self._is_free(command.source):
            self._drive_by(command.source, now_s)
            self._controller = self._clutch = None
            self._velocity = _in_world(command.linear), _in_world(command.angular)
        else:
            return self._refuse(command.source)
        return ""

    def apply_controller_pose(self, steer: ControllerPoseCommand, now_s: float) -> str:
        """Applies the pose of the demonstrator's controller. Returns a rejection reason, as
        ``apply_velocity_command`` does.

        After a change of clutch, viewpoint or scale, the current poses of tool and controller become the references.
        The tool therefore does not jump.
        """
        pose = None if steer.grip is None else compute_controller_pose(steer.grip, steer.xr_from_world)
        if not steer.clutch or pose is None or self._servo is None:
            self._leave("demonstrator")
            return ""
        if not self._is_free("demonstrator"):
            return self._refuse("demonstrator")
        self._drive_by("demonstrator", now_s)
        clutch = steer.xr_from_world, steer.scale
        if clutch != self._clutch:
            self._servo.store_reference_poses(pose.pos_w, pose.q_w, steer.scale)
        self._velocity, self._controller, self._clutch = None, pose, clutch
        return ""

    def stop_robot(self) -> None:
        """Stop the robot. It remains at rest until the next command."""
        self._velocity = self._controller = self._clutch = self.active_operator = None
        self._changed = True

    def is_overdue(self, now_s: float) -> bool:
        """Whether the latest command is older than ``OPERATOR_COMMAND_TIMEOUT_S``. The caller must then stop the
        robot.
        """
        return self.active_operator is not None and now_s - self._commanded_s > OPERATOR_COMMAND_TIMEOUT_S

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the action (1, A) of the latest command."""
        self.latest_operator = self.active_operator or "operator"
        return self._action()

    def update_action(self) -> FloatArray | None:
        """Returns the action (1, A) while a controller steers, or if a command arrived; otherwise ``None``."""
        return self._action() if self._changed or self._controller is not None else None

    def close(self) -> None:
        """Stop the robot."""
        self.stop_robot()

    def _action(self) -> FloatArray:
        self._changed = False
        if self._hand is None or self._servo is None:
            return self._zero_action
        if self._controller is not None:
            velocity = self._servo.compute_hand_velocity(self._controller.pos_w, self._controller.q_w)
            return self._hand.compute_action(*velocity)[None]
        return (
            self._zero_action if self._velocity is None else self._hand.compute_action(*self._velocity)[None]
        )

    def _is_free(self, role: OperatorRole) -> bool:
        return self.active_operator in (None, role)

    def _drive_by(self, role: OperatorRole, now_s: float) -> None:
        self.active_operator = self.latest_operator = role
        self._commanded_s, self._changed = now_s, True
        self._refused.discard(role)

    def _leave(self, role: OperatorRole) -> None:
        self._refused.discard(role)
        if self.active_operator == role:
            self.stop_robot()

    def _refuse(self, role: OperatorRole) -> str:
        if role in self._refused:
            return ""
        self._refused.add(role)
        return f"the {self.active_operator} drives the robot; wait until they release it"


def _in_world(direction: Sequence[float]) -> FloatArray:
    """Transforms a vector (3,) from the frame of the person (forward, left, up) to the world frame."""
    forward, left, up = direction
    return np.array([left, -forward, up])
