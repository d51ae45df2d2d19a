"""Participant flow of a study: numbers at each step, and flow chart (CONSORT: Schulz et al., BMJ 340, 2010, c332)."""

# Matplotlib's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import wrap

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from avrgym.analysis.page.report_figures import (
    MATPLOTLIB_STYLE,
    TEXT_COLOUR,
    ReportFigure,
    make_report_figure,
)
from avrgym.analysis.reading.study_data import StudyData
from avrgym.study.design.design import Design
from avrgym.study.storage.database_rows import Participant
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE
from avrgym.study.storage.store import StudyStore

WITHDRAWAL_EVENT = "participant withdrawn"
"""Name of the study event of a withdrawal. The field ``detail`` of the event contains the reason."""


@dataclass(frozen=True, kw_only=True)
class ParticipantFlow:
    """Number of people, or of simulated participants, at each step of a study.

    Attributes:
        is_simulated: whether the numbers are of simulated participants.
        enrolled_participant_count: enrolled participants, including deleted participants.
        deleted_participant_count: participants with deleted data.
        without_consent_count: enrolled participants without consent so far.
        excluded_participant_count: participants that were excluded by their answers to inclusion questions.
        early_withdrawal_count: withdrawals before a trial order was allocated.
        unknown_consent_count: participants with lost consent records (the database was lost).
        awaiting_allocation_count: participants with consent, but without answers to the inclusion questions.
        allocated_participant_count: participants with an allocated trial order.
        late_withdrawal_count: withdrawals after allocation.
        unknown_withdrawal_count: allocated participants with lost withdrawal records.
        unfinished_participant_count: allocated participants that have not completed the study.
        completed_participant_count: participants that completed the study.
        analysed_participant_count: participants with analysed trials or answers.
        participants_by_order: number of participants by trial order (from 1).
        participants_by_consent_version: number of participants by their latest accepted consent version.
        reconsented_participant_count: participants that gave consent again.
        declined_consent_count: participants that declined consent.
        first_session_day, last_session_day: days of the first and last session (ISO 8601).
        unfinished_analysed_participant_count: analysed participants that have not completed the study.
        completed_unanalysed_participant_count: participants that completed the study, but have no analysed trial or
            answer.
        exclusions_by_answer: number of exclusions by answer to an inclusion question.
        early_withdrawals_by_reason: number of withdrawals before allocation, by reason.
        late_withdrawals_by_reason: number of withdrawals after allocation, by reason.
    """

    is_simulated: bool
    enrolled_participant_count: int
    deleted_participant_count: int
    without_consent_count: int
    excluded_participant_count: int
    early_withdrawal_count: int
    unknown_consent_count: int = 0
    awaiting_allocation_count: int
    allocated_participant_count: int
    late_withdrawal_count: int
    unknown_withdrawal_count: int = 0
    unfinished_participant_count: int
    completed_participant_count: int
    analysed_participant_count: int
    participants_by_order: Mapping[int, int]
    participants_by_consent_version: Mapping[str, int]
    reconsented_participant_count: int = 0
    declined_consent_count: int = 0
    first_session_day: str | None
    last_session_day: str | None
    unfinished_analysed_participant_count: int = 0
    completed_unanalysed_participant_count: int = 0
    exclusions_by_answer: Mapping[str, int] = field(default_factory=dict[str, int])
    early_withdrawals_by_reason: Mapping[str, int] = field(default_factory=dict[str, int])
    late_withdrawals_by_reason: Mapping[str, int] = field(default_factory=dict[str, int])


def compute_participant_flows(store: StudyStore, data: StudyData) -> list[ParticipantFlow]:
    """Returns the flow of people, then the flow of simulated participants. A group without participants is omitted."""
    everyone, deleted = store.read_participants(), store.read_deleted_participants()
    return [
        _flow(store, [each for each in everyone if each.simulated is simulated], simulated, gone, data)
        for simulated in (False, True)
        if (gone := sum(each.simulated is simulated for each in deleted))
        or any(each.simulated is simulated for each in everyone)
    ]


