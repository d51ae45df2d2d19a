"""Measures the latency of the server in a recorded session. The client runs in its own process on this computer.

The client sends tracking frames like a headset. For each frame, the client stores the arrival time of the first state
that includes this frame. All times are on the system's monotonic clock, which all processes share.
"""

import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Thread

import numpy as np
from websockets.sync.client import ClientConnection, connect

from avrgym.array_types import FloatArray
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.policies.registry import resolve_session_policy
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.system import random_streams
from avrgym.system.child_processes import block_terminal_signals
from avrgym.tasks.registry import get_observation_and_action_size
from avrgym.vr.benchmark.cpu_steal import (
    CpuStealMonitor,
    TimeSpan,
    compute_overlap_s,
    find_undisturbed_periods,
)
from avrgym.vr.benchmark.second_headset import run_demonstrator
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, ReceivedMessage
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.real_time_loop import LateTick, RealTimeLoop
from avrgym.vr.session.plan import SessionPlan, SessionPolicies, TrialPlan
from avrgym.vr.session.session import Session

TRACKING_RATE_HZ = 90.0
"""Number of tracking frames that the client sends per second."""
POLICY_HIDDEN_UNITS = 64
"""Number of neurons in each of the two hidden layers of the untrained network."""
MEASURED_POLICY_NAME = "measured"
"""Name of the measured policy in the session's plan."""
CLIENT_TIMEOUT_S = 120.0
"""Maximum duration of the session in seconds, without the duration of the trial."""
STEAL_TIME_COLUMN = 8
"""Index of the steal time in the first line of Linux's ``/proc/stat`` (proc(5)). The name of the line has index 0."""
PERCENTILE_LEVELS = {"p50": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0}
"""The computed percentiles (0 to 100), by name."""

PercentilesMs = dict[str, float]
"""Percentiles in milliseconds, by name."""


@dataclass(frozen=True)
class LiveLatencyResult:
    """Results of a live, recorded trial in one environment.

    Attributes:
        env: the environment's id.
        seconds: duration of the measurement.
        rate_hz: number of ticks per second.
        tick_ms: duration of a tick.
        processor_ms: processor time of a tick.
        round_trip_ms: time from sending a tracking frame to the arrival of the first state that includes it.
        undisturbed_tick_ms: ``tick_ms`` of the ticks without CPU steal; ``None`` without such ticks, or if CPU steal
            was not measured (see ``cpu_steal``).
        undisturbed_round_trip_ms: ``round_trip_ms`` of the frames without CPU steal; ``None`` as for
            ``undisturbed_tick_ms``.
        stages_ms: stages of the round trip: ``to_server`` (from client to server), ``queue`` (until the next tick),
            ``tick`` (until its state is sent), ``return`` (from server to client).
        missed_deadlines: number of ticks that ended after the next tick was due, or that were skipped.
        missed_running: number of these ticks that would also have been late without CPU steal; ``None`` if CPU steal
            was not measured.
        stolen_s: CPU steal of all processors during the trial, as the system reports it.
        steering_ms: time from sending a demonstrator's steering message to sending the first state that includes it;
            ``None`` without a second headset.
    """

    env: str
    seconds: float
    rate_hz: float
    tick_ms: PercentilesMs
    processor_ms: PercentilesMs
    round_trip_ms: PercentilesMs
    undisturbed_tick_ms: PercentilesMs | None
    undisturbed_round_trip_ms: PercentilesMs | None
    stages_ms: dict[str, PercentilesMs]
    missed_deadlines: int
    missed_running: int | None
    stolen_s: float
    steering_ms: PercentilesMs | None = None


def measure_live_latency(environment_id: str, seconds: float, policy: str | None = None) -> LiveLatencyResult:
    """Measures the latency in a trial of ``seconds`` in one environment. Returns the results.

    ``policy``: a name as in ``policies.registry.resolve_session_policy``; ``None``: an untrained network. With
    ``operator``, a demonstrator with a second headset steers the robot.

    Raises:
        ValueError: for an unknown environment or policy. The message lists the allowed values.
        ServerError: if the client is not built.
        RuntimeError: if the trial does not start or does not end.
    """
    found = _untrained(environment_id) if policy is None else resolve_session_policy(policy, environment_id)
    plan, policies = _plan(environment_id, seconds), {(environment_id, MEASURED_POLICY_NAME): found}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as workers:
        times = _Times()

        def make(send: Callable[[messages.Message], None]) -> Session:
            return _TimedSession(plan, policies, Path(folder), send, workers, times)

        with LiveServer(make, "127.0.0.1", 0) as server:
            times.watch(server.loop)
            before_s = _stolen_s()
            with CpuStealMonitor() as cpu_steal:
                trips, times.steer_sent = _attend(server, seconds, steered=policy == OPERATOR_POLICY_NAME)
            times.stolen_s, times.stood_still = _stolen_s() - before_s, cpu_steal.steal_spans
            times.late = list(server.loop.late_ticks)
    return _sum_up(environment_id, times, trips)


