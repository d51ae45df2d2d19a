"""Write the TypeScript that server and client share, and the examples with which the client's tests check it.

``python scripts/write_typescript.py`` writes, in ``client/``:

- ``src/generated/messages.ts``: the messages and the constants of the protocol;
- ``src/generated/body-model.ts``: the parameters with which poses become joint angles;
- ``src/generated/interface-texts.ts``: the texts of the participant's page in every language;
- ``tests/data/messages.json``: an example of every message as Python encodes it;
- ``tests/data/states.json``: a sequence of encoded states.

``--check`` writes nothing and fails if a file is out of date.
"""

import argparse
import json
import textwrap
from pathlib import Path
from types import UnionType
from typing import Any, get_args

import msgspec
import numpy as np
from msgspec import inspect

from avrgym.models import human
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.texts.interface_texts import list_included_languages, read_texts
from avrgym.vr.latency import STAGE_LABELS
from avrgym.vr.protocol import messages, state_encoding, webxr
from avrgym.vr.session.phases import list_phase_names_with_flag
from avrgym.vr.tracking import arm, body, hand_device_switches
from avrgym.vr.tracking.tracking_frames import STALE_POSE_AGE_S

CLIENT = Path(__file__).parents[1] / "client"

HEADER = """// Written by `python scripts/write_typescript.py` from the server's own definitions. Do not edit.
"""

SCALARS: dict[type[inspect.Type], str] = {
    inspect.IntType: "number",
    inspect.FloatType: "number",
    inspect.StrType: "string",
    inspect.BoolType: "boolean",
    inspect.NoneType: "null",
    inspect.BytesType: "Uint8Array",
}

SCALAR_EXAMPLES: dict[type[inspect.Type], object] = {
    inspect.IntType: 7,
    inspect.FloatType: 1.25,
    inspect.StrType: "Würfel",
    inspect.BoolType: True,
    inspect.BytesType: b"\x00\x01\xff",
}

UNIONS = {
    "ParticipantMessage": messages.ParticipantMessage,
    "WatcherMessage": messages.WatcherMessage,
    "ServerMessage": messages.ServerMessage,
}

PARTS_OF_MESSAGES = (
    messages.XRPose,
    messages.Skeleton,
    messages.StageLatency,
    messages.StreamStatus,
    messages.CommandLabel,
    messages.SelectionTarget,
    messages.PresentationPreferences,
)

CONSTANTS = {
    "PROTOCOL": messages.PROTOCOL_VERSION,
    "STATES_PER_RECEIPT": messages.STATES_PER_RECEIPT,
    "STALE_S": STALE_POSE_AGE_S,
    "TICK_S": messages.TICK_S,
    "JOINT_STEPS": json.dumps(state_encoding.JOINT_QUANTISATION_STEPS.tolist()),
    "POSE_STEPS": json.dumps(state_encoding.POSE_QUANTISATION_STEPS.tolist()),
    "STAGE_LABELS": json.dumps(STAGE_LABELS),
    "FORCE_LIMITS_N: Readonly<Record<string, number>>": json.dumps(
        {region.name: float(limit) for region, limit in zip(BODY_REGIONS, QUASI_STATIC_LIMIT_N, strict=True)}
    ),
}
PHASE_FLAGS = ("has_motion", "can_be_stopped", "awaits_confirmation", "can_choose_body")
"""What the client needs to know of each phase: attributes of the classes in ``session.phases``."""


def aliases() -> list[tuple[str, inspect.Type]]:
    """The named tuples and literals of ``messages.py``, in the order of their definition."""
    named = [(name, value) for name, value in vars(messages).items() if name[0].isupper() and get_args(value)]
    infos = [(name, inspect.type_info(value)) for name, value in named if not isinstance(value, UnionType)]
    return [(name, info) for name, info in infos if isinstance(info, inspect.TupleType | inspect.LiteralType)]


def type_name(info: inspect.Type) -> str:
    """The TypeScript name of a type: that of its alias where it has one."""
    info = info.type if isinstance(info, inspect.Metadata) else info
    names = [name for name, alias in aliases() if alias == info]
    return names[0] if names else type_text(info)


def type_text(info: inspect.Type) -> str:
    """The TypeScript of a type."""
    if type(info) in SCALARS:
        return SCALARS[type(info)]
    if isinstance(info, inspect.StructType):
        return info.cls.__name__
    if isinstance(info, inspect.LiteralType):
        return " | ".join(json.dumps(value) for value in info.values)
    if isinstance(info, inspect.TupleType):
        return f"[{', '.join(type_name(item) for item in info.item_types)}]"
    if isinstance(info, inspect.ListType | inspect.VarTupleType):
        item = type_name(info.item_type)
        return f"({item})[]" if " | " in item else f"{item}[]"
    if isinstance(info, inspect.DictType):
        return f"Record<{type_name(info.key_type)}, {type_name(info.value_type)}>"
    if isinstance(info, inspect.UnionType):
        return " | ".join(type_name(item) for item in info.types)
    raise TypeError(f"messages.py may use {', '.join(kind.__name__ for kind in SCALARS)}, structs, literals, "
                    f"tuples, lists, mappings and unions, not {type(info).__name__}")  # fmt: skip


