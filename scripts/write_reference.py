"""Writes the generated parts of the reference: ``python scripts/write_reference.py``

Commands, messages, files, policies, populations, tables and errors, into ``build/reference``. The pages in ``docs``
include them.
"""

import inspect
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

import msgspec
from msgspec import inspect as types
from typer.main import get_command
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.networks.policy import PolicyMetadata, TrainedHumanMetadata
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.questionnaires.stop_rules import StopRule
from avrgym.recording import schema
from avrgym.recording.configuration import (
    BodyModel,
    HeadsetCheck,
    TrackingQuality,
    TrialConfiguration,
    Versions,
)
from avrgym.recording.input_profile import InputProfile
from avrgym.study.design import design
from avrgym.vr.protocol import messages
from reference_tables import TABLES

OUT = Path(__file__).parents[1] / "build" / "reference"
STUDY_TABLES = {
    "The study itself": design.Design,
    "`[consent]`": design.ConsentConfig,
    "`[[inclusion]]`": design.InclusionQuestion,
    "`[[questionnaires]]`": Questionnaire,
    "`items` of a questionnaire": Item,
    "`[[stop_rules]]`": StopRule,
    "`[furniture]`": RealFurniture,
    "`[reporting]`": design.PublicationDetails,
    "`[database]`": design.DatabaseConfig,
}
RECORDING_PARTS = [
    ("The configuration", TrialConfiguration),
    ("Versions", Versions),
    ("The body model", BodyModel),
    ("The headset check", HeadsetCheck),
    ("A tracked part", TrackingQuality),
    ("The input profile", InputProfile),
    ("The outcome", schema.Outcome),
    ("A pose", schema.Pose),
]
NAMES: dict[type, str] = {kind: name for name, kind in STUDY_TABLES.items()} | {
    TrainedHumanMetadata: "the role of a human",
    **{kind: title.lower() for title, kind in RECORDING_PARTS},
    messages.XRPose: "a pose",
    schema.Pose: "a pose",
}
"""Names of structs that are fields."""
WORDS: dict[type[types.Type], str] = {
    types.IntType: "whole number",
    types.FloatType: "number",
    types.StrType: "text",
    types.BoolType: "true or false",
    types.BytesType: "bytes",
    types.AnyType: "anything",
    types.NoneType: "nothing",
}
PARAMETER_BOUNDS = {
    "ge": "≥ {}",
    "le": "≤ {}",
    "min_length": "at least {} long",
    "max_length": "at most {} long",
}


def main() -> None:
    """Write every part into its own file."""
    OUT.mkdir(parents=True, exist_ok=True)
    pages = {
        "commands": commands(get_command(app)),
        "messages": _messages(),
        "recording": structs(
            [*RECORDING_PARTS, *((f"`{topic}`", kind) for topic, kind in schema.TOPICS.items())]
        ),
        "study_file": structs(STUDY_TABLES.items()),
        "policy_file": structs([("The header", PolicyMetadata), ("A human", TrainedHumanMetadata)]),
    }
    for name, lines in (pages | {name: write() for name, write in TABLES.items()}).items():
        (OUT / f"{name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def commands(group: Any, *path: str) -> Iterator[str]:
    """The help of each command of a group, sorted by name."""
    for name, command in sorted(group.commands.items()):
        if hasattr(command, "commands"):
            yield from commands(command, *path, name)
        else:
            shown = CliRunner().invoke(app, [*path, name, "--help"], prog_name="avrgym").stdout.strip()
            yield from (f"## avrgym {' '.join([*path, name])}", "", "```text", shown, "```", "")


def _messages() -> Iterator[str]:
    unions = {
        "From the participant's page": messages.ParticipantMessage,
        "From the experimenter's and spectators' pages": messages.WatcherMessage,
        "From the server": messages.ServerMessage,
    }
    for title, union in unions.items():
        yield from (f"## {title}", "")
        yield from structs(((f"`{_tag(kind)}`", kind) for kind in get_args(union)), level=3)
    yield from structs([("A pose", messages.XRPose)])


def _tag(kind: type[messages.Message]) -> str:
    return str(types.type_info(kind).tag)  # type: ignore[attr-defined]


def structs(named: Iterable[tuple[str, type[msgspec.Struct]]], level: int = 2) -> Iterator[str]:
    """A section for each struct: its docstring and its fields."""
    for title, kind in named:
        yield from (f"{'#' * level} {title}", "", docstring(kind), "")
        fields = types.type_info(kind).fields  # type: ignore[attr-defined]
        rows = [
            (f"`{each.encode_name}`", type_words(each.type), _default(each), _description(each.type))
            for each in fields
        ]
        yield from table(("field", "type", "default", "meaning"), rows)


def docstring(thing: Any) -> str:
    """A docstring as Markdown."""
    return (inspect.getdoc(thing) or "").replace("``", "`")


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> Iterator[str]:
    """A table in Markdown without its empty columns; nothing if it has no rows."""
    kept = [place for place in range(len(head)) if any(row[place] for row in rows)]
    for row in (head, ("---",) * len(head), *rows) if rows else ():
        yield f"| {' | '.join(_cell(row[place]) for place in kept)} |"
    yield ""


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def _default(field: types.Field) -> str:
    if field.default in (msgspec.UNSET, msgspec.NODEFAULT) or isinstance(field.default, msgspec.Struct):
        return ""
    return f"`{msgspec.json.encode(field.default).decode()}`"


def _description(info: types.Type) -> str:
    schema_of = info.extra_json_schema if isinstance(info, types.Metadata) else None
    return str((schema_of or {}).get("description", ""))


def type_words(info: types.Type) -> str:
    """A type in words, with its bounds."""
    if isinstance(info, types.Metadata):
        return type_words(info.type)
    allowed = [
        text.format(value)
        for name, text in PARAMETER_BOUNDS.items()
        if (value := getattr(info, name, None)) is not None
    ]
    return ", ".join([_type_name(info), *allowed])


def _type_name(info: types.Type) -> str:
    if isinstance(info, types.StructType):
        return NAMES.get(info.cls, f"a {info.cls.__name__}")
    if isinstance(info, types.LiteralType):
        return " or ".join(f"`{value}`" for value in info.values)
    if isinstance(info, types.UnionType):
        return " or ".join(type_words(each) for each in info.types)
    if isinstance(info, types.TupleType):
        return f"[{', '.join(type_words(each) for each in info.item_types)}]"
    if isinstance(info, types.ListType | types.VarTupleType):
        return f"list of {type_words(info.item_type)}"
    if isinstance(info, types.DictType):
        return f"table of {type_words(info.value_type)}"
    return WORDS.get(type(info), type(info).__name__)


if __name__ == "__main__":
    main()
