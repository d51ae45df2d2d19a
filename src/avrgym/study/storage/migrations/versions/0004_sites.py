"""Where participants take part, and the studies that a study was merged from."""

import sqlalchemy as sa
from alembic import op

revision = "0004_sites"
down_revision = "0003_torso_height"


def upgrade() -> None:
    op.add_column("participant", sa.Column("site", sa.String))
    op.add_column("participant", sa.Column("site_number", sa.Integer))
    op.create_table(
        "site",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("entries", sa.Integer, nullable=False),
        sa.Column("digest", sa.String, nullable=False),
        sa.Column("salt", sa.String),
        sa.UniqueConstraint("name"),
    )
