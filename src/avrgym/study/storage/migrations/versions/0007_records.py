"""Adverse events, and what participants say about their functioning."""

import sqlalchemy as sa
from alembic import op

revision = "0007_records"
down_revision = "0006_headset_check"


def upgrade() -> None:
    op.add_column("participant", sa.Column("functioning", sa.JSON))
    op.create_table(
        "adverse_event",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("recorded_at", sa.String, nullable=False),
        sa.Column("recorded_by", sa.String),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("trial", sa.Integer, sa.ForeignKey("trial.id")),
        sa.Column("follows", sa.Integer, sa.ForeignKey("adverse_event.id")),
        sa.Column("began_at", sa.String, nullable=False),
        sa.Column("description", sa.String, nullable=False),
        sa.Column("severity", sa.String, nullable=False),
        sa.Column("seriousness", sa.String, nullable=False),
        sa.Column("relatedness", sa.String, nullable=False),
        sa.Column("action", sa.String, nullable=False),
        sa.Column("outcome", sa.String, nullable=False),
        sa.Column("salt", sa.String),
    )
