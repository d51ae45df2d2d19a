"""Line numbers of TOML values in errors, also with separated tables of an array and texts that look like headers."""

import pytest

from avrgym.system.toml_lines import ValuePath, find_line_number

TEXT = '''title = "a"

[[asked]]
name = "first"
items = [
    { id = "a" },
    { id = "b" },
]

[consent]
text = """
[[asked]]
name = "no table"
"""

[[asked]]
name = "second"
when = [
    "before",
    "after",
]
'''


@pytest.mark.parametrize(
    ("place", "line"),
    [
        ((), 1),
        (("title",), 1),
        (("asked", 0), 4),
        (("asked", 0, "name"), 4),
        (("asked", 0, "items", 1, "id"), 7),
        (("consent", "text"), 11),
        (("asked", 1), 17),
        (("asked", 1, "name"), 17),
        (("asked", 1, "when", 1), 20),
    ],
)
def test_a_value_begins_on_its_line(place: ValuePath, line: int) -> None:
    assert find_line_number(TEXT, place) == line
