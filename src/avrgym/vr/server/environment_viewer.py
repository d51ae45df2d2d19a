"""Viewer of an environment: simulates episodes without a participant, and streams them to a browser."""

from typing import Literal

import numpy as np

from avrgym.models.human import Person
from avrgym.policies.registry import resolve_session_policy
from avrgym.system import random_streams
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.vr.live_world.drivers import OperatorDriver, make_driver
from avrgym.vr.live_world.scene_message import encode_world_poses, make_scene_message
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, MessageSender, ReceivedMessage
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.session.reporting import STATUS_INTERVAL_TICKS, make_viewer_status

EPISODE_END_PAUSE_S = 2.0
SCENE_LOADING_TIMEOUT_S = 15.0
"""Maximum time in seconds for a client to load the scene of an episode. The episode then starts."""


class EnvironmentViewer:
    """Simulates episodes one after another at 100 Hz; implements ``RealTimeSession``.

    The page can pause, continue and skip to the next episode. With the policy ``operator``, a person drives the robot
    on the page.
    """

    def __init__(
        self,
        environment_id: str,
        policy: str,
        people: str,
        seed: int,
        send: MessageSender,
        impairment: str = "none",
        *,
        force_guard: bool = False,
        settings: Settings = DEFAULT_SETTINGS,
        allow_other_settings: bool = False,
        steps: int = EPISODE_STEPS,
    ) -> None:
        """Compile the scene and start the first episode.

        Args:
            environment_id: such as ``avrgym/FeedingJaco-v1``.
            policy: any name that ``policies.registry.resolve_session_policy`` accepts.
            people: the population, a name in ``people.distributions.NAMED_DISTRIBUTIONS`` or a people file.
            seed: seed of the first episode; incremented for each later episode.
            send: receives all messages for clients.
            impairment: a name in ``people.impairments.IMPAIRMENTS``.
            force_guard: whether the force guard limits contact force and approach speed.
            settings: settings of the environment.
            allow_other_settings: whether to allow a policy that was trained with other settings.
            steps: number of control steps of an episode.

        Raises:
            ValueError: for an unknown name. The message lists the allowed names.
        """
        self.scenes: list[tuple[str, Person, Settings]] = []
        self._episodes = Episodes(
            environment_id,
            1,
            people=people,
            impairment=impairment,
            num_threads=1,
            by_region=True,
            force_guard=force_guard,
            settings=settings,
        )
        self._length = steps
        self._policy, self._seed, self._send = policy, seed, send
        self._driver = make_driver(
            resolve_session_policy(
                policy, environment_id, settings, allow_other_settings=allow_other_settings
            ),
            background=True,
        )
        self._phase: Literal["loading", "running", "ended"] = "loading"
        self._now_s, self._ticks = 0.0, 0
        self._paused = False
        self._begin()

    @property
    def is_at_rest(self) -> bool:
        """Whether the simulation is paused or waits for the next episode."""
        return self._paused or self._phase != "running"

    def send_initial_state(self, send: MessageSender, role: messages.Role, now_s: float) -> None:
        """Send welcome, scene, phase and status to a new connection with this role."""
        name = self._episodes.environment_id
        send(messages.Welcome(messages.PROTOCOL_VERSION, name, role, haptics=False, sounds=True))
        send(self._scene())
        send(self._phase_message())
        send(self._status())

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Handle a message of a page; ignores messages that only sessions use."""
        match message:
            case messages.WatcherSceneLoaded() if (
                message.url == self._scene().url and self._phase == "loading"
            ):
                self._run()
            case messages.ExperimenterCommand(name="pause" | "continue"):
                self._paused = message.name == "pause"
                self._tell()
            case messages.ExperimenterCommand(name="skip"):
                self._begin()
            case messages.VelocityCommand() if isinstance(self._driver, OperatorDriver):
                self._driver.apply_velocity_command(message, now_s)
            case _:
                pass

    def tick(self, now_s: float) -> None:
        """Advance the simulation by 10 ms. ``now_s``: the time on the loop's clock."""
        self._now_s = now_s
        if isinstance(self._driver, OperatorDriver) and self._driver.is_overdue(now_s):
            self._driver.stop_robot()
        if not self._paused:
            self._go_on()
        self._ticks += 1
        self._send_state()
        if self._ticks % STATUS_INTERVAL_TICKS == 0:
            self._send(self._status())

    def close(self, now_s: float) -> None:
        """Stop the driver of the robot. Nothing is stored."""
        self._driver.close()

    def _begin(self) -> None:
        """Prepare the next episode. It starts when a client has loaded its scene."""
        generator = random_streams.make_episode_rng(self._seed)
        self._seed += 1
        self._episodes.reset(np.array([0]), [generator])
        self._driver.reset(self._episodes, [generator])
        self._failure = ""
        self._latest: FirstWorldStep | None = None
        self._steps, self._reward = 0, 0.0
        self._success = False
        episodes = self._episodes
        self.scenes.append((episodes.environment_id, episodes.get_person(0), episodes.settings))
        self._phase, self._waits_until_s = "loading", self._now_s + SCENE_LOADING_TIMEOUT_S
        self._send(self._scene())
        self._tell()

    def _run(self) -> None:
        self._phase = "running"
        self._tell()

    def _go_on(self) -> None:
        if self._phase == "running":
            self._advance()
        elif self._now_s >= self._waits_until_s:
            self._run() if self._phase == "loading" else self._begin()

    def _advance(self) -> None:
        step = self._episodes.control_loop.tick(self._driver)
        if step is not None:
            self._finish_step(step)
        if self._driver.failure_message != self._failure:
            self._failure = self._driver.failure_message
            self._tell()

    def _finish_step(self, step: FirstWorldStep) -> None:
        self._latest, success = step, bool(step.outcome.success[0])
        self._steps += 1
        self._reward += float(step.outcome.reward[0])
        if self._steps == self._length:
            self._phase, self._waits_until_s = "ended", self._now_s + EPISODE_END_PAUSE_S
        if success != self._success or self._steps == self._length:
            self._success = success
            self._tell()

    def _tell(self) -> None:
        self._send(self._phase_message())
        self._send(self._status())

    def _phase_message(self) -> messages.PhaseDescription:
        outcome = "success" if self._success else ""
        held = f"the robot holds its position: {self._failure}" if self._failure else "running"
        state = {"loading": "preparing", "running": outcome or held, "ended": outcome or "no success"}
        words = "paused" if self._paused else state[self._phase]
        text = f"{self._episodes.environment_id}, {self._policy}, episode {len(self.scenes)}: {words}"
        return messages.PhaseDescription(
            name="viewing", text=text, trial=0, trials=0, practice=False, seconds=None
        )

    def _status(self) -> messages.SessionStatus:
        return make_viewer_status(
            self._episodes.simulation,
            self._latest,
            environment=self._episodes.environment_id,
            torso_height_m=self._episodes.get_person(0).torso_height_m,
            episode=len(self.scenes),
            step=self._steps,
            steps=self._length,
            reward=self._reward,
            success=self._success,
            paused=self._paused,
            operated=isinstance(self._driver, OperatorDriver),
            idle=self.is_at_rest or self._driver.is_idle,
        )

    def _scene(self) -> messages.Scene:
        number, nowhere = len(self.scenes) - 1, Registration(np.zeros(3), 0.0)
        return make_scene_message(number, self._episodes, nowhere)

    def _send_state(self) -> None:
        self._send(
            messages.WorldState(
                sequence_number=self._ticks,
                simulation_time_s=self._ticks * TICK_S,
                tracking_sequence_number=-1,
                joint_targets=b"",
                deviating_parts=[],
                poses=encode_world_poses(self._episodes),
            )
        )
