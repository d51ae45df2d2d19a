"""Cybersickness in Virtual Reality Questionnaire (CSQ-VR): six symptoms on seven-point scales."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

INTENSITY_LABELS = ("absent", "very mild", "mild", "moderate", "intense", "very intense", "extreme")


def _feeling(name: str, text: str) -> InstrumentItem:
    return InstrumentItem(
        f"csq_{name}",
        f"Do you experience {text}?",
        INTENSITY_LABELS[0],
        INTENSITY_LABELS[-1],
        INTENSITY_LABELS,
    )


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
    citation=(
        "Kourtesis, Linnell, Amir, Argelaguet and MacPherson (2023), Cybersickness in Virtual Reality Questionnaire "
        "(CSQ-VR), doi:10.3390/virtualworlds2010002"
    ),
    licence="CC BY 4.0, as its article",
    response_scale=ResponseScale(option_count=7, lowest_value=1),
    items=_CSQ_ITEMS,
    scales=(
        ScoreScale("nausea", ("csq_nausea", "csq_dizziness"), "sum"),
        ScoreScale("vestibular", ("csq_disorientation", "csq_imbalance"), "sum"),
        ScoreScale("oculomotor", ("csq_fatigue", "csq_discomfort"), "sum"),
        ScoreScale("total", tuple(item.id for item in _CSQ_ITEMS), "sum"),
    ),
)
