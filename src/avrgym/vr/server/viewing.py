"""An environment on show: episode after episode, live in the browser, with nobody taking part."""

from typing import Literal

import numpy as np

from avrgym.models.human import Person
from avrgym.policies.registry import find
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.known import EPISODE_STEPS
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import Send
from avrgym.vr.protocol.received import Received
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.tracking.driving import driver_of
from avrgym.vr.tracking.world import TICK_S, ControlSteps, poses, scene_message

LOOK_AT_END_S = 2.0
LOADING_S = 15.0
"""How long an episode waits for a client to draw its scene; without a client it goes on."""


class Viewing:
    """Runs like a session: ticks at 100 Hz and talks to one client. ``scenes`` are those it told of."""

    def __init__(
        self,
        environment_id: str,
        policy: str,
        people: str,
        seed: int,
        send: Send,
        impairment: str = "none",
    ) -> None:
        """Compile the scene and begin the first episode.

        Args:
            environment_id: such as ``avrgym/FeedingJaco-v1``.
            policy: whatever ``policies.registry.find`` finds.
            people: whom to meet, a name in ``people.distributions.NAMED`` or a file of people.
            seed: of the first episode; each later one takes the next.
            send: takes every message for the client.
            impairment: a name in ``people.impairments.IMPAIRMENTS``.

        Raises:
            ValueError: for an unknown name, naming what is allowed.
        """
        self.scenes: list[tuple[str, Person]] = []
        self._episodes = Episodes(
            environment_id, 1, distribution=people, impairment=impairment, num_threads=1
        )
        self._policy, self._seed, self._send = policy, seed, send
        self._driver = driver_of(find(policy, environment_id), beside=True)
        self._phase: Literal["loading", "running", "ended"] = "loading"
        self._now_s, self._ticks = 0.0, 0
        self._begin()

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves."""
        return self._phase != "running"

    def greet(self, send: Send, role: messages.Role, now_s: float) -> None:
        """Tell a client that has just connected where things stand."""
        name = self._episodes.environment_id
        send(messages.Welcome(messages.PROTOCOL, name, role, haptics=False, sounds=True))
        send(self._scene())
        send(self._phase_message())

    def receive(self, message: Received, now_s: float) -> None:
        """Take a message of a client: only that it has loaded the scene matters here."""
        loaded = isinstance(message, messages.SceneLoaded) and message.url == self._scene().url
        if loaded and self._phase == "loading":
            self._run()

    def tick(self, now_s: float) -> None:
        """Advance by 10 ms."""
        self._now_s = now_s
        if self._phase == "running":
            self._advance()
        elif now_s >= self._waits_until_s:
            self._run() if self._phase == "loading" else self._begin()
        self._ticks += 1
        self._send_state()

    def close(self, now_s: float) -> None:
        """Nothing is kept."""
        self._driver.close()

    def _begin(self) -> None:
        """Begin the next episode; it runs as soon as a client draws its scene."""
        generator = np.random.default_rng(self._seed)
        self._seed += 1
        self._episodes.begin(np.array([0]), [generator])
        self._driver.begin(self._episodes, [generator])
        self._failure = ""
        self._control = ControlSteps(self._episodes)
        self._steps = 0
        self._success = False
        self.scenes.append((self._episodes.environment_id, self._episodes.person_in(0)))
        self._phase, self._waits_until_s = "loading", self._now_s + LOADING_S
        self._send(self._scene())
        self._tell()

    def _run(self) -> None:
        self._phase = "running"
        self._tell()

    def _advance(self) -> None:
        step = self._control.tick(self._driver.act, self._driver.amend)
        if step is not None:
            self._finish_step(bool(step.outcome.success[0]))
        if self._driver.failure != self._failure:
            self._failure = self._driver.failure
            self._tell()

    def _finish_step(self, success: bool) -> None:
        self._steps += 1
        if self._steps == EPISODE_STEPS:
            self._phase, self._waits_until_s = "ended", self._now_s + LOOK_AT_END_S
        if success != self._success or self._steps == EPISODE_STEPS:
            self._success = success
            self._tell()

    def _tell(self) -> None:
        self._send(self._phase_message())

    def _phase_message(self) -> messages.Phase:
        outcome = "success" if self._success else ""
        held = f"the robot holds still, {self._failure}" if self._failure else "running"
        state = {"loading": "preparing", "running": outcome or held, "ended": outcome or "no success"}
        text = f"{self._episodes.environment_id}, {self._policy}, episode {len(self.scenes)}: {state[self._phase]}"
        return messages.Phase(name="viewing", text=text, trial=0, trials=0, practice=False, seconds=None)

    def _scene(self) -> messages.Scene:
        number, nowhere = len(self.scenes) - 1, Registration(np.zeros(3), 0.0)
        return scene_message(number, self._episodes, nowhere)

    def _send_state(self) -> None:
        self._send(
            messages.State(
                sequence=self._ticks,
                simulation_time_s=self._ticks * TICK_S,
                tracking_sequence=-1,
                joint_targets=b"",
                held=[],
                poses=poses(self._episodes),
            )
        )