def comment(cls: type) -> str:
    """The docstring as a block comment."""
    text = textwrap.dedent("    " + (cls.__doc__ or "")).strip().replace("``", "`")
    return "/** " + text.replace("\n", "\n * ").replace(" * \n", " *\n") + " */\n"


def struct_text(info: inspect.StructType) -> str:
    """One struct: a tuple type where it is array-like, else an interface, with its tag if it has one."""
    fields = [(field.encode_name, type_name(field.type)) for field in info.fields]
    if info.array_like:
        items = ", ".join(f"{name}: {text}" for name, text in fields)
        return f"{comment(info.cls)}export type {info.cls.__name__} = [{items}];\n"
    tagged = [f"type: {json.dumps(info.tag)}"] if info.tag else []
    lines = [*tagged, *(f"{name}: {text}" for name, text in fields)]
    body = "".join(f"  {line};\n" for line in lines)
    return f"{comment(info.cls)}export interface {info.cls.__name__} {{\n{body}}}\n"


def struct_info(cls: type) -> inspect.StructType:
    info = inspect.type_info(cls)
    assert isinstance(info, inspect.StructType)
    return info


def generate() -> str:
    """The whole of ``messages.ts``."""
    parts = [HEADER, *(f"export const {name} = {value};\n" for name, value in CONSTANTS.items())]
    parts += [f"export type {name} = {type_text(info)};\n" for name, info in aliases()]
    parts += [phases_text(), *(struct_text(struct_info(cls)) for cls in PARTS_OF_MESSAGES)]
    written: set[type] = set()
    for name, union in UNIONS.items():
        parts += [struct_text(struct_info(cls)) for cls in get_args(union) if cls not in written]
        written.update(get_args(union))
        parts.append(f"export type {name} = {' | '.join(cls.__name__ for cls in get_args(union))};\n")
    return "\n".join(parts)


def phases_text() -> str:
    """The phases in which each of the client's flags holds."""
    sets = "".join(f"  {flag}: {json.dumps(list_phase_names_with_flag(flag))},\n" for flag in PHASE_FLAGS)
    flags = " | ".join(json.dumps(flag) for flag in PHASE_FLAGS)
    return f"export const PHASES_WHERE: Record<{flags}, readonly PhaseName[]> = {{\n{sets}}};\n"


ANATOMY: dict[str, dict[str, object]] = {
    "ARM": {
        "lower_rad": arm.ARM_LOWER_LIMITS_RAD,
        "upper_rad": arm.ARM_UPPER_LIMITS_RAD,
        "most_turn_rad": arm.MAX_TICK_ROTATION_RAD,
        "detour_rad": arm.MAX_ACCURATE_ROTATION_RAD,
        "reached": arm.MAX_REACH_FRACTION,
        "pole_rad": arm.SINGULARITY_ANGLE_RAD,
        "swivel_step_rad": arm.SWIVEL_STEP_RAD,
        "outside": arm.OUT_OF_RANGE_COST_WEIGHT,
        "stay": arm.MOTION_COST_WEIGHT,
        "ease": arm.COMFORT_COST_WEIGHTS,
        "at_ease_rad": arm.COMFORTABLE_ANGLES_RAD,
        "lift": arm.RAISED_ELBOW_COST_WEIGHT,
        "elbow_rests": arm.ELBOW_REST_DIRECTION,
        "least_squares_steps": arm.NUM_LEAST_SQUARES_STEPS,
        "metres_per_radian": arm.CHARACTERISTIC_LENGTH_M,
        "exact_rad": arm.CLIPPING_TOLERANCE_RAD,
        "damping_m": arm.LEAST_SQUARES_DAMPING_M,
    },
    "TRUNK": {
        "waist_yaw_share": body.WAIST_YAW_FRACTION,
        "waist_ranges_rad": body.WAIST_RANGES_RAD,
        "head_ranges_rad": body.HEAD_RANGES_RAD,
    },
    "DEVICES": {
        "body_from_device_q": human.DEVICE_TO_BODY_QUAT,
        "head_centre_from_headset": webxr.HEAD_CENTRE_FROM_HEADSET,
        "hand_centre_from_wrist": webxr.HAND_CENTRE_FROM_WRIST,
        "hand_from_wrist_q": webxr.HAND_FROM_WRIST_AXES,
    },
    "SWITCHES": {
        "same_m": hand_device_switches.MAX_DEVICE_OFFSET_M,
        "same_rad": hand_device_switches.MAX_DEVICE_OFFSET_RAD,
        "max_switch_gap_s": hand_device_switches.MAX_SWITCH_GAP_S,
        "rest_radius_m": hand_device_switches.MAX_REST_DISPLACEMENT_M,
        "fading_per_metre": hand_device_switches.CORRECTION_DECAY_PER_M,
        "metres_per_radian": hand_device_switches.CHARACTERISTIC_LENGTH_M,
    },
    "PERSON": {
        "prefix": human.PERSON_NAME_PREFIX,
        "joints": {
            "waist": body.WAIST_JOINT_INDICES,
            "head": body.HEAD_JOINT_INDICES,
            **body.ARM_JOINT_INDICES,
        },
    },
}
"""What the client solves the participant's own body with, as the server does; quaternions are w, x, y, z."""


