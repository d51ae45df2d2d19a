"""Who drives the robot of a live world: a driver answers in time or has the robot hold still, and never raises."""

import threading
import time
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Protocol

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.policies import controllers, registry
from avrgym.policies.cartesian_control import CartesianController
from avrgym.policies.controllers import Controller, ExternalController
from avrgym.policies.registry import ActionFunction, AnyPolicy, HumanOperator, Script
from avrgym.policies.trained import Policy
from avrgym.tasks.episodes import Episodes
from avrgym.vr.protocol.messages import Drive

Generators = Sequence[np.random.Generator]

ANSWER_WITHIN_S = 0.08
"""How long somebody else's controller may take for an action, of the control step's 0.1 s."""
ANSWER_SIMULATED_WITHIN_S = 10.0
"""The same where time is simulated, which waits for the answer."""
OPERATOR_HEARD_S = 0.2
"""After so long without a word of the operator the robot holds still."""

NOTHING = np.zeros((1, 0))
"""The action of a robot that is not known yet."""


def still(episodes: Episodes) -> FloatArray:
    """The action (1, A) that holds a robot still."""
    return np.zeros((1, episodes.action_size))


class Driver(Protocol):
    """Drives one episode after another."""

    @property
    def failure(self) -> str:
        """What keeps it from driving at present, as ``ControllerError`` says it; empty while it drives."""
        ...

    @property
    def idle(self) -> bool:
        """Whether the robot holds still for want of an action."""
        ...

    def reset(self, episodes: Episodes, generators: Generators) -> None:
        """Prepare for the episode that has begun in a world, drawn from its generator."""
        ...

    def act(self, observation: FloatArray) -> FloatArray:
        """The action (1, A) with which a control step begins that sees ``observation`` (1, O)."""
        ...

    def amend(self) -> FloatArray | None:
        """Asked at every other tick of the step: another action (1, A), if there is one since."""
        ...

    def close(self) -> None:
        """Drive no more."""
        ...


def driver_of(policy: AnyPolicy, *, beside: bool) -> Driver:
    """Who drives by a policy; others' controllers run ``beside`` the thread that asks, or it waits for them."""
    if isinstance(policy, HumanOperator):
        return Operator()
    if isinstance(policy, ExternalController):
        return Guarded(policy, beside=beside)
    return InTick(policy)


class InTick:
    """A policy that comes with AVR Gym or is a file of its format: it answers at once."""

    def __init__(self, policy: Policy | Script) -> None:
        self.failure = ""
        self._policy = policy
        self._act: ActionFunction | None = None

    @property
    def idle(self) -> bool:
        """Whether the robot holds still for want of an action."""
        return self.failure != ""

    def reset(self, episodes: Episodes, generators: Generators) -> None:
        """Prepare for the episode that has begun in a world, drawn from its generator."""
        self.failure, self._act = "", None
        self._begun, self._still = (episodes, generators), still(episodes)

    def act(self, observation: FloatArray) -> FloatArray:
        """The action (1, A) with which a control step begins that sees ``observation`` (1, O)."""
        try:
            act = self._act = self._act or registry.action_function(self._policy, *self._begun)
            action = controllers.checked_action(lambda: act(observation), self._still.shape)
        except Exception as error:  # an oracle in a situation that nobody foresaw
            self.failure = str(controllers.controller_error(error))
            return self._still
        self.failure = ""
        return action

    def amend(self) -> FloatArray | None:
        """Nothing comes later."""

    def close(self) -> None:
        """Nothing is left."""


class Guarded:
    """Somebody else's controller, on a thread of its own.

    What fails, and what takes longer than ``ANSWER_WITHIN_S`` (``ANSWER_SIMULATED_WITHIN_S`` unless it runs ``beside``
    the thread that asks), holds the robot still; an answer that comes too late is dropped. Until an answer is due, the
    robot goes on as it was told last. One that still thinks when the next episode begins is left behind, and another
    made.
    """

    def __init__(self, foreign: ExternalController, *, beside: bool) -> None:
        self._foreign, self._beside = foreign, beside
        self._limit_s = ANSWER_WITHIN_S if beside else ANSWER_SIMULATED_WITHIN_S
        self._late = f"late: no answer within {1000 * self._limit_s:.0f} ms"
        self._worker = Worker(foreign)
        self._ready = self._asked = None
        self._still = NOTHING
        self._hold("")

    @property
    def idle(self) -> bool:
        """Whether the robot holds still for want of an action."""
        return self.failure != ""

    def reset(self, episodes: Episodes, generators: Generators) -> None:
        """Prepare for the episode that has begun in a world, drawn from its generator."""
        if self._worker.busy:
            self._worker.close()
            self._worker = Worker(self._foreign)
        seed, environment = registry.controller_seed(generators[0]), episodes.environment_id
        self._ready = self._ask(lambda controller: controllers.reset(controller, seed, environment))
        self._asked, self._still = None, still(episodes)
        self._hold("")

    def act(self, observation: FloatArray) -> FloatArray:
        """The action (1, A) with which a control step begins that sees ``observation`` (1, O)."""
        self._hear()
        if self._ready is None or not self._ready.done:
            self._hold(self._late)
        elif self._ready.failure:
            self._hold(self._ready.failure)
        elif self._asked is None:
            row, count = observation[0].copy(), self._still.shape[1]
            self._asked = self._ask(lambda controller: controllers.act(controller, row, count))
            self._hear()
        return self._action

    def amend(self) -> FloatArray | None:
        """Asked at every other tick of the step: another action (1, A), if there is one since."""
        before = self._action
        self._hear()
        return None if self._action is before else self._action

    def close(self) -> None:
        """Let the controller go as soon as it has answered."""
        waits = not self._beside and not self._worker.busy
        self._worker.close()
        if waits:
            self._worker.join(self._limit_s)

    def _ask(self, work: "Work") -> "Request":
        request = self._worker.ask(work)
        if not self._beside:
            request.wait(self._limit_s)
        return request

    def _hear(self) -> None:
        """Take an answer that has come; wait no longer for one that is late."""
        asked = self._asked
        if asked is None:
            return
        if asked.done:
            self._asked = None
        if asked.took_s > self._limit_s:
            self._hold(self._late)
        elif self._asked is None and asked.failure:
            self._hold(asked.failure)
        elif self._asked is None and asked.answer is not None:
            self._action, self.failure = asked.answer[None], ""

    def _hold(self, failure: str) -> None:
        self._action, self.failure = self._still, failure


