"""Add the tables of invitations to hosted studies."""

import sqlalchemy as sa
from alembic import op

revision = "0014_invitations"
down_revision = "0013_caregivers"


def upgrade() -> None:
    op.create_table(
        "invitation",
        sa.Column("id", sa.Integer, primary_key=True),
        *_texts("created_at", "sha256"),
        sa.Column("label", sa.String),
        *_texts("expires_at"),
        sa.Column("places", sa.Integer, nullable=False),
        sa.Column("closed_at", sa.String),
        sa.Column("salt", sa.String),
        sa.UniqueConstraint("sha256"),
    )
    op.create_table(
        "invitation_use",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("invitation", sa.Integer, sa.ForeignKey("invitation.id"), nullable=False),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number")),
        *_texts("at", "sha256"),
        sa.Column("service_study", sa.String),
        sa.Column("service_session", sa.String),
        sa.Column("salt", sa.String),
        sa.UniqueConstraint("sha256"),
    )


def _texts(*names: str) -> list[sa.Column[str]]:
    return [sa.Column(name, sa.String, nullable=False) for name in names]
