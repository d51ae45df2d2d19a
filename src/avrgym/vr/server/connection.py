"""One WebSocket connection: authentication, received messages, sent messages."""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, get_args

import msgspec
from fastapi import WebSocket, WebSocketDisconnect

from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    TICK_S,
    ControllerPoseCommand,
    DemonstrationCommand,
    DemonstratorDisconnected,
    Hello,
    Message,
    OperatorRole,
    OtherPersonRobotCommand,
    ParticipantDisconnected,
    Problem,
    Role,
    Scene,
    StateReceipt,
    TrackingFrameMessage,
    TrackingFrameTimes,
    VelocityCommand,
    WatcherSceneLoaded,
    WorldState,
)
from avrgym.vr.protocol.state_encoding import StateEncoder
from avrgym.vr.server.authentication import EXPIRED_LINK_REJECTION, AuthenticatedClient, Tokens
from avrgym.vr.server.broadcast import Broadcast, ConnectionClosedError, Outbox
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.inbox import stops_robot
from avrgym.vr.server.real_time_loop import RealTimeLoop, S

_log = logging.getLogger("uvicorn.error")
HELLO_TIMEOUT_S = 5.0
TOKEN_CHECK_INTERVAL_S = 1.0
"""Interval in seconds at which a connection's token is checked again. If it was revoked, the connection is closed."""
MAX_BURST_MESSAGES, MAX_MESSAGES_PER_S = 1000, 250
"""Maximum number of messages of a client in a burst, and per second. A headset sends up to 144 frames per second. After
a network interruption, it sends the frames of up to seven seconds in a burst."""


@dataclass(frozen=True)
class Channel:
    """A type of WebSocket connection: the roles that may open it and the messages that it accepts.

    ``decode_message`` decodes a message. ``message_types`` is the union of the messages' types.
    """

    allowed_roles: tuple[Role, ...]
    decode_message: Callable[[bytes], Any]
    message_types: Any

    @property
    def message_tags(self) -> str:
        """The tags of the accepted messages, separated by commas."""
        return ", ".join(kind.__struct_config__.tag for kind in get_args(self.message_types))


SINGLE_CONNECTION_ROLES: tuple[Role, ...] = ("participant", "demonstrator")
"""Roles with at most one connection."""


class MessageRateLimit:
    """Limits the number of messages of a client (token bucket). A burst after a network interruption is allowed."""

    def __init__(self) -> None:
        self._left, self._asked_s = float(MAX_BURST_MESSAGES), 0.0

    def allows(self, now_s: float) -> bool:
        """Counts one message. Returns whether the limit allows it."""
        self._left = (
            min(self._left + MAX_MESSAGES_PER_S * (now_s - self._asked_s), float(MAX_BURST_MESSAGES)) - 1.0
        )
        self._asked_s = now_s
        return self._left >= 0.0

    def __str__(self) -> str:
        return f"the limits are {MAX_BURST_MESSAGES} in a burst and {MAX_MESSAGES_PER_S} per second"


class FrameLatencyTracker:
    """Measures the latency of each tracking frame: from its arrival until the server sends the first state that
    includes it."""

    def __init__(self) -> None:
        self._received_s: dict[int, float] = {}

    def record_arrival(self, sequence: int) -> None:
        """Store the current time as arrival time of the tracking frame with number ``sequence``."""
        self._received_s[sequence] = time.monotonic()
        if len(self._received_s) > MAX_STORED_FRAME_TIMES:
            del self._received_s[next(iter(self._received_s))]

    def pop_newest_frame_times(self, state: WorldState, created_s: float) -> TrackingFrameTimes | None:
        """Returns the times of the newest frame in a state that is sent now; ``None`` if an earlier state already
        included it.
        """
        received_s = self._received_s.pop(state.tracking_sequence_number, None)
        if received_s is None:
            return None
        return TrackingFrameTimes(state.tracking_sequence_number, received_s, created_s, time.monotonic())


MAX_STORED_FRAME_TIMES = 1000


