"""The tables of a study's database. A new database is created from these definitions. Times are in ISO 8601, UTC.

Columns keep their names, because checksums of rows include them. ``key`` is the name in Python, where it differs.
"""

from datetime import UTC, datetime
from secrets import token_hex

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


def make_utc_timestamp() -> str:
    """Returns the current time in the stored format (ISO 8601, UTC)."""
    return datetime.now(UTC).isoformat(timespec="microseconds")


def make_salt() -> str:
    """Returns a random salt for a row. Without a salt, the row's contents could be guessed from its checksum."""
    return token_hex(16)


def _salt() -> Column[str]:
    return Column("salt", String, default=make_salt)


STUDY_TABLE = Table(
    "study",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("created_at", String, nullable=False),
    Column("protocol", JSON, nullable=False),
    _salt(),
)
"""One row: the design fields that determine trial orders. They must not change after the first allocation."""

PARTICIPANT_TABLE = Table(
    "participant",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("state", String, nullable=False),
    Column("simulated", Boolean, nullable=False),
    Column("site", String),
    Column("site_number", Integer),
    Column("sex", String, nullable=False),
    Column("age_years", Integer),
    Column("language", String),
    Column("cell", Integer),
    Column("enrolled_at", String, nullable=False),
    Column("consented_at", String),
    Column("consent_version", String),
    Column("consent_sha256", String),
    Column("inclusion", JSON),
    Column("functioning", JSON(none_as_null=True)),
    Column("input_profile", JSON(none_as_null=True)),
    Column("respondent", String),
    _salt(),
)
"""Participants, see ``database_rows.Participant``.

``functioning``: answers about disability, diagnosis and assistive devices. ``input_profile``: input devices and
actions, see ``recording.input_profile``. ``respondent``: ``proxy`` if a proxy answers the questionnaires.
``language``: language of the texts. ``site_number``: participant number at the site, in a merged study.
"""

SESSION_TABLE = Table(
    "session",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("state", String, nullable=False),
    Column("station", String, nullable=False),
    Column("process", Integer, key="process_id", nullable=False),
    Column("opened_at", String, nullable=False),
    Column("closed_at", String),
    Column("headset_check", JSON(none_as_null=True)),
    _salt(),
    UniqueConstraint("participant", "number"),
)
"""Sessions. ``headset_check``: results of the latest headset check, in the format of ``vr.headset_check``."""

DESIGN_TABLE = Table(
    "design",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("session", Integer, ForeignKey("session.id")),
    Column("stored_at", String, nullable=False),
    Column("design", JSON, nullable=False),
    Column("wordings", JSON, nullable=False),
    _salt(),
)
"""The design at the start of a session, or at the inclusion of a participant (``session`` is null).

``wordings`` contains the texts that participants read in each language, see ``design.design_comparison``.
"""

TRIAL_TABLE = Table(
    "trial",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("position", Integer, nullable=False),
    Column("environment", String, nullable=False),
    Column("policy", String, nullable=False),
    Column("seed", BigInteger, nullable=False),
    Column("practice", Boolean, nullable=False),
    Column("state", String, nullable=False),
    _salt(),
    UniqueConstraint("participant", "position"),
)

ATTEMPT_TABLE = Table(
    "attempt",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("trial", Integer, ForeignKey("trial.id"), nullable=False),
    Column("session", Integer, ForeignKey("session.id"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("state", String, nullable=False),
    Column("recording", String, nullable=False, unique=True),
    Column("sha256", String),
    Column("figures", JSON, key="metrics", nullable=False),
    Column("torso_height_m", Float),
    Column("input_profile", JSON(none_as_null=True)),
    Column("started_at", String, nullable=False),
    Column("ended_at", String),
    _salt(),
    UniqueConstraint("trial", "number"),
)
"""Attempts at trials. ``recording``: path relative to the study's folder, with ``/``.

``torso_height_m``: torso height of the simulated body. ``input_profile``: the participant's input profile at the start
of the attempt.
"""

ANSWER_TABLE = Table(
    "answer",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("session", Integer, ForeignKey("session.id"), nullable=False),
    Column("attempt", Integer, ForeignKey("attempt.id")),
    Column("item", String, nullable=False),
    Column("value", Integer, nullable=False),
    Column("response_time_s", Float, nullable=False),
    Column("answered_at", String, nullable=False),
    Column("respondent", String),
    _salt(),
    UniqueConstraint("attempt", "item"),
)
"""Answers to items. An answer without an attempt is about the whole session.

``respondent``: ``proxy`` or ``caregiver``; null for the participant.
"""

EVENT_TABLE = Table(
    "event",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, key="recorded_at", nullable=False),
    Column("participant", Integer, ForeignKey("participant.number")),
    Column("session", Integer, ForeignKey("session.id")),
    Column("attempt", Integer, ForeignKey("attempt.id")),
    Column("name", String, nullable=False),
    Column("detail", String, nullable=False),
    _salt(),
)

NOTE_TABLE = Table(
    "note",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, key="written_at", nullable=False),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("session", Integer, ForeignKey("session.id")),
    Column("text", String, nullable=False),
    _salt(),
)

