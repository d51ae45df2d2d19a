"""How sick somebody is of a simulation: SSQ and CSQ-VR."""

from avrgym.recording.instruments.instrument import Instrument, InstrumentItem, Response, Scale

SEVERITIES = ("none", "slight", "moderate", "severe")
FEELINGS = ("absent", "very mild", "mild", "moderate", "intense", "very intense", "extreme")

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


NAUSEA = _symptoms(
    "general_discomfort", "increased_salivation", "sweating", "nausea", "difficulty_concentrating",
    "stomach_awareness", "burping",
)  # fmt: skip
OCULOMOTOR = _symptoms(
    "general_discomfort", "fatigue", "headache", "eyestrain", "difficulty_focusing", "difficulty_concentrating",
    "blurred_vision",
)  # fmt: skip
DISORIENTATION = _symptoms(
    "difficulty_focusing", "nausea", "fullness_of_head", "blurred_vision", "dizzy_eyes_open", "dizzy_eyes_closed",
    "vertigo",
)  # fmt: skip

SSQ = Instrument(
    name="ssq",
    title="Simulator Sickness Questionnaire",
    source=(
        "Kennedy, Lane, Berbaum and Lilienthal (1993), Simulator Sickness Questionnaire, "
        "doi:10.1207/s15327108ijap0303_3"
    ),
    licence="names of symptoms and of their severity, which nobody owns",
    response=Response(points=4, lowest=0),
    items=tuple(
        InstrumentItem(f"ssq_{name}", text, SEVERITIES[0], SEVERITIES[-1], SEVERITIES)
        for name, text in SYMPTOMS.items()
    ),
    scales=(
        Scale("nausea", NAUSEA, "sum", 9.54),
        Scale("oculomotor", OCULOMOTOR, "sum", 7.58),
        Scale("disorientation", DISORIENTATION, "sum", 13.92),
        Scale("total", NAUSEA + OCULOMOTOR + DISORIENTATION, "sum", 3.74),
    ),
)


def _feeling(name: str, text: str) -> InstrumentItem:
    return InstrumentItem(f"csq_{name}", f"Do you experience {text}?", FEELINGS[0], FEELINGS[-1], FEELINGS)


_CSQ_ITEMS = (
    _feeling("nausea", "nausea (e.g., stomach pain, acid reflux, or tension to vomit)"),
    _feeling("dizziness", "dizziness (e.g., light-headedness or spinning feeling)"),
    _feeling("disorientation", "disorientation (e.g., spatial confusion or vertigo)"),
    _feeling("imbalance", "postural instability (i.e., imbalance)"),
    _feeling("fatigue", "a visually induced fatigue (e.g., feeling of tiredness or sleepiness)"),
    _feeling("discomfort", "a visually induced discomfort (e.g., eyestrain, blurred vision, or headache)"),
)

CSQ_VR = Instrument(
    name="csq-vr",
    title="Cybersickness in Virtual Reality Questionnaire",
    source=(
        "Kourtesis, Linnell, Amir, Argelaguet and MacPherson (2023), Cybersickness in Virtual Reality Questionnaire "
        "(CSQ-VR), doi:10.3390/virtualworlds2010002"
    ),
    licence="CC BY 4.0, with the article that it stands in",
    response=Response(points=7, lowest=1),
    items=_CSQ_ITEMS,
    scales=(
        Scale("nausea", ("csq_nausea", "csq_dizziness"), "sum"),
        Scale("vestibular", ("csq_disorientation", "csq_imbalance"), "sum"),
        Scale("oculomotor", ("csq_fatigue", "csq_discomfort"), "sum"),
        Scale("total", tuple(item.id for item in _CSQ_ITEMS), "sum"),
    ),
)
