"""Emulated participants of a hosted study: the whole way from the invitation to the code, over HTTP and WebSockets.

They send tracking frames at 90 Hz, as a headset does, and answer all questions. They run in one process, apart from the
host. Motions are recorded once and repeated, so that many participants need little processor time.
"""

import asyncio
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Literal

import httpx
import msgspec
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException

from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import Hello, PhaseDescription, Question, Scene, TrackingFrameMessage

TRACKING_HZ = 90.0
POLL_S = 1.0
CALIBRATION_S = 1.5
ANSWER_S = 0.4
RECONNECT_S = 0.3
MAX_SENT = 400
WAITING_PHASES = ("headset", "calibration", "check", "ready", "break", "paused", "confirm")
LEAVING_TRIAL = 2
DATABASE_IS_AWAY = 503
STATE_TAG = b"\xa4type\xa5state"
Course = Literal["completes", "is screened out", "withdraws", "leaves"]
"""What a participant does. The last two end in the second trial: with a withdrawal, or without a word."""
DEFAULT_COURSES: tuple[Course, ...] = ("completes",)


@dataclass
class Outcome:
    """What happened to one participant. ``round_trips_s``: from a tracking frame to the first state with it.

    ``received_bytes``: of all WebSocket messages. ``sent_bytes``: of tracking frames. Both without headers.
    """

    ending: str = ""
    code: str = ""
    connections: int = 0
    waited_s: float = 0.0
    round_trips_s: list[float] = field(default_factory=list[float])
    error: str = ""
    received_bytes: int = 0
    sent_bytes: int = 0


def record_motion(seconds: float = 10.0, seed: int = 1) -> list[TrackingFrameMessage]:
    """Returns the tracking frames of a participant who sits and sways."""
    person = SimulatedParticipant(sample_participant_traits("woman", seed), seed)
    person.adopt_posture("avrgym/FeedingJaco-v1")
    steps = int(seconds * TRACKING_HZ)
    return [person.make_tracking_frame(step / TRACKING_HZ, moving=False) for step in range(steps)]


