"""The wire protocol between the VR client and the server, defined once.

Every WebSocket message is one MessagePack map with a ``type`` tag. The TypeScript side is generated from this
module (``python -m avrgym.vr.typescript``). Poses of the headset and the controllers travel exactly as WebXR
gives them: reference space ``local-floor``, metres, y up, quaternions x, y, z, w. The server converts them.
"""

from typing import Annotated, Literal, TypeVar

import msgspec

PROTOCOL = 2

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class XRPose(msgspec.Struct, frozen=True, array_like=True):
    """A pose in WebXR's ``local-floor`` space: position in metres (y up), orientation x, y, z, w."""

    position: Vector3
    orientation: Quaternion


class Message(msgspec.Struct, frozen=True, tag_field="type", forbid_unknown_fields=True):
    """Base of all messages."""


# From the client -------------------------------------------------------------------------------------------


class Hello(Message, frozen=True, tag="hello"):
    """The first message of a connection. The token is the one in the fragment of the page's address."""

    protocol: int
    token: Annotated[str, msgspec.Meta(max_length=128)]
    device: Annotated[str, msgspec.Meta(max_length=512)]
    emulated: bool


class Tracking(Message, frozen=True, tag="tracking"):
    """One XR frame. ``sequence`` counts up by one; ``client_time_ms`` is the XR frame's time stamp.

    Controller poses are grip poses; a pose that is not tracked is ``None``.
    """

    sequence: Annotated[int, msgspec.Meta(ge=0)]
    client_time_ms: float
    head: XRPose | None
    left: XRPose | None
    right: XRPose | None
    modality: Literal["controllers", "hands", "none"]


class Entered(Message, frozen=True, tag="entered"):
    """The participant entered VR."""


class Left(Message, frozen=True, tag="left"):
    """The participant left VR (the connection may stay)."""


class Ready(Message, frozen=True, tag="ready"):
    """The participant pressed a trigger where the phase asks for it."""


class SceneLoaded(Message, frozen=True, tag="scene_loaded"):
    """The client shows the scene of this address."""

    url: Annotated[str, msgspec.Meta(max_length=128)]


class Stop(Message, frozen=True, tag="stop"):
    """The participant pressed a menu button or the stop key: the robot must hold at once."""


class OriginReset(Message, frozen=True, tag="origin_reset"):
    """The reference space's origin jumped: earlier registration is void."""


class Answer(Message, frozen=True, tag="answer"):
    """The answer to one item of the questionnaire, with the time from its appearance to the press."""

    item: Annotated[str, msgspec.Meta(max_length=64)]
    value: Annotated[int, msgspec.Meta(ge=1, le=100)]
    response_time_s: Annotated[float, msgspec.Meta(ge=0)]


ClientMessage = Hello | Tracking | Entered | Left | Ready | SceneLoaded | Stop | OriginReset | Answer

# From the server -------------------------------------------------------------------------------------------

PhaseName = Literal[
    "waiting",
    "calibration",
    "loading",
    "free_before",
    "countdown",
    "trial",
    "free_after",
    "questionnaire",
    "paused",
    "finished",
    "viewing",
]


class Welcome(Message, frozen=True, tag="welcome"):
    """The connection is accepted."""

    protocol: int
    session: str


class Scene(Message, frozen=True, tag="scene"):
    """A scene to draw: a GLB whose nodes carry ``extras.body``, and where the simulated world stands.

    ``xr_from_world`` places the simulation's z-up world in the participant's ``local-floor`` space: apply it
    to the root node as it is. ``bodies`` is the order of the poses in every following ``State``; those of
    ``marks`` spots on the person follow, of one radius and one colour (red, green, blue in 0..1).
    ``head_bodies`` are hidden from the participant's own eyes.
    """

    url: str
    bodies: list[str]
    head_bodies: list[str]
    marks: int
    mark_radius_m: float
    mark_rgb: Vector3
    xr_from_world: XRPose


class State(Message, frozen=True, tag="state"):
    """The world at one instant.

    ``poses``: little-endian float32 (bodies + marks, 7): x, y, z, then w, x, y, z; world frame.
    ``tracking_sequence`` is the newest tracking frame that this state already follows, -1 before the first.
    """

    sequence: int
    simulation_time_s: float
    tracking_sequence: int
    poses: bytes


class Phase(Message, frozen=True, tag="phase"):
    """Where the session stands, with the words to show to the participant."""

    name: PhaseName
    text: str
    trial: int
    trials: int
    practice: bool
    seconds: float | None


class Question(Message, frozen=True, tag="question"):
    """One item to show and to answer by pointing and pressing the trigger."""

    item: str
    text: str
    points: int
    low: str
    high: str
    number: int
    count: int


class Problem(Message, frozen=True, tag="problem"):
    """What was wrong with a message or a measurement, and what is allowed. The session goes on."""

    message: str


ServerMessage = Welcome | Scene | State | Phase | Question | Problem

_Any = TypeVar("_Any")

_client_decoder = msgspec.msgpack.Decoder(ClientMessage)
_server_decoder = msgspec.msgpack.Decoder(ServerMessage)
_encoder = msgspec.msgpack.Encoder()


def encode(message: Message) -> bytes:
    """Encode any message of the protocol."""
    return _encoder.encode(message)


def decode_client(data: bytes) -> ClientMessage:
    """Decode a message from the client; raises ``msgspec.DecodeError`` when it is not one."""
    return _decode(_client_decoder, data)


def decode_server(data: bytes) -> ServerMessage:
    """Decode a message from the server; raises ``msgspec.DecodeError`` when it is not one."""
    return _decode(_server_decoder, data)


def _decode(decoder: msgspec.msgpack.Decoder[_Any], data: bytes) -> _Any:
    try:
        return decoder.decode(data)
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(f"text that is not UTF-8: {error}") from error
