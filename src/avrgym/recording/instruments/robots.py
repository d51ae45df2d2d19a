"""What people make of a robot: RoSAS, Godspeed and trust."""

from avrgym.recording.instruments.instrument import Instrument, InstrumentItem, Response, Scale

ATTRIBUTES = {
    "warmth": ("happy", "feeling", "social", "organic", "compassionate", "emotional"),
    "competence": ("capable", "responsive", "interactive", "reliable", "competent", "knowledgeable"),
    "discomfort": ("scary", "strange", "awkward", "dangerous", "awful", "aggressive"),
}
OPPOSITES = {
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
"""By scale the words at both ends, of which the right one counts more; as printed, none is reversed."""

ROSAS = Instrument(
    name="rosas",
    title="Robotic Social Attributes Scale",
    source=(
        "Carpinella, Wyman, Perez and Stroessner (2017), The Robotic Social Attributes Scale (RoSAS), "
        "doi:10.1145/2909824.3020208"
    ),
    licence="single adjectives, which nobody owns; the question is worded by AVR Gym",
    response=Response(points=9, lowest=1),
    items=tuple(
        InstrumentItem(
            f"rosas_{word}",
            f"How closely do you associate this word with the robot: {word}?",
            "definitely not associated",
            "definitely associated",
        )
        for words in ATTRIBUTES.values()
        for word in words
    ),
    scales=tuple(Scale(name, tuple(f"rosas_{word}" for word in words)) for name, words in ATTRIBUTES.items()),
)


def _opposites_id(scale: str, low: str) -> str:
    return f"godspeed_{scale}_{low.split()[-1]}"


def _between(scale: str, low: str, high: str) -> InstrumentItem:
    whose = "How did you feel?" if scale == "safety" else "What is your impression of the robot?"
    return InstrumentItem(_opposites_id(scale, low), whose, low, high)


GODSPEED = Instrument(
    name="godspeed",
    title="Godspeed questionnaire series",
    source=(
        "Bartneck, Kulić, Croft and Zoghbi (2009), Measurement instruments for the anthropomorphism, animacy, "
        "likeability, perceived intelligence, and perceived safety of robots, doi:10.1007/s12369-008-0001-3"
    ),
    licence="pairs of adjectives, which nobody owns; the questions are worded by AVR Gym",
    response=Response(points=5, lowest=1),
    items=tuple(_between(scale, *pair) for scale, pairs in OPPOSITES.items() for pair in pairs),
    scales=tuple(
        Scale(scale, tuple(_opposites_id(scale, low) for low, _ in pairs))
        for scale, pairs in OPPOSITES.items()
    ),
)

_TRUST_ITEMS = tuple(f"trust_{number}" for number in range(1, 13))

JIAN_TRUST = Instrument(
    name="jian-trust",
    title="Checklist for trust between people and automation",
    source=(
        "Jian, Bisantz and Drury (2000), Foundations for an empirically determined scale of trust in automated "
        "systems, doi:10.1207/S15327566IJCE0401_04"
    ),
    licence="the publisher's; AVR Gym does not include the statements",
    texts="the article, whose twelve statements are numbered as here",
    response=Response(points=7, lowest=1),
    items=tuple(InstrumentItem(item, low="not at all", high="extremely") for item in _TRUST_ITEMS),
    scales=(Scale("trust", _TRUST_ITEMS, reversed=_TRUST_ITEMS[:5]),),
)
