"""Report section about commands to the robot: conditions, number of commands, waiting time and agreement."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from statistics import fmean

from avrgym.analysis.page.html_elements import (
    Markup,
    format_group_caption,
    format_number,
    format_short_number,
    render_bullet_list,
    render_table,
    tag,
)
from avrgym.analysis.reading.commands import TrialCommandsRow
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.commands.preferences import describe_preferences
from avrgym.study.design.design import Condition, Design

COMMANDS_METHOD_TEXT = (
    "Commands: an ignored command is not allowed in its condition, or no trial ran. Waiting time: time at the waiting "
    "pose. Agreement: share of the executed commands after which the robot did what they mean within 1.5 s: the tool "
    "comes nearer by 1 cm or is nearer than 5 cm (ready, again, closer), does not come nearer (wait, farther, other "
    "side, stop), or the speed factor changes (slower, faster)."
)


def render_commands_section(
    design: Design, trials: Sequence[TrialRow], commands: Sequence[TrialCommandsRow], simulated: bool
) -> Markup:
    """Returns the report section; empty if the design has no conditions with commands."""
    counted = [row for row in trials if row.simulated is simulated and row.counted]
    if not design.conditions or not counted:
        return Markup()
    described = [f"{name}: {describe_condition(rules)}" for name, rules in design.conditions.items()]
    own = {(row.participant, row.position): row for row in commands if row.simulated is simulated}
    groups = dict.fromkeys((row.task, row.robot, row.policy) for row in counted)
    body = [
        _cells(key, [row for row in counted if (row.task, row.robot, row.policy) == key], own)
        for key in groups
    ]
    heads = (
        "Task", "Robot", "Condition", "Trials", "Success", "Force, mean / N", "Force, peak / N", "Waiting / s",
        "Commands per trial", "ignored", "Agreement", "Speed factor",
    )  # fmt: skip
    return tag(
        "section",
        tag("h3", "Commands to the robot"),
        render_bullet_list(described),
        render_table(
            format_group_caption("Means over trials by condition", simulated),
            heads,
            body,
            numbers=range(3, len(heads)),
        ),
        _preferences_table(design, own.values(), simulated),
    )


def _preferences_table(design: Design, rows: Iterable[TrialCommandsRow], simulated: bool) -> Markup:
    """Returns a table of the participants' own preferences; empty if no condition uses them."""
    with_preferences = [name for name, rules in design.conditions.items() if rules.preferences]
    own = [row for row in rows if row.counted and row.policy in with_preferences]
    if not own:
        return Markup()
    groups = defaultdict[tuple[object, ...], list[TrialCommandsRow]](list)
    for row in own:
        groups[
            row.policy,
            f"{row.preferred_speed:.0%}",
            format_short_number(100.0 * row.preferred_distance_m),
            row.preferred_side,
            row.bite_timing.replace("_", " "),
            "–" if row.bite_timing == "on_cue" else format_short_number(row.pause_s),
            f"{row.force_share:.0%}",
        ].append(row)
    heads = (
        "Condition", "Speed", "Distance / cm", "Side", "Continues", "Pause / s", "Force, of the limit", "Participants",
        "Trials",
    )  # fmt: skip
    body = [(*key, len({row.participant for row in each}), len(each)) for key, each in sorted(groups.items())]
    caption = format_group_caption("Participants' own preferences at the start of their trials", simulated)
    return render_table(caption, heads, body, numbers=(1, 2, 5, 6, 7, 8))


def describe_condition(rules: Condition) -> str:
    """Returns a description of a condition: policy, commands, preferences and settings."""
    words = [f"policy {rules.policy}"]
    if rules.commands:
        words.append(f"commands {', '.join(rules.commands)} by {', '.join(rules.sources)}")
        words.append("executed by the pacing layer" if rules.pacing else "executed by the controller")
    else:
        words.append("without commands")
    if rules.preferences:
        words.append("with the participants' own preferences")
    if rules.settings.changed_values:
        words.append(f"settings {rules.settings}")
    described = f"{'; '.join(words)}."
    return f"{described} {describe_preferences(rules.defaults)}" if rules.uses_pacing_layer else described


def _cells(
    key: tuple[str, str, str], trials: list[TrialRow], commands: dict[tuple[str, int], TrialCommandsRow]
) -> tuple[object, ...]:
    own = [commands[place] for row in trials if (place := (row.participant, row.position)) in commands]
    agreed = [row.agreement_share for row in own if row.agreement_share is not None]
    return (
        *key,
        len(trials),
        f"{100 * fmean(bool(row.success) for row in trials):.0f} %",
        _mean([row.force_mean_n for row in trials]),
        _mean([row.force_peak_n for row in trials]),
        _mean([row.waiting_s for row in own]),
        _mean([row.commands for row in own]),
        _mean([row.ignored for row in own]),
        f"{100 * fmean(agreed):.0f} %" if agreed else "–",
        _mean([row.speed_factor for row in own]),
    )


def _mean(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return format_number(fmean(known) if known else None, absent="–")
