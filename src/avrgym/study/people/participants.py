"""Participants: enrolment, consent, inclusion, allocation, withdrawal and notes."""

from collections.abc import Mapping
from dataclasses import asdict

import msgspec
import sqlalchemy as sa

from avrgym.commands.respondents import CONSENT_ROLES, PARTICIPANT_RESPONDENT
from avrgym.models.human import SEXES, Sex
from avrgym.recording.configuration import RecordedConsent
from avrgym.recording.input_profile import InputProfile
from avrgym.study.design.allocation import (
    find_least_used_order_index,
    list_order_indices_for_site,
    plan_trials,
)
from avrgym.study.design.design import Design
from avrgym.study.design.toml_validation import NAME_PATTERN
from avrgym.study.people.consents import (
    DisplayedConsentText,
    is_consent_complete,
    restore_consents,
    store_consent,
)
from avrgym.study.people.identities import check_duplicate_enrolment
from avrgym.study.people.input_profiles import check_required_participant_arms
from avrgym.study.storage import hash_chain, identity_file, schema
from avrgym.study.storage.data_loss import PARTICIPATION_CONFIRMED_EVENT
from avrgym.study.storage.database_rows import (
    ConsentRecord,
    ExperimenterNote,
    Participant,
    StudySession,
    format_pseudonym,
)
from avrgym.study.storage.free_text import check_note, check_single_line
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.sessions import check_consent_version, end_open_sessions, has_completed_study
from avrgym.study.storage.state_transitions import (
    ALLOCATED_STATES,
    UNKNOWN_PARTICIPATION_STATE,
    StudyError,
    check_transition,
)
from avrgym.study.storage.store import (
    StudyStore,
    change_state,
    find_participant,
    find_rows,
    record_event,
    store_design,
)
from avrgym.study.storage.study_folder import find_used_participant_numbers
from avrgym.texts.interface_texts import InterfaceTexts, InvalidTextsError, read_texts

RECONSENT_EVENT = "participant consented again"
"""Name of the event of a consent to a new version of the text."""
CONSENT_INCOMPLETE_EVENT = "consent incomplete"
"""Name of the event of a proxy consent without assent, or of an assent without proxy consent."""


def enrol_participant(
    store: StudyStore,
    sex: Sex,
    *,
    age_years: int | None = None,
    language: str = "",
    name: str = "",
    contact: str = "",
    simulated: bool = False,
    site: str = "",
    confirm_duplicate: bool = False,
    input_profile: InputProfile | None = None,
) -> str:
    """Enrol a participant. Returns the new pseudonym. Only the identity file contains name and contact.

    Trial orders are balanced within each ``site``; default: the design's site. ``language``: language of the texts, one
    of the design's languages; default: the first. ``confirm_duplicate``: enrol the person although another participant
    has the same name or contact. ``input_profile``: how the person selects items and stops the robot; default: two
    controllers.

    Raises:
        PossibleDuplicateError: if the person may be enrolled already, unless ``confirm_duplicate``.
        StudyError: for an unknown body model or language, an impossible age, or an invalid name, contact or site. Also
            for a simulated participant with a name or contact, or if a task works on an absent arm of the profile.
        KeyUnavailableError: if a name or contact is given, and the key of the identity file is missing.
    """
    if sex not in SEXES:
        raise StudyError(f"unknown body model {sex!r}; allowed: {', '.join(SEXES)}")
    if age_years is not None and not 0 <= age_years <= 130:
        raise StudyError(f"age is {age_years} years; allowed: 0 to 130")
    languages = store.design.languages
    if language and language not in languages:
        raise StudyError(f"unknown language {language!r}; allowed in this study: {', '.join(languages)}")
    if simulated and (name or contact):
        raise StudyError("a simulated participant cannot have a name or contact; leave both empty")
    check_required_participant_arms(store.design, input_profile)
    _check_identity(name, contact)
    if site and not NAME_PATTERN.fullmatch(site):
        raise StudyError(f"{site!r} is not a valid site; allowed: at most 40 letters, digits, - and _")
    identity = identity_file.Identity(name, contact)
    with store.write_transaction() as connection:
        confirmation = check_duplicate_enrolment(store.folder, identity, confirmed=confirm_duplicate)
        if name or contact:
            identity_file.create_identity_file(store.folder)
        number = _next_number(store, connection)
        pseudonym = format_pseudonym(number)
        hash_chain.insert_row(
            connection,
            schema.PARTICIPANT_TABLE,
            number=number,
            state="enrolled",
            simulated=simulated,
            site=site or store.design.site or None,
            sex=sex,
            age_years=age_years,
            language=language or languages[0],
            input_profile=None if input_profile is None else msgspec.to_builtins(input_profile),
            enrolled_at=make_utc_timestamp(),
        )
        record_event(connection, "participant enrolled", confirmation, {"participant": number})
    if name or contact:
        with store.write_transaction():  # after the commit: a crash leaves no name without a participant
            identity_file.store_identity(store.folder, pseudonym, identity)
    return pseudonym


