"""What the check of the headset measured at the beginning of a session; earlier sessions had none."""

import sqlalchemy as sa
from alembic import op

revision = "0006_headset_check"
down_revision = "0005_language"


def upgrade() -> None:
    op.add_column("session", sa.Column("headset_check", sa.JSON))