def _stolen_s() -> float:
    """Returns the CPU steal of all processors since the start of the system, in seconds; 0 if it is unknown."""
    statistics = Path("/proc/stat")
    if not statistics.exists():
        return 0.0
    return int(statistics.read_text().split(maxsplit=9)[STEAL_TIME_COLUMN]) / os.sysconf("SC_CLK_TCK")


def _plan(environment_id: str, seconds: float) -> SessionPlan:
    trial = TrialPlan(environment_id, MEASURED_POLICY_NAME, seed=0, practice=True)
    steps = round(seconds * 10) + 1
    return SessionPlan([trial], "woman", 0.5, is_simulated=True, trial_steps=steps, countdown_s=0.5)


def _untrained(environment_id: str) -> Policy:
    """Returns a network with random weights. Its size and computing time are the same as for trained networks."""
    size, actions = get_observation_and_action_size(environment_id)
    random, layers = (
        random_streams.make_untrained_weight_rng(),
        (size, POLICY_HIDDEN_UNITS, POLICY_HIDDEN_UNITS, actions),
    )
    return Policy(
        weights=tuple(random.normal(0.0, 0.1, pair) for pair in pairwise(layers)),
        biases=tuple(np.zeros(count) for count in layers[1:]),
        observation_mean=np.zeros(size),
        observation_variance=np.ones(size),
        observation_clip=10.0,
        observation_epsilon=1e-8,
        action_std=0.1,
        metadata=PolicyMetadata(environment=environment_id, people="", steps=0, seed=0),
    )


class _Times:
    """Times of each tracking frame's stages, and durations of ticks, in seconds; only during the trial."""

    def __init__(self) -> None:
        self.arrived: dict[int, float] = {}
        self.taken: dict[int, float] = {}
        self.answered: dict[int, float] = {}
        self.began: list[float] = []
        self.took: list[float] = []
        self.computed: list[float] = []
        self.steer_sent: list[float] = []
        self.steer_answered: dict[int, float] = {}
        self.steer_pending: list[int] = []
        self._steer_numbers: dict[int, int] = {}
        self._steers = 0
        self.late: list[LateTick] = []
        self.stood_still: list[TimeSpan] | None = None
        self.stolen_s = 0.0

    def watch(self, loop: RealTimeLoop[Session]) -> None:
        """Starts to store the times at which tracking frames reach a loop's inbox."""
        post = loop.post

        def note(message: ReceivedMessage) -> None:
            if isinstance(message, messages.TrackingFrameMessage):
                self.arrived[message.sequence] = time.monotonic()
            elif isinstance(message, messages.ControllerPoseCommand):
                self._steer_numbers[id(message)] = self._steers
                self._steers += 1
            post(message)

        loop.post = note

    def note_steering(self, message: messages.ControllerPoseCommand) -> None:
        """Stores that the session receives a demonstrator's steering message now."""
        self.steer_pending.append(self._steer_numbers.pop(id(message)))

    def note_state(self, state: messages.WorldState) -> None:
        """Stores the current time for all tracking frames and steering messages that ``state`` is the first to
        include."""
        now_s = time.monotonic()
        self.answered.setdefault(state.tracking_sequence_number, now_s)
        self.steer_answered |= dict.fromkeys(self.steer_pending, now_s)
        self.steer_pending.clear()

    def note_tick(self, began_s: float, computed_s: float) -> None:
        """Stores the start, duration and processor time of a tick that ends now."""
        self.began.append(began_s)
        self.took.append(time.monotonic() - began_s)
        self.computed.append(computed_s)


