"""Dataclasses for the rows of a study's database tables. Times are in ISO 8601, UTC."""

import re
from dataclasses import dataclass
from typing import Any

import msgspec

from avrgym.commands.respondents import PARTICIPANT_RESPONDENT
from avrgym.models.human import Sex
from avrgym.recording.configuration import HeadsetCheck
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.schema import Answer, Metrics
from avrgym.study.storage.state_transitions import StudyError
from avrgym.tasks.registry import find_environment

RECORDINGS_FOLDER = "recordings"
"""Folder of all recordings, relative to the study's folder."""


def format_pseudonym(number: int) -> str:
    """Returns the pseudonym of a participant number, such as ``sub-001``."""
    return f"sub-{number:03}"


def parse_participant_number(pseudonym: str) -> int:
    """Returns the participant number of a pseudonym. Raises ``StudyError`` for any other text."""
    if re.fullmatch(r"sub-[0-9]{3,9}", pseudonym):
        number = int(pseudonym.removeprefix("sub-"))
        if number > 0 and format_pseudonym(number) == pseudonym:
            return number
    raise StudyError(f"{pseudonym!r} is not a pseudonym; allowed: sub-001, sub-002 and so on")


@dataclass(frozen=True)
class Participant:
    """A participant of a study.

    ``cell``: index of the participant's trial order in the design. ``inclusion``: answers to the inclusion questions,
    by question id. ``functioning``: answers about disability and assistive devices. ``language``: language tag;
    ``None`` for the design's first language. ``site_number``: participant number at the site, in a merged study.
    ``input_profile``: ``None`` for two controllers. ``respondent``: one of ``RESPONDENTS``; ``None`` for the
    participant.
    """

    number: int
    state: str
    simulated: bool
    site: str | None
    site_number: int | None
    sex: Sex
    age_years: int | None
    language: str | None
    cell: int | None
    enrolled_at: str
    consented_at: str | None
    consent_version: str | None
    consent_sha256: str | None
    inclusion: dict[str, bool] | None
    functioning: dict[str, Any] | None
    input_profile: InputProfile | None
    respondent: str | None

    @property
    def pseudonym(self) -> str:
        """The participant's pseudonym, such as ``sub-001``."""
        return format_pseudonym(self.number)

    @property
    def effective_respondent(self) -> str:
        """The person who answers the participant's questionnaires: one of ``PARTICIPANT_RESPONDENTS``."""
        return self.respondent or PARTICIPANT_RESPONDENT

    def must_reconsent(self, version: str) -> bool:
        """Returns whether the participant must consent again, because the accepted consent text has another version."""
        return self.state in ("consented", "allocated") and self.consent_version not in (None, version)

    @property
    def pseudonym_at_site(self) -> str | None:
        """The participant's pseudonym at the site; ``None`` if the study is not merged from sites."""
        return None if self.site_number is None else format_pseudonym(self.site_number)

    def __str__(self) -> str:
        return self.pseudonym


@dataclass(frozen=True)
class StudySession:
    """A participant's session. ``station``: name of the computer. ``process_id``: id of the process that runs it."""

    id: int
    participant: int
    number: int
    state: str
    station: str
    process_id: int
    opened_at: str
    closed_at: str | None
    headset_check: dict[str, Any] | None

    @property
    def latest_headset_check(self) -> HeadsetCheck | None:
        """Result of the session's latest headset check; ``None`` before the first check."""
        return None if self.headset_check is None else msgspec.convert(self.headset_check, HeadsetCheck)

    @property
    def recordings_folder(self) -> str:
        """Folder of the session's recordings, relative to the study's folder."""
        return f"{RECORDINGS_FOLDER}/{format_pseudonym(self.participant)}/{self.name}"

    @property
    def name(self) -> str:
        """Name of the session, such as ``ses-01``."""
        return f"ses-{self.number:02}"

    def __str__(self) -> str:
        return f"{self.name} of {format_pseudonym(self.participant)}"


@dataclass(frozen=True)
class StoredDesign:
    """The design at the start of a session, or at the inclusion of a participant (``session`` is ``None``).

    ``wordings``: the texts that participants read, by language, kind and key.
    """

    id: int
    participant: int
    session: int | None
    stored_at: str
    design: dict[str, Any]
    wordings: dict[str, dict[str, dict[str, str]]]


@dataclass(frozen=True)
class Trial:
    """A planned trial. ``position``: number in the participant's trial order, from 1, with practice trials."""

    id: int
    participant: int
    position: int
    environment: str
    policy: str
    seed: int
    practice: bool
    state: str

    @property
    def task(self) -> str:
        """Name of the task."""
        return find_environment(self.environment)[0]

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return find_environment(self.environment)[1]

    def __str__(self) -> str:
        return f"trial {self.position} of {format_pseudonym(self.participant)}"


