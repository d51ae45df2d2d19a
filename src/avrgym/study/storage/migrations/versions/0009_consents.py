"""An archive of consent texts, and every decision about one; the consents of earlier versions become its first rows."""

import sqlalchemy as sa
from alembic import op

from avrgym.study.storage import hash_chain, schema

revision = "0009_consents"
down_revision = "0008_log"

_COLUMNS = ("number", "language", "consented_at", "consent_version", "consent_sha256")


def upgrade() -> None:
    op.create_table(
        "consent_text",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("sha256", sa.String, nullable=False),
        sa.Column("version", sa.String, nullable=False),
        sa.Column("language", sa.String, nullable=False),
        sa.Column("text", sa.String, nullable=False),
        sa.Column("salt", sa.String),
    )
    op.create_table(
        "consent",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("participant", sa.Integer, sa.ForeignKey("participant.number"), nullable=False),
        sa.Column("agreed", sa.Boolean, nullable=False),
        sa.Column("version", sa.String),
        sa.Column("language", sa.String),
        sa.Column("sha256", sa.String),
        sa.Column("salt", sa.String),
    )
    _keep_earlier_consents()


def _keep_earlier_consents() -> None:
    connection = op.get_bind()
    people = sa.table("participant", *map(sa.column, _COLUMNS))
    given = sa.select(people).where(people.c.consented_at.is_not(None)).order_by(people.c.consented_at)
    for person in connection.execute(given).all():
        hash_chain.insert(
            connection,
            schema.CONSENT,
            at=person.consented_at,
            participant=person.number,
            agreed=True,
            version=person.consent_version,
            language=person.language,
            sha256=person.consent_sha256,
        )