CommandRecorder = Callable[[AuthenticatedClient, Any], None]
"""Function that is called with the first message (``Hello``) of each watcher, and with each command before its
execution. It must not block."""

PARTICIPANT_CHANNEL = Channel(
    ("participant",), messages.decode_participant_message, messages.ParticipantMessage
)
WATCHER_CHANNEL = Channel(
    ("experimenter", "caregiver", "demonstrator", "spectator"),
    messages.decode_watcher_message,
    messages.WatcherMessage,
)


async def serve_connection(
    socket: WebSocket,
    channel: Channel,
    tokens: Tokens,
    limiter: ConnectionLimiter,
    broadcast: Broadcast,
    loop: RealTimeLoop[S],
    record: CommandRecorder,
) -> None:
    """Authenticate a client, then receive and send messages until the connection closes."""
    await socket.accept()
    hello = await _authenticate(socket, channel, tokens, broadcast)
    caller = None if hello is None else tokens.find_client_by_token(hello.token)
    if hello is None or caller is None:
        return
    role = caller.role
    limiter.mark_authenticated(socket.scope, role)
    if role != "participant":
        record(caller, hello)
    with broadcast.register_connection(role) as outbox:
        loop.send_initial_state(broadcast.make_sender(outbox), role)
        frame_times = FrameLatencyTracker()
        await _until_either(
            _receive(
                socket, channel, caller, loop, outbox, frame_times, record, lambda: _opens(tokens, hello)
            ),
            _send(socket, outbox, frame_times),
            _until_revoked(socket, tokens, hello, role),
        )
    if role == "participant":
        loop.post(ParticipantDisconnected())
    elif role == "demonstrator":
        loop.post(DemonstratorDisconnected())


def _opens(tokens: Tokens, hello: Hello) -> bool:
    return tokens.find_client_by_token(hello.token) is not None


async def _until_revoked(socket: WebSocket, tokens: Tokens, hello: Hello, role: Role) -> None:
    """Check the token of the connection repeatedly. Close the connection when the token is revoked."""
    while _opens(tokens, hello):
        await asyncio.sleep(TOKEN_CHECK_INTERVAL_S)
    ended = (
        (EXPIRED_LINK_REJECTION.close_code, EXPIRED_LINK_REJECTION.message)
        if role == "participant"
        else (4403, _REVOKED)
    )
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(*ended)


async def _authenticate(
    socket: WebSocket, channel: Channel, tokens: Tokens, broadcast: Broadcast
) -> Hello | None:
    """Receive the first message (``Hello``) and check its token. Returns the message.

    If the token is rejected, sends the reason and returns ``None``.
    """
    refusal = 4400, f"the first message must be a hello of protocol {messages.PROTOCOL_VERSION}"
    hello = language = None
    try:
        hello = channel.decode_message(await asyncio.wait_for(socket.receive_bytes(), HELLO_TIMEOUT_S))
    except TimeoutError:
        refusal = 4408, f"no hello was received within {HELLO_TIMEOUT_S:g} s; connect again"
    except (msgspec.DecodeError, KeyError, WebSocketDisconnect):
        pass
    if isinstance(hello, Hello) and hello.protocol != messages.PROTOCOL_VERSION:
        refusal = 4400, _OTHER_VERSION.format(hello.protocol)
    elif isinstance(hello, Hello):
        caller = tokens.find_client_by_token(hello.token)
        if caller is None or caller.role not in channel.allowed_roles:
            why = tokens.find_rejection(hello.token)
            refusal, language = (why.close_code, why.message), why.language
        elif caller.role in SINGLE_CONNECTION_ROLES and broadcast.has_connection(caller.role):
            refusal = (
                4409,
                f"a {caller.role} is already connected; only one is allowed, so close the other page first",
            )
        else:
            return hello
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        if language is not None:
            await socket.send_bytes(messages.encode_message(language))
        await socket.send_bytes(messages.encode_message(Problem(message=refusal[1])))
        await socket.close(*refusal)
    return None


