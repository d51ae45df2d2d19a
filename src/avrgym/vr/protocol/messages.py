"""The protocol between the VR client and the server.

Every WebSocket message is a MessagePack map with a ``type`` tag. ``scripts/write_typescript.py`` generates the
TypeScript types from this module. Poses of headset and controllers have the conventions of WebXR: reference space
``local-floor``, metres, y up, quaternions x, y, z, w. The server converts them.

Watchers are the clients of experimenters, caregivers, demonstrators and spectators.
"""

from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

import msgspec

from avrgym.commands.input_methods import InputMethod as InputMethod
from avrgym.commands.input_methods import StopInput as StopInput
from avrgym.commands.vocabulary import ClientCommandSource, CommandSource, OtherPersonCommandSource
from avrgym.commands.vocabulary import CommandName as RobotCommandName
from avrgym.models.body_names import Side as Side
from avrgym.models.body_names import TrackedBodyPart
from avrgym.models.furniture.real_furniture import FurniturePoint as FurniturePoint
from avrgym.models.human import Sex
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.recording import schema
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.presentation import Contrast as Contrast
from avrgym.recording.presentation import PanelPosition as PanelPosition
from avrgym.recording.presentation import PresentationPreferences as PresentationPreferences

PROTOCOL_VERSION = 17
"""Version of the protocol. Client and server must have the same version."""

TICK_S = PHYSICS_STEP_S
"""Period of the real-time loop in seconds."""

MAX_UNACKNOWLEDGED_STATES = 8
"""Maximum number of sent states that the client has not acknowledged. If a round trip takes more than 60 ms, some
states are skipped."""
STATES_PER_RECEIPT = 2

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
NormalizedValue = Annotated[float, msgspec.Meta(ge=-1, le=1)]
NormalizedVector = tuple[NormalizedValue, NormalizedValue, NormalizedValue]
Modality = Literal["controller", "hand", "mouse", "none"]
"""The device that tracks a hand."""
StopMethod = Literal["button", "triggers", "squeeze", "select", "palm", "gaze", "switch", "page", "key"]
"""Method with which a participant stops the robot: with a menu button; by holding both triggers, a grip button
(squeeze) or the only select button; with a raised palm; by looking at the stop sign; with a switch; with the page's
button or a key."""
Visibility = Literal["visible", "visible-blurred", "hidden", "context-lost"]
"""Whether the participant sees the scene and can act. The names are those of WebXR and the page visibility API.

``visible-blurred``: a menu of the headset covers the scene, and no input arrives. ``hidden``: the headset shows
nothing, or the page is in the background. ``context-lost``: the graphics of the participant's device failed.
"""


class XRPose(msgspec.Struct, frozen=True, array_like=True):
    """A pose in WebXR's ``local-floor`` space: position in metres (y up), orientation x, y, z, w."""

    position: Vector3
    orientation: Quaternion


class Skeleton(msgspec.Struct, frozen=True):
    """Dimensions of a person's body in metres, for inverse and forward kinematics.

    ``hips_pos_w`` and ``hips_q_w`` (w, x, y, z): the pose of the hips in the world frame. ``waist`` is in the frame of
    the hips; ``neck`` and ``right_shoulder`` are in the frame of the torso. ``head_centre_m``: height above the neck.
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
    """Latency of a stage between tracking and display: percentiles in milliseconds."""

    stage: str
    p50: float
    p95: float
    p99: float


class StreamStatus(msgspec.Struct, frozen=True):
    """Whether the stream of another device is available. ``name``: name of the stream in the study."""

    name: str
    present: bool


class CommandLabel(msgspec.Struct, frozen=True):
    """A robot command that the participant can give, and its label in the participant's language."""

    name: RobotCommandName
    label: str


class Message(msgspec.Struct, frozen=True, tag_field="type", forbid_unknown_fields=True):
    """Base class of all messages between client and server."""


# From the client -------------------------------------------------------------------------------------------


class Hello(Message, frozen=True, tag="hello"):
    """The first message of a connection. ``token`` is in the fragment of the page's address."""

    protocol: int
    token: Annotated[str, msgspec.Meta(max_length=128)]
    device: Annotated[str, msgspec.Meta(max_length=512)]
    emulated: bool


