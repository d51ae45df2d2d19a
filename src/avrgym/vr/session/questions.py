"""The questionnaire of one trial: which item is asked, and what counts as its answer."""

from collections.abc import Sequence

from avrgym.recording.questionnaire import Item, validate_answer
from avrgym.recording.records import Answer
from avrgym.vr.protocol import messages


class Questions:
    """Asks one item after another."""

    def __init__(self, items: Sequence[Item]) -> None:
        self._items = items
        self._asked = 0

    @property
    def done(self) -> bool:
        """Whether every item is answered."""
        return self._asked == len(self._items)

    def question(self) -> messages.Question:
        """The item that is asked now."""
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
        )

    def take(self, answer: messages.Answer) -> Answer:
        """Go on to the next item; gives the answer to this one.

        Raises:
            ValueError: when this does not answer the item that is asked, naming what is allowed.
        """
        validate_answer([self._items[self._asked]], answer.item, answer.value)
        self._asked += 1
        return Answer(answer.item, answer.value, answer.response_time_s)
