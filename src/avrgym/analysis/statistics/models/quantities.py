"""What models are made of: each quantity that trials of a study give, and where in the study its trials stand."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from avrgym.analysis.reading.observations import Observations
from avrgym.analysis.rows import AttemptRow
from avrgym.analysis.statistics.models.effects import EFFECTS, Observed, effects
from avrgym.analysis.statistics.models.fitting import LOGISTIC, MIXED, ORDINAL
from avrgym.analysis.statistics.subjective import AFTER_TRIAL, asked_at
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.study.design.design import Design

MOST_ORDERED = 11
"""Answers on longer scales are taken for numbers."""
SUCCESS, REWARD = "success", "reward"
ANSWERS, SCORES, TRIALS = "answers", "scores", "trials"
"""Where the values of a source stand."""
Key = tuple[str, int]
"""Pseudonym and position of a trial."""


@dataclass(frozen=True)
class Source:
    """Quantities that are looked at together, each with the model that suits it, and where their values stand.

    ``questionnaire`` is that of answers and scores.
    """

    name: str
    models: Mapping[str, str]
    rows: str
    questionnaire: str = ""

    def family(self, kind: str) -> str:
        """The family of one kind of effects, which are corrected together."""
        return f"{kind}, {self.name}"


def sources(design: Design) -> Iterator[Source]:
    """What the trials of a design give."""
    rated = asked_at(design, AFTER_TRIAL)
    for questionnaire in rated:
        models = {item.id: _suiting(item) for item in questionnaire.items}
        yield Source(_of_answers(questionnaire, len(rated) > 1), models, ANSWERS, questionnaire.name)
    for questionnaire in rated:
        if questionnaire.instrument is not None:
            scales = dict.fromkeys(questionnaire.instrument.scale_names, MIXED)
            yield Source(f"models of scores of {questionnaire.name}", scales, SCORES, questionnaire.name)
    yield Source("models of success and reward", {SUCCESS: LOGISTIC, REWARD: MIXED}, TRIALS)


def _of_answers(questionnaire: Questionnaire, several: bool) -> str:
    return f"models of answers to {questionnaire.name}" if several else "models of answers"


def _suiting(item: Item) -> str:
    return ORDINAL if item.points <= MOST_ORDERED else MIXED


def offered_models(design: Design) -> dict[str, tuple[str, ...]]:
    """The families of effects in models by name, each with its quantities: what a plan may name."""
    kinds = {effect.kind for effect in effects(design)}
    return {
        source.family(kind): tuple(source.models)
        for source in sources(design)
        for kind in EFFECTS
        if kind in kinds
    }


def observed_values(
    design: Design, seen: Observations, simulated: bool, source: Source
) -> Mapping[str, list[Observed]]:
    """The values of each quantity of a source in the counted trials of people, or of simulated participants."""
    counted = {
        (row.participant, row.position) for row in seen.trials if row.counted and row.simulated is simulated
    }
    course = courses(design, seen.attempts)
    found: dict[str, list[Observed]] = {quantity: [] for quantity in source.models}
    for quantity, key, value in _values(seen, source):
        if quantity in found and key in counted and key in course:
            found[quantity].append(replace(course[key], value=value))
    return found


def _values(seen: Observations, source: Source) -> Iterator[tuple[str, Key, float]]:
    """Quantity, trial and value of all trials."""
    if source.rows == ANSWERS:
        for row in seen.answers:
            if row.counted and row.position is not None and row.questionnaire == source.questionnaire:
                yield row.item, (row.participant, row.position), float(row.value)
    elif source.rows == SCORES:
        for row in seen.scores:
            about = row.counted and row.position is not None and row.questionnaire == source.questionnaire
            if about and row.score is not None and row.position is not None:
                yield row.scale, (row.participant, row.position), row.score
    else:
        for row in seen.trials:
            if row.success is not None:
                yield SUCCESS, (row.participant, row.position), float(row.success)
            if row.reward is not None:
                yield REWARD, (row.participant, row.position), row.reward


def courses(design: Design, attempts: Sequence[AttemptRow]) -> dict[Key, Observed]:
    """Every completed trial but for practice, where it stood in its participant's course, still without a value."""
    found: dict[Key, Observed] = {}
    blocks, places = max(len(design.tasks) - 1, 1), max(len(design.conditions) - 1, 1)
    block, place = 0, 0
    last: AttemptRow | None = None
    for row in (each for each in attempts if each.state == "completed"):
        if last is None or last.participant != row.participant:
            block, place, last = 0, 0, None
        elif last.task != row.task:
            block, place = block + 1, 0
        same = last is not None and last.task == row.task
        if not row.practice:
            found[row.participant, row.position] = Observed(
                row.participant, row.task, row.robot, row.policy,
                min(block / blocks, 1.0), min(place / places, 1.0), last.policy if last and same else None, 0.0,
            )  # fmt: skip
            place += 1
        last = row
    return found