class _TimedSession(Session):
    """A session that stores the times of its messages and ticks."""

    def __init__(
        self,
        plan: SessionPlan,
        policies: SessionPolicies,
        folder: Path,
        send: messages.MessageSender,
        workers: ThreadPoolExecutor,
        times: _Times,
    ) -> None:
        self._times = times

        def send_noted(message: messages.SentMessage) -> None:
            if isinstance(message, messages.WorldState):
                times.note_state(message)
            send(message)

        super().__init__(plan, policies, folder, send_noted, "bench", workers=workers)

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        if isinstance(message, messages.TrackingFrameMessage):
            self._times.taken[message.sequence] = time.monotonic()
        elif isinstance(message, messages.ControllerPoseCommand):
            self._times.note_steering(message)
        super().receive(message, now_s)

    def tick(self, now_s: float) -> None:
        began, computed_before, driving = time.monotonic(), time.thread_time(), self.phase_name == "trial"
        super().tick(now_s)
        if driving:
            self._times.note_tick(began, time.thread_time() - computed_before)


RoundTripTimes = dict[int, tuple[float, float]]
"""(time of sending a tracking frame, arrival time of the first state that includes it), by the frame's number."""


def _attend(
    server: LiveServer[Session], seconds: float, *, steered: bool
) -> tuple[RoundTripTimes, list[float]]:
    """Runs the clients' processes until the trial ends.

    Returns the times of the trial's round trips, and the times at which a demonstrator sent steering messages.

    ``steered``: whether a demonstrator steers the robot.
    """
    url, tokens = f"ws://127.0.0.1:{server.port}", server.tokens
    steering = (
        _start_client(run_demonstrator, f"{url}/watch", tokens.demonstrator) if steered else nullcontext()
    )
    participant = _start_client(run_client, f"{url}/ws", tokens.participant, server.session.scenes[0][0])
    with steering as demonstrator, participant as here:
        trips = _receive_trips(server, here, seconds)
        return trips, [] if demonstrator is None else demonstrator.recv()


@contextmanager
def _start_client(run: Callable[..., None], *arguments: str) -> Generator[Connection]:
    """Context manager: starts a client's process, yields the connection for its results, and ends the process."""
    here, there = multiprocessing.Pipe()
    client = multiprocessing.get_context("spawn").Process(target=run, args=(*arguments, there))
    with block_terminal_signals():
        client.start()
    there.close()  # the end of the process is then detected here
    try:
        yield here
    finally:
        client.terminate()
        client.join()


def _receive_trips(server: LiveServer[Session], here: Connection, seconds: float) -> RoundTripTimes:
    """Returns the times of the round trips, which the participant's process sends after the trial."""
    try:
        if not here.poll(seconds + CLIENT_TIMEOUT_S):
            raise RuntimeError(
                f"the trial did not end within {seconds + CLIENT_TIMEOUT_S:.0f} s; the session is in phase "
                f"{server.session.phase_name}"
            )
        return here.recv()
    except EOFError:
        phase = server.session.phase_name
        raise RuntimeError(
            f"the client ended in phase {phase}, before the trial; its error is printed above"
        ) from None


def run_client(url: str, token: str, environment_id: str, results: Connection) -> None:
    """Main function of the client's process: calibrates and sends tracking frames.

    At the end, it sends the times of the round trips to ``results``.
    """
    with connect(url, max_size=None) as socket:
        socket.send(
            messages.encode_message(
                messages.Hello(messages.PROTOCOL_VERSION, token, "benchmark", emulated=True)
            )
        )
        results.send(_Client(socket, environment_id).run())