def set_identity(
    store: StudyStore, pseudonym: str, name: str, contact: str, *, confirm_duplicate: bool = False
) -> None:
    """Store name and contact of a participant in the identity file.

    Raises:
        PossibleDuplicateError: if another participant has the same name or contact, unless ``confirm_duplicate``.
        StudyError: for an invalid name or contact.
        KeyUnavailableError: if the key of the identity file is missing.
    """
    _check_identity(name, contact)
    identity = identity_file.Identity(name, contact)
    with store.write_transaction() as connection:  # the lock also protects the identity file
        number = find_participant(connection, pseudonym).number
        confirmation = check_duplicate_enrolment(
            store.folder, identity, confirmed=confirm_duplicate, pseudonym=pseudonym
        )
        if confirmation:
            record_event(connection, "identity corrected", confirmation, {"participant": number})
        identity_file.store_identity(store.folder, pseudonym, identity)


def read_participant_texts(store: StudyStore, participant: Participant) -> InterfaceTexts:
    """Returns the texts in the participant's language. Raises ``StudyError`` if this language has no texts."""
    try:
        return read_texts(participant.language or store.design.languages[0], store.folder)
    except InvalidTextsError as error:
        raise StudyError(str(error)) from None


def read_consent_text(store: StudyStore, participant: Participant) -> DisplayedConsentText:
    """Returns the design's consent text in the participant's language."""
    texts, consent = read_participant_texts(store, participant), store.design.consent
    return DisplayedConsentText(consent.version, texts.language, texts.translate(consent.text))


def record_consent(store: StudyStore, pseudonym: str, role: str = PARTICIPANT_RESPONDENT) -> bool:
    """Store a consent to the design's text in the participant's language.

    ``role``: one of ``CONSENT_ROLES``. A representative's consent and the participant's assent are two records, in any
    order. The consent is complete only with both. Returns whether the consent is complete.

    Re-consent to a new version changes neither state, order nor earlier consents.

    Raises:
        StudyError: if the state does not allow consent, or if a participant read another text with the same
            version.
    """
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        again = participant.must_reconsent(store.design.consent.version)
        if not again:
            check_transition("participant", pseudonym, participant.state, "consented")
        before = find_rows(connection, ConsentRecord, participant=participant.number)
        given = _store_consent(store, connection, participant, role, agreed=True)
        about, detail = {"participant": participant.number}, f"version {given.version}"
        if given.role is not None:
            detail = f"{given.role}, {detail}"
        if not is_consent_complete(given, before):
            record_event(connection, CONSENT_INCOMPLETE_EVENT, detail, about)
            return False
        values = {
            "consented_at": given.decided_at,
            "consent_version": given.version,
            "consent_sha256": given.sha256,
        }
        if again:
            hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, participant.number, **values)
            record_event(connection, RECONSENT_EVENT, detail, about)
        else:
            change_state(connection, participant, "consented", about, detail, **values)
    return True


def decline_consent(store: StudyStore, pseudonym: str, role: str = PARTICIPANT_RESPONDENT) -> None:
    """Store that a new version of the text, or the assent, is declined, and withdraw the participant.

    ``role``: one of ``CONSENT_ROLES``.

    Raises:
        StudyError: if no re-consent is necessary. A new participant can decline to assent without an error.
    """
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        dissents = role == "assent" and participant.state == "enrolled"
        if not dissents and not participant.must_reconsent(store.design.consent.version):
            raise StudyError(f"{pseudonym} needs no re-consent; use `avrgym study withdraw` for a withdrawal")
        declined = _store_consent(store, connection, participant, role, agreed=False)
        _withdraw(store, connection, participant, f"does not agree to version {declined.version}")


def _store_consent(
    store: StudyStore, connection: sa.Connection, participant: Participant, role: str, *, agreed: bool
) -> ConsentRecord:
    if role not in CONSENT_ROLES:
        raise StudyError(f"unknown role {role!r} of a consent; allowed: {', '.join(CONSENT_ROLES)}")
    shown = read_consent_text(store, participant)
    return store_consent(connection, participant, shown, store.design.languages[0], role, agreed=agreed)


def record_inclusion_answers(store: StudyStore, pseudonym: str, answers: Mapping[str, bool]) -> bool:
    """Store the answers to the inclusion questions. Then allocate the participant to a trial order, or exclude them.

    Returns:
        Whether the participant meets the inclusion criteria.

    Raises:
        StudyError: for missing or unknown answers, or without consent.
    """
    questions = {question.id: question.required for question in store.design.inclusion}
    if set(answers) != set(questions) or not all(type(answer) is bool for answer in answers.values()):
        raise StudyError(
            f"an answer is missing or unknown; allowed: true or false for each of {', '.join(questions)}"
        )
    fits = all(answers[question] == required for question, required in questions.items())
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        check_consent_version(store, participant)
        about, given = {"participant": participant.number}, dict(answers)
        if not fits:
            change_state(connection, participant, "excluded", about, inclusion=given)
            return False
        cell = _free_cell(connection, store.design, participant)
        change_state(connection, participant, "allocated", about, f"cell {cell}", cell=cell, inclusion=given)
        store_design(store, connection, about)
        _plan(connection, store.design, cell, participant)
    return True


