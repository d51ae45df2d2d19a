"""Read the answers of a participant, select the analysed answers, and compute scores."""

from collections.abc import Iterator, Sequence
from dataclasses import fields

from avrgym.analysis.reading.table_rows import AnswerRow, DataProblemRow, ScoreRow
from avrgym.questionnaires.questionnaire import REPEATABLE_QUESTION_MOMENTS, SESSION_QUESTION_MOMENTS
from avrgym.study.export.exported_attempts import ExportedAnswer, ExportedAttempt, list_participant_answers
from avrgym.study.export.scores import compute_scores
from avrgym.study.storage.database_rows import Participant
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.state_transitions import ALLOCATED_STATES
from avrgym.study.storage.store import StudyStore

ANSWER_COLUMN_NAMES = {column.name for column in fields(AnswerRow)}
SCORE_COLUMN_NAMES = {column.name for column in fields(ScoreRow)}


class ParticipantAnswers:
    """The answers of one participant. ``counted_positions``: positions of the analysed trials of the participant."""

    def __init__(
        self,
        store: StudyStore,
        participant: Participant,
        attempts: Sequence[ExportedAttempt],
        counted_positions: set[int],
        answered_items: AnsweredItems,
    ) -> None:
        self._store, self._participant, self._answered_items = store, participant, answered_items
        self._answers = list_participant_answers(store, participant, attempts, answered_items)
        takes_part = participant.state in ALLOCATED_STATES
        self._compared = _compared(self._answers) if takes_part else set[int]()
        of_trials = {each.stored_answer.id for each in self._answers if _is_of_trial(each, counted_positions)}
        self._counted = of_trials | self._compared

    def make_answer_rows(self) -> Iterator[AnswerRow]:
        """Yields a row for each answer of the participant, in order of time."""
        for answer in self._answers:
            columns = {
                name: value for name, value in vars(answer.to_row()).items() if name in ANSWER_COLUMN_NAMES
            }
            yield AnswerRow(counted=answer.stored_answer.id in self._counted, **columns)

    def make_score_rows(self) -> Iterator[ScoreRow]:
        """Yields a row for each score of the participant. A score is analysed if all its answers are analysed."""
        for score in compute_scores(self._store, self._participant, self._answers, self._answered_items):
            counted = all(answer.stored_answer.id in self._counted for answer in score.answers)
            columns = {
                name: value for name, value in vars(score.to_row()).items() if name in SCORE_COLUMN_NAMES
            }
            yield ScoreRow(counted=counted, **columns)

    def find_problems(self) -> Iterator[DataProblemRow]:
        """Yields a data problem for each moment (before or after sessions) with several answers to the same item."""
        if self._participant.state not in ALLOCATED_STATES:
            return
        for moment in SESSION_QUESTION_MOMENTS:
            given = [answer for answer in self._answers if answer.moment == moment]
            again = [answer for answer in given if answer.stored_answer.id not in self._compared]
            if again:
                items = ", ".join(dict.fromkeys(answer.stored_answer.item for answer in again))
                sessions = " and ".join(str(n) for n in sorted({each.session.number for each in given}))
                yield DataProblemRow(
                    simulated=self._participant.simulated,
                    where=self._participant.pseudonym,
                    what=f"answered {items} {moment.replace('_', ' ')} more than once, in sessions {sessions}",
                    consequence="for each item, only the latest answer after a session and the latest answer before "
                    "that session are analysed",
                )


def _is_of_trial(answer: ExportedAnswer, counted_positions: set[int]) -> bool:
    about = answer.attempt
    return (
        about is not None and about.attempt.state == "completed" and about.trial.position in counted_positions
    )


def _compared(answers: Sequence[ExportedAnswer]) -> set[int]:
    """Returns the ids of the analysed answers about sessions.

    For each item, these are the latest answer after a session, and the latest answer before that session. All answers
    after breaks and all answers of caregivers are analysed.
    """
    before, after = SESSION_QUESTION_MOMENTS
    ids = {answer.stored_answer.id for answer in answers if answer.moment in REPEATABLE_QUESTION_MOMENTS}
    for item in {answer.stored_answer.item for answer in answers}:
        own = {
            answer.stored_answer.id: answer.moment for answer in answers if answer.stored_answer.item == item
        }
        last = max((each for each in own if own[each] == after), default=None)
        first = [each for each in own if own[each] == before and (last is None or each < last)]
        ids |= {each for each in (last, max(first, default=None)) if each is not None}
    return ids
