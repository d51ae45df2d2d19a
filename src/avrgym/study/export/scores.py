"""Scores of validated questionnaires, from a participant's answers at one moment of the study."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.questionnaires.instrument import Instrument
from avrgym.questionnaires.questionnaire import Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.export.exported_attempts import ExportedAnswer
from avrgym.study.export.table_rows import ScaleRow, ScoreRow
from avrgym.study.storage.answers import find_session_ids_of_visit
from avrgym.study.storage.database_rows import Participant, StudySession
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.store import StudyStore

AnswerTimeKey = tuple[int, int, str]
"""Time of answers: attempt id (0 without an attempt), session id, and moment (one of ``QUESTION_MOMENTS``)."""


@dataclass(frozen=True)
class Score:
    """The score of one scale from the answers at one moment of the study.

    ``scale_name``: name of the scale. ``value``: the score; ``None`` if required answers are missing.
    """

    questionnaire: Questionnaire
    instrument: Instrument
    scale_name: str
    value: float | None
    answers: tuple[ExportedAnswer, ...]

    @property
    def _respondent(self) -> str:
        """``PROXY_RESPONDENT`` if a proxy gave at least one answer; otherwise the respondent of the last answer."""
        given = [answer.stored_answer.effective_respondent for answer in self.answers]
        return PROXY_RESPONDENT if PROXY_RESPONDENT in given else given[-1]

    def to_row(self) -> ScoreRow:
        """Returns this score as a row of the table ``scores``."""
        minimum, maximum = self.instrument.compute_score_range(self.scale_name)
        items = self.instrument.list_item_ids(self.scale_name)
        return ScoreRow(
            **vars(replace(self.answers[-1].make_identifiers(), respondent=self._respondent)),
            instrument=self.instrument.name,
            scale=self.scale_name,
            score=self.value,
            minimum=minimum,
            maximum=maximum,
            answered=sum(answer.stored_answer.item in items for answer in self.answers),
            items=len(items),
        )


def compute_scores(
    store: StudyStore,
    participant: Participant,
    answers: Sequence[ExportedAnswer],
    answered_items: AnsweredItems,
) -> list[Score]:
    """Returns all scores of a participant, in the order of their answers.

    After a crash, the next session contains the remaining items. The answers of both sessions are then scored together.
    Weights are read from the design. A design without weights uses the participant's answers to the weighting
    questionnaire at the same time, or the latest ones.
    """
    sessions = store.read_sessions(participant.pseudonym)
    answers_by_questionnaire: dict[tuple[str, AnswerTimeKey], list[ExportedAnswer]] = {}
    for answer in answers:
        if _is_of_instrument(answer):
            key = answer.questionnaire.name, _moment(answer, sessions)
            answers_by_questionnaire.setdefault(key, []).append(answer)
    given = {
        key: {each.stored_answer.item: each.stored_answer.value for each in own}
        for key, own in answers_by_questionnaire.items()
    }
    design = answered_items.design
    return [
        score
        for (name, when), own in answers_by_questionnaire.items()
        for questionnaire in design.questionnaires
        if questionnaire.name == name and questionnaire.instrument is not None
        for weights in (_weights(design, questionnaire, when, given),)
        for score in _scores(questionnaire, questionnaire.instrument, weights, own)
    ]


def make_scale_rows(design: Design) -> Iterator[ScaleRow]:
    """Yields a row for each scale of the design's validated questionnaires."""
    for questionnaire in design.questionnaires:
        instrument = questionnaire.instrument
        for name in instrument.scale_names if instrument else ():
            assert instrument is not None
            scale = next((each for each in instrument.scales if each.name == name), None)
            minimum, maximum = instrument.compute_score_range(name)
            yield ScaleRow(
                questionnaire=questionnaire.name,
                instrument=instrument.name,
                title=instrument.title,
                scale=name,
                function=scale.aggregation if scale else "weighted mean",
                factor=scale.score_factor if scale else 1.0,
                reversed=", ".join(scale.reversed_item_ids) if scale else "",
                offset=scale.item_value_offset if scale else 0,
                items=", ".join(scale.item_ids if scale else instrument.list_item_ids(name)),
                minimum=minimum,
                maximum=maximum,
                missing=instrument.missing_answer_rule,
                source=instrument.citation,
                licence=instrument.licence,
            )


def uses_instruments(design: Design) -> bool:
    """Returns whether the design contains a validated questionnaire."""
    return any(questionnaire.instrument is not None for questionnaire in design.questionnaires)


def _is_of_instrument(answer: ExportedAnswer) -> bool:
    """Returns whether the answered item belongs to a validated questionnaire."""
    instrument = answer.questionnaire.instrument
    return instrument is not None and any(item.id == answer.stored_answer.item for item in instrument.items)


def _moment(answer: ExportedAnswer, sessions: Sequence[StudySession]) -> AnswerTimeKey:
    if answer.stored_answer.attempt is not None:
        return answer.stored_answer.attempt, answer.stored_answer.session, answer.moment
    return 0, find_session_ids_of_visit(sessions, answer.stored_answer.session)[0], answer.moment


def _scores(
    questionnaire: Questionnaire,
    instrument: Instrument,
    weights: Mapping[str, int] | None,
    answers: Sequence[ExportedAnswer],
) -> Iterator[Score]:
    given = {answer.stored_answer.item: answer.stored_answer.value for answer in answers}
    for scale, value in instrument.compute_scores(given, weights).items():
        yield Score(questionnaire, instrument, scale, value, tuple(answers))


def _weights(
    design: Design,
    questionnaire: Questionnaire,
    when: AnswerTimeKey,
    given: Mapping[tuple[str, AnswerTimeKey], Mapping[str, int]],
) -> Mapping[str, int] | None:
    """Returns the weights for a questionnaire's weighted score at one time; ``None`` if there are none."""
    if questionnaire.weights is not msgspec.UNSET:
        return questionnaire.weights
    weighting = questionnaire.instrument.weighting if questionnaire.instrument else None
    if weighting is None:
        return None
    sources = [each for each in design.questionnaires if each.use == weighting.weights_instrument_name]
    whole = {
        when: weights
        for source in sources
        for (name, when), answers in given.items()
        if name == source.name and source.instrument is not None
        for weights in (_chosen(source.instrument, answers),)
        if weights is not None
    }
    return whole.get(when) or next(reversed(whole.values()), None)


def _chosen(instrument: Instrument, answers: Mapping[str, int]) -> dict[str, int] | None:
    """Returns weights from the participant's answers, by factor; ``None`` if an answer is missing."""
    scores = instrument.compute_scores(answers)
    weights = {scale: round(score) for scale, score in scores.items() if score is not None}
    return weights if len(weights) == len(scores) else None
