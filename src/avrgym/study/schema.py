"""The tables of a study. Times are ISO 8601 in UTC; migrations lead here from every earlier version."""

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    UniqueConstraint,
)

METADATA = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    }
)

STUDY = Table(
    "study",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("created_at", String, nullable=False),
    Column("protocol", JSON, nullable=False),
)
"""One row: the fields of the design that may not change."""

PARTICIPANT = Table(
    "participant",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("state", String, nullable=False),
    Column("simulated", Boolean, nullable=False),
    Column("sex", String, nullable=False),
    Column("age_years", Integer),
    Column("cell", Integer),
    Column("enrolled_at", String, nullable=False),
    Column("consented_at", String),
    Column("consent_version", String),
    Column("consent_sha256", String),
    Column("inclusion", JSON),
)

SESSION = Table(
    "session",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("participant", ForeignKey("participant.number"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("state", String, nullable=False),
    Column("station", String, nullable=False),
    Column("process", Integer, nullable=False),
    Column("opened_at", String, nullable=False),
    Column("closed_at", String),
    UniqueConstraint("participant", "number"),
)

TRIAL = Table(
    "trial",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("participant", ForeignKey("participant.number"), nullable=False),
    Column("position", Integer, nullable=False),
    Column("environment", String, nullable=False),
    Column("policy", String, nullable=False),
    Column("seed", BigInteger, nullable=False),
    Column("practice", Boolean, nullable=False),
    Column("state", String, nullable=False),
    UniqueConstraint("participant", "position"),
)

ATTEMPT = Table(
    "attempt",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("trial", ForeignKey("trial.id"), nullable=False),
    Column("session", ForeignKey("session.id"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("state", String, nullable=False),
    Column("recording", String, nullable=False, unique=True),
    Column("sha256", String),
    Column("figures", JSON, nullable=False),
    Column("started_at", String, nullable=False),
    Column("ended_at", String),
    UniqueConstraint("trial", "number"),
)
"""``recording`` is relative to the study's folder, with ``/``."""

ANSWER = Table(
    "answer",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("session", ForeignKey("session.id"), nullable=False),
    Column("attempt", ForeignKey("attempt.id")),
    Column("item", String, nullable=False),
    Column("value", Integer, nullable=False),
    Column("response_time_s", Float, nullable=False),
    Column("answered_at", String, nullable=False),
    UniqueConstraint("attempt", "item"),
)
"""Without an attempt: an answer about the whole session."""

EVENT = Table(
    "event",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, nullable=False),
    Column("participant", ForeignKey("participant.number")),
    Column("session", ForeignKey("session.id")),
    Column("attempt", ForeignKey("attempt.id")),
    Column("name", String, nullable=False),
    Column("detail", String, nullable=False),
)

NOTE = Table(
    "note",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, nullable=False),
    Column("participant", ForeignKey("participant.number"), nullable=False),
    Column("session", ForeignKey("session.id")),
    Column("text", String, nullable=False),
)

TOMBSTONE = Table(
    "tombstone",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("simulated", Boolean, nullable=False),
    Column("deleted_at", String, nullable=False),
)
"""A participant whose data were deleted; their number is never given again."""