class TrackingFrameMessage(Message, frozen=True, tag="tracking"):
    """The poses of one XR frame. ``sequence`` increases by one; ``client_time_ms`` is the XR frame's time stamp.

    ``left`` and ``right`` are grip poses of controllers, or wrist poses of bare hands, depending on the modality.
    ``None``: not tracked.
    """

    sequence: Annotated[int, msgspec.Meta(ge=0)]
    client_time_ms: float
    head: XRPose | None
    left: XRPose | None
    right: XRPose | None
    left_modality: Modality
    right_modality: Modality


class StateReceipt(Message, frozen=True, tag="receipt"):
    """Acknowledges states; sent after every ``STATES_PER_RECEIPT`` states. ``num_states``: number of all received
    states."""

    num_states: Annotated[int, msgspec.Meta(ge=0)] = msgspec.field(name="states")


class VrEntered(Message, frozen=True, tag="entered"):
    """The participant entered VR."""


class VrLeft(Message, frozen=True, tag="left"):
    """The participant left VR. The connection may remain open."""


class ParticipantReady(Message, frozen=True, tag="ready"):
    """The participant pressed the trigger to confirm, in a phase that waits for this."""


class SceneLoaded(Message, frozen=True, tag="scene_loaded"):
    """The client displays the scene with this address."""

    url: Annotated[str, msgspec.Meta(max_length=128)]


class Stop(Message, frozen=True, tag="stop"):
    """The emergency stop: the robot must hold still immediately. ``method``: the participant's action."""

    method: StopMethod | None = None


class RobotCommand(Message, frozen=True, tag="robot_command"):
    """A command of the participant to the robot, see ``avrgym.commands.vocabulary``.

    ``source``: the source of the command, such as a key. ``client_time_ms``: time of the input, on the page's clock.
    """

    name: RobotCommandName
    source: ClientCommandSource
    client_time_ms: float


class VisibilityChanged(Message, frozen=True, tag="visibility_changed"):
    """The visibility of the scene has changed. After each ``welcome``, the server assumes ``visible``."""

    visibility: Visibility


class RecalibrationRequest(Message, frozen=True, tag="recalibrate"):
    """The participant requests a new calibration, because the virtual body or seat does not fit."""


class BreakRequest(Message, frozen=True, tag="request_break"):
    """The participant requests a break before the next trial."""


class PreferenceChangeRequest(Message, frozen=True, tag="change_preferences"):
    """The participant requests the questions about preferences for the robot, before the next trial."""


class OriginReset(Message, frozen=True, tag="origin_reset"):
    """The origin of the reference space has changed, so the registration is invalid."""


class Answer(Message, schema.Answer, frozen=True, tag="answer"):
    """The answer to a questionnaire item, with the response time since its display."""


class PreviousQuestionRequest(Message, frozen=True, tag="back"):
    """The participant requests the previous question, to change the answer."""


class BodyChoice(Message, frozen=True, tag="choose_body"):
    """The participant's choice of a body model. A change of the sex requires a new calibration."""

    sex: Sex
    skin_tone: Annotated[str, msgspec.Meta(max_length=32)]


class SelectionTarget(msgspec.Struct, frozen=True):
    """A button or another object that the participant can select: its value and its label."""

    value: int
    label: Annotated[str, msgspec.Meta(max_length=256)]


class OfferedTargets(Message, frozen=True, tag="offered"):
    """The targets that the participant can select now. The experimenter may select a target for the participant.

    ``offer_number`` increases with each offer. An offer without targets ends the previous offer.
    """

    offer_number: Annotated[int, msgspec.Meta(ge=0)] = msgspec.field(name="number")
    targets: Annotated[list[SelectionTarget], msgspec.Meta(max_length=128)]


class Latency(Message, schema.Latency, frozen=True, tag="latency"):
    """Latencies of the frames of the last second, from tracking to display."""


class FrameIntervals(Message, frozen=True, tag="headset_frames"):
    """Frame intervals of the last second during the headset check, with a description of the device.

    ``device``: the browser's user agent. ``profiles``: input profiles of the controllers. ``display_hz``: refresh rate
    of the display, if known.
    """

    device: Annotated[str, msgspec.Meta(max_length=512)]
    emulated: bool
    profiles: Annotated[list[Annotated[str, msgspec.Meta(max_length=128)]], msgspec.Meta(max_length=4)]
    display_hz: Annotated[float, msgspec.Meta(gt=0, le=1000)] | None
    intervals_ms: Annotated[
        list[Annotated[float, msgspec.Meta(gt=0, le=60_000)]], msgspec.Meta(max_length=512)
    ]


