"""Descriptions of columns on the fields of rows."""

from dataclasses import dataclass
from typing import Annotated

import pytest

from avrgym.system.columns import BOOLEAN, NUMBER, TEXT, TIME, Column, describe_columns


@dataclass
class Row:
    name: Annotated[str, Column("The name.")]
    time_s: Annotated[float | None, Column("When it was.", unit="s", empty="never")]
    share: Annotated[float, Column("A share.", allowed="0 to 1")]
    counted: Annotated[bool, Column("Whether it counts.")]
    at: Annotated[str, Column("The time.", TIME)] = ""


def test_type_and_unit_follow_from_the_annotation() -> None:
    assert describe_columns(Row) == {
        "name": Column("The name.", TEXT),
        "time_s": Column("When it was.", NUMBER, "s", "", "never"),
        "share": Column("A share.", NUMBER, "1", "0 to 1"),
        "counted": Column("Whether it counts.", BOOLEAN, "", "true, false"),
        "at": Column("The time.", TIME),
    }


def test_a_field_without_description_is_an_error() -> None:
    @dataclass
    class Bare(Row):
        extra: int = 0

    with pytest.raises(TypeError, match=r"Bare\.extra"):
        describe_columns(Bare)
