"""Simulator Sickness Questionnaire (SSQ): 16 symptoms with four severities."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

SEVERITY_LABELS = ("none", "slight", "moderate", "severe")

SYMPTOMS = {
    "general_discomfort": "General discomfort",
    "fatigue": "Fatigue",
    "headache": "Headache",
    "eyestrain": "Eyestrain",
    "difficulty_focusing": "Difficulty focusing",
    "increased_salivation": "Increased salivation",
    "sweating": "Sweating",
    "nausea": "Nausea",
    "difficulty_concentrating": "Difficulty concentrating",
    "fullness_of_head": "Fullness of head",
    "blurred_vision": "Blurred vision",
    "dizzy_eyes_open": "Dizzy (eyes open)",
    "dizzy_eyes_closed": "Dizzy (eyes closed)",
    "vertigo": "Vertigo",
    "stomach_awareness": "Stomach awareness",
    "burping": "Burping",
}


def _symptoms(*names: str) -> tuple[str, ...]:
    return tuple(f"ssq_{name}" for name in names)


NAUSEA_ITEMS = _symptoms(
    "general_discomfort", "increased_salivation", "sweating", "nausea", "difficulty_concentrating",
    "stomach_awareness", "burping",
)  # fmt: skip
OCULOMOTOR_ITEMS = _symptoms(
    "general_discomfort", "fatigue", "headache", "eyestrain", "difficulty_focusing", "difficulty_concentrating",
    "blurred_vision",
)  # fmt: skip
DISORIENTATION_ITEMS = _symptoms(
    "difficulty_focusing", "nausea", "fullness_of_head", "blurred_vision", "dizzy_eyes_open", "dizzy_eyes_closed",
    "vertigo",
)  # fmt: skip

SSQ = Instrument(
    name="ssq",
    title="Simulator Sickness Questionnaire",
    citation=(
        "Kennedy, Lane, Berbaum and Lilienthal (1993), Simulator Sickness Questionnaire, "
        "doi:10.1207/s15327108ijap0303_3"
    ),
    licence="names of symptoms and of their severity, which have no copyright",
    response_scale=ResponseScale(option_count=4, lowest_value=0),
    items=tuple(
        InstrumentItem(f"ssq_{name}", text, SEVERITY_LABELS[0], SEVERITY_LABELS[-1], SEVERITY_LABELS)
        for name, text in SYMPTOMS.items()
    ),
    scales=(
        ScoreScale("nausea", NAUSEA_ITEMS, "sum", 9.54),
        ScoreScale("oculomotor", OCULOMOTOR_ITEMS, "sum", 7.58),
        ScoreScale("disorientation", DISORIENTATION_ITEMS, "sum", 13.92),
        ScoreScale("total", NAUSEA_ITEMS + OCULOMOTOR_ITEMS + DISORIENTATION_ITEMS, "sum", 3.74),
    ),
)
