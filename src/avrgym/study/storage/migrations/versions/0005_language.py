"""The language that a participant reads the study in."""

import sqlalchemy as sa
from alembic import op

revision = "0005_language"
down_revision = "0004_sites"


def upgrade() -> None:
    op.add_column("participant", sa.Column("language", sa.String))
