"""Schema of a recording: the JSON records of each topic.

JSON preserves every bit of finite numbers. Numbers that are not finite are the strings ``"NaN"``, ``"Infinity"`` and
``"-Infinity"``. The module ``configuration`` defines the trial's configuration.
"""

import math
from typing import Annotated, Any, Literal, get_args

import msgspec

from avrgym.questionnaires.questionnaire import MAX_OPTION_COUNT
from avrgym.system.type_guards import is_array, is_table

MAX_LATENCY_FRAMES, MAX_LATENCY_MS = 256, 60_000
"""Limits of one latency record: maximum number of frames, and maximum latency in milliseconds."""


class Record(msgspec.Struct, frozen=True, omit_defaults=True):
    """Base class of all records. Times are in seconds from the start of the trial unless noted."""


class Pose(Record, frozen=True):
    """A pose in WebXR's ``local-floor`` space: position in metres (y up), orientation as quaternion x, y, z, w."""

    position: list[float]
    orientation: list[float]


class Physics(Record, frozen=True):
    """The simulator's full integration state after a physics step.

    ``step``: number of finished control steps. ``simulation_time_s``: time of the simulated world. ``state``: MuJoCo's
    ``mjSTATE_INTEGRATION`` vector.
    """

    step: int
    simulation_time_s: float
    state: list[float]


class TrackingFrame(Record, frozen=True):
    """One WebXR frame as the server received it. A pose without tracking is ``None``.

    ``moved_person``: whether the frame moved the person; otherwise a newer frame replaced it. ``rejected``: whether the
    frame was stale or invalid. A rejected frame does not move the person. ``rejected_parts``: parts (``head``,
    ``left``, ``right``) that the frame did not move. Their poses jumped, or the task needs them and their poses were
    stale. ``untracked_parts``: parts with poses that are missing, or unchanged for 0.2 s. ``left_modality``,
    ``right_modality``: tracking method of a hand: ``controller``, ``hand`` (bare hand, pose of the wrist), ``mouse``
    (without a headset) or ``none``.
    """

    sequence: int
    client_time_ms: float
    received_time_s: float
    moved_person: bool = msgspec.field(name="applied")
    rejected: bool = msgspec.field(name="held")
    head: Pose | None = None
    left: Pose | None = None
    right: Pose | None = None
    left_modality: str = "none"
    right_modality: str = "none"
    rejected_parts: list[str] = msgspec.field(default=[], name="held_parts")
    untracked_parts: list[str] = []


class BodyTargets(Record, frozen=True):
    """Joint targets of the person in radians, valid from the next physics step. They are recorded when they change.

    The order is that of ``joints`` in the configuration.
    """

    joint_targets: list[float]


class Command(Record, frozen=True):
    """The robot's command at the start of control step ``step``. An interrupted step has no ``Control`` record.

    A slow driver or a human operator may change the command during the step. The phase ``retreat`` has no control
    steps; there, the commands move the robot away from the person. ``brakes_on``: whether the brakes are on; the action
    is then zero.
    """

    step: int
    action: list[float]
    brakes_on: bool = msgspec.field(default=False, name="brakes")


class Placement(Record, frozen=True):
    """A new pose of the simulated world in ``local-floor``, after the participant moved on the seat.

    The configuration's ``xr_from_world`` is the pose at the start.
    """

    xr_from_world: Pose


class Control(Record, frozen=True):
    """One control step of the robot. ``reward`` is the weighted sum of ``reward_terms``, which are not weighted.

    ``driver``: name of the policy, ``operator`` or ``demonstrator``. ``idle``: whether the robot was stopped at the end
    of the step. Possible causes are no command of the operator, a failed controller, and stale tracking.
    """

    step: int
    observation: list[float]
    action: list[float]
    reward: float
    reward_terms: dict[str, float]
    success: bool
    distance_m: float
    force_on_person_n: float
    driver: str = ""
    idle: bool = False


class Event(Record, frozen=True):
    """An event of the session, for example a lost connection. ``detail`` contains further information."""

    name: str
    detail: str


class RobotCommand(Record, frozen=True):
    """A command from the participant to the robot, see ``avrgym.commands.vocabulary``.

    ``source``: input source, such as ``button`` or ``nod``. ``step``: number of finished control steps. ``had_effect``:
    whether the pacing layer reacted. ``refusal_reason``: the reason why the command was ignored; empty for an allowed
    command.
    """

    name: str
    source: str
    step: int
    had_effect: bool = msgspec.field(default=False, name="effective")
    refusal_reason: str = msgspec.field(default="", name="refusal")


class Pacing(Record, frozen=True):
    """State of the pacing layer at the end of a control step, see ``avrgym.safety.pacing``.

    ``mode``: mode, such as ``waiting``. ``speed_factor``: factor of the policy's speed. ``preferred_side``: 1 left, -1
    right, 0 any. ``tool_distance_m``: distance between tool and mouth or arm.
    """

    step: int
    mode: str
    speed_factor: float
    preferred_distance_m: float = msgspec.field(name="distance_m")
    preferred_side: float = msgspec.field(name="side")
    tool_distance_m: float = msgspec.field(name="gap_m")
    tool_speed_m_s: float


class Answer(Record, frozen=True):
    """The answer to one item. ``response_time_s``: time from the item's appearance to the answer."""

    item: Annotated[str, msgspec.Meta(max_length=64)]
    value: Annotated[int, msgspec.Meta(ge=1, le=MAX_OPTION_COUNT)]
    response_time_s: Annotated[float, msgspec.Meta(ge=0)]