def anatomy() -> str:
    """The whole of ``body-model.ts``."""
    return "\n".join([HEADER, *(facts_text(name, facts) for name, facts in ANATOMY.items())])


def facts_text(name: str, facts: dict[str, object]) -> str:
    """Facts as one constant, a line each."""
    lines = "".join(
        f"  {fact}: {json.dumps(value, default=np.ndarray.tolist)},\n" for fact, value in facts.items()
    )
    return f"export const {name} = {{\n{lines}}} as const;\n"


def texts() -> str:
    """The whole of ``interface-texts.ts``: the words of the page in every language that AVR Gym brings."""
    words = {
        language: {"direction": each.direction, "texts": dict(each.page)}
        for language, each in ((language, read_texts(language)) for language in list_included_languages())
    }
    shown = json.dumps(words, indent=2, ensure_ascii=False)
    return f"{HEADER}\nexport const TEXTS = {shown} as const;\n"


def example(info: inspect.Type) -> Any:
    """A value of a type in plain data: numbers that are not whole, text that is not ASCII."""
    info = info.type if isinstance(info, inspect.Metadata) else info
    if isinstance(info, inspect.StructType):
        values = [example(field.type) for field in info.fields]
        named = {field.encode_name: value for field, value in zip(info.fields, values, strict=True)}
        return values if info.array_like else {"type": info.tag, **named} if info.tag else named
    if isinstance(info, inspect.LiteralType):
        return info.values[0]
    if isinstance(info, inspect.TupleType):
        return [0.5 - place / 8 for place, _ in enumerate(info.item_types)]
    if isinstance(info, inspect.ListType | inspect.VarTupleType):
        return [example(info.item_type)] * 2
    if isinstance(info, inspect.DictType):
        return {example(info.key_type): example(info.value_type)}
    if isinstance(info, inspect.UnionType):
        return example(next(item for item in info.types if not isinstance(item, inspect.NoneType)))
    return SCALAR_EXAMPLES[type(info)]


def example_messages() -> dict[str, list[messages.Message]]:
    """One example of every message, by the union that it belongs to."""
    return {
        name: [msgspec.convert(example(struct_info(cls)), cls) for cls in get_args(union)]
        for name, union in UNIONS.items()
    }


def generate_examples() -> str:
    """The examples as JSON: what the message holds and the bytes (both base64) that Python makes of it."""
    rows = [
        {"union": union, "value": msgspec.to_builtins(message), "bytes": messages.encode_message(message)}
        for union, examples in example_messages().items()
        for message in examples
    ]
    return msgspec.json.format(msgspec.json.encode(rows), indent=1).decode() + "\n"


def state_examples() -> str:
    """States of two bodies as JSON: each change as it is sent, and the numbers that the client then holds."""
    encoder, decoder = state_encoding.StateEncoder(), state_encoding.StateDecoder()
    rows: list[dict[str, Any]] = []
    for number in range(6):
        turned = np.array([np.cos(0.1 * number), 0.0, np.sin(0.1 * number), 0.0])
        poses = np.array(
            [[0.3 * number**2, -1.0, 4e5 * (number % 2), *turned], [0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0]]
        )
        targets = np.array([0.0, -0.2 * number])
        state = messages.WorldState(
            sequence_number=number,
            simulation_time_s=0.01 * number,
            tracking_sequence_number=-1,
            joint_targets=targets.astype("<f4").tobytes(),
            deviating_parts=[],
            poses=poses.astype("<f4").tobytes(),
        )
        change = encoder.encode(state)
        told = decoder.decode(change)
        numbers = {name: np.frombuffer(getattr(told, name), "<f4") for name in ("joint_targets", "poses")}
        rows.append(
            {
                "bytes": messages.encode_message(change),
                **{name: each.tolist() for name, each in numbers.items()},
            }
        )
    return msgspec.json.format(msgspec.json.encode(rows), indent=1).decode() + "\n"


def stale() -> dict[Path, str]:
    """The files that do not hold what they should, with what they should hold."""
    wanted = {
        CLIENT / "src/generated/messages.ts": generate(),
        CLIENT / "src/generated/body-model.ts": anatomy(),
        CLIENT / "src/generated/interface-texts.ts": texts(),
        CLIENT / "tests/data/messages.json": generate_examples(),
        CLIENT / "tests/data/states.json": state_examples(),
    }
    return {
        path: text for path, text in wanted.items() if not path.exists() or path.read_text("utf-8") != text
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail when a file is stale")
    check = parser.parse_args().check
    if not CLIENT.is_dir():
        raise SystemExit(f"{CLIENT} is missing: run this in a checkout of the project")
    for path, text in stale().items():
        if check:
            raise SystemExit(f"{path} is stale: run python scripts/write_typescript.py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