class _Client:
    def __init__(self, socket: ClientConnection, environment_id: str) -> None:
        self._socket, self._environment = socket, environment_id
        self._sent: dict[int, float] = {}
        self._came: dict[int, float] = {}
        self._phase, self._states = "", 0
        self._over = Event()

    def run(self) -> RoundTripTimes:
        self._send(messages.VrEntered())
        sender = Thread(target=self._track)
        sender.start()
        while not self._over.is_set():
            self._take(messages.decode_server_message(bytes(self._socket.recv(decode=False))))
        sender.join()
        return {n: (self._sent[n], came) for n, came in self._came.items() if n in self._sent}

    def _take(self, message: messages.ServerMessage) -> None:
        if isinstance(message, messages.WorldStateChange):
            self._take_state(message)
        elif isinstance(message, messages.Scene):
            self._send(messages.SceneLoaded(message.url))
        elif isinstance(message, messages.PhaseDescription):
            self._phase = message.name
            if message.name == "free_after":
                self._over.set()

    def _take_state(self, state: messages.WorldStateChange) -> None:
        if self._phase == "trial":
            self._came.setdefault(state.tracking_sequence, time.monotonic())
        self._states += 1
        if self._states % messages.STATES_PER_RECEIPT == 0:
            self._send(messages.StateReceipt(self._states))

    def _track(self) -> None:
        participant = SimulatedParticipant(sample_participant_traits("woman", 0), 0)
        participant.adopt_posture(self._environment)
        began = due = time.monotonic()
        while not self._over.is_set():
            moving = self._phase not in ("calibration", "")
            frame = participant.make_tracking_frame(due - began, moving=moving)
            self._sent[frame.sequence] = time.monotonic()
            self._send(frame)
            if (
                self._phase in ("calibration", "check", "paused")
                and frame.sequence % round(TRACKING_RATE_HZ) == 0
            ):
                self._send(messages.ParticipantReady())
            due += 1.0 / TRACKING_RATE_HZ
            time.sleep(max(0.0, due - time.monotonic()))

    def _send(self, message: messages.Message) -> None:
        self._socket.send(messages.encode_message(message))


def _sum_up(environment_id: str, times: _Times, trips: RoundTripTimes) -> LiveLatencyResult:
    whole = [n for n in trips if n in times.arrived and n in times.taken and n in times.answered]
    sent, came = (np.array([trips[n][i] for n in whole]) for i in (0, 1))
    arrived, taken, answered = (
        np.array([when[n] for n in whole]) for when in (times.arrived, times.taken, times.answered)
    )
    stages = {
        "to_server": arrived - sent,
        "queue": taken - arrived,
        "tick": answered - taken,
        "return": came - answered,
    }
    began, took = np.array(times.began), np.array(times.took)
    lasted_s = times.began[-1] - times.began[0] + TICK_S
    late = [tick for tick in times.late if times.began[0] < tick.ended_s and tick.due_s <= times.began[-1]]
    return LiveLatencyResult(
        env=environment_id,
        seconds=lasted_s,
        rate_hz=len(times.began) / lasted_s,
        tick_ms=_spread(took),
        processor_ms=_spread(np.array(times.computed)),
        round_trip_ms=_spread(came - sent),
        undisturbed_tick_ms=_undisturbed(times.stood_still, began, took),
        undisturbed_round_trip_ms=_undisturbed(times.stood_still, sent, came - sent),
        stages_ms={name: _spread(stage) for name, stage in stages.items()},
        missed_deadlines=_missed(late),
        missed_running=None if times.stood_still is None else _missed(_late_running(late, times.stood_still)),
        stolen_s=times.stolen_s,
        steering_ms=_spread(
            np.array([answered - times.steer_sent[n] for n, answered in times.steer_answered.items()])
        )
        if times.steer_answered
        else None,
    )


def _missed(late: list[LateTick]) -> int:
    return sum(1 + tick.missed_ticks for tick in late)


def _late_running(late: list[LateTick], stood_still: list[TimeSpan]) -> list[LateTick]:
    """Returns the late ticks that would also have been late without CPU steal.

    The delay of these ticks exceeds the CPU steal since the first tick of an uninterrupted sequence of late ticks.
    """
    running: list[LateTick] = []
    began_s, next_s = -np.inf, -np.inf
    for tick in late:
        if tick.due_s > next_s + 0.5 * TICK_S:
            began_s = tick.due_s
        next_s = tick.due_s + (1 + tick.missed_ticks) * TICK_S
        if tick.ended_s - tick.due_s - TICK_S > compute_overlap_s(stood_still, began_s, tick.ended_s):
            running.append(tick)
    return running


def _spread(seconds: FloatArray) -> PercentilesMs:
    return {name: float(1000.0 * np.percentile(seconds, share)) for name, share in PERCENTILE_LEVELS.items()}


def _undisturbed(
    stood_still: list[TimeSpan] | None, began_s: FloatArray, took_s: FloatArray
) -> PercentilesMs | None:
    """Returns percentiles of the durations of events without CPU steal; ``None`` without such events."""
    if stood_still is None:
        return None
    alone = find_undisturbed_periods(stood_still, began_s, began_s + took_s)
    return _spread(took_s[alone]) if alone.any() else None
