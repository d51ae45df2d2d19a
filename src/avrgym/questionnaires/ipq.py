"""igroup Presence Questionnaire (IPQ): sense of presence in a virtual environment."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

SPATIAL_PRESENCE_ITEMS = tuple(f"ipq_sp{number}" for number in range(1, 6))
INVOLVEMENT_ITEMS = tuple(f"ipq_inv{number}" for number in range(1, 5))
REALISM_ITEMS = tuple(f"ipq_real{number}" for number in range(1, 5))
REVERSED_ITEMS = ("ipq_sp2", "ipq_inv3", "ipq_real1")
"""Items whose values are reversed in scores."""

IPQ = Instrument(
    name="ipq",
    title="igroup Presence Questionnaire",
    citation=(
        "Schubert, Friedmann and Regenbrecht (2001), The experience of presence: factor analytic insights, "
        "doi:10.1162/105474601300343603"
    ),
    licence="the source states none; AVR Gym does not include the item texts",
    texts_source="https://www.igroup.org/pq/ipq/",
    response_scale=ResponseScale(option_count=7, lowest_value=0),
    items=tuple(
        InstrumentItem(item)
        for item in ("ipq_g1", *SPATIAL_PRESENCE_ITEMS, *INVOLVEMENT_ITEMS, *REALISM_ITEMS)
    ),
    scales=(
        ScoreScale("general", ("ipq_g1",)),
        ScoreScale("spatial", SPATIAL_PRESENCE_ITEMS, reversed_item_ids=REVERSED_ITEMS),
        ScoreScale("involvement", INVOLVEMENT_ITEMS, reversed_item_ids=REVERSED_ITEMS),
        ScoreScale("realism", REALISM_ITEMS, reversed_item_ids=REVERSED_ITEMS),
    ),
)