@dataclass(frozen=True)
class TrialAttempt:
    """An attempt at a trial.

    ``number``: number of the attempt at this trial, from 1. ``recording``: path of the recording, relative to the
    study's folder. ``sha256``: checksum of the closed recording. ``torso_height_m``: torso height of the simulated
    body; ``None`` if only the recording contains it.
    """

    id: int
    trial: int
    session: int
    number: int
    state: str
    recording: str
    sha256: str | None
    metrics: Metrics
    torso_height_m: float | None
    input_profile: InputProfile | None
    started_at: str
    ended_at: str | None

    def __str__(self) -> str:
        return self.recording.removeprefix(f"{RECORDINGS_FOLDER}/").removesuffix(".mcap")


class StudyAnswer(Answer, frozen=True):
    """A stored answer to a questionnaire item.

    ``attempt``: id of the attempt; ``None`` for an answer about a whole session. ``respondent``: one of
    ``RESPONDENTS``; ``None`` for the participant.
    """

    id: int
    session: int
    attempt: int | None
    answered_at: str
    respondent: str | None

    @property
    def effective_respondent(self) -> str:
        """The person who answered: one of ``RESPONDENTS``."""
        return self.respondent or PARTICIPANT_RESPONDENT


@dataclass(frozen=True)
class StudyEvent:
    """A stored event. ``recorded_at``: time of storage. ``participant``, ``session``, ``attempt``: ids, or ``None``."""

    id: int
    recorded_at: str
    participant: int | None
    session: int | None
    attempt: int | None
    name: str
    detail: str


@dataclass(frozen=True)
class ExperimenterNote:
    """A note of an experimenter about a participant. ``written_at``: time of the note."""

    id: int
    written_at: str
    participant: int
    session: int | None
    text: str


@dataclass(frozen=True)
class AdverseEventReport:
    """A report of an adverse event.

    ``began_at``: start of the event. ``recorded_at``: time of the report. ``follows``: id of the first report of the
    same event; ``None`` in the first report.
    """

    id: int
    recorded_at: str
    recorded_by: str | None
    participant: int
    trial: int | None
    follows: int | None
    began_at: str
    description: str
    severity: str
    seriousness: str
    relatedness: str
    action: str
    outcome: str


@dataclass(frozen=True)
class ConsentText:
    """A consent text in one language. ``first_used_at``: time of its first use."""

    id: int
    first_used_at: str
    sha256: str
    version: str
    language: str
    text: str


@dataclass(frozen=True)
class ConsentRecord:
    """A decision about a consent text, by the participant or a representative.

    ``decided_at``: time of the decision. ``sha256``: checksum of the text. Fields that an earlier version of AVR Gym
    did not store are ``None``.
    """

    id: int
    decided_at: str
    participant: int
    agreed: bool
    version: str | None
    language: str | None
    sha256: str | None
    role: str | None

    @property
    def consenter_role(self) -> str:
        """Role of the person who decided: one of ``CONSENT_ROLES``."""
        return self.role or PARTICIPANT_RESPONDENT


@dataclass(frozen=True)
class StoredSessionLink:
    """Checksum of a link to a session. ``role``: ``caregiver``; ``None`` for the participant's link."""

    id: int
    session: int
    created_at: str
    sha256: str
    role: str | None


@dataclass(frozen=True)
class Invitation:
    """An invitation to a hosted study: the checksum of its token, and the number of participants that it admits."""

    id: int
    created_at: str
    sha256: str
    label: str | None
    expires_at: str
    places: int
    closed_at: str | None


@dataclass(frozen=True)
class InvitationUse:
    """An enrolment with an invitation. ``participant``: ``None`` after the participant's deletion.

    ``sha256``: checksum of the participant's personal token.
    """

    id: int
    invitation: int
    participant: int | None
    used_at: str
    sha256: str
    service_study: str | None
    service_session: str | None


@dataclass(frozen=True)
class Site:
    """A site of a merged study.

    ``num_entries`` and ``last_digest``: number and digest of the last entry in the site's hash chain at the latest
    merge.
    """

    number: int
    name: str
    num_entries: int
    last_digest: str


@dataclass(frozen=True)
class DeletedParticipant:
    """A participant whose data were deleted: number, day of deletion, and whether the participant was simulated."""

    number: int
    simulated: bool
    deleted_at: str


@dataclass(frozen=True)
class Experimenter:
    """An experimenter with a personal token. Only the token's checksum is stored."""

    id: int
    name: str
    token_sha256: str
    created_at: str
    revoked_at: str | None


@dataclass(frozen=True)
class AuditLogEntry:
    """An entry of the audit log: an action, or the view of data.

    ``action``: the action. ``person``: name of the person. ``identified_by``: one of ``IDENTIFICATION_METHODS``.
    ``completed`` and ``planned``: numbers of participants when the person viewed results.
    """

    id: int
    recorded_at: str
    person: str
    identified_by: str
    action: str
    participant: int | None
    detail: str
    completed: int | None
    planned: int | None
