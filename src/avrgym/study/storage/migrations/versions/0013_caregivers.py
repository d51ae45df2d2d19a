"""Add the roles of consents, links and respondents. In earlier studies, all participants answer for themselves."""

import sqlalchemy as sa
from alembic import op

revision = "0013_caregivers"
down_revision = "0012_input_profiles"


def upgrade() -> None:
    for table, column in (
        ("participant", "respondent"),
        ("answer", "respondent"),
        ("consent", "role"),
        ("link", "role"),
    ):
        op.add_column(table, sa.Column(column, sa.String))