_Numbers = Annotated[list[int], msgspec.Meta(max_length=MAX_LATENCY_FRAMES)]
_Milliseconds = Annotated[
    list[Annotated[float, msgspec.Meta(ge=0, le=MAX_LATENCY_MS)]], msgspec.Meta(max_length=MAX_LATENCY_FRAMES)
]


class Latency(Record, frozen=True):
    """Latency of tracking frames from pose to displayed image by stage, in milliseconds. Each list has one entry per
    frame.

    ``sequence``: number of each frame, the newest frame in a displayed state. Each stage starts at the end of the
    previous stage. The first stage starts at the tracked pose. The stages end at these events: ``sample_ms``, the pose
    is sent; ``up_ms``, it arrives at the server; ``simulate_ms``, the state is simulated; ``send_ms``, the state is
    sent; ``down_ms``, it arrives at the client; ``draw_ms``, the image is displayed. The clocks of client and server
    are synchronised: the fastest messages are assumed to take equal times in both directions.
    """

    sequence: _Numbers
    sample_ms: _Milliseconds
    up_ms: _Milliseconds
    simulate_ms: _Milliseconds
    send_ms: _Milliseconds
    down_ms: _Milliseconds
    draw_ms: _Milliseconds


class Stream(Record, frozen=True):
    """A stream of another device; recorded before its first samples.

    ``name``: name in the study. ``measurement_type``: as the device reports it, for example ``EEG``. ``rate_hz``:
    nominal sample rate, 0 for irregular samples. Channel names and units are empty if the device reports none.
    """

    name: str = msgspec.field(name="stream")
    device_name: str = msgspec.field(name="source")
    measurement_type: str = msgspec.field(name="kind")
    rate_hz: float
    channels: list[str]
    units: list[str]


class StreamSamples(Record, frozen=True):
    """Samples of a stream in the order of arrival: numbers in ``values``, or text in ``texts``.

    ``time_s``: time of each sample. ``clock_offset_s``: clock offset that was added to the device's times.
    """

    stream_name: str = msgspec.field(name="stream")
    clock_offset_s: float = msgspec.field(name="offset_s")
    time_s: list[float]
    values: list[list[float]] = []
    texts: list[list[str]] = []


TOPICS: dict[str, type[Record]] = {
    "/physics": Physics,
    "/tracking": TrackingFrame,
    "/body_targets": BodyTargets,
    "/commands": Command,
    "/control": Control,
    "/events": Event,
    "/answers": Answer,
    "/latency": Latency,
    "/streams": Stream,
    "/samples": StreamSamples,
    "/placement": Placement,
    "/robot_commands": RobotCommand,
    "/pacing": Pacing,
}

AttemptEnd = Literal[
    "completed", "stopped", "paused", "interrupted", "repeated", "skipped", "ended", "failed"
]
"""Result of an attempt. Only ``completed`` attempts are analysed. In these attempts the robot finished, and the
recording is complete.
"""
ATTEMPT_ENDS: tuple[AttemptEnd, ...] = get_args(AttemptEnd)


class Metrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """Metrics of an attempt. An unknown metric is ``None``.

    ``steps``: number of control steps. ``reward``: sum over these steps. ``success``: whether the robot succeeded.
    ``seconds``: duration of the attempt, with free movement and questions.
    """

    steps: int | None = None
    reward: float | None = None
    success: bool | None = None
    seconds: float | None = None


class Outcome(Metrics, frozen=True, kw_only=True):
    """Result and metrics of an attempt.

    ``completed_later``: whether the recording was completed later. This happens if the program was killed after the
    robot finished.
    """

    result: AttemptEnd
    completed_later: bool = msgspec.field(default=False, name="cut_off")


_encoder = msgspec.json.Encoder()
_decoders = {kind: msgspec.json.Decoder(kind, strict=False) for kind in TOPICS.values()}


def encode(value: Any) -> bytes:
    """Returns a record, or another value of JSON types, as JSON bytes."""
    data = _encoder.encode(value)
    if b"null" in data:
        data = _encoder.encode(_spell_out(msgspec.to_builtins(value)))
    return data


def decode(topic: str, data: bytes) -> Any:
    """Returns the record of ``topic`` that ``data`` (JSON) contains. Raises ``msgspec.DecodeError`` for invalid
    data."""
    return _decoders[TOPICS[topic]].decode(data)


def make_json_schema(topic: str) -> bytes:
    """Returns the JSON Schema of a topic's records. It has no references, because MCAP viewers do not resolve them."""
    (reference,), definitions = msgspec.json.schema_components((TOPICS[topic],))
    return _encoder.encode(_resolve(reference, definitions))


def _spell_out(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if is_table(value):
        return {name: _spell_out(item) for name, item in value.items()}
    if is_array(value):
        return [_spell_out(item) for item in value]
    return value


def _resolve(node: Any, definitions: dict[str, Any]) -> Any:
    if is_array(node):
        return [_resolve(item, definitions) for item in node]
    if not is_table(node):
        return node
    if "$ref" in node:
        return _resolve(definitions[node["$ref"].rpartition("/")[2]], definitions)
    if "anyOf" in node:
        (present,) = (option for option in node["anyOf"] if option != {"type": "null"})
        return _resolve(present, definitions)
    return {name: _resolve(item, definitions) for name, item in node.items() if name != "default"}
