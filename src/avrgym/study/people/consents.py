"""Consent decisions. A decision stores the checksum of the consent text, and an archive stores the text itself."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import msgspec
import sqlalchemy as sa

from avrgym.commands.respondents import PARTICIPANT_RESPONDENT
from avrgym.recording.configuration import RecordedConsent
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import ConsentRecord, ConsentText, Participant, format_pseudonym
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows
from avrgym.texts.interface_texts import InvalidTextsError, normalize_whitespace, read_texts


@dataclass(frozen=True)
class DisplayedConsentText:
    """The design's consent text in one language."""

    version: str
    language: str
    text: str

    @property
    def sha256(self) -> str:
        """SHA-256 of the text, as hexadecimal digits."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def find_consents_to_other_texts(
    shown: DisplayedConsentText,
    consents: Iterable[ConsentRecord],
    archive: Iterable[ConsentText],
    first_language: str,
) -> list[ConsentRecord]:
    """Returns the consents that have the version and language of ``shown``, but another text. White space is ignored.

    ``first_language``: the language of consents without a stored language.
    """
    same = {
        kept.sha256 for kept in archive if normalize_whitespace(kept.text) == normalize_whitespace(shown.text)
    }
    return [
        each
        for each in consents
        if (each.version, each.language or first_language) == (shown.version, shown.language)
        and each.sha256 not in (None, shown.sha256, *same)
    ]


def store_consent(
    connection: sa.Connection,
    participant: Participant,
    shown: DisplayedConsentText,
    first_language: str,
    role: str,
    *,
    agreed: bool,
) -> ConsentRecord:
    """Store a consent decision, and add a new text to the archive. Returns the stored decision.

    ``role``: one of ``CONSENT_ROLES``.

    Raises:
        StudyError: if a participant read another text with the same version and language.
    """
    archive = find_rows(connection, ConsentText)
    others = find_consents_to_other_texts(
        shown, find_rows(connection, ConsentRecord), archive, first_language
    )
    if others:
        raise StudyError(
            f"{format_consenting_pseudonyms(others)} read another consent text with version {shown.version} "
            f"({shown.language}): increase version under [consent] in study.toml, or restore their text"
        )
    at, sha256 = make_utc_timestamp(), _archived(connection, shown, archive)
    stored_role = None if role == PARTICIPANT_RESPONDENT else role
    row = {
        "decided_at": at,
        "agreed": agreed,
        "version": shown.version,
        "language": shown.language,
        "sha256": sha256,
    }
    key = hash_chain.insert_row(
        connection, schema.CONSENT_TABLE, participant=participant.number, role=stored_role, **row
    )
    return ConsentRecord(
        key, at, participant.number, agreed, shown.version, shown.language, sha256, stored_role
    )


def is_consent_complete(decision: ConsentRecord, others: Iterable[ConsentRecord]) -> bool:
    """Returns whether a decision, together with the participant's ``others``, permits participation.

    The consent of a proxy needs the participant's assent, and the assent needs the consent of a proxy.
    """
    missing = {"proxy": "assent", "assent": "proxy"}.get(decision.consenter_role)
    latest = [each for each in others if each.role == missing and each.version == decision.version]
    return decision.agreed and (missing is None or (bool(latest) and latest[-1].agreed))


def find_missing_consent_role(consents: Sequence[ConsentRecord], version: str) -> str:
    """Returns the role that is missing (``proxy`` or ``assent``) if only the other role agreed to a version.

    Returns an empty text in all other cases.
    """
    latest = {each.role: each.agreed for each in consents if each.version == version and each.role}
    given = [role for role, agreed in latest.items() if agreed]
    return {"proxy": "assent", "assent": "proxy"}[given[0]] if len(given) == 1 else ""


def describe_consent(consent: ConsentRecord) -> str:
    """Returns a decision as text, without its time."""
    who = {"proxy": "consent of a representative", "assent": "assent of the participant"}
    named = who.get(consent.consenter_role, "consent of the participant")
    return f"{named}, version {consent.version}: {'yes' if consent.agreed else 'no'}"


def find_latest_consent(
    consents: Iterable[ConsentRecord], *, of_proxy: bool = False
) -> RecordedConsent | None:
    """Returns the latest consent in the format of recordings; ``None`` without consent.

    ``of_proxy``: return the consent of a representative; otherwise the participant's own consent or assent.
    """
    agreed = [each for each in consents if each.agreed and (each.role == "proxy") is of_proxy]
    if not agreed:
        return None
    latest = agreed[-1]
    return RecordedConsent(latest.decided_at, latest.version, latest.language, latest.sha256, latest.role)


def restore_consents(
    store: StudyStore, connection: sa.Connection, participant_number: int, recorded: Iterable[RecordedConsent]
) -> None:
    """Insert a participant's recorded consents in order of time, and store the latest one in the participant's row.

    The design's text is archived if the participant agreed to it.
    """
    consents = {each.decided_at: each for each in recorded}
    for _, each in sorted(consents.items()):
        values = msgspec.structs.asdict(each)
        hash_chain.insert_row(
            connection, schema.CONSENT_TABLE, participant=participant_number, agreed=True, **values
        )
        row = {
            "consented_at": each.decided_at,
            "consent_version": each.version,
            "consent_sha256": each.sha256,
        }
        hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, participant_number, **row)
        shown = read_current_consent_text(store, each.language or "")
        if shown and (shown.version, shown.sha256) == (each.version, each.sha256):
            _archived(connection, shown, find_rows(connection, ConsentText))


def read_current_consent_text(store: StudyStore, language: str) -> DisplayedConsentText | None:
    """Returns the design's consent text in a language; ``None`` if the language has no texts."""
    consent = store.design.consent
    try:
        text = read_texts(language, store.folder).translate(consent.text)
    except InvalidTextsError:
        return None
    return DisplayedConsentText(consent.version, language, text)


def format_consenting_pseudonyms(consents: Iterable[ConsentRecord]) -> str:
    """Returns the pseudonyms of the participants with these consents, as text without duplicates."""
    return ", ".join(format_pseudonym(number) for number in sorted({each.participant for each in consents}))


def _archived(connection: sa.Connection, shown: DisplayedConsentText, archive: Iterable[ConsentText]) -> str:
    """Add the text to the archive if it is new. Returns the checksum of the archived text."""
    for kept in archive:
        same_use = (kept.version, kept.language) == (shown.version, shown.language)
        if same_use and normalize_whitespace(kept.text) == normalize_whitespace(shown.text):
            return kept.sha256
    row = {"version": shown.version, "language": shown.language, "text": shown.text}
    hash_chain.insert_row(
        connection, schema.CONSENT_TEXT_TABLE, first_used_at=make_utc_timestamp(), sha256=shown.sha256, **row
    )
    return shown.sha256
