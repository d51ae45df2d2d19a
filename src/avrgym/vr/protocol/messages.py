"""The wire protocol between the VR client and the server, defined once.

Every WebSocket message is one MessagePack map with a ``type`` tag. The TypeScript side is generated from this
module (``scripts/write_typescript.py``). Poses of the headset and the controllers travel exactly as WebXR
gives them: reference space ``local-floor``, metres, y up, quaternions x, y, z, w. The server converts them.
"""

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

import msgspec

from avrgym.models.body_names import Part
from avrgym.models.human import Sex
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.recording import schema

PROTOCOL = 12

TICK_S = PHYSICS_STEP_S
"""Period of the real-time loop."""

MAX_UNACKNOWLEDGED_STATES = 8
"""So many states are sent beyond those that the client says it received: on a network that takes longer than 60 ms
there and back, fewer come than are made."""
STATES_PER_RECEIPT = 2

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Share = Annotated[float, msgspec.Meta(ge=-1, le=1)]
Shares = tuple[Share, Share, Share]
Modality = Literal["controller", "hand", "mouse", "none"]
"""What one hand is tracked with."""
StopWay = Literal["button", "triggers", "squeeze", "select", "palm", "gaze", "page", "key"]
"""How a participant stops the robot: with a menu button; by holding both triggers, a squeeze, or the only select; with
a raised palm; by looking at the stop sign; with the page's button or a key."""
Visibility = Literal["visible", "visible-blurred", "hidden", "context-lost"]
"""Whether the participant sees the scene and can act in it, as WebXR and pages name it; else why they cannot.

``visible-blurred``: a menu of the headset covers the scene, and no input arrives. ``hidden``: the headset shows
nothing, or the page is in the background. ``context-lost``: the graphics of the participant's device failed.
"""


class XRPose(msgspec.Struct, frozen=True, array_like=True):
    """A pose in WebXR's ``local-floor`` space: position in metres (y up), orientation x, y, z, w."""

    position: Vector3
    orientation: Quaternion


class Skeleton(msgspec.Struct, frozen=True):
    """A person's measures, metres: what joint angles and the poses of head and hands are computed from.

    ``hips_pos_w`` and ``hips_q_w`` (w, x, y, z) are where the hips rest in the world; the waist is given in their
    frame, neck (the head's joints) and right shoulder in the torso's. The head's centre lies so far above the neck.
    """

    hips_pos_w: Vector3
    hips_q_w: Quaternion
    waist: Vector3
    neck: Vector3
    head_centre_m: float
    right_shoulder: Vector3
    upper_arm_m: float
    forearm_m: float
    hand_m: float


class StageLatency(msgspec.Struct, frozen=True):
    """How long a stage on the way from poses to pictures takes, percentiles in milliseconds."""

    stage: str
    p50: float
    p95: float
    p99: float


class StreamStatus(msgspec.Struct, frozen=True):
    """A stream of another device by the study's name for it, and whether it is there."""

    name: str
    present: bool


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

    Of a hand that holds a controller the pose is the grip's, of a bare hand the wrist's; a pose that is not tracked is
    ``None``. Which of them each hand is says its modality.
    """

    sequence: Annotated[int, msgspec.Meta(ge=0)]
    client_time_ms: float
    head: XRPose | None
    left: XRPose | None
    right: XRPose | None
    left_modality: Modality
    right_modality: Modality


class Receipt(Message, frozen=True, tag="receipt"):
    """How many states this connection has brought so far; it is told after every ``STATES_PER_RECEIPT`` of them."""

    states: Annotated[int, msgspec.Meta(ge=0)]


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
    """The emergency stop: the robot must hold immediately. ``way`` is how the participant made it."""

    way: StopWay | None = None


class VisibilityChanged(Message, frozen=True, tag="visibility_changed"):
    """From now on the participant sees the scene, or does not; after each welcome they see it until this arrives."""

    visibility: Visibility


class Recalibrate(Message, frozen=True, tag="recalibrate"):
    """The participant saw that body or seat do not fit, and wants to be measured again."""


class OriginReset(Message, frozen=True, tag="origin_reset"):
    """The reference space's origin jumped: earlier registration is void."""


class Answer(Message, schema.Answer, frozen=True, tag="answer"):
    """The answer to one item of the questionnaire, with the time from its appearance to the press."""


