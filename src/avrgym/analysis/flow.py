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

from avrgym.analysis.page.drawing import MATPLOTLIB_STYLE, TEXT_COLOUR, ReportFigure, make_report_figure
from avrgym.analysis.reading.study_data import StudyData
from avrgym.study.design.design import Design
from avrgym.study.storage.rows import Participant
from avrgym.study.storage.states import UNKNOWN_PARTICIPATION
from avrgym.study.storage.store import Store

WITHDRAWAL_EVENT = "participant withdrawn"
"""Name of the study event of a withdrawal. The field ``detail`` of the event contains the reason."""


@dataclass(frozen=True, kw_only=True)
class ParticipantFlow:
    """Number of people, or of simulated participants, at each step of a study.

    Attributes:
        simulated: whether the numbers are of simulated participants.
        enrolled: enrolled participants, including deleted participants.
        deleted: participants with deleted data.
        without_consent: enrolled participants without consent so far.
        excluded: participants that were excluded by their answers to inclusion questions.
        withdrew_before_allocation: withdrawals before a trial order was allocated.
        consent_unknown: participants with lost consent records (the database was lost).
        awaiting_allocation: participants with consent, but without answers to the inclusion questions.
        allocated: participants with an allocated trial order.
        withdrew: withdrawals after allocation.
        withdrawal_unknown: allocated participants with lost withdrawal records.
        unfinished: allocated participants that have not completed the study.
        completed: participants that completed the study.
        analysed: participants with analysed trials or answers.
        participants_by_order: number of participants by trial order (from 1).
        participants_by_consent_version: number of participants by their latest accepted consent version.
        reconsented: participants that gave consent again.
        declined: participants that declined consent.
        first_session_day, last_session_day: days of the first and last session (ISO 8601).
        analysed_unfinished: analysed participants that have not completed the study.
        completed_without_data: participants that completed the study, but have no analysed trial or answer.
        exclusions_by_answer: number of exclusions by answer to an inclusion question.
        early_withdrawals_by_reason: number of withdrawals before allocation, by reason.
        withdrawals_by_reason: number of withdrawals after allocation, by reason.
    """

    simulated: bool
    enrolled: int
    deleted: int
    without_consent: int
    excluded: int
    withdrew_before_allocation: int
    consent_unknown: int = 0
    awaiting_allocation: int
    allocated: int
    withdrew: int
    withdrawal_unknown: int = 0
    unfinished: int
    completed: int
    analysed: int
    participants_by_order: Mapping[int, int]
    participants_by_consent_version: Mapping[str, int]
    reconsented: int = 0
    declined: int = 0
    first_session_day: str | None
    last_session_day: str | None
    analysed_unfinished: int = 0
    completed_without_data: int = 0
    exclusions_by_answer: Mapping[str, int] = field(default_factory=dict[str, int])
    early_withdrawals_by_reason: Mapping[str, int] = field(default_factory=dict[str, int])
    withdrawals_by_reason: Mapping[str, int] = field(default_factory=dict[str, int])


def participant_flows(store: Store, data: StudyData) -> list[ParticipantFlow]:
    """Returns the flow of people, then the flow of simulated participants. A group without participants is omitted."""
    everyone, deleted = store.participants(), store.deleted_participants()
    return [
        _flow(store, [each for each in everyone if each.simulated is simulated], simulated, gone, data)
        for simulated in (False, True)
        if (gone := sum(each.simulated is simulated for each in deleted))
        or any(each.simulated is simulated for each in everyone)
    ]


