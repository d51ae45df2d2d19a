"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001_first"
down_revision = None


def upgrade() -> None:
    op.create_table(
        "study",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("protocol", sa.JSON, nullable=False),
    )
    op.create_table(
        "participant",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("state", sa.String, nullable=False),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("sex", sa.String, nullable=False),
        sa.Column("age_years", sa.Integer),
        sa.Column("cell", sa.Integer),
        sa.Column("enrolled_at", sa.String, nullable=False),
        sa.Column("consented_at", sa.String),
        sa.Column("consent_version", sa.String),
        sa.Column("consent_sha256", sa.String),
        sa.Column("inclusion", sa.JSON),
    )
    op.create_table(
        "session",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("state", sa.String, nullable=False),
        sa.Column("station", sa.String, nullable=False),
        sa.Column("process", sa.Integer, nullable=False),
        sa.Column("opened_at", sa.String, nullable=False),
        sa.Column("closed_at", sa.String),
        sa.UniqueConstraint("participant", "number"),
    )
    op.create_table(
        "trial",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("position", sa.Integer, nullable=False),
        sa.Column("environment", sa.String, nullable=False),
        sa.Column("policy", sa.String, nullable=False),
        sa.Column("seed", sa.BigInteger, nullable=False),
        sa.Column("practice", sa.Boolean, nullable=False),
        sa.Column("state", sa.String, nullable=False),
        sa.UniqueConstraint("participant", "position"),
    )
    op.create_table(
        "attempt",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("trial", sa.Integer, sa.ForeignKey("trial.id"), nullable=False),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id"), nullable=False),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("state", sa.String, nullable=False),
        sa.Column("recording", sa.String, nullable=False, unique=True),
        sa.Column("sha256", sa.String),
        sa.Column("figures", sa.JSON, nullable=False),
        sa.Column("started_at", sa.String, nullable=False),
        sa.Column("ended_at", sa.String),
        sa.UniqueConstraint("trial", "number"),
    )
    op.create_table(
        "answer",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id"), nullable=False),
        sa.Column("attempt", sa.Integer, sa.ForeignKey("attempt.id")),
        sa.Column("item", sa.String, nullable=False),
        sa.Column("value", sa.Integer, nullable=False),
        sa.Column("response_time_s", sa.Float, nullable=False),
        sa.Column("answered_at", sa.String, nullable=False),
        sa.UniqueConstraint("attempt", "item"),
    )
    op.create_table(
        "event",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number")),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id")),
        sa.Column("attempt", sa.Integer, sa.ForeignKey("attempt.id")),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("detail", sa.String, nullable=False),
    )
    op.create_table(
        "note",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("session", sa.Integer, sa.ForeignKey("session.id")),
        sa.Column("text", sa.String, nullable=False),
    )
    op.create_table(
        "tombstone",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("simulated", sa.Boolean, nullable=False),
        sa.Column("deleted_at", sa.String, nullable=False),
    )