class Back(Message, frozen=True, tag="back"):
    """The participant wants to see the question before this one, and to answer it anew."""


class ChooseBody(Message, frozen=True, tag="choose_body"):
    """The body that the participant shall have; one of another sex is measured anew."""

    sex: Sex
    skin_tone: Annotated[str, msgspec.Meta(max_length=32)]


class Latency(Message, schema.Latency, frozen=True, tag="latency"):
    """How long the frames of the last second took from pose to picture."""


class HeadsetFrames(Message, frozen=True, tag="headset_frames"):
    """The frames of the last second while the headset is checked: milliseconds from each to the next, and on what.

    ``device`` is what the browser says that it is, ``profiles`` what it says of the controllers; ``display_hz`` is the
    display's rate, where it tells.
    """

    device: Annotated[str, msgspec.Meta(max_length=512)]
    emulated: bool
    profiles: Annotated[list[Annotated[str, msgspec.Meta(max_length=128)]], msgspec.Meta(max_length=4)]
    display_hz: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None
    intervals_ms: Annotated[
        list[Annotated[float, msgspec.Meta(gt=0, le=60_000)]], msgspec.Meta(max_length=512)
    ]


ClientMessage = (
    Hello
    | Tracking
    | Receipt
    | Entered
    | Left
    | Ready
    | SceneLoaded
    | Stop
    | VisibilityChanged
    | Recalibrate
    | OriginReset
    | Answer
    | Back
    | ChooseBody
    | Latency
    | HeadsetFrames
)

# From the experimenter ---------------------------------------------------------------------------------------

CommandName = Literal["stop", "pause", "continue", "repeat", "skip", "end", "recalibrate"]


class Command(Message, frozen=True, tag="command"):
    """What the experimenter wants of the session.

    ``stop``: the robot holds at once, and the participant may repeat the trial. ``pause``: the same, and no
    trial begins before ``continue``. ``repeat``: a new attempt at the trial. ``skip``: on to the next one.
    ``end``: the session is over. ``recalibrate``: the participant is measured again.
    """

    name: CommandName


class ChooseTheirBody(ChooseBody, frozen=True, tag="choose_body"):
    """The same, chosen by the experimenter."""


class CorrectTorsoHeight(Message, frozen=True, tag="correct_torso_height"):
    """The torso height that the experimenter measured; the body is made anew with it."""

    torso_height_m: float


class Drive(Message, frozen=True, tag="drive"):
    """How the operator moves the robot's hand, where they drive: many times a second while ``engaged``.

    Shares of the hand's greatest speeds, in the participant's directions: ``linear`` ahead, to the left and up,
    ``angular`` about these axes. Once the operator is no longer engaged, or silent, the robot holds still.
    """

    engaged: bool
    linear: Shares
    angular: Shares


class SceneWatched(Message, frozen=True, tag="scene_watched"):
    """A page that watches shows the scene of this address: an environment on show waits for that, no session does."""

    url: Annotated[str, msgspec.Meta(max_length=128)]


ExperimenterMessage = Hello | Receipt | Command | CorrectTorsoHeight | ChooseTheirBody | Drive | SceneWatched

# From the server -------------------------------------------------------------------------------------------

PhaseName = Literal[
    "waiting",
    "headset",
    "headset_check",
    "headset_stop",
    "calibration",
    "reach",
    "loading",
    "check",
    "ready",
    "free_before",
    "countdown",
    "trial",
    "retreat",
    "free_after",
    "questionnaire",
    "confirm",
    "paused",
    "finished",
    "viewing",
]


Role = Literal["participant", "spectator", "experimenter"]


class Welcome(Message, frozen=True, tag="welcome"):
    """The connection is accepted, as whose; whether a touch is felt and a success heard is the plan's choice."""

    protocol: int
    session: str
    role: Role
    haptics: bool
    sounds: bool


class Language(Message, frozen=True, tag="language"):
    """The participant's language: its tag, how it is written, and the words of their page by key.

    ``direction`` is ``ltr`` or ``rtl``, as HTML has it.
    """

    language: str
    direction: str
    words: dict[str, str]


class Body(Message, frozen=True, tag="body"):
    """The participant's body, and which tones of skin there are: by name, and red, green, blue in 0..1 of each."""

    sex: Sex
    skin_tone: str
    skin_tones: list[str]
    skin_tones_rgb: list[Vector3]


