"""Docstrings name parameters, fields, functions, classes and modules that exist."""

import ast
import builtins
import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

from helpers.system.paths import ROOT

SOURCE = ROOT / "src" / "avrgym"
TEXTS = {path.relative_to(SOURCE).as_posix(): path.read_text() for path in sorted(SOURCE.rglob("*.py"))}
PROSE = re.compile(r'"""(?:.|\n)*?"""|^ *# [^\n]*|  # [^\n]*', re.M)
NAME = re.compile(r"(?<!such as )(?<!example )``([A-Za-z_][\w.]*)(?:\([^`\n]*\))?``")
FILE_NAME = re.compile(r".+\.(csv|db|html|json|mcap|mismatch|py|sha256|sqlite|svg|toml|TXT|zip)")
DEFINITION = re.compile(r'^(?:def|class) (\w+)|^([A-Z_]{2,}|[A-Z]\w+)\b|"(\w+)"', re.M)
SECTION = re.compile(r"^(?:Args|Attributes):\n((?:    .*\n?|\n(?=    ))+)", re.M)
ENTRY = re.compile(r"^    (\**\w+(?:, \**\w+)*):", re.M)
EXTERNAL = {
    *dir(builtins), "gym", "gymnasium", "mcap", "minari", "msgspec", "numpy", "sqlite3",
    "AWS_ACCESS_KEY_ID", "AWS_ENDPOINT_URL", "AWS_SECRET_ACCESS_KEY",
    "array_api_compat", "additional_wrappers", "create_env_from_metadata", "discrete", "gpu", "gripSpace", "lang",
    "lsl", "MINARI_DATASETS_PATH", "mjSTATE_INTEGRATION", "nohup", "np_random", "rtprio", "select_action",
    "set_const", "sha256sum", "VecNormalize",
    "frame_skip", "motor_gains",  # in Assistive Gym
    "environment_state", "late", "lift_arm", "R_ab", "wrist_rgb",  # parts of texts, and composed names
}  # fmt: skip
"""Names of other programs, and names that no file contains as one word."""

CODE = {file: PROSE.sub("", text) for file, text in TEXTS.items()}
WORDS = {file: set(re.findall(r"\w+", code)) for file, code in CODE.items()}
MEMBERS: dict[str, set[str]] = defaultdict(set)
"""Words of the files that define a name or are in a package of this name."""
for file, code in CODE.items():
    for name in (modules := ["avrgym", *file.removesuffix(".py").split("/")]):
        MEMBERS[name] |= WORDS[file] | {*modules}
    for match in DEFINITION.finditer(code):
        MEMBERS[match[match.lastindex or 0]] |= WORDS[file]


def test_names_in_docstrings_exist():
    """A name is in the code of its file, or is defined in another file or program."""
    found = [
        f"{file}:{text.count(chr(10), 0, match.start()) + 1}: {match[1]}"
        for file, text in TEXTS.items()
        for match in NAME.finditer(text)
        if not FILE_NAME.fullmatch(match[1]) and not _exists(match[1], file)
    ]
    assert found == []


def _exists(name: str, file: str) -> bool:
    first, *_ = parts = name.split(".")
    if first in EXTERNAL:
        return True
    return (first in WORDS[file] or first in MEMBERS) and all(
        part in WORDS[file] or part in MEMBERS.get(owner, ()) for owner, part in pairwise(parts)
    )


def test_sections_of_docstrings_list_parameters_and_fields():
    listed = list(_sections())
    assert len(listed) > 300
    assert [f"{place}: {name}" for place, name, existing in listed if name not in existing] == []


def _sections() -> Iterator[tuple[str, str, set[str]]]:
    """Yields place and name of each entry of ``Args`` and ``Attributes``, and the names that exist there."""
    for file, text in TEXTS.items():
        if not re.search(r"^ +(Args|Attributes):$", text, re.M):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                for section in SECTION.findall(ast.get_docstring(node) or ""):
                    for entry in ENTRY.findall(section):
                        for name in entry.split(", "):
                            yield f"{file}:{node.lineno}", name.lstrip("*"), _names(node)


def _names(node: ast.FunctionDef | ast.ClassDef) -> set[str]:
    """Returns the parameters of a function, or parameters, fields and methods of a class."""
    if isinstance(node, ast.FunctionDef):
        return {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}
    fields = {each.attr for each in ast.walk(node) if isinstance(each, ast.Attribute)}
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name):
            fields.add(each.target.id)
        elif isinstance(each, ast.FunctionDef):
            fields |= {each.name, *(_names(each) if each.name == "__init__" else ())}
    return fields
