"""Add the tables that 0.2.0 lacks, and copy each participant's consent into the consent table.

Development versions between 0.2.0 and this revision have some of the tables already.
"""

import sqlalchemy as sa
from alembic import op

from avrgym.study.storage import hash_chain, schema

revision = "0011_links"
down_revision = "0006_headset_check"

_CONSENT = ("number", "language", "consented_at", "consent_version", "consent_sha256")


def upgrade() -> None:
    tables = set(sa.inspect(op.get_bind()).get_table_names())
    if "adverse_event" not in tables:
        op.add_column("participant", sa.Column("functioning", sa.JSON))
        _create_adverse_events()
    if "log" not in tables:
        _create_log()
    if "consent" not in tables:
        _create_consents()
        _copy_consents()
    if "design" not in tables:
        op.create_table(
            "design",
            _id(),
            _reference("participant", "participant.number", nullable=False),
            _reference("session", "session.id"),
            *_texts("stored_at"),
            sa.Column("design", sa.JSON, nullable=False),
            sa.Column("wordings", sa.JSON, nullable=False),
            _salt(),
        )
    op.create_table(
        "link", _id(), _reference("session", "session.id", nullable=False), *_texts("at", "sha256"), _salt()
    )


def _create_adverse_events() -> None:
    op.create_table(
        "adverse_event",
        _id(),
        *_texts("recorded_at"),
        sa.Column("recorded_by", sa.String),
        _reference("participant", "participant.number", nullable=False),
        _reference("trial", "trial.id"),
        _reference("follows", "adverse_event.id"),
        *_texts("began_at", "description", "severity", "seriousness", "relatedness", "action", "outcome"),
        _salt(),
    )


def _create_log() -> None:
    op.create_table(
        "experimenter",
        _id(),
        *_texts("name", "token_sha256", "created_at"),
        sa.Column("revoked_at", sa.String),
        _salt(),
        sa.UniqueConstraint("token_sha256"),
    )
    op.create_table(
        "log",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        *_texts("at", "person", "known_by", "name"),
        sa.Column("participant", sa.Integer),
        *_texts("detail"),
        sa.Column("completed", sa.Integer),
        sa.Column("planned", sa.Integer),
        _salt(),
    )


def _create_consents() -> None:
    op.create_table("consent_text", _id(), *_texts("at", "sha256", "version", "language", "text"), _salt())
    op.create_table(
        "consent",
        _id(),
        *_texts("at"),
        _reference("participant", "participant.number", nullable=False),
        sa.Column("agreed", sa.Boolean, nullable=False),
        *(sa.Column(name, sa.String) for name in ("version", "language", "sha256")),
        _salt(),
    )


def _copy_consents() -> None:
    connection = op.get_bind()
    participants = sa.table("participant", *map(sa.column, _CONSENT))
    consented = sa.select(participants).where(participants.c.consented_at.is_not(None))
    for row in connection.execute(consented.order_by(participants.c.consented_at)).all():
        hash_chain.insert_row(
            connection,
            schema.CONSENT_TABLE,
            decided_at=row.consented_at,
            participant=row.number,
            agreed=True,
            version=row.consent_version,
            language=row.language,
            sha256=row.consent_sha256,
        )


def _id() -> sa.Column[int]:
    return sa.Column("id", sa.Integer, primary_key=True)


def _texts(*names: str) -> list[sa.Column[str]]:
    return [sa.Column(name, sa.String, nullable=False) for name in names]


def _reference(name: str, target: str, *, nullable: bool = True) -> sa.Column[int]:
    return sa.Column(name, sa.Integer, sa.ForeignKey(target), nullable=nullable)


def _salt() -> sa.Column[str]:
    return sa.Column("salt", sa.String)