class EmulatedParticipant:
    """One participant with an invitation. ``host``: the host header, if it differs from the connected address."""

    def __init__(
        self,
        origin: str,
        invitation: str,
        motion: Sequence[TrackingFrameMessage],
        offset: int = 0,
        course: Course = "completes",
    ) -> None:
        self.outcome, self.host, self._course = Outcome(), "", course
        self._origin, self._invitation, self._motion, self._sequence = origin, invitation, motion, offset
        self._began_s = time.monotonic()
        self._sent_s: dict[int, float] = {}
        self._phase, self._since_s, self._scene_url = "", 0.0, ""
        self._question: Question | None = None
        self._trial = 0

    async def take_part(self, deadline_s: float) -> Outcome:
        """Take part until the study has ended for this participant, at most for ``deadline_s``."""
        try:
            async with asyncio.timeout(deadline_s), self._client() as web:
                await self._follow(web)
        except (TimeoutError, httpx.HTTPError, KeyError) as error:
            self.outcome.error = repr(error)
        return self.outcome

    def _client(self) -> httpx.AsyncClient:
        headers = {"host": self.host} if self.host else {}
        return httpx.AsyncClient(base_url=self._origin, timeout=60.0, headers=headers)

    async def _follow(self, web: httpx.AsyncClient) -> None:
        given = await web.post("/api/participants", json={"token": self._invitation, "sex": "woman"})
        own = {"authorization": f"Bearer {given.json()['token']}"}

        async def act(name: str, **body: object) -> None:
            with suppress(httpx.TransportError):  # the host starts again; the next stage repeats the action
                answer = await web.post(f"/api/{name}", json=body, headers=own)
                if answer.status_code != DATABASE_IS_AWAY:
                    answer.raise_for_status()

        while True:
            try:
                response = await web.get("/api/stage", headers=own)
            except httpx.TransportError:  # the host starts again
                await asyncio.sleep(POLL_S)
                continue
            if response.status_code == DATABASE_IS_AWAY:
                await asyncio.sleep(POLL_S)
                continue
            if response.is_error:
                raise httpx.HTTPError(f"{response.status_code}: {response.text}")
            stage = response.json()["stage"]
            match stage["type"]:
                case "consent":
                    await act("consent", version=stage["version"], sha256=stage["sha256"], agreed=True)
                case "inclusion":
                    eligible = self._course != "is screened out"
                    answers = {
                        name: ("epilepsy" not in text) == eligible for name, text in stage["questions"]
                    }
                    await act("inclusion", answers=answers)
                case "safety":
                    await act("safety")
                case "ready":
                    await act("waiting-list")
                case "waiting":
                    self.outcome.waited_s += POLL_S
                    await asyncio.sleep(POLL_S)
                case "session":
                    await self._attend(stage["path"], stage["token"])
                    if self._is_leaving and self._course == "leaves":
                        return
                    if self._is_leaving:
                        await act("withdrawal")
                    await asyncio.sleep(RECONNECT_S)
                case _:
                    self.outcome.ending, self.outcome.code = stage["ending"], stage["code"]
                    return

    async def _attend(self, path: str, token: str) -> None:
        """Take part in a session until its connection closes."""
        connected = self._origin.removeprefix("http://")
        address = f"ws://{self.host or connected}/{path}ws"
        name, _, port = connected.partition(":")
        with suppress(OSError, WebSocketException, TimeoutError):
            async with connect(
                address,
                max_size=None,
                compression=None,
                proxy=None,
                ping_interval=None,
                host=name,
                port=int(port or 80),
            ) as socket:
                self.outcome.connections += 1
                await socket.send(
                    messages.encode_message(
                        Hello(messages.PROTOCOL_VERSION, token, "emulated", emulated=True)
                    )
                )
                sending = asyncio.create_task(self._send(socket))
                try:
                    await self._receive(socket)
                finally:
                    sending.cancel()

    @property
    def _is_leaving(self) -> bool:
        leaves = self._course in ("withdraws", "leaves")
        return leaves and self._phase == "trial" and self._trial == LEAVING_TRIAL

    async def _receive(self, socket: ClientConnection) -> None:
        states = 0
        with suppress(ConnectionClosed):
            async for data in socket:
                assert isinstance(data, bytes)
                self.outcome.received_bytes += len(data)
                if STATE_TAG in data[:16]:
                    states += 1
                    if states % messages.STATES_PER_RECEIPT == 0:
                        await socket.send(messages.encode_message(messages.StateReceipt(states)))
                    continue
                message = messages.decode_server_message(data)
                now_s = time.monotonic()
                match message:
                    case messages.Welcome():
                        await socket.send(messages.encode_message(messages.VrEntered()))
                    case PhaseDescription():
                        self._phase, self._since_s, self._question = message.name, now_s, None
                        self._trial = message.trial
                        if message.name == "finished" or self._is_leaving:
                            return
                    case Question():
                        self._question, self._since_s = message, now_s
                    case Scene():
                        self._scene_url = message.url
                        await socket.send(messages.encode_message(messages.SceneLoaded(url=message.url)))
                    case messages.TrackingFrameTimes():
                        sent_s = self._sent_s.pop(message.tracking_sequence, None)
                        if sent_s is not None:
                            self.outcome.round_trips_s.append(now_s - sent_s)
                    case _:
                        pass

    async def _send(self, socket: ClientConnection) -> None:
        """Send tracking frames at a fixed rate, and the answers that are due."""
        due_s = time.monotonic()
        with suppress(ConnectionClosed):
            while True:
                now_s = time.monotonic()
                self._sequence += 1
                frame = msgspec.structs.replace(
                    self._motion[self._sequence % len(self._motion)],
                    sequence=self._sequence,
                    client_time_ms=1000.0 * (now_s - self._began_s),
                )
                self._sent_s[self._sequence] = now_s
                if len(self._sent_s) > MAX_SENT:
                    del self._sent_s[next(iter(self._sent_s))]
                encoded = messages.encode_message(frame)
                self.outcome.sent_bytes += len(encoded)
                await socket.send(encoded)
                await self._respond(socket, now_s)
                due_s = max(due_s + 1.0 / TRACKING_HZ, now_s - 0.1)
                await asyncio.sleep(max(due_s - time.monotonic(), 0.0))

    async def _respond(self, socket: ClientConnection, now_s: float) -> None:
        waited_s = now_s - self._since_s
        if self._phase in WAITING_PHASES and waited_s > CALIBRATION_S:
            self._since_s = now_s
            await socket.send(messages.encode_message(messages.ParticipantReady()))
        question = self._question
        if question is not None and waited_s > ANSWER_S:
            self._question = None
            value = math.ceil(question.points / 2)
            answer = messages.Answer(item=question.item, value=value, response_time_s=waited_s)
            await socket.send(messages.encode_message(answer))


async def take_part_together(
    origin: str,
    invitations: Sequence[str],
    deadline_s: float,
    motion: Sequence[TrackingFrameMessage],
    courses: Sequence[Course] = DEFAULT_COURSES,
) -> list[Outcome]:
    """Let one participant for each invitation take part at the same time. Returns their outcomes.

    ``courses``: of the first participants; the others follow in turn.
    """
    everyone = [
        EmulatedParticipant(origin, invitation, motion, 37 * number, courses[number % len(courses)])
        for number, invitation in enumerate(invitations)
    ]
    return list(await asyncio.gather(*(each.take_part(deadline_s) for each in everyone)))


def percentile_ms(outcomes: Sequence[Outcome], share: float) -> float:
    """Returns a percentile of all round trips, in milliseconds."""
    trips = sorted(trip for each in outcomes for trip in each.round_trips_s)
    return 1000.0 * trips[min(int(share * len(trips)), len(trips) - 1)] if trips else math.nan
