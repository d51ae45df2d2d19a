"""Tables of the reference that come from records, policy files and source: see ``write_reference``."""

import ast
import dataclasses
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from avrgym.learning.evaluation import EvaluationResult, compute_wilson_interval
from avrgym.people.zoo.commanding_partners import COMMANDING_PARTNER_SETS
from avrgym.people.zoo.partners import SINGLE_STYLE_PARTNER_SETS, ZOO_PARTNER_SETS
from avrgym.people.zoo.styles import (
    COMMAND_PARAMETER_SOURCES,
    COMMANDING_STYLE,
    COMMANDING_STYLE_NAME,
    PARAMETER_SOURCES,
    STYLES,
    BehaviourStyle,
)
from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.questionnaires.instrument import Instrument
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.safety.approach_speed import compute_effective_mass_kg
from avrgym.safety.force_guard import INTERVENTION_FORCE_LIMIT_FRACTION
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N, compute_max_impact_speed_m_s
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, ROBOTS, TASKS, get_observation_and_action_size

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "avrgym"
sys.path.insert(0, str(ROOT / "research"))

from figures_file import cells, name_of, read  # noqa: E402
from papers_results import SIMULATION, short  # noqa: E402
from partners import CLINICAL, FIGURES_FILE  # noqa: E402
from policy_tables import settings_table  # noqa: E402
from robots import FIGURES_FILE as ROBOTS_FILE  # noqa: E402

Lines = Iterator[str]
KINDS = ("original", "revised", "adaptive")
NO_BREAK = "\N{NO-BREAK SPACE}"
POPULATIONS = ("zoo/unseen", "participants", "guarded", "revised", "tremor", "weakness", "limits")
AXES = ("delay", "amplitude", "tempo")


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> Lines:
    """A table in Markdown."""
    for row in (head, ("---",) * len(head), *rows):
        yield f"| {' | '.join(_cell(cell) for cell in row)} |"
    yield ""


def _cell(text: str) -> str:
    return re.sub("[ \n]+", " ", text.replace("|", "¦"))


def _parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text("utf-8"))


def _sentence(docstring: str | None) -> str:
    first = " ".join((docstring or "").replace("``", "`").split("\n\n")[0].split())
    return re.split(r"(?<=[.:]) (?=[A-Z])", first)[0]


def environments() -> Lines:
    """The environments with their sizes and packaged policies."""
    rows = []
    for name in ENVIRONMENTS:
        observation_size, action_size = get_observation_and_action_size(name)
        kinds = ", ".join(kind for kind in KINDS if kind in find_packaged_policies(name))
        rows.append((f"`{name}`", str(action_size), str(observation_size), kinds))
    return table(("environment", "action", "observation", "packaged policies"), rows)


def observations() -> Lines:
    """The parts of each task's observation, in order, with their sizes."""
    rows = []
    for name, task in TASKS.items():
        robot = next(robot for of, robot in ENVIRONMENTS.values() if of == name)
        found = task.make_observation_spec(task.make_scene(ROBOTS[robot]))
        parts = ", ".join(f"`{entry.name}` ({entry.size})" for entry in found.entries)
        rows.append((name, str(found.size), parts))
    return table(("task", "numbers with its first robot", "parts in order"), rows)


def body_regions() -> Lines:
    """Force limits by body region, and the contact speeds that reach half of them."""
    environments = {robot: f"avrgym/Feeding{robot}-v1" for robot in ("Jaco", "PR2")}
    speeds = {
        robot: compute_max_impact_speed_m_s(
            INTERVENTION_FORCE_LIMIT_FRACTION * QUASI_STATIC_LIMIT_N,
            compute_effective_mass_kg(Episodes(environment, 1).simulation),
        )
        for robot, environment in environments.items()
    }
    rows = [
        (
            region.name,
            f"{region.quasi_static_limit_n:g} N",
            f"{region.transient_limit_n:g} N",
            f"{region.spring_constant_n_mm:g} N/mm",
            f"{region.effective_mass_kg:g} kg",
            *(f"{100 * speeds[robot][number]:.0f} cm/s" for robot in environments),
            ", ".join(region.geoms),
        )
        for number, region in enumerate(BODY_REGIONS)
    ]
    head = "region", "quasi-static limit", "transient limit", "spring", "mass"
    return table((*head, *(f"maximum contact speed, {robot}" for robot in environments), "geoms"), rows)


