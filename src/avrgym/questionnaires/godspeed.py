"""Godspeed questionnaire series: semantic differential ratings of a robot, on five scales."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

WORD_PAIRS_BY_SCALE = {
    "anthropomorphism": (
        ("fake", "natural"), ("machinelike", "humanlike"), ("unconscious", "conscious"), ("artificial", "lifelike"),
        ("moving rigidly", "moving elegantly"),
    ),
    "animacy": (
        ("dead", "alive"), ("stagnant", "lively"), ("mechanical", "organic"), ("artificial", "lifelike"),
        ("inert", "interactive"), ("apathetic", "responsive"),
    ),
    "likeability": (
        ("dislike", "like"), ("unfriendly", "friendly"), ("unkind", "kind"), ("unpleasant", "pleasant"),
        ("awful", "nice"),
    ),
    "intelligence": (
        ("incompetent", "competent"), ("ignorant", "knowledgeable"), ("irresponsible", "responsible"),
        ("unintelligent", "intelligent"), ("foolish", "sensible"),
    ),
    "safety": (("anxious", "relaxed"), ("agitated", "calm"), ("quiescent", "surprised")),
}  # fmt: skip
"""Word pairs of each scale, by scale name. The second word has the highest value. No item is reversed."""


def _opposites_id(scale: str, low: str) -> str:
    return f"godspeed_{scale}_{low.split()[-1]}"


def _between(scale: str, low: str, high: str) -> InstrumentItem:
    whose = "How did you feel?" if scale == "safety" else "What is your impression of the robot?"
    return InstrumentItem(_opposites_id(scale, low), whose, low, high)


GODSPEED = Instrument(
    name="godspeed",
    title="Godspeed questionnaire series",
    citation=(
        "Bartneck, Kulić, Croft and Zoghbi (2009), Measurement instruments for the anthropomorphism, animacy, "
        "likeability, perceived intelligence, and perceived safety of robots, doi:10.1007/s12369-008-0001-3"
    ),
    licence="pairs of adjectives, which have no copyright; AVR Gym wrote the questions",
    response_scale=ResponseScale(option_count=5, lowest_value=1),
    items=tuple(_between(scale, *pair) for scale, pairs in WORD_PAIRS_BY_SCALE.items() for pair in pairs),
    scales=tuple(
        ScoreScale(scale, tuple(_opposites_id(scale, low) for low, _ in pairs))
        for scale, pairs in WORD_PAIRS_BY_SCALE.items()
    ),
)
