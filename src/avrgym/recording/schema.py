"""What a recording of a trial holds: one struct per topic, written as JSON.

JSON keeps every finite double bit for bit. Numbers that are not finite are written as the strings ``"NaN"``,
``"Infinity"`` and ``"-Infinity"``, because JSON has none for them.
"""

import math
from typing import Annotated, Any, Literal, get_args

import msgspec

from avrgym.questionnaires.questionnaire import MOST_POINTS
from avrgym.system.type_guards import is_array, is_table

MOST_FRAMES, LONGEST_MS = 256, 60_000
"""What one record of latencies holds at most."""


class Record(msgspec.Struct, frozen=True, omit_defaults=True):
    """Base of all records. Their times count from the start of the trial unless they say otherwise."""


class Pose(Record, frozen=True):
    """A pose in WebXR's ``local-floor`` space: position in metres (y up), orientation x, y, z, w."""

    position: list[float]
    orientation: list[float]


class Physics(Record, frozen=True):
    """The simulated world after a physics step: the simulator's full integration state.

    ``step`` counts the trial's finished control steps; ``simulation_time_s`` is the world's own time.
    """

    step: int
    simulation_time_s: float
    state: list[float]


class TrackingFrame(Record, frozen=True):
    """One XR frame as received; a pose that was not tracked is ``None``.

    ``applied``: the frame moved the person; one that a newer frame overtook did not.
    ``held``: the frame was stale or invalid, and the person kept the last pose.
    ``held_parts``: which of ``head``, ``left`` and ``right`` it did not move, because their poses had jumped, or were
    stale though the task needs the part. ``untracked_parts``: which had stale poses, missing or the same for 0.2 s.
    ``left_modality``, ``right_modality``: what a hand was tracked with: a ``controller``, the bare ``hand``, whose
    pose is the wrist's, a ``mouse`` in place of a headset, or ``none``.
    """

    sequence: int
    client_time_ms: float
    received_time_s: float
    applied: bool
    held: bool
    head: Pose | None = None
    left: Pose | None = None
    right: Pose | None = None
    left_modality: str = "none"
    right_modality: str = "none"
    held_parts: list[str] = []
    untracked_parts: list[str] = []


class BodyTargets(Record, frozen=True):
    """The joint angles that the person's body is driven to from the next physics step on, as soon as they change.

    Radians, in the order of the model's joints.
    """

    joint_targets: list[float]


class Command(Record, frozen=True):
    """The command to the robot at the beginning of control step ``step``; an interrupted step has only this record.

    A driver that answers later, or a person, gives further commands during the step. In the phase ``retreat``, in which
    there are no control steps, these are the commands of the motion away from the person. ``brakes``: the action is
    zero, and the brakes hold the robot.
    """

    step: int
    action: list[float]
    brakes: bool = False


class Placement(Record, frozen=True):
    """Where the simulated world stands in ``local-floor`` from now on, after a participant has slid on their seat.

    Until then it stands where the metadata say.
    """

    xr_from_world: Pose


class Control(Record, frozen=True):
    """One control step of the robot. ``reward_terms`` are not weighted; ``reward`` is their weighted sum.

    ``driver``: who drove, a policy by its name or ``operator``; empty where nobody wrote it down. ``idle``: at the end
    of the step the robot held still, because the operator drove nowhere, the controller failed or tracking
    was stale.
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
    """Anything that happened at one instant, such as a lost connection."""

    name: str
    detail: str


class Answer(Record, frozen=True):
    """The answer to one item of the questionnaire, and the time from its appearance to the press.

    The message that brings it and the row that keeps it add to this record what else they say.
    """

    item: Annotated[str, msgspec.Meta(max_length=64)]
    value: Annotated[int, msgspec.Meta(ge=1, le=MOST_POINTS)]
    response_time_s: Annotated[float, msgspec.Meta(ge=0)]


_Numbers = Annotated[list[int], msgspec.Meta(max_length=MOST_FRAMES)]
_Milliseconds = Annotated[
    list[Annotated[float, msgspec.Meta(ge=0, le=LONGEST_MS)]], msgspec.Meta(max_length=MOST_FRAMES)
]


class Latency(Record, frozen=True):
    """How long tracking frames took from pose to picture, stage after stage, milliseconds: an entry for each frame.

    ``sequence`` are the frames that a state was the first to follow. ``sample_ms``: from the pose to its sending;
    ``up_ms``: until the server had it; ``simulate_ms``: until a tick had simulated it and handed its state out;
    ``send_ms``: until that was sent; ``down_ms``: until the client had it; ``draw_ms``: until a picture showed it. The
    clocks of both sides are aligned so that the fastest messages take as long either way.
    """

    sequence: _Numbers
    sample_ms: _Milliseconds
    up_ms: _Milliseconds
    simulate_ms: _Milliseconds
    send_ms: _Milliseconds
    down_ms: _Milliseconds
    draw_ms: _Milliseconds


class Stream(Record, frozen=True):
    """A stream of another device, written before the first of its samples in a trial.

    ``stream`` is what the study calls it, ``source`` what the device does. ``kind`` is the device's word for what it
    measures, such as ``EEG``. ``rate_hz`` is the rate that it promises, 0 for samples that come at any time. Names of
    channels and units are empty where the device gives none.
    """

    stream: str
    source: str
    kind: str
    rate_hz: float
    channels: list[str]
    units: list[str]


class StreamSamples(Record, frozen=True):
    """Samples of a stream in the order they came, an entry each: of a stream of numbers ``values``, else ``texts``.

    ``time_s``: when each was taken. ``offset_s`` was added to the times that the device gave, because its clock is so
    much behind ours.
    """

    stream: str
    offset_s: float
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
}

AttemptEnd = Literal[
    "completed", "stopped", "paused", "interrupted", "repeated", "skipped", "ended", "failed"
]
"""How an attempt ended. Only ``completed`` counts: the robot has finished and the recording is complete."""
ATTEMPT_ENDS: tuple[AttemptEnd, ...] = get_args(AttemptEnd)


class Metrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """The results of an attempt; ``None`` if a result is not known.

    ``steps``: number of control steps. ``reward``: sum over them. ``success``: whether the robot has succeeded.
    ``seconds``: duration of the attempt, with free movement and questions.
    """

    steps: int | None = None
    reward: float | None = None
    success: bool | None = None
    seconds: float | None = None


class Outcome(Metrics, frozen=True, kw_only=True):
    """The end and the results of an attempt.

    ``cut_off``: the program was killed after the robot had finished, and the recording was completed later.
    """

    result: AttemptEnd
    cut_off: bool = False


_encoder = msgspec.json.Encoder()
_decoders = {kind: msgspec.json.Decoder(kind, strict=False) for kind in TOPICS.values()}


def encode(value: Any) -> bytes:
    """A record, or any plain value, as JSON."""
    data = _encoder.encode(value)
    if b"null" in data:
        data = _encoder.encode(_spell_out(msgspec.to_builtins(value)))
    return data


def decode(topic: str, data: bytes) -> Any:
    """The record of a topic; raises ``msgspec.DecodeError`` when the data do not fit it."""
    return _decoders[TOPICS[topic]].decode(data)


def json_schema(topic: str) -> bytes:
    """The JSON Schema of a topic's records, without references, as viewers of recordings want it."""
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
