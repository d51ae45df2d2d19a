"""Checklist for trust between people and automation (Jian, Bisantz and Drury): twelve statements."""

from avrgym.questionnaires.instrument import Instrument, InstrumentItem, ResponseScale, ScoreScale

_TRUST_ITEMS = tuple(f"trust_{number}" for number in range(1, 13))

JIAN_TRUST = Instrument(
    name="jian-trust",
    title="Checklist for trust between people and automation",
    citation=(
        "Jian, Bisantz and Drury (2000), Foundations for an empirically determined scale of trust in automated "
        "systems, doi:10.1207/S15327566IJCE0401_04"
    ),
    licence="the publisher's; AVR Gym does not include the statements",
    texts_source="the article, which numbers its twelve statements in this order",
    response_scale=ResponseScale(option_count=7, lowest_value=1),
    items=tuple(
        InstrumentItem(item, low_label="not at all", high_label="extremely") for item in _TRUST_ITEMS
    ),
    scales=(ScoreScale("trust", _TRUST_ITEMS, reversed_item_ids=_TRUST_ITEMS[:5]),),
)
