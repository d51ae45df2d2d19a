"""Report section about trials: an overview, and the time course of each trial."""

from collections.abc import Sequence
from urllib.parse import quote

from avrgym.analysis.page.html_elements import (
    Markup,
    format_number,
    render_definition_list,
    render_table,
    tag,
)
from avrgym.analysis.page.line_charts import draw_trial_charts
from avrgym.analysis.reading.study_data import StudyData
from avrgym.analysis.reading.table_rows import AnswerRow, RewardTermRow, TrialRow


def render_trials_section(observed: StudyData, simulated: bool, study_link: str) -> Markup:
    """Returns the report section: a table of all planned trials, and details of each trial with a recording."""
    rows = [row for row in observed.trials if row.simulated is simulated]
    opened = [_trial(observed, row, study_link) for row in rows if row.recording is not None]
    return tag(
        "section",
        tag("h3", "Trials"),
        tag("details", tag("summary", f"All {len(rows)} planned trials"), _overview(rows, simulated)),
        tag("p", "Open a trial to see its time course. Run replay commands in the study's folder."),
        *opened,
    )


def _overview(rows: Sequence[TrialRow], simulated: bool) -> Markup:
    heads = (
        "Trial",
        "Task",
        "Robot",
        "Policy",
        "State",
        "Attempts",
        "Analysed",
        "Recording",
        "Tracking lost",
        "Reward",
        "Success",
    )
    body = [
        (
            _link(row), row.task, row.robot, row.policy + (" (practice)" if row.practice else ""), row.state,
            row.attempts, _counted(row), row.recorded or "–", _share(row.tracking_loss_share),
            format_number(row.reward, absent="–"), _yes(row.success),
        )
        for row in rows
    ]  # fmt: skip
    caption = "Planned trials (simulated participants)" if simulated else "Planned trials"
    return render_table(caption, heads, body, numbers=(5, 8, 9))


def _counted(row: TrialRow) -> str:
    return "excluded" if row.left_out else _yes(row.counted)


def _share(share: float | None) -> str:
    """Returns a share (0 to 1) as a percentage; a dash for ``None``."""
    return "–" if share is None else f"{100 * share:.1f} %"


def _link(row: TrialRow) -> Markup | str:
    return tag("a", _name(row), href=f"#{_id(row)}") if row.recording else _name(row)


def _name(row: TrialRow) -> str:
    return f"{row.participant}, {row.position}"


def _id(row: TrialRow) -> str:
    return f"{row.participant}-trial-{row.position}"


def _yes(value: bool | None) -> str:
    return "–" if value is None else "yes" if value else "no"


def _times(count: int | None) -> str:
    return "–" if count is None else f"{count} ×"


def _trial(observed: StudyData, row: TrialRow, study_link: str) -> Markup:
    key = (row.participant, row.position)
    series = observed.time_series_by_trial.get(key)
    charts = (
        draw_trial_charts(series.times_s, series.control_steps, series.reward_weights)
        if series
        else tag("p", f"No time series: the recording is {row.recorded}.")
    )
    answers = [each for each in observed.answers if (each.participant, each.position) == key and each.attempt]
    terms = [each for each in observed.reward_terms if (each.participant, each.position) == key]
    parts = (_metrics(row), charts, _answers(answers), _terms(terms), _replay(row, study_link))
    return tag("details", _summary(row), tag("div", *parts, id=_id(row)))


def _summary(row: TrialRow) -> Markup:
    kind = " (practice)" if row.practice else ""
    simulated = ", simulated" if row.simulated else ""
    success = {True: ", success", False: ", no success", None: ""}[row.success]
    what = f"{_name(row)}: {row.task}, {row.robot}, {row.policy}{kind}{simulated}"
    return tag("summary", f"{what}: reward {format_number(row.reward)}{success}")


def _metrics(row: TrialRow) -> Markup:
    return render_definition_list(
        {
            "Steps": row.steps,
            "Closest to the target": format_number(row.distance_min_m, "m"),
            "Mean force on the person": format_number(row.force_mean_n, "N"),
            "Peak force on the person": format_number(row.force_peak_n, "N"),
            "Interventions of the force guard": _times(row.guard_interventions),
            "Tracking lost": _share(row.tracking_loss_share),
            "Torso height": format_number(row.torso_height_m, "m", digits=3),
            "Bent forward, mean": format_number(row.waist_x_deg, "°", digits=1),
            "Attempts": row.attempts,
            "Recording": row.recorded,
        }
    )


def _answers(rows: Sequence[AnswerRow]) -> Markup:
    given = ", ".join(f"{row.item} {row.value}{_ends(row)}" for row in rows)
    return tag("p", f"Answers: {given}." if given else "No answers.")


def _ends(row: AnswerRow) -> str:
    """Returns minimum and maximum of the response scale as text; empty if the design does not contain the item."""
    return "" if row.minimum is None else f" ({row.minimum} to {row.maximum})"


def _terms(rows: Sequence[RewardTermRow]) -> Markup:
    shown = [row for row in rows if row.sum]
    given = ", ".join(f"{row.term} {format_number(row.weighted_sum)}" for row in shown)
    return tag(
        "p",
        f"Reward by weighted term: {given}." if given else "No reward terms were recorded.",
        class_="faint",
    )


def _replay(row: TrialRow, study_link: str) -> Markup:
    file = tag("a", "recording", href=f"{quote(study_link)}/{quote(str(row.recording))}")
    return tag("p", "Its ", file, "; replay: ", tag("code", f"avrgym replay {row.recording}"))
