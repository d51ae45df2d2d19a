"""A ledger of what was written, and salts for its checksums."""

import sqlalchemy as sa
from alembic import op

revision = "0002_ledger"
down_revision = "0001_first"

SALTED = ("study", "participant", "session", "trial", "attempt", "answer", "event", "note", "tombstone")


def upgrade() -> None:
    for table in SALTED:
        op.add_column(table, sa.Column("salt", sa.String))
    op.create_table(
        "ledger",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("table", sa.String, nullable=False),
        sa.Column("key", sa.Integer, nullable=False),
        sa.Column("content", sa.String),
        sa.Column("digest", sa.String, nullable=False),
    )