ParticipantMessage = (
    Hello
    | TrackingFrameMessage
    | StateReceipt
    | VrEntered
    | VrLeft
    | ParticipantReady
    | SceneLoaded
    | Stop
    | RobotCommand
    | VisibilityChanged
    | RecalibrationRequest
    | BreakRequest
    | PreferenceChangeRequest
    | OriginReset
    | Answer
    | PreviousQuestionRequest
    | BodyChoice
    | OfferedTargets
    | Latency
    | FrameIntervals
)

# From the experimenter ---------------------------------------------------------------------------------------

ExperimenterCommandName = Literal[
    "stop", "pause", "continue", "repeat", "skip", "end", "recalibrate", "break"
]


class ExperimenterCommand(Message, frozen=True, tag="command"):
    """A command of the experimenter.

    ``stop``: stop the robot immediately; the participant may repeat the trial. ``pause``: stop the robot, and
    start no trial before ``continue``. ``repeat``: a new attempt at the trial. ``skip``: go to the next
    trial. ``end``: end the session. ``recalibrate``: calibrate the participant again. ``break``: a break before
    the next trial.
    """

    name: ExperimenterCommandName


class ParticipantBodyChoice(BodyChoice, frozen=True, tag="choose_body"):
    """The experimenter's choice of the participant's body model, as ``BodyChoice``."""


class TorsoHeightCorrection(Message, frozen=True, tag="correct_torso_height"):
    """The participant's torso height as the experimenter measured it. The body is rebuilt with this height."""

    torso_height_m: float


OperatorRole = Literal["operator", "demonstrator"]
"""Role that controls the robot: the experimenter (``operator``) or a demonstrator."""
DemonstrationButton = Literal["start", "success", "discard"]


class VelocityCommand(Message, frozen=True, tag="drive"):
    """Velocity command of the operator for the robot's hand, sent many times a second while ``engaged``.

    The components are shares of the maximum speeds. ``linear``: forward, left and up in the participant's frame;
    ``angular``: about these axes. The robot holds still when the operator disengages or sends no commands. ``source``
    is the sender.
    """

    engaged: bool
    linear: NormalizedVector
    angular: NormalizedVector
    source: OperatorRole = "operator"


class ControllerPoseCommand(Message, frozen=True, tag="steer"):
    """The demonstrator's controller in one XR frame. While ``clutch`` is true, the tool repeats its relative motion.

    ``grip``: pose of the grip in the demonstrator's ``local-floor`` space; ``None``: not tracked. ``xr_from_world``:
    pose of the world in this space. ``scale``: translation of the tool divided by the translation of the controller.
    """

    clutch: bool
    grip: XRPose | None
    xr_from_world: XRPose
    scale: Annotated[float, msgspec.Meta(ge=0.1, le=2)]


class DemonstrationCommand(Message, frozen=True, tag="demonstrate"):
    """A pressed button in a demonstration session: it starts an episode, ends it as a success, or discards it."""

    button: DemonstrationButton


class OtherPersonRobotCommand(Message, frozen=True, tag="robot_command"):
    """A command of the caregiver or the experimenter to the robot, as ``RobotCommand``."""

    name: RobotCommandName
    source: OtherPersonCommandSource
    client_time_ms: float


class TargetSelectionRequest(Message, frozen=True, tag="press"):
    """The experimenter selects a target for the participant."""

    offer_number: Annotated[int, msgspec.Meta(ge=0)] = msgspec.field(name="number")
    target_value: int = msgspec.field(name="value")


class FurniturePointMark(Message, frozen=True, tag="mark_point"):
    """The tracked controller touches a point of the real seat or mattress. The points are front, rear and top."""

    point: FurniturePoint


class WatcherSceneLoaded(Message, frozen=True, tag="scene_watched"):
    """A watcher's page displays the scene with this address. The environment viewer waits for this; sessions do not."""

    url: Annotated[str, msgspec.Meta(max_length=128)]