_REVOKED = "the token of this page was revoked; ask the experimenter for a new one"
_OTHER_VERSION = (
    f"this page uses protocol {{}}, the server protocol {messages.PROTOCOL_VERSION}: reload the "
    f"page to update it"
)


async def _until_either(*directions: Coroutine[Any, Any, None]) -> None:
    tasks = [asyncio.create_task(each) for each in directions]
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    for failure in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(failure, Exception):
            _log.error("a connection failed: %r", failure, exc_info=failure)


async def _receive(
    socket: WebSocket,
    channel: Channel,
    caller: AuthenticatedClient,
    loop: RealTimeLoop[S],
    outbox: Outbox,
    frame_times: FrameLatencyTracker,
    record: CommandRecorder,
    opens: Callable[[], bool],
) -> None:
    """Pass received messages to the loop. After a participant's link has expired, discard their messages."""
    rate_limit = MessageRateLimit()
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            frame = await socket.receive()
            if frame["type"] == "websocket.disconnect":
                return
            if not rate_limit.allows(time.monotonic()):
                await socket.close(1008, f"too many messages: {rate_limit}")
                return
            if caller.role == "participant" and not opens():
                continue
            message = _decode(frame.get("bytes"), channel, outbox.push)
            if isinstance(message, Hello):
                outbox.push(Problem(message="only the first message may be a hello"))
            elif isinstance(message, StateReceipt):
                outbox.acknowledge_states(message.num_states)
            elif message is not None and (refusal := _refusal(caller.role, message)):
                outbox.push(Problem(message=refusal, role=caller.role))
            elif message is not None:
                if isinstance(message, TrackingFrameMessage):
                    frame_times.record_arrival(message.sequence)
                if not stops_robot(message):
                    await _until(lambda: not loop.inbox_is_full)
                if caller.role == "experimenter":
                    record(caller, message)
                loop.post(message)


_OPERATOR_ROLES: dict[Role, OperatorRole] = {"experimenter": "operator", "demonstrator": "demonstrator"}


def _refusal(role: Role, message: object) -> str:
    """Returns the reason why a role may not send this message; empty if the message is allowed."""
    if role == "spectator":
        return "spectators may send no commands; open the experimenter's address"
    if isinstance(message, OtherPersonRobotCommand):
        return "" if message.source == role else f"the source of commands from this page must be {role}"
    if isinstance(message, VelocityCommand) and message.source != _OPERATOR_ROLES.get(role):
        return f"{role}s may not drive the robot as {message.source}"
    if isinstance(message, ControllerPoseCommand) and role != "demonstrator":
        return "only demonstrators may steer the robot; open the demonstrator's address"
    if role == "caregiver" and not isinstance(message, WatcherSceneLoaded):
        return "caregivers may send only robot commands; open the experimenter's address"
    if role == "demonstrator" and not isinstance(
        message, WatcherSceneLoaded | VelocityCommand | ControllerPoseCommand | DemonstrationCommand
    ):
        return "demonstrators may drive the robot, and start and end demonstrations"
    return ""


async def _until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(TICK_S)


def _decode(data: bytes | None, channel: Channel, report: Callable[[Message], None]) -> Any:
    if data is None:
        report(Problem(message=f"a text frame was received; send MessagePack of type {channel.message_tags}"))
        return None
    try:
        return channel.decode_message(data)
    except msgspec.DecodeError as error:
        report(Problem(message=f"invalid message ({error}); the allowed types are {channel.message_tags}"))
        return None


async def _send(socket: WebSocket, outbox: Outbox, frame_times: FrameLatencyTracker) -> None:
    encoder = StateEncoder()
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        try:
            while True:
                message = await outbox.next_message()
                if isinstance(message, Scene):
                    encoder.reset()
                if isinstance(message, WorldState):
                    passed = frame_times.pop_newest_frame_times(message, outbox.latest_state_time_s)
                    if passed is not None:
                        await socket.send_bytes(messages.encode_message(passed))
                    message = encoder.encode(message)
                await socket.send_bytes(messages.encode_message(message))
        except ConnectionClosedError as end:
            await socket.close(end.close_code, str(end))