def robots() -> Lines:
    """Reach of every robot in every task, and success, force and exceeded limits of its oracle and its policies."""
    figures = read(ROBOTS_FILE)
    policies = {
        f"{short(environment)} {kind}": policy.metadata.measured for environment, kind, policy in _packaged()
    } | {
        name.removesuffix(" revised"): each
        for name, each in read(FIGURES_FILE).items()
        if name.endswith(" revised")
    }
    rows = []
    for environment in ENVIRONMENTS:
        found = figures.get(environment, {})
        shares = (f"{100.0 * found[key]:.1f} %" if key in found else "–" for key in ("start", "goals"))
        oracle = (_result(found), f"{found['reward_mean']:.0f}") if found else ("–", "–")
        kinds = (policies.get(f"{short(environment)} {kind}") for kind in KINDS[1:])
        rows.append((short(environment), *shares, *oracle, *cells(kinds, _result)))
    return table(("environment", "starts", "goals", "oracle", "reward", *KINDS[1:]), rows)


def policies() -> Lines:
    """Success, force and exceeded limits of every packaged policy with every population that was evaluated."""
    figures = read(FIGURES_FILE)
    rows = []
    for environment, kind, policy in _packaged():
        found = [figures.get(name_of(environment, kind, group)) for group in POPULATIONS]
        rows.append((short(environment), kind, _result(policy.metadata.measured), *cells(found, _result)))
    return table(("environment", "policy", "training", *POPULATIONS), rows)


def policies_clinical() -> Lines:
    """Success, force and exceeded limits of Adaptive policies with people who have clinical impairments."""
    figures = read(FIGURES_FILE)
    rows = []
    for environment, kind, _ in _packaged():
        found = [figures.get(name_of(environment, kind, group)) for group in CLINICAL]
        if any(found):
            rows.append((short(environment), *("–" if each is None else _result(each) for each in found)))
    return table(("environment", *CLINICAL), rows)


def _result(figures: Mapping[str, Any]) -> str:
    rate, episodes = figures["success_rate"], figures["episodes"]
    low, high = (100.0 * end for end in compute_wilson_interval(round(rate * episodes), episodes))
    lines = [f"{100.0 * rate:.1f} % [{low:.0f}, {high:.0f}]", f"{figures['force_mean_newton']:.1f} N"]
    if "episodes_over_limit" in figures:
        lines.append(f"{figures['episodes_over_limit']} of {episodes}")
    return "<br>".join(lines).replace(" ", NO_BREAK)


def _packaged() -> Iterator[tuple[str, str, Policy]]:
    for environment in ENVIRONMENTS:
        files = find_packaged_policies(environment)
        for kind in KINDS:
            if kind in files:
                yield environment, kind, Policy.load(files[kind])


def policy_training() -> Lines:
    """What each packaged policy reaches on its training population, next to the paper, and how it was trained."""
    rows = []
    for environment, kind, policy in _packaged():
        metadata, paper = policy.metadata, SIMULATION.get(environment)
        success, reward = metadata.measured["success_rate"], metadata.measured["reward_mean"]
        hours = f"{metadata.seconds / 3600:.1f}" if metadata.seconds else "–"
        training = f"{policy.action_std:.2g}", f"{metadata.steps / 1e6:.2f} M", hours
        reached = ("–", "–") if paper is None else (f"{paper.success} %", str(paper.reward))
        results = f"{100 * success:.1f} %", reached[0], f"{reward:.0f}", reached[1]
        rows.append((short(environment), kind, *results, *training))
    head = "success", "success, paper", "reward", "reward, paper", "noise", "steps", "hours"
    return table(("environment", "policy", *head), rows)


def training_settings() -> Lines:
    """How the settings of trainings differ between the tasks."""
    return iter([*settings_table(), ""])


ALL_STYLES = {**STYLES, COMMANDING_STYLE_NAME: COMMANDING_STYLE}
_STYLE_SETS = {**SINGLE_STYLE_PARTNER_SETS, **COMMANDING_PARTNER_SETS}


def zoo_styles() -> Lines:
    """What people of each style do, and the sources."""
    return table(
        ("style", "behaviour", "sources"),
        [(f"`{name}`", style.description, style.source) for name, style in ALL_STYLES.items()],
    )


def zoo_parameters() -> Lines:
    """The source of each behaviour parameter, or that it is an assumption."""
    sources = {**PARAMETER_SOURCES, **COMMAND_PARAMETER_SOURCES}
    return table(("parameter", "source"), [(f"`{name}`", text) for name, text in sources.items()])