WatcherMessage = (
    Hello
    | StateReceipt
    | ExperimenterCommand
    | TorsoHeightCorrection
    | ParticipantBodyChoice
    | TargetSelectionRequest
    | FurniturePointMark
    | VelocityCommand
    | ControllerPoseCommand
    | DemonstrationCommand
    | OtherPersonRobotCommand
    | WatcherSceneLoaded
)

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
    "break",
    "paused",
    "finished",
    "viewing",
]


DemonstrationStage = Literal["preparing", "ready", "running", "finished"]
Role = Literal["participant", "spectator", "experimenter", "caregiver", "demonstrator"]


class Welcome(Message, frozen=True, tag="welcome"):
    """The server accepts the connection in a role. ``haptics``, ``sounds``: whether the session plan enables this
    feedback."""

    protocol: int
    session: str
    role: Role
    haptics: bool
    sounds: bool


class Language(Message, frozen=True, tag="language"):
    """The participant's language: its tag, its direction (``ltr`` or ``rtl``) and the texts of the page by key."""

    language: str
    direction: str
    texts: dict[str, str]


class ParticipantBody(Message, frozen=True, tag="body"):
    """The participant's body model, and the available skin tones: names and RGB values in [0, 1]."""

    sex: Sex
    skin_tone: str
    skin_tones: list[str]
    skin_tones_rgb: list[Vector3]


class InputProfileMessage(Message, InputProfile, frozen=True, tag="input"):
    """The participant's input profile, with the stop methods."""


class ParticipantTargets(OfferedTargets, frozen=True, tag="targets"):
    """The targets that the participant can select now, for experimenters."""


class TargetSelected(TargetSelectionRequest, frozen=True, tag="pressed"):
    """The experimenter selected a target. The participant's client ignores this message if the offer is no longer
    valid."""


