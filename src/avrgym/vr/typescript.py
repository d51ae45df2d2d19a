"""Writes the TypeScript side of the wire protocol from ``messages.py``, ``phases`` and the loop's constants.

``python -m avrgym.vr.typescript`` writes ``client/src/messages.ts`` and one example of every message as
Python encodes it, ``client/tests/messages.json``; ``--check`` writes nothing and fails when either is stale.
"""

import argparse
import json
import textwrap
from pathlib import Path
from types import UnionType
from typing import Any, get_args

import msgspec
from msgspec import inspect

from avrgym.vr.protocol import messages
from avrgym.vr.session.phases import where
from avrgym.vr.tracking.frames import STALE_S
from avrgym.vr.tracking.world import TICK_S

CLIENT = Path(__file__).parents[3] / "client"

HEADER = """// Written by `python -m avrgym.vr.typescript` from the server's own definitions. Do not edit.
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
    "ClientMessage": messages.ClientMessage,
    "ExperimenterMessage": messages.ExperimenterMessage,
    "ServerMessage": messages.ServerMessage,
}

CONSTANTS = {"PROTOCOL": messages.PROTOCOL, "STALE_S": STALE_S, "TICK_S": TICK_S}
PHASE_FLAGS = ("moves", "can_be_stopped", "awaits_ready", "can_choose_body")
"""What the client needs to know of each phase: attributes of the classes in ``session.phases``."""


def aliases() -> list[tuple[str, inspect.Type]]:
    """The named tuples and literals of ``messages.py``, in the order of their definition."""
    named = [(name, value) for name, value in vars(messages).items() if name[0].isupper() and get_args(value)]
    infos = [(name, inspect.type_info(value)) for name, value in named if not isinstance(value, UnionType)]
    return [(name, info) for name, info in infos if isinstance(info, inspect.TupleType | inspect.LiteralType)]


def type_name(info: inspect.Type) -> str:
    """The TypeScript name of a type: that of its alias where it has one."""
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
    if isinstance(info, inspect.ListType):
        return f"{type_name(info.item_type)}[]"
    if isinstance(info, inspect.UnionType):
        return " | ".join(type_name(item) for item in info.types)
    raise TypeError(f"messages.py may use {', '.join(kind.__name__ for kind in SCALARS)}, structs, literals, "
                    f"tuples, lists and unions, not {type(info).__name__}")  # fmt: skip


def comment(cls: type) -> str:
    """The docstring as a block comment."""
    text = textwrap.dedent("    " + (cls.__doc__ or "")).strip().replace("``", "`")
    return "/** " + text.replace("\n", "\n * ").replace(" * \n", " *\n") + " */\n"


def struct_text(info: inspect.StructType) -> str:
    """One struct: a tuple type where it is array-like, else an interface with its tag."""
    fields = [(field.encode_name, type_name(field.type)) for field in info.fields]
    if info.array_like:
        items = ", ".join(f"{name}: {text}" for name, text in fields)
        return f"{comment(info.cls)}export type {info.cls.__name__} = [{items}];\n"
    lines = [f"type: {json.dumps(info.tag)}", *(f"{name}: {text}" for name, text in fields)]
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
    parts += [phases_text(), struct_text(struct_info(messages.XRPose))]
    written: set[type] = set()
    for name, union in UNIONS.items():
        parts += [struct_text(struct_info(cls)) for cls in get_args(union) if cls not in written]
        written.update(get_args(union))
        parts.append(f"export type {name} = {' | '.join(cls.__name__ for cls in get_args(union))};\n")
    return "\n".join(parts)


def phases_text() -> str:
    """The phases in which each of the client's flags holds."""
    sets = "".join(f"  {flag}: {json.dumps(where(flag))},\n" for flag in PHASE_FLAGS)
    flags = " | ".join(json.dumps(flag) for flag in PHASE_FLAGS)
    return f"export const PHASES_WHERE: Record<{flags}, readonly PhaseName[]> = {{\n{sets}}};\n"


def example(info: inspect.Type) -> Any:
    """A value of a type in plain data: numbers that are not whole, text that is not ASCII."""
    if isinstance(info, inspect.StructType):
        values = [example(field.type) for field in info.fields]
        named = {field.encode_name: value for field, value in zip(info.fields, values, strict=True)}
        return values if info.array_like else {"type": info.tag, **named}
    if isinstance(info, inspect.LiteralType):
        return info.values[0]
    if isinstance(info, inspect.TupleType):
        return [0.5 - place / 8 for place, _ in enumerate(info.item_types)]
    if isinstance(info, inspect.ListType):
        return [example(info.item_type)] * 2
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
        {"union": union, "value": msgspec.to_builtins(message), "bytes": messages.encode(message)}
        for union, examples in example_messages().items()
        for message in examples
    ]
    return msgspec.json.format(msgspec.json.encode(rows), indent=1).decode() + "\n"


def stale() -> dict[Path, str]:
    """The files that do not hold what they should, with what they should hold."""
    wanted = {
        CLIENT / "src/messages.ts": generate(),
        CLIENT / "tests/messages.json": generate_examples(),
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
            raise SystemExit(f"{path} is stale: run python -m avrgym.vr.typescript")
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