def zoo_partners() -> Lines:
    """Which parameters each style moves along which axis, and how many partners it has."""
    rows = [
        (f"`{name}`", *(_ranges(style, axis) for axis in AXES), _counts(name))
        for name, style in ALL_STYLES.items()
    ]
    total = " + ".join(str(len(partners)) for partners in ZOO_PARTNER_SETS.values())
    all_but = f"all but `{COMMANDING_STYLE_NAME}`"
    return table(
        ("style", *AXES, "partners, train + unseen + extreme"), [*rows, (all_but, "", "", "", total)]
    )


def _ranges(style: BehaviourStyle, axis: str) -> str:
    return ", ".join(
        f"{trait} {first:g}–{last:g}" for trait, (first, last) in getattr(style, f"{axis}_ranges").items()
    )


def _counts(name: str) -> str:
    return " + ".join(str(len(_STYLE_SETS[f"{zoo}/{name}"])) for zoo in ZOO_PARTNER_SETS)


def instruments() -> Lines:
    """The validated questionnaires, their answers and their scores."""
    rows = [
        (f"`{each.name}`", each.title, _answers(each), ", ".join(f"`{name}`" for name in each.scale_names))
        for each in INSTRUMENTS.values()
    ]
    return table(("`use`", "questionnaire", "answers", "scores"), rows)


def _answers(instrument: Instrument) -> str:
    response = instrument.response_scale
    steps = f" in steps of {response.step}" if response.step != 1 else ""
    return f"{response.lowest_value} to {response.highest_value}{steps}"


def evaluation() -> Lines:
    """The keys of a row of ``avrgym evaluate --json``."""
    yield " ".join((inspect.getdoc(EvaluationResult) or "").replace("``", "`").split())
    yield ""
    kinds = (
        (field.name, str(getattr(field.type, "__name__", field.type))) for field in _fields(EvaluationResult)
    )
    yield from table(("key", "type"), [(f"`{name}`", f"`{kind}`") for name, kind in kinds])


def _fields(kind: Any) -> tuple[Any, ...]:
    return dataclasses.fields(kind)


def analysis_tables() -> Lines:
    """The tables of an analysis: what a row is, and its columns."""
    trees = [_parsed(file) for file in sorted((SOURCE / "analysis").rglob("*.py"))]
    classes = {node.name: node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    rows = {}
    for node in (node for tree in trees for node in ast.walk(tree)):
        match node:
            case ast.Call(func=ast.Attribute(attr="of"), args=[ast.Constant(value=str(name)), kind, *_]):
                found = classes.get(ast.unparse(kind).split(".")[-1])
                if found is not None:
                    rows[name] = (f"`{name}`", _sentence(ast.get_docstring(found)), _columns(found))
    return table(("table", "a row", "columns"), [rows[name] for name in sorted(rows)])


def _columns(kind: ast.ClassDef) -> str:
    names = [ast.unparse(node.target) for node in kind.body if isinstance(node, ast.AnnAssign)]
    return ", ".join(f"`{name}`" for name in names)


def errors() -> Lines:
    """Every message of an error in the source, by package; … stands for names and numbers."""
    for package in sorted(path for path in SOURCE.iterdir() if path.is_dir() and path.name != "skeletons"):
        found = {text for file in sorted(package.rglob("*.py")) for text in _messages(_parsed(file))}
        if found:
            yield from (f"### {package.name}", "")
            yield from (f"- `{text}`" for text in sorted(found, key=str.lower))
            yield ""


def _messages(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
            text = " ".join(_text(node.exc.args[0]).replace("`", "").split())
            if len(text.strip(" …:;,.")) > 8:
                yield text


def _text(node: ast.expr) -> str:
    """The text of a string expression; names and numbers as …."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(_text(value) if isinstance(value, ast.Constant) else "…" for value in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _text(left) + _text(right)
        case ast.IfExp(body=body):
            return _text(body)
        case _:
            return "…"


TABLES = {
    each.__name__: each
    for each in (
        environments, observations, robots, body_regions, policies, policies_clinical, policy_training,
        training_settings, zoo_styles, zoo_parameters, zoo_partners, instruments, evaluation, analysis_tables, errors,
    )
}  # fmt: skip
"""By the name of the file that they are written to."""
