"""The links of participants, one for each session."""

import sqlalchemy as sa
from alembic import op

revision = "0011_links"
down_revision = "0010_design"


def upgrade() -> None:
    op.create_table(
        "link",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id"), nullable=False),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("sha256", sa.String, nullable=False),
        sa.Column("salt", sa.String),
    )
