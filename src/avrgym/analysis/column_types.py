"""Column types of the analysis tables: Python type and description of a column that several tables have."""

from dataclasses import replace
from typing import Annotated

from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.table_rows import AttemptNumber as AttemptNumber
from avrgym.study.export.table_rows import IsPractice as IsPractice
from avrgym.study.export.table_rows import IsSimulated as IsSimulated
from avrgym.study.export.table_rows import PolicyName as PolicyName
from avrgym.study.export.table_rows import Pseudonym as Pseudonym
from avrgym.study.export.table_rows import QuestionMoment as QuestionMoment
from avrgym.study.export.table_rows import QuestionnaireName as QuestionnaireName
from avrgym.study.export.table_rows import RobotName as RobotName
from avrgym.study.export.table_rows import SessionNumber as SessionNumber
from avrgym.study.export.table_rows import SiteName as SiteName
from avrgym.study.export.table_rows import TaskName as TaskName
from avrgym.study.export.table_rows import TrialPosition as TrialPosition
from avrgym.system.columns import Column

AT_LEAST_0_TEXT, AT_LEAST_1_TEXT, FRACTION_RANGE_TEXT = "0 and above", "1 and above", "0 to 1"
ABOUT_SESSIONS_TEXT = "the row is about whole sessions"
NOT_TESTED_TEXT = "no test was possible"
_ANSWERS = COLUMNS_BY_TABLE["answers"]
PolicyNameOrNone = Annotated[
    str | None, replace(COLUMNS_BY_TABLE["attempts"]["policy"], empty=ABOUT_SESSIONS_TEXT)
]
ItemName = Annotated[str, _ANSWERS["item"]]
ValueCount = Annotated[int, Column("Number of values.", allowed=AT_LEAST_0_TEXT)]
ProxyAnswerCount = Annotated[int, Column("Number of values from answers of a proxy.", allowed="0 to n")]
Mean = Annotated[float, Column("Mean.")]
Minimum = Annotated[float, Column("Minimum.")]
LowerQuartile = Annotated[float, Column("Lower quartile, by linear interpolation.")]
Median = Annotated[float, Column("Median.")]
UpperQuartile = Annotated[float, Column("Upper quartile, by linear interpolation.")]
Maximum = Annotated[float, Column("Maximum.")]
FamilyName = Annotated[str, Column("Family of tests that are corrected together.")]
QuantityName = Annotated[str, Column("The quantity; its name ends with its unit.")]
GroupAName = Annotated[str, Column("First group of the comparison.")]
GroupBName = Annotated[str, Column("Second group of the comparison.")]
ZeroDifferenceCount = Annotated[
    int, Column("Number of zero differences, which the test omits.", allowed=AT_LEAST_0_TEXT)
]
MedianA = Annotated[float | None, Column("Median of the first group.", empty="no values, or positions")]
MedianB = Annotated[float | None, Column("Median of the second group.", empty="no values, or positions")]
EffectSize = Annotated[
    float | None,
    Column(
        "Rank-biserial correlation; for energy tests the normalised energy distance (0 to 1).",
        allowed="-1 to 1",
        empty="no differences",
    ),
]
_NO_INTERVAL = "no effect size, a test by trial, an energy distance, or too few participants"
EffectSizeLow = Annotated[
    float | None,
    Column("Lower bound of its 95 % confidence interval.", allowed="-1 to 1", empty=_NO_INTERVAL),
]
EffectSizeHigh = Annotated[
    float | None,
    Column("Upper bound of its 95 % confidence interval.", allowed="-1 to 1", empty=_NO_INTERVAL),
]
PValue = Annotated[
    float | None, Column("Two-sided p value.", allowed=FRACTION_RANGE_TEXT, empty=NOT_TESTED_TEXT)
]
HolmCorrectedPValue = Annotated[
    float | None,
    Column(
        "p after Holm's correction within the family.", allowed=FRACTION_RANGE_TEXT, empty=NOT_TESTED_TEXT
    ),
]
PrimaryCorrectedPValue = Annotated[
    float | None,
    Column(
        "p after correction over all primary results of the study.",
        allowed=FRACTION_RANGE_TEXT,
        empty="not a primary result, or no test was possible",
    ),
]
SignificanceStars = Annotated[
    str,
    Column(
        "Stars for p_primary: * < 0.05, ** < 0.01, *** < 0.001.",
        empty="0.05 or more, or not a primary result",
    ),
]
ResultRole = Annotated[
    str,
    Column("Role for its question.", allowed="primary, sensitivity analysis, secondary, supplement"),
]
PlanStatus = Annotated[
    str,
    Column(
        "Status by the frozen plan of the study.",
        allowed="confirmatory, exploratory, not in the plan",
        empty="no plan was frozen before the first participant",
    ),
]
Note = Annotated[str, Column("Reason for a missing test or estimate, or omitted values.", empty="no note")]