class Scene(Message, frozen=True, tag="scene"):
    """A scene to display: the address of a GLB file, and the pose of the world. Nodes of the file have ``extras.body``.

    ``xr_from_world``: pose of the z-up world frame in ``local-floor``, for the root node. ``bodies``: the order of the
    poses in later state messages. ``marks``: number of spheres on the person that show the targets of the task. In
    state messages, their positions come after the bodies. All marks have the same radius and colour (RGB in [0, 1]).
    The first-person view hides ``head_bodies``. Its viewpoint is ``eyes``, in the frame of the first head body (x left,
    −y forward, z up). ``skeleton``: the participant's body dimensions. Names of the participant's bodies begin with
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


class WorldMotion(Message, frozen=True, tag="placed"):
    """Commands the client to move the world linearly to another pose in ``local-floor``, in a given time.

    The server sends this message when a participant has slid on the seat.
    """

    xr_from_world: XRPose
    seconds: float


class NextScene(Message, frozen=True, tag="upcoming"):
    """The address of the next scene, which the client may fetch in advance."""

    url: str


class WorldState(Message, frozen=True):
    """The state of the world at one time, inside the server. Clients receive it as a ``WorldStateChange``.

    ``poses``: little-endian float32 (bodies + marks, 7) in the world frame: position x, y, z, quaternion w, x, y, z.
    ``joint_targets``: little-endian float32, radians. For the other fields, see ``WorldStateChange``.
    """

    sequence_number: int
    simulation_time_s: float
    tracking_sequence_number: int
    joint_targets: bytes
    deviating_parts: list[TrackedBodyPart]
    poses: bytes


class WorldStateChange(Message, frozen=True, tag="state"):
    """The state of the world at one time, as the difference to the previous state of this connection.

    The first state after a ``scene`` message contains all rows. ``tracking_sequence``: the newest tracking frame that
    this state includes, -1 before the first. ``joint_targets``: target angles of the person's joints.
    ``deviating_parts``: parts of the body that cannot follow tracking, because of an obstacle or lost tracking. The
    client draws the simulated poses of these parts.

    ``joint_targets`` has steps of 1e-5 rad and one row per joint. ``poses`` has one row x, y, z, w, x, y, z per body or
    mark. Positions have steps of 0.1 mm, quaternions of 5e-5. Unchanged rows are omitted. Each row begins with the
    number of omitted rows before it. Its differences follow in zigzag encoding. All numbers are varints of Protocol
    Buffers.
    """

    sequence: int
    simulation_time_s: float
    tracking_sequence: int
    deviating_parts: list[TrackedBodyPart]
    joint_targets: bytes
    poses: bytes


class TrackingFrameTimes(Message, frozen=True, tag="passed"):
    """Times of a tracking frame in the server, in seconds of the server's clock.

    ``received_s``: the frame was received. ``simulated_s``: the first state that includes it was computed. ``sent_s``:
    this state was sent. This state is the next message.
    """

    tracking_sequence: int
    received_s: float
    simulated_s: float
    sent_s: float


class PhaseDescription(Message, frozen=True, tag="phase"):
    """The phase of the session, with the text for the participant.

    ``trial``: number of the running or next trial, from 1. ``trials``: number of trials. ``seconds``: time limit.
    ``text`` is for VR with a trigger. ``texts_by_input``: texts for other input methods. ``page_text``: text for the
    page without a headset. ``key``: the key of the text. ``preferences``: whether the participant may change their
    preferences for the robot now.
    """

    name: PhaseName
    text: str
    trial: int
    trials: int
    practice: bool
    seconds: float | None
    page_text: str = ""
    texts_by_input: dict[str, str] = {}
    key: str = ""
    preferences: bool = False


class Question(Message, frozen=True, tag="question"):
    """A questionnaire item.

    ``item``: its identifier. ``points``: number of points of the scale. ``low``, ``high``: texts at the ends of the
    scale. ``labels``: texts of the buttons; default: numbers from 1 to ``points``. ``number``: position in the
    questionnaire, from 1. ``count``: number of items. ``previous_answer``: the earlier answer, if the participant went
    back to this item.
    """

    item: str
    text: str
    points: int
    low: str
    high: str
    labels: list[str]
    number: int
    count: int
    previous_answer: int | None = None


class Problem(Message, frozen=True, tag="problem"):
    """An error in a message or a measurement, with the allowed values. The session continues.

    ``message`` is for VR with a trigger. ``page_message``: text for the page without a headset. ``messages_by_input``:
    texts for other input methods. ``role``: the role that receives the problem. The experimenter receives all problems.
    """

    message: str
    role: Role = "participant"
    page_message: str = ""
    messages_by_input: dict[str, str] = {}


class AvailableRobotCommands(Message, frozen=True, tag="robot_commands"):
    """The robot commands that are possible now; an empty list if no command is possible. Sent when a field changes its
    value.

    ``sources``: the allowed sources. ``mode``: the mode of the pacing layer, see ``avrgym.safety.pacing``; empty
    without the layer. ``speed_factor``: factor of the policy's speed. ``distance_m``: distance at which the robot
    waits.
    """

    commands: list[CommandLabel]
    sources: list[CommandSource]
    mode: str
    speed_factor: float
    distance_m: float


class HapticAndAudioFeedback(Message, frozen=True, tag="feedback"):
    """Haptic and acoustic feedback for one control step.

    ``left_touched``, ``right_touched``: whether robot or tool touch this arm or hand. ``events``: the number of task
    successes in this step: bites or drops in the mouth, wiped targets, or scratches.
    """

    left_touched: bool
    right_touched: bool
    events: int


class ToolForce(Message, frozen=True, tag="tool_force"):
    """The contact force of the tool on the person, in newtons, for demonstrators. Sent when it changes."""

    force_n: float


class DemonstrationProgress(Message, frozen=True, tag="demonstration_progress"):
    """Progress of a demonstration session, for watchers. Sent when it changes.

    ``stage``: ``preparing`` (the next world is built), ``ready`` (waits for the start), ``running`` or ``finished``.
    ``goal``: the task. ``episodes``: planned number; ``None``: unlimited. ``completed``, ``successes`` and
    ``discarded``: numbers of episodes. ``seconds``: maximum duration of an episode. ``policy``: name of the policy that
    drives until an operator takes over; empty without a policy.
    """

    stage: DemonstrationStage
    goal: str
    episodes: int | None
    completed: int
    successes: int
    discarded: int
    seconds: float
    policy: str = ""


class SessionStatus(Message, frozen=True, tag="status"):
    """The status of the session, several times a second, for watchers only.

    ``step``: number of control steps of the attempt. ``steps``: number of control steps of a complete trial.
    ``reward``: the sum of rewards. ``success``: whether the attempt has succeeded until now. ``distance_m`` and
    ``force_on_person_n`` are values of the latest step. ``force_region``: the body region with the highest ratio of
    force to allowed force; empty without contact. ``force_share``: this ratio; 0 without contact.

    ``retracting``: the force guard moves the robot. ``withdrawing``: the robot withdraws its tool after success, or has
    withdrawn it. ``operated``: the experimenter drives the robot in this trial. ``idle``: the robot holds still without
    an action. ``paused``: no trial may start. ``pause_reason``: the answer that met a stop rule; empty without such an
    answer.

    ``tracking_age_s``: time since the newest valid frame. ``untracked_parts``: parts of the body with stale poses. If
    one of them is in ``needed_parts``, the robot holds still, and the attempt ends after a second. ``latency``: recent
    latencies from tracking to display, in total (``total_ms``) and by stage. ``streams``: streams of other devices.
    ``headset_s``: the participant's time in VR. ``headset_limit_s``: the maximum time in VR. ``break_is_due``: a break
    follows before the next trial.
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
    needed_parts: list[TrackedBodyPart]
    untracked_parts: list[TrackedBodyPart]
    operated: bool
    idle: bool
    latency: list[StageLatency]
    streams: list[StreamStatus]
    headset_s: float = 0.0
    headset_limit_s: float | None = None
    break_is_due: bool = False


