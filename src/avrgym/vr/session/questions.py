"""The items of a questionnaire in order: the current item, and validation of answers."""

from collections.abc import Mapping, Sequence

from avrgym.questionnaires.questionnaire import Item, validate_answer
from avrgym.recording.schema import Answer
from avrgym.vr.protocol import messages


class QuestionSequence:
    """The items of a questionnaire in order, with the current item. A participant may go back to change answers."""

    def __init__(
        self, items: Sequence[Item], given: Mapping[str, int] | None = None, *, review: bool = False
    ) -> None:
        """Start with the first item that has no answer in ``given``. If ``review`` is true, start with the first
        item."""
        self._items = items
        self._given = dict(given or {})
        self._asked = (
            0
            if review
            else next((i for i, item in enumerate(items) if item.id not in self._given), len(items))
        )

    @property
    def are_all_answered(self) -> bool:
        """Whether every item is answered."""
        return self._asked == len(self._items)

    @property
    def unanswered_item_ids(self) -> list[str]:
        """The identifiers of the items without an answer."""
        return [item.id for item in self._items if item.id not in self._given]

    @property
    def previous_answer(self) -> int | None:
        """The earlier answer to the current item; ``None`` without an earlier answer."""
        return self._given.get(self._items[self._asked].id)

    def make_current_question(self) -> messages.Question:
        """Returns the current item as a message for the clients."""
        item = self._items[self._asked]
        return messages.Question(
            item=item.id,
            text=item.text,
            points=item.points,
            low=item.low,
            high=item.high,
            labels=list(item.labels),
            number=self._asked + 1,
            count=len(self._items),
            previous_answer=self.previous_answer,
        )

    def store_answer(self, answer: messages.Answer) -> Answer:
        """Store the answer to the current item and move to the next item. Returns the answer for the recording.

        Raises:
            ValueError: for an invalid answer. The message contains the allowed values.
        """
        validate_answer([self._items[self._asked]], answer.item, answer.value)
        self._asked += 1
        self._given[answer.item] = answer.value
        return Answer(answer.item, answer.value, answer.response_time_s)

    def go_back(self) -> bool:
        """Move to the previous item. Returns whether there is a previous item."""
        if self._asked == 0:
            return False
        self._asked -= 1
        return True