def withdraw_participant(store: StudyStore, pseudonym: str, reason: str = "") -> None:
    """Withdraw a participant. A running trial stops, and open sessions end.

    Raises:
        StudyError: if the reason is too long, or if the state does not allow a withdrawal.
    """
    check_single_line("the reason", reason)
    with store.write_transaction() as connection:
        _withdraw(store, connection, find_participant(connection, pseudonym), reason)


def _withdraw(store: StudyStore, connection: sa.Connection, participant: Participant, reason: str) -> None:
    change_state(connection, participant, "withdrawn", {"participant": participant.number}, reason)
    end_open_sessions(store, connection, participant, attempts="stopped", sessions="closed")


def confirm_participation(store: StudyStore, pseudonym: str, evidence: str) -> str:
    """Store that a participant with unknown state consented and did not withdraw. Returns the new state.

    ``evidence``: text about the evidence, for example a signed form and its place.

    Raises:
        StudyError: for empty or too long evidence, or for a participant with a known state.
    """
    check_single_line("the evidence", evidence)
    if not evidence.strip():
        raise StudyError('evidence is empty; allowed: text such as "consent form of 3 May in folder 2"')
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        if participant.state != UNKNOWN_PARTICIPATION_STATE or participant.cell is None:
            order = "" if participant.cell is not None else " and has no trial order"
            raise StudyError(
                f"{participant} is {participant.state}{order}; allowed: a participant with unknown state and a "
                "trial order, after a rebuild of the database"
            )
        after = "completed" if has_completed_study(store, connection, participant) else "allocated"
        about = {"participant": participant.number}
        change_state(connection, participant, after, about)
        if participant.consented_at is None:
            restore_consents(
                store, connection, participant.number, [RecordedConsent(participant.enrolled_at)]
            )
        record_event(connection, PARTICIPATION_CONFIRMED_EVENT, evidence, about)
    return after


def add_note(store: StudyStore, pseudonym: str, text: str, session: int | None = None) -> None:
    """Store a note about a participant, or about one of their sessions. ``session``: the id of the session.

    Raises:
        StudyError: for an empty or too long note, or for a session of another participant.
    """
    check_note(text)
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        own = find_rows(connection, StudySession, participant=participant.number)
        if session is not None and session not in {visit.id for visit in own}:
            raise StudyError(
                f"session {session} is not a session of {participant}; the dashboard lists their sessions"
            )
        note = {
            "written_at": make_utc_timestamp(),
            "participant": participant.number,
            "session": session,
            "text": text,
        }
        hash_chain.insert_row(connection, schema.NOTE_TABLE, **note)


def edit_note(store: StudyStore, pseudonym: str, note_id: int, text: str) -> None:
    """Replace the text of a note. The earlier text is not stored, because it may contain a name.

    Raises:
        StudyError: for an empty or too long note, or for a note about another participant.
    """
    check_note(text)
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        if not find_rows(connection, ExperimenterNote, id=note_id, participant=participant.number):
            raise StudyError(f"{pseudonym} has no note {note_id}; the dashboard lists all notes")
        hash_chain.update_row(connection, schema.NOTE_TABLE, note_id, text=text)
        record_event(connection, "note changed", f"note {note_id}", {"participant": participant.number})


def _check_identity(name: str, contact: str) -> None:
    check_single_line("the name", name)
    check_single_line("the contact", contact)


def _next_number(store: StudyStore, connection: sa.Connection) -> int:
    """Returns the next participant number. It is not in the identity file, participation list or recordings."""
    taken = find_used_participant_numbers(store.folder)
    for table in (schema.PARTICIPANT_TABLE, schema.TOMBSTONE_TABLE):
        taken.add(connection.execute(sa.select(sa.func.max(table.c.number))).scalar() or 0)
    return max(taken) + 1


def _free_cell(connection: sa.Connection, design: Design, participant: Participant) -> int:
    """Returns the cell (index of a trial order) for a participant.

    People and simulated participants are balanced separately.
    """
    taken: dict[bool, list[int]] = {True: [], False: []}
    for other in find_rows(connection, Participant, simulated=participant.simulated):
        if other.state in ALLOCATED_STATES and other.cell is not None:
            taken[other.site == participant.site].append(other.cell)
    return find_least_used_order_index(
        list_order_indices_for_site(design, participant.site), taken[True], taken[False]
    )


def _plan(connection: sa.Connection, design: Design, cell: int, participant: Participant) -> None:
    number = participant.number
    for trial in plan_trials(design, cell, number, participant.site):
        hash_chain.insert_row(
            connection, schema.TRIAL_TABLE, **asdict(trial), participant=number, state="planned"
        )