def _flow(
    store: StudyStore, own: Sequence[Participant], simulated: bool, deleted: int, data: StudyData
) -> ParticipantFlow:
    with_order = [each for each in own if each.cell is not None]
    without = [each for each in own if each.cell is None]
    analysed = [each for each in own if each.pseudonym in data.analysed_pseudonyms]
    completed = [each for each in with_order if each.state == "completed"]
    decisions = [store.read_consents(each.pseudonym) for each in own]
    days = sorted(session.opened_at[:10] for each in own for session in store.read_sessions(each.pseudonym))
    return ParticipantFlow(
        is_simulated=simulated,
        enrolled_participant_count=len(own) + deleted,
        deleted_participant_count=deleted,
        without_consent_count=_in(without, "enrolled"),
        excluded_participant_count=_in(without, "excluded"),
        early_withdrawal_count=_in(without, "withdrawn"),
        unknown_consent_count=_in(without, UNKNOWN_PARTICIPATION_STATE),
        awaiting_allocation_count=_in(without, "consented"),
        allocated_participant_count=len(with_order),
        late_withdrawal_count=_in(with_order, "withdrawn"),
        unknown_withdrawal_count=_in(with_order, UNKNOWN_PARTICIPATION_STATE),
        unfinished_participant_count=_in(with_order, "allocated"),
        completed_participant_count=len(completed),
        analysed_participant_count=len(analysed),
        participants_by_order=dict(
            sorted(Counter(each.cell + 1 for each in with_order if each.cell is not None).items())
        ),
        participants_by_consent_version=dict(
            sorted(Counter(each.consent_version for each in own if each.consent_version).items())
        ),
        reconsented_participant_count=sum(any(each.agreed for each in made[1:]) for made in decisions),
        declined_consent_count=sum(any(not each.agreed for each in made) for made in decisions),
        first_session_day=days[0] if days else None,
        last_session_day=days[-1] if days else None,
        unfinished_analysed_participant_count=len(analysed) - _in(analysed, "completed"),
        completed_unanalysed_participant_count=len(completed) - _in(analysed, "completed"),
        exclusions_by_answer=Counter(answer for each in own for answer in _excluding(store.design, each)),
        early_withdrawals_by_reason=Counter(_reasons(store, without)),
        late_withdrawals_by_reason=Counter(_reasons(store, with_order)),
    )


def _excluding(design: Design, participant: Participant) -> Iterator[str]:
    """Yields the answers to inclusion questions that excluded the participant."""
    if participant.state != "excluded":
        return
    questions = {question.id: question for question in design.inclusion}
    for name, answer in (participant.inclusion or {}).items():
        question = questions.get(name)
        if question is None or question.required != answer:
            yield f"{question.text if question else name} {'Yes' if answer else 'No'}"


def _reasons(store: StudyStore, own: Sequence[Participant]) -> Iterator[str]:
    """Yields the reason of each withdrawal, or "no reason stored"."""
    gone = {each.number for each in own if each.state == "withdrawn"}
    stored = {each.participant: each.detail for each in store.read_events() if each.name == WITHDRAWAL_EVENT}
    return (stored.get(number) or "no reason stored" for number in sorted(gone))


def _in(own: Iterable[Participant], state: str) -> int:
    return sum(each.state == state for each in own)


BOX_WIDTH_INCH, DROPOUT_BOX_WIDTH_INCH, BOX_GAP_INCH, LINE_HEIGHT_INCH = 2.9, 2.9, 0.22, 0.17
"""Sizes in the flow chart in inches: width of step and dropout boxes, space between boxes, height of a text line."""
CHARACTERS_PER_LINE = 42
"""Maximum number of characters in a text line of a box."""
UNKNOWN_CONSENT_TEXT = "consent or withdrawal unknown, database lost"


