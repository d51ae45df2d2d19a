"""The page's table of inputs agrees with the browser tests."""

import re
from pathlib import Path

from test_browser_inputs import HEADSETS, WAYS

PAGE = Path(__file__).parents[2] / "docs/how_to/connect_headset.md"
STOPS = {
    "press one": "button",
    "both triggers": "triggers",
    "hold the trigger": "select",
    "palm": "palm",
    "look": "gaze",
}
"""Words of the table, and the kind of stop that they name."""


def test_the_table_lists_each_tested_headset_with_its_stop() -> None:
    section = PAGE.read_text("utf-8").split("## Inputs")[1].split("\n## ")[0]
    rows = [
        row.split("|")[1:-1] for row in section.splitlines() if row.startswith("| ") and row.count("|") == 7
    ]
    cells = [[cell.strip() for cell in row] for row in rows[1:]]
    assert all(all(row) for row in cells)
    named = {name: stop for *_, stop, names in cells for name in re.findall(r"`([\w-]+)`", names)}
    assert sorted(named) == sorted(HEADSETS)
    for name, words in named.items():
        way = next(way for word, way in STOPS.items() if word in words)
        assert way == ("triggers" if WAYS[name] == "squeeze" else WAYS[name])