ADVERSE_EVENT_TABLE = Table(
    "adverse_event",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("recorded_at", String, nullable=False),
    Column("recorded_by", String),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("trial", Integer, ForeignKey("trial.id")),
    Column("follows", Integer, ForeignKey("adverse_event.id")),
    Column("began_at", String, nullable=False),
    Column("description", String, nullable=False),
    Column("severity", String, nullable=False),
    Column("seriousness", String, nullable=False),
    Column("relatedness", String, nullable=False),
    Column("action", String, nullable=False),
    Column("outcome", String, nullable=False),
    _salt(),
)
"""Reports of adverse events. ``follows`` is the id of the first report of the same event."""

CONSENT_TEXT_TABLE = Table(
    "consent_text",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, key="first_used_at", nullable=False),
    Column("sha256", String, nullable=False),
    Column("version", String, nullable=False),
    Column("language", String, nullable=False),
    Column("text", String, nullable=False),
    _salt(),
)
"""Consent texts that participants read. A text is stored at its first use and never changed."""

CONSENT_TABLE = Table(
    "consent",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("at", String, key="decided_at", nullable=False),
    Column("participant", Integer, ForeignKey("participant.number"), nullable=False),
    Column("agreed", Boolean, nullable=False),
    Column("version", String),
    Column("language", String),
    Column("sha256", String),
    Column("role", String),
    _salt(),
)
"""All decisions about consent texts, in order. ``sha256``: checksum of the text.

``role``: ``proxy`` for a representative's consent, ``assent`` for the participant's assent to it; null for the
participant's own consent.

The participant's row also contains the latest consent.
"""

SESSION_LINK_TABLE = Table(
    "link",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("session", Integer, ForeignKey("session.id"), nullable=False),
    Column("at", String, key="created_at", nullable=False),
    Column("sha256", String, nullable=False),
    Column("role", String),
    _salt(),
)
"""Checksums of session links. ``role``: ``caregiver``; null for the participant's link.

Only the latest link of an open session is valid for a participant.
"""

INVITATION_TABLE = Table(
    "invitation",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("created_at", String, nullable=False),
    Column("sha256", String, nullable=False),
    Column("label", String),
    Column("expires_at", String, nullable=False),
    Column("places", Integer, nullable=False),
    Column("closed_at", String),
    _salt(),
    UniqueConstraint("sha256"),
)
"""Invitations to a hosted study. ``sha256``: checksum of the link's token. ``places``: maximum number of participants;
1 for a single-use link. ``label``: a reference of the experimenter, without names."""

INVITATION_USE_TABLE = Table(
    "invitation_use",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("invitation", Integer, ForeignKey("invitation.id"), nullable=False),
    Column("participant", Integer, ForeignKey("participant.number")),
    Column("at", String, key="used_at", nullable=False),
    Column("sha256", String, nullable=False),
    Column("service_study", String),
    Column("service_session", String),
    _salt(),
    UniqueConstraint("sha256"),
)
"""Enrolments with an invitation. ``participant``: null after the participant's deletion. ``sha256``: checksum of the
participant's personal token.
``service_study`` and ``service_session``: the recruitment service's ids of its study and session."""

TOMBSTONE_TABLE = Table(
    "tombstone",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("simulated", Boolean, nullable=False),
    Column("deleted_at", String, nullable=False),
    _salt(),
)
"""Participants with deleted data. Their numbers are never used again."""

SITE_TABLE = Table(
    "site",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("name", String, nullable=False),
    Column("entries", Integer, key="num_entries", nullable=False),
    Column("digest", String, key="last_digest", nullable=False),
    _salt(),
    UniqueConstraint("name"),
)
"""Sites of a merged study, with the last entry of each site's hash chain at the latest merge."""

EXPERIMENTER_TABLE = Table(
    "experimenter",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("name", String, nullable=False),
    Column("token_sha256", String, nullable=False),
    Column("created_at", String, nullable=False),
    Column("revoked_at", String),
    _salt(),
    UniqueConstraint("token_sha256"),
)
"""Experimenters with personal tokens. Only checksums of tokens are stored."""

AUDIT_LOG_TABLE = Table(
    "log",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("at", String, key="recorded_at", nullable=False),
    Column("person", String, nullable=False),
    Column("known_by", String, key="identified_by", nullable=False),
    Column("name", String, key="action", nullable=False),
    Column("participant", Integer),
    Column("detail", String, nullable=False),
    Column("completed", Integer),
    Column("planned", Integer),
    _salt(),
)
"""The audit log: actions with person and time. Rows are never changed or deleted.

``completed`` and ``planned``: numbers of participants when the person viewed results.
"""

LEDGER_TABLE = Table(
    "ledger",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("table", String, nullable=False),
    Column("key", Integer, nullable=False),
    Column("content", String),
    Column("digest", String, nullable=False),
)
"""The hash chain. ``content``: checksum of a row; null after the row's deletion."""