Work = Callable[[Controller], FloatArray | None]


class Request:
    """Something that is asked of a controller; ``answer`` or ``failure`` are there before it is ``done``."""

    def __init__(self, work: Work) -> None:
        self._work, self._asked_s, self._ended_s = work, time.monotonic(), 0.0
        self._done = threading.Event()
        self.answer: FloatArray | None = None
        self.failure = ""

    @property
    def done(self) -> bool:
        """Whether there is an answer or a failure."""
        return self._done.is_set()

    @property
    def took_s(self) -> float:
        """How long it took, or takes so far."""
        return (self._ended_s if self.done else time.monotonic()) - self._asked_s

    def run(self, find: Callable[[], Controller]) -> None:
        """Do it."""
        try:
            answer = self._work(find())
        except (Exception, SystemExit) as error:  # other people's code may raise anything
            self.failure = str(controllers.controller_error(error))
        else:
            self.answer = answer
        self._ended_s = time.monotonic()
        self._done.set()

    def wait(self, most_s: float) -> None:
        """Wait until it is done, or so long."""
        self._done.wait(most_s)


class Worker:
    """Asks one controller, which it makes when it is needed, one thing after another on a thread of its own."""

    def __init__(self, foreign: ExternalController) -> None:
        self._foreign = foreign
        self._controller: Controller | None = None
        self._latest: Request | None = None
        self._waiting: SimpleQueue[Request | None] = SimpleQueue()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=foreign.name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """Whether the controller still has to answer."""
        return self._latest is not None and not self._latest.done

    def ask(self, work: Work) -> Request:
        """Have something done."""
        self._latest = request = Request(work)
        self._waiting.put(request)
        return request

    def close(self) -> None:
        """Let the controller go, and end."""
        if self._controller is not None and not self._closed:
            self.ask(controllers.close)
        self._closed = True
        self._waiting.put(None)

    def join(self, most_s: float) -> None:
        """Wait for its end, or so long."""
        self._thread.join(most_s)

    def _run(self) -> None:
        while (request := self._waiting.get()) is not None:
            request.run(self._found)

    def _found(self) -> Controller:
        self._controller = self._controller or self._foreign.make()
        return self._controller


class Operator:
    """A person who moves the robot's hand, and lets it go by saying so or nothing."""

    failure = ""

    def __init__(self) -> None:
        self._hand: CartesianController | None = None
        self._still = NOTHING
        self._wish: tuple[FloatArray, FloatArray] | None = None
        self._heard_s = 0.0
        self._changed = False

    @property
    def idle(self) -> bool:
        """Whether the robot holds still for want of an action."""
        return self._wish is None

    def reset(self, episodes: Episodes, generators: Generators) -> None:
        """Prepare for the episode that has begun in a world."""
        self._hand, self._still = CartesianController(episodes.simulation), still(episodes)
        self.let_go()

    def obey(self, asked: Drive, now_s: float) -> None:
        """Move the hand as the operator's page asks, or let it go."""
        if asked.engaged:
            self.drive(_in_world(asked.linear), _in_world(asked.angular), now_s)
        else:
            self.let_go()

    def drive(self, linear: FloatArray, angular: FloatArray, now_s: float) -> None:
        """Move the hand so from now on, both (3,) as ``Hand.action`` takes them."""
        self._wish, self._heard_s = (linear, angular), now_s
        self._changed = True

    def let_go(self) -> None:
        """Hold the robot still."""
        self._wish, self._changed = None, True

    def watch(self, now_s: float) -> None:
        """Hold the robot still when nothing was heard for too long."""
        if self._wish is not None and now_s - self._heard_s > OPERATOR_HEARD_S:
            self.let_go()

    def act(self, observation: FloatArray) -> FloatArray:
        """The action (1, A) with which a control step begins, whatever it sees."""
        self._changed = False
        if self._hand is None or self._wish is None:
            return self._still
        return self._hand.action(*self._wish)[None]

    def amend(self) -> FloatArray | None:
        """What the operator wants, where that has changed during the step."""
        return self.act(self._still) if self._changed else None

    def close(self) -> None:
        """Hold the robot still."""
        self.let_go()


def _in_world(direction: Sequence[float]) -> FloatArray:
    """A vector (3,) in the world frame that is given ahead of the person, to their left and up."""
    ahead, left, up = direction
    return np.array([left, -ahead, up])