def make_flow_steps(flow: ParticipantFlow) -> list[tuple[str, list[str]]]:
    """Returns (text, dropouts) of each step of the participant flow.

    The text contains the number of participants. Each dropout text contains a reason and its number of participants.
    """
    before = f"withdrew before the first trial was planned{_reasons_text(flow.early_withdrawals_by_reason)}"
    unfinished = (
        f", of them {flow.unfinished_analysed_participant_count} not finished yet"
        if flow.unfinished_analysed_participant_count
        else ""
    )
    return [
        (
            f"Enrolled: {flow.enrolled_participant_count}",
            _some(
                {
                    "excluded by the inclusion questions"
                    f"{_reasons_text(flow.exclusions_by_answer)}": flow.excluded_participant_count,
                    before: flow.early_withdrawal_count,
                    UNKNOWN_CONSENT_TEXT: flow.unknown_consent_count,
                    "no consent yet": flow.without_consent_count,
                    "inclusion questions not answered yet": flow.awaiting_allocation_count,
                    "deleted with all data": flow.deleted_participant_count,
                }
            ),
        ),
        (
            f"Allocated to an order of trials: {flow.allocated_participant_count}",
            _some(
                {
                    f"withdrew{_reasons_text(flow.late_withdrawals_by_reason)}": flow.late_withdrawal_count,
                    UNKNOWN_CONSENT_TEXT: flow.unknown_withdrawal_count,
                    "not finished yet": flow.unfinished_participant_count,
                }
            ),
        ),
        (
            f"Completed the study: {flow.completed_participant_count}",
            _some({"without an analysed trial or answer": flow.completed_unanalysed_participant_count}),
        ),
        (f"In the analysis: {flow.analysed_participant_count}{unfinished}", []),
    ]


def _reasons_text(reasons: Mapping[str, int]) -> str:
    """Returns a text in brackets: each reason with its number of participants; empty if ``reasons`` is empty."""
    return f" ({'; '.join(f'{reason}: {number}' for reason, number in reasons.items())})" if reasons else ""


def _some(left: dict[str, int]) -> list[str]:
    return [f"{number} {why}" for why, number in left.items() if number]


def draw_flow_chart(flow: ParticipantFlow) -> ReportFigure:
    """Returns the flow chart. The chart of simulated participants is marked as simulated."""
    width_in, shown = BOX_WIDTH_INCH + DROPOUT_BOX_WIDTH_INCH + 3 * BOX_GAP_INCH, make_flow_steps(flow)
    boxes = [_box_height(_lines([words])) for words, _ in shown]
    beside = [_box_height(lines) + BOX_GAP_INCH if (lines := _lines(left)) else 0.0 for _, left in shown]
    height_in = 0.3 + sum(boxes) + sum(beside) + BOX_GAP_INCH * len(shown)
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(width_in, height_in))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, width_in), ylim=(height_in, 0.0))
        axes.set_axis_off()
        top, middle = 0.3, BOX_GAP_INCH + BOX_WIDTH_INCH / 2
        for (words, left), tall, aside in zip(shown, boxes, beside, strict=True):
            _box(axes, BOX_GAP_INCH, top, BOX_WIDTH_INCH, _lines([words]))
            below = top + tall
            if left:
                at = below + BOX_GAP_INCH / 2 + aside / 2
                _box(
                    axes,
                    BOX_WIDTH_INCH + 2 * BOX_GAP_INCH,
                    at - (aside - BOX_GAP_INCH) / 2,
                    DROPOUT_BOX_WIDTH_INCH,
                    _lines(left),
                )
                _arrow(axes, (middle, at), (BOX_WIDTH_INCH + 2 * BOX_GAP_INCH, at))
            top = below + aside + BOX_GAP_INCH
            if words != shown[-1][0]:
                _arrow(axes, (middle, below), (middle, top))
    return make_report_figure(flow.is_simulated, "flow", "Flow of participants", figure)


def _lines(texts: Sequence[str]) -> list[str]:
    return [line for text in texts for line in wrap(text, CHARACTERS_PER_LINE)]


def _box_height(lines: Sequence[str]) -> float:
    """Returns the height of a box with these lines of text, in inches."""
    return LINE_HEIGHT_INCH * (len(lines) + 1)


def _box(axes: Axes, x: float, y: float, width: float, lines: Sequence[str]) -> None:
    tall = _box_height(lines)
    axes.add_patch(Rectangle((x, y), width, tall, fill=False, edgecolor=TEXT_COLOUR, linewidth=0.8))
    axes.text(x + 0.1, y + tall / 2, "\n".join(lines), fontsize=8, va="center", linespacing=1.2)


def _arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "-|>", "color": TEXT_COLOUR, "linewidth": 0.8})