class Scene(Message, frozen=True, tag="scene"):
    """A scene to draw: a GLB whose nodes carry ``extras.body``, and where the simulated world stands.

    ``xr_from_world`` places the simulation's z-up world in the participant's ``local-floor`` space: apply it
    to the root node as it is. ``bodies`` is the order of the poses in every following state; those of
    ``marks`` spots on the person follow, of one radius and one colour (red, green, blue in 0..1).
    ``head_bodies`` are hidden from the participant's own eyes, which lie at ``eyes`` in the frame of the first
    of them (x left, -y ahead, z up). ``skeleton`` is that of the participant's body, whose bodies' names begin with
    ``person/``.
    """

    url: str
    bodies: list[str]
    head_bodies: list[str]
    marks: int
    mark_radius_m: float
    mark_rgb: Vector3
    eyes: Vector3
    skeleton: Skeleton
    xr_from_world: XRPose


class Placed(Message, frozen=True, tag="placed"):
    """The world goes from where it stands to another place in ``local-floor``, evenly, within so many seconds.

    So it follows a participant who has slid on their seat.
    """

    xr_from_world: XRPose
    seconds: float


class Upcoming(Message, frozen=True, tag="upcoming"):
    """The address of a scene that comes next: a client that fetches it now shows it sooner then."""

    url: str


class State(Message, frozen=True):
    """The world at one instant, as sessions hand it out. What is sent of it is a ``StateChange``.

    ``poses``: little-endian float32 (bodies + marks, 7): x, y, z, then w, x, y, z; world frame.
    ``joint_targets``: little-endian float32, radians. The other fields are those of ``StateChange``.
    """

    sequence: int
    simulation_time_s: float
    tracking_sequence: int
    joint_targets: bytes
    held: list[Part]
    poses: bytes


class StateChange(Message, frozen=True, tag="state"):
    """The world at one instant: how it differs from the state that this connection was sent before.

    After a scene it differs from nothing. ``tracking_sequence`` is the newest tracking frame that this state already
    follows, -1 before the first; ``joint_targets`` are the angles that the person's joints are driven to for it.
    ``held`` are the parts of the body that are not, and will not come, where they are tracked: something is in their
    way, or they are not tracked. Their owner sees them where they are simulated.

    ``joint_targets`` come in steps of 1e-5 rad, one row a joint; ``poses`` in steps of 0.1 mm and 5e-5, one row of x,
    y, z, w, x, y, z a body or mark. Rows that are as before are left out, but for the first state: each row begins
    with how many were, then come its differences in zigzag; all are varints as in Protocol Buffers.
    """

    sequence: int
    simulation_time_s: float
    tracking_sequence: int
    held: list[Part]
    joint_targets: bytes
    poses: bytes


class Passed(Message, frozen=True, tag="passed"):
    """When a tracking frame passed the server, in seconds of its clock; the state that follows it comes next.

    When it was received, when that state was handed out, and when it is sent.
    """

    tracking_sequence: int
    received_s: float
    simulated_s: float
    sent_s: float


class Phase(Message, frozen=True, tag="phase"):
    """Where the session stands, with the words to show to the participant.

    ``text`` is for somebody in VR who selects by a trigger, ``texts_by_input`` for other kinds of input, and
    ``page_text`` for somebody who takes part on the page, without a headset, where these differ.
    """

    name: PhaseName
    text: str
    trial: int
    trials: int
    practice: bool
    seconds: float | None
    page_text: str = ""
    texts_by_input: dict[str, str] = {}


class Question(Message, frozen=True, tag="question"):
    """One item to show and to answer by pointing and pressing the trigger.

    ``labels`` are the words on its buttons; where there are none, they are numbered from 1 to ``points``. ``given`` is
    the participant's earlier answer, where they went back to a question.
    """

    item: str
    text: str
    points: int
    low: str
    high: str
    labels: list[str]
    number: int
    count: int
    given: int | None = None


class Problem(Message, frozen=True, tag="problem"):
    """What was wrong with a message or a measurement, and what is allowed. The session goes on.

    ``page_message`` says it to somebody who takes part without a headset, ``messages_by_input`` to somebody in VR who
    selects by another input than a trigger, where these differ. ``role``: the person that it concerns. The participant
    never reads what was wrong with what the experimenter asked for; the experimenter, who helps them, reads both.
    """

    message: str
    role: Role = "participant"
    page_message: str = ""
    messages_by_input: dict[str, str] = {}


