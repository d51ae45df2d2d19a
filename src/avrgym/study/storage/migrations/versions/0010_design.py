"""The design that each session began with; that of earlier ones is not stored."""

import sqlalchemy as sa
from alembic import op

revision = "0010_design"
down_revision = "0009_consents"


def upgrade() -> None:
    op.create_table(
        "design",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id")),
        sa.Column("stored_at", sa.String, nullable=False),
        sa.Column("design", sa.JSON, nullable=False),
        sa.Column("wordings", sa.JSON, nullable=False),
        sa.Column("salt", sa.String),
    )