def _flow(
    store: Store, own: Sequence[Participant], simulated: bool, deleted: int, data: StudyData
) -> ParticipantFlow:
    with_order = [each for each in own if each.cell is not None]
    without = [each for each in own if each.cell is None]
    analysed = [each for each in own if each.pseudonym in data.analysed_pseudonyms]
    completed = [each for each in with_order if each.state == "completed"]
    decisions = [store.consents(each.pseudonym) for each in own]
    days = sorted(session.opened_at[:10] for each in own for session in store.sessions(each.pseudonym))
    return ParticipantFlow(
        simulated=simulated,
        enrolled=len(own) + deleted,
        deleted=deleted,
        without_consent=_in(without, "enrolled"),
        excluded=_in(without, "excluded"),
        withdrew_before_allocation=_in(without, "withdrawn"),
        consent_unknown=_in(without, UNKNOWN_PARTICIPATION),
        awaiting_allocation=_in(without, "consented"),
        allocated=len(with_order),
        withdrew=_in(with_order, "withdrawn"),
        withdrawal_unknown=_in(with_order, UNKNOWN_PARTICIPATION),
        unfinished=_in(with_order, "allocated"),
        completed=len(completed),
        analysed=len(analysed),
        participants_by_order=dict(
            sorted(Counter(each.cell + 1 for each in with_order if each.cell is not None).items())
        ),
        participants_by_consent_version=dict(
            sorted(Counter(each.consent_version for each in own if each.consent_version).items())
        ),
        reconsented=sum(any(each.agreed for each in made[1:]) for made in decisions),
        declined=sum(any(not each.agreed for each in made) for made in decisions),
        first_session_day=days[0] if days else None,
        last_session_day=days[-1] if days else None,
        analysed_unfinished=len(analysed) - _in(analysed, "completed"),
        completed_without_data=len(completed) - _in(analysed, "completed"),
        exclusions_by_answer=Counter(answer for each in own for answer in _excluding(store.design, each)),
        early_withdrawals_by_reason=Counter(_reasons(store, without)),
        withdrawals_by_reason=Counter(_reasons(store, with_order)),
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


def _reasons(store: Store, own: Sequence[Participant]) -> Iterator[str]:
    """Yields the reason of each withdrawal, or "no reason stored"."""
    gone = {each.number for each in own if each.state == "withdrawn"}
    stored = {each.participant: each.detail for each in store.events() if each.name == WITHDRAWAL_EVENT}
    return (stored.get(number) or "no reason stored" for number in sorted(gone))


def _in(own: Iterable[Participant], state: str) -> int:
    return sum(each.state == state for each in own)


BOX_WIDTH_IN, DROPOUT_BOX_WIDTH_IN, BOX_GAP_IN, LINE_HEIGHT_IN = 2.9, 2.9, 0.22, 0.17
"""Sizes in the flow chart in inches: width of step and dropout boxes, space between boxes, height of a text line."""
CHARACTERS_PER_LINE = 42
"""Maximum number of characters in a text line of a box."""
UNKNOWN_CONSENT_TEXT = "consent or withdrawal unknown, database lost"


def flow_steps(flow: ParticipantFlow) -> list[tuple[str, list[str]]]:
    """Returns (text, dropouts) of each step of the participant flow.

    The text contains the number of participants. Each dropout text contains a reason and its number of participants.
    """
    before = f"withdrew before the first trial was planned{_reasons_text(flow.early_withdrawals_by_reason)}"
    unfinished = f", of them {flow.analysed_unfinished} not finished yet" if flow.analysed_unfinished else ""
    return [
        (
            f"Enrolled: {flow.enrolled}",
            _some(
                {
                    f"excluded by the inclusion questions{_reasons_text(flow.exclusions_by_answer)}": flow.excluded,
                    before: flow.withdrew_before_allocation,
                    UNKNOWN_CONSENT_TEXT: flow.consent_unknown,
                    "no consent yet": flow.without_consent,
                    "inclusion questions not answered yet": flow.awaiting_allocation,
                    "deleted with all data": flow.deleted,
                }
            ),
        ),
        (
            f"Allocated to an order of trials: {flow.allocated}",
            _some(
                {
                    f"withdrew{_reasons_text(flow.withdrawals_by_reason)}": flow.withdrew,
                    UNKNOWN_CONSENT_TEXT: flow.withdrawal_unknown,
                    "not finished yet": flow.unfinished,
                }
            ),
        ),
        (
            f"Completed the study: {flow.completed}",
            _some({"without an analysed trial or answer": flow.completed_without_data}),
        ),
        (f"In the analysis: {flow.analysed}{unfinished}", []),
    ]


def _reasons_text(reasons: Mapping[str, int]) -> str:
    """Returns a text in brackets: each reason with its number of participants; empty if ``reasons`` is empty."""
    return f" ({'; '.join(f'{reason}: {number}' for reason, number in reasons.items())})" if reasons else ""


def _some(left: dict[str, int]) -> list[str]:
    return [f"{number} {why}" for why, number in left.items() if number]


def flow_chart(flow: ParticipantFlow) -> ReportFigure:
    """Returns the flow chart. The chart of simulated participants is marked as simulated."""
    width_in, shown = BOX_WIDTH_IN + DROPOUT_BOX_WIDTH_IN + 3 * BOX_GAP_IN, flow_steps(flow)
    boxes = [_box_height(_lines([words])) for words, _ in shown]
    beside = [_box_height(lines) + BOX_GAP_IN if (lines := _lines(left)) else 0.0 for _, left in shown]
    height_in = 0.3 + sum(boxes) + sum(beside) + BOX_GAP_IN * len(shown)
    with matplotlib.rc_context(MATPLOTLIB_STYLE):
        figure = Figure(figsize=(width_in, height_in))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, width_in), ylim=(height_in, 0.0))
        axes.set_axis_off()
        top, middle = 0.3, BOX_GAP_IN + BOX_WIDTH_IN / 2
        for (words, left), tall, aside in zip(shown, boxes, beside, strict=True):
            _box(axes, BOX_GAP_IN, top, BOX_WIDTH_IN, _lines([words]))
            below = top + tall
            if left:
                at = below + BOX_GAP_IN / 2 + aside / 2
                _box(
                    axes,
                    BOX_WIDTH_IN + 2 * BOX_GAP_IN,
                    at - (aside - BOX_GAP_IN) / 2,
                    DROPOUT_BOX_WIDTH_IN,
                    _lines(left),
                )
                _arrow(axes, (middle, at), (BOX_WIDTH_IN + 2 * BOX_GAP_IN, at))
            top = below + aside + BOX_GAP_IN
            if words != shown[-1][0]:
                _arrow(axes, (middle, below), (middle, top))
    return make_report_figure(flow.simulated, "flow", "Flow of participants", figure)


def _lines(texts: Sequence[str]) -> list[str]:
    return [line for text in texts for line in wrap(text, CHARACTERS_PER_LINE)]


def _box_height(lines: Sequence[str]) -> float:
    """Returns the height of a box with these lines of text, in inches."""
    return LINE_HEIGHT_IN * (len(lines) + 1)


def _box(axes: Axes, x: float, y: float, width: float, lines: Sequence[str]) -> None:
    tall = _box_height(lines)
    axes.add_patch(Rectangle((x, y), width, tall, fill=False, edgecolor=TEXT_COLOUR, linewidth=0.8))
    axes.text(x + 0.1, y + tall / 2, "\n".join(lines), fontsize=8, va="center", linespacing=1.2)


def _arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "-|>", "color": TEXT_COLOUR, "linewidth": 0.8})
