"""Experimenters with tokens of their own, and the log of actions."""

import sqlalchemy as sa
from alembic import op

revision = "0008_log"
down_revision = "0007_records"


def upgrade() -> None:
    op.create_table(
        "experimenter",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("token_sha256", sa.String, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("revoked_at", sa.String),
        sa.Column("salt", sa.String),
        sa.UniqueConstraint("token_sha256"),
    )
    op.create_table(
        "log",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("person", sa.String, nullable=False),
        sa.Column("known_by", sa.String, nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("participant", sa.Integer),
        sa.Column("detail", sa.String, nullable=False),
        sa.Column("completed", sa.Integer),
        sa.Column("planned", sa.Integer),
        sa.Column("salt", sa.String),
    )
