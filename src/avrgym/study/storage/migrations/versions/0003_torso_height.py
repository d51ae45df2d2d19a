"""The torso height of the body that an attempt was run with; of earlier attempts only the recordings tell it."""

import sqlalchemy as sa
from alembic import op

revision = "0003_torso_height"
down_revision = "0002_ledger"


def upgrade() -> None:
    op.add_column("attempt", sa.Column("torso_height_m", sa.Float))
