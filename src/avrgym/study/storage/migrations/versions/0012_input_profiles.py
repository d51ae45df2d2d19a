"""Add the input profiles of participants and attempts. In earlier studies, all participants use two controllers."""

import sqlalchemy as sa
from alembic import op

revision = "0012_input_profiles"
down_revision = "0011_links"


def upgrade() -> None:
    for table in ("participant", "attempt"):
        op.add_column(table, sa.Column("input_profile", sa.JSON))
