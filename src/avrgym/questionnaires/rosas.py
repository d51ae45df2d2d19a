"""Robotic Social Attributes Scale (RoSAS): perceived warmth, competence and discomfort."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

ATTRIBUTES_BY_SCALE = {
    "warmth": ("happy", "feeling", "social", "organic", "compassionate", "emotional"),
    "competence": ("capable", "responsive", "interactive", "reliable", "competent", "knowledgeable"),
    "discomfort": ("scary", "strange", "awkward", "dangerous", "awful", "aggressive"),
}

ROSAS = Instrument(
    name="rosas",
    title="Robotic Social Attributes Scale",
    citation=(
        "Carpinella, Wyman, Perez and Stroessner (2017), The Robotic Social Attributes Scale (RoSAS), "
        "doi:10.1145/2909824.3020208"
    ),
    licence="single adjectives, which have no copyright; AVR Gym wrote the question",
    response_scale=ResponseScale(option_count=9, lowest_value=1),
    items=tuple(
        InstrumentItem(
            f"rosas_{word}",
            f"How closely do you associate this word with the robot: {word}?",
            "definitely not associated",
            "definitely associated",
        )
        for words in ATTRIBUTES_BY_SCALE.values()
        for word in words
    ),
    scales=tuple(
        ScoreScale(name, tuple(f"rosas_{word}" for word in words))
        for name, words in ATTRIBUTES_BY_SCALE.items()
    ),
)
