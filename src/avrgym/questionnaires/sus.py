"""System Usability Scale (SUS): ten statements about a system, one score from 0 to 100."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

_STATEMENTS = (
    "I think that I would like to use this system frequently.",
    "I found the system unnecessarily complex.",
    "I thought the system was easy to use.",
    "I think that I would need the support of a technical person to be able to use this system.",
    "I found the various functions in this system were well integrated.",
    "I thought there was too much inconsistency in this system.",
    "I would imagine that most people would learn to use this system very quickly.",
    "I found the system very cumbersome to use.",
    "I felt very confident using the system.",
    "I needed to learn a lot of things before I could get going with this system.",
)
_SUS_ITEMS = tuple(f"sus_{number}" for number in range(1, 11))

SUS = Instrument(
    name="sus",
    title="System Usability Scale",
    citation="Brooke (1996), SUS: a 'quick and dirty' usability scale, in Usability Evaluation in Industry, 189-194",
    licence="free to use where reports acknowledge the source (Brooke 1996)",
    response_scale=ResponseScale(option_count=5, lowest_value=1),
    items=tuple(
        InstrumentItem(item, text, "strongly disagree", "strongly agree")
        for item, text in zip(_SUS_ITEMS, _STATEMENTS, strict=True)
    ),
    scales=(
        ScoreScale(
            "usability", _SUS_ITEMS, "sum", 2.5, reversed_item_ids=_SUS_ITEMS[1::2], item_value_offset=-1
        ),
    ),
    missing_answer_rule="centre",
)
