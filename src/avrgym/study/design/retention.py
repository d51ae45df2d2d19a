"""Retention periods after the end of the study, for each kind of data."""

import calendar
from collections.abc import Mapping
from datetime import date
from typing import Annotated

import msgspec

from avrgym.study.design.toml_validation import ValidationError

RetentionMonths = Annotated[int, msgspec.Meta(ge=0, le=1200)]
RetentionYears = Annotated[int, msgspec.Meta(ge=0, le=100)]
IDENTITY_DATA, RECORDING_DATA, ALL_DATA = "identities", "recordings", "data"


class RetentionPeriods(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Retention periods after the end of the study. Data without a period are never deleted.

    ``identities_months``: names and contacts. ``recordings_years``: recordings of people. ``data_years``: all data of
    people.
    """

    ended_on: str = ""
    identities_months: RetentionMonths | None = None
    recordings_years: RetentionYears | None = None
    data_years: RetentionYears | None = None

    @property
    def months_by_data_kind(self) -> Mapping[str, int]:
        """The retention periods in months, by kind of data. Kinds without a period are omitted."""
        years = {RECORDING_DATA: self.recordings_years, ALL_DATA: self.data_years}
        given = {IDENTITY_DATA: self.identities_months} | {
            kind: None if period is None else 12 * period for kind, period in years.items()
        }
        return {kind: period for kind, period in given.items() if period is not None}

    @property
    def last_study_day(self) -> date | None:
        """The last day of the study; ``None`` if unknown."""
        return date.fromisoformat(self.ended_on) if self.ended_on else None

    @property
    def deletion_date_by_data_kind(self) -> Mapping[str, date]:
        """The first day after the retention period, by kind of data; empty if the end of the study is unknown."""
        end = self.last_study_day
        return (
            {}
            if end is None
            else {kind: _later(end, months) for kind, months in self.months_by_data_kind.items()}
        )


def check_retention(retention: RetentionPeriods) -> None:
    """Raises ``ValidationError`` if ``ended_on`` is not a date."""
    try:
        _ = retention.last_study_day
    except ValueError:
        raise ValidationError(
            ("retention", "ended_on"),
            f"{retention.ended_on!r} is not a date; allowed: a date such as 2027-06-30",
        ) from None


def _later(day: date, months: int) -> date:
    """Returns the same day ``months`` later; if that month is too short, its last day."""
    year, month = divmod(12 * day.year + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, calendar.monthrange(year, month + 1)[1]))