class TickTiming(Message, frozen=True, tag="timing"):
    """Durations of the ticks of the last second, for watchers, and the number of skipped ticks since the start."""

    tick_ms_median: float
    tick_ms_max: float
    missed_ticks: int


ServerMessage = (
    Welcome
    | Language
    | ParticipantBody
    | InputProfileMessage
    | ParticipantTargets
    | TargetSelected
    | Scene
    | WorldMotion
    | NextScene
    | TrackingFrameTimes
    | WorldStateChange
    | PhaseDescription
    | Question
    | Problem
    | AvailableRobotCommands
    | HapticAndAudioFeedback
    | SessionStatus
    | TickTiming
    | ToolForce
    | DemonstrationProgress
)

SentMessage = ServerMessage | WorldState
"""All messages that a session sends. Clients receive a ``WorldState`` as a ``WorldStateChange``."""
MessageSender = Callable[[SentMessage], None]
"""Function that sends a message to its receivers."""

_Any = TypeVar("_Any")

_client_decoder = msgspec.msgpack.Decoder(ParticipantMessage)
_experimenter_decoder = msgspec.msgpack.Decoder(WatcherMessage)
_server_decoder = msgspec.msgpack.Decoder(ServerMessage)
_encoder = msgspec.msgpack.Encoder()


def encode_message(message: Message) -> bytes:
    """Returns a message of the protocol, encoded as MessagePack."""
    return _encoder.encode(message)


def decode_participant_message(data: bytes) -> ParticipantMessage:
    """Decode and return a message from the client. Raises ``msgspec.DecodeError`` for invalid data."""
    return _decode(_client_decoder, data)


def decode_watcher_message(data: bytes) -> WatcherMessage:
    """Decode and return a message from a watcher. Raises ``msgspec.DecodeError`` for invalid data."""
    return _decode(_experimenter_decoder, data)


def decode_server_message(data: bytes) -> ServerMessage:
    """Decode and return a message from the server. Raises ``msgspec.DecodeError`` for invalid data."""
    return _decode(_server_decoder, data)


def _decode(decoder: msgspec.msgpack.Decoder[_Any], data: bytes) -> _Any:
    try:
        return decoder.decode(data)
    except UnicodeDecodeError as error:
        raise msgspec.DecodeError(f"a text is not UTF-8: {error}; allowed: texts in UTF-8") from error
    except RecursionError as error:
        raise msgspec.DecodeError(
            "the message is nested too deeply; allowed: the fields of its message type"
        ) from error


# Messages to a session --------------------------------------------------------------------------------------


class ParticipantDisconnected(msgspec.Struct, frozen=True):
    """The participant's connection has closed."""


class DemonstratorDisconnected(msgspec.Struct, frozen=True):
    """The demonstrator's connection has closed."""


ReceivedMessage = ParticipantMessage | WatcherMessage | ParticipantDisconnected | DemonstratorDisconnected
"""All messages that a session receives: messages of its clients, and messages that a connection has closed."""