class Feedback(Message, frozen=True, tag="feedback"):
    """What the participant feels and hears of one control step.

    Whether robot or tool touch the left and the right arm, hands included; ``events``: how many bites or drops
    reached the mouth, markers were wiped or scratches made.
    """

    left_touched: bool
    right_touched: bool
    events: int


class Status(Message, frozen=True, tag="status"):
    """How the session stands, several times a second, for those who watch it; never sent to the participant.

    ``step`` counts the attempt's control steps, ``reward`` sums them up, ``success`` is so far; distance and force are
    those of the latest one. ``force_region`` is the region of the body that bears most now, by its limit, and
    ``force_share`` how much of that; empty and 0 where none bears anything. ``retracting``: the force guard moves the
    robot. ``withdrawing``: after success the robot withdraws its tool, or waits withdrawn. ``tracking_age_s`` is the
    time since the newest usable frame. ``untracked_parts`` have stale poses; those of them that are in
    ``needed_parts``, which the task needs, hold the robot, and end an attempt after a second. ``visibility``: whether
    the participant sees the scene. ``operated``: in this trial the experimenter drives; ``idle``: the robot holds
    still for want of an action. ``pause_reason``: the answer for which a stop rule paused the session, empty where
    none did. ``latency``: how late pictures were in the last seconds of which the client told, from pose to picture
    as ``total_ms`` and by stage. ``streams``: those of other devices.
    """

    phase: PhaseName
    trial: int
    trials: int
    attempt: int
    environment: str
    paused: bool
    pause_reason: str
    torso_height_m: float
    step: int
    steps: int
    reward: float
    success: bool
    distance_m: float
    force_on_person_n: float
    force_region: str
    force_share: float
    retracting: bool
    withdrawing: bool
    tracking_age_s: float | None
    visibility: Visibility
    left_modality: Modality
    right_modality: Modality
    needed_parts: list[Part]
    untracked_parts: list[Part]
    operated: bool
    idle: bool
    latency: list[StageLatency]
    streams: list[StreamStatus]


class Timing(Message, frozen=True, tag="timing"):
    """What the last second's ticks of 10 ms took, for those who watch; ticks given up since the beginning."""

    tick_ms_median: float
    tick_ms_max: float
    missed_ticks: int


ServerMessage = (
    Welcome
    | Language
    | Body
    | Scene
    | Placed
    | Upcoming
    | Passed
    | StateChange
    | Phase
    | Question
    | Problem
    | Feedback
    | Status
    | Timing
)

Sent = ServerMessage | State
"""What a session hands out; of states clients are sent the changes."""
Send = Callable[[Sent], None]
"""Sends what a session hands out to whom it concerns."""

_Any = TypeVar("_Any")

_client_decoder = msgspec.msgpack.Decoder(ClientMessage)
_experimenter_decoder = msgspec.msgpack.Decoder(ExperimenterMessage)
_server_decoder = msgspec.msgpack.Decoder(ServerMessage)
_encoder = msgspec.msgpack.Encoder()


def encode(message: Message) -> bytes:
    """Encode any message of the protocol."""
    return _encoder.encode(message)


def decode_client(data: bytes) -> ClientMessage:
    """Decode a message from the client; raises ``msgspec.DecodeError`` when it is not one."""
    return _decode(_client_decoder, data)


def decode_experimenter(data: bytes) -> ExperimenterMessage:
    """Decode a message from who watches; raises ``msgspec.DecodeError`` when it is not one."""
    return _decode(_experimenter_decoder, data)


def decode_server(data: bytes) -> ServerMessage:
    """Decode a message from the server; raises ``msgspec.DecodeError`` when it is not one."""
    return _decode(_server_decoder, data)


def _decode(decoder: msgspec.msgpack.Decoder[_Any], data: bytes) -> _Any:
    try:
        return decoder.decode(data)
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(f"text that is not UTF-8: {error}") from error
    except RecursionError as error:
        raise msgspec.DecodeError("nested too deeply") from error


# What a session receives -----------------------------------------------------------------------------------


class Disconnected(msgspec.Struct, frozen=True):
    """The participant's connection has closed."""


Received = ClientMessage | ExperimenterMessage | Disconnected
"""Everything that a session receives: messages of its clients, and the end of the participant's connection."""
