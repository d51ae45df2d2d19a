"""Attempts and answers of a study with participant, session and trial, for all export formats."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import NumpyArray
from avrgym.models.cameras import list_image_formats, parse_cameras
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.recording.reader import (
    Recording,
    RecordingError,
    read_header,
    read_recording,
)
from avrgym.recording.recorded_world import render_recorded_images
from avrgym.recording.schema import Control
from avrgym.robots.registry import find_robot
from avrgym.study.export.table_rows import AnswerIdentifiers, AnswerRow, AttemptIdentifiers
from avrgym.study.storage.answers import find_answer_moments
from avrgym.study.storage.attempts import CHECKSUM_MISMATCH_MESSAGE, compute_recording_sha256
from avrgym.study.storage.database_rows import Participant, StudyAnswer, StudySession, Trial, TrialAttempt
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore


@dataclass(frozen=True)
class ExportedAttempt:
    """One attempt with its participant, session, trial and answers."""

    store: StudyStore
    participant: Participant
    session: StudySession
    trial: Trial
    attempt: TrialAttempt
    answers: tuple[StudyAnswer, ...]

    @property
    def scene_name(self) -> str:
        """Task and robot as one name, such as ``FeedingJaco``."""
        return self.trial.task + self.trial.robot

    def read_recording(self, *, undecoded: Collection[str] = ()) -> Recording:
        """Returns the recording up to its end or its first damage. Recordings are large and not cached.

        ``undecoded``: topics that remain JSON bytes, as in ``reader.read_recording``.
        """
        return read_recording(self.store.resolve_path(self.attempt.recording), undecoded=undecoded)

    def read_complete_recording(self) -> Recording:
        """Returns the recording, which must be complete and unchanged.

        Raises:
            StudyError: if the recording is missing, damaged or changed. The message begins with the recording's name.
        """
        name = self.attempt.recording
        if not self.store.resolve_path(name).is_file():
            raise StudyError(f"{name} {self._absence}")
        if self.is_recording_changed():
            raise StudyError(f"{name} {CHECKSUM_MISMATCH_MESSAGE}")
        try:
            recording = self.read_recording()
        except (OSError, RecordingError) as error:
            raise StudyError(f"{name} cannot be read: {error}") from error
        if not recording.is_complete:
            raise StudyError(f"{name} is incomplete; allowed: complete recordings")
        return recording

    def is_recording_changed(self) -> bool:
        """Returns whether the recording exists, but differs from the checksum at the end of the attempt."""
        return compute_recording_sha256(self.store, self.attempt.recording) not in (None, self.attempt.sha256)

    def read_torso_height_m(self) -> float:
        """Returns the torso height (m) of the participant's body model in this trial."""
        if self.attempt.torso_height_m is not None:
            return self.attempt.torso_height_m
        return read_header(
            self.store.resolve_path(self.attempt.recording)
        ).configuration.person.torso_height_m

    @property
    def _absence(self) -> str:
        here = self.participant.site_number is not None or self.session.station == self.store.station_name
        return "is missing" if here else f"is at another station; it was recorded at {self.session.station}"

    def read_control_steps(self) -> list[tuple[float, Control]]:
        """Returns time (s) and data of each control step. Raises the errors of ``read_complete_recording``."""
        return [
            (time_ns / 1e9, control)
            for time_ns, control in self.read_complete_recording().messages_by_topic["/control"]
        ]

    def render_images(self, cameras: Sequence[str]) -> dict[str, NumpyArray]:
        """Returns rendered camera images (steps, ...) at the start of each control step, by image name.

        The images are rendered from the recorded simulation states.

        Raises:
            StudyError: for a camera that the robot does not have, or if the states cannot be rendered.
            RuntimeError: if no graphics library can render on this computer.
        """
        if not cameras:
            return {}
        try:
            chosen = parse_cameras(cameras, find_robot(self.trial.robot))
            frames = [*render_recorded_images(self.read_complete_recording(), chosen)]
        except ValueError as error:
            raise StudyError(f"{self.attempt.recording}: {error}") from error
        return {name: np.stack([frame[name] for frame in frames]) for name in list_image_formats(chosen)}

    def make_identifiers(self) -> AttemptIdentifiers:
        """Returns the columns that identify this attempt in tables."""
        return AttemptIdentifiers(
            participant=self.participant.pseudonym,
            site=self.participant.site,
            simulated=self.participant.simulated,
            session=self.session.number,
            position=self.trial.position,
            practice=self.trial.practice,
            task=self.trial.task,
            robot=self.trial.robot,
            policy=self.trial.policy,
            attempt=self.attempt.number,
        )


def list_all_attempts(store: StudyStore) -> Iterator[ExportedAttempt]:
    """Yields all attempts of a study, ordered by participant and start time."""
    for participant in store.read_participants():
        yield from list_participant_attempts(store, participant)


def list_participant_attempts(store: StudyStore, participant: Participant) -> Iterator[ExportedAttempt]:
    """Yields all attempts of a participant, ordered by start time."""
    sessions = {session.id: session for session in store.read_sessions(participant.pseudonym)}
    trials = {trial.id: trial for trial in store.read_trials(participant.pseudonym)}
    answers = store.read_answers(participant.pseudonym)
    for attempt in store.read_attempts(participant.pseudonym):
        own = tuple(answer for answer in answers if answer.attempt == attempt.id)
        if attempt.trial not in trials:
            raise StudyError(f"{attempt} belongs to no trial of {participant}; run `avrgym study check`")
        session, trial = sessions[attempt.session], trials[attempt.trial]
        yield ExportedAttempt(store, participant, session, trial, attempt, own)


def list_completed_attempts(store: StudyStore) -> Iterator[ExportedAttempt]:
    """Yields all completed attempts of a study, ordered by participant and start time."""
    return (exported for exported in list_all_attempts(store) if exported.attempt.state == "completed")


@dataclass(frozen=True)
class ExportedAnswer:
    """One answer with its participant, session and attempt. An answer about a whole session has no attempt.

    ``stored_answer``: the answer in the database. ``moment``: one of ``QUESTION_MOMENTS``. ``item``: the item version
    that the participant read.
    """

    participant: Participant
    session: StudySession
    attempt: ExportedAttempt | None
    stored_answer: StudyAnswer
    moment: str
    questionnaire: Questionnaire
    item: Item

    def make_identifiers(self) -> AnswerIdentifiers:
        """Returns the columns that identify this answer in tables."""
        attempt = self.attempt
        return AnswerIdentifiers(
            participant=self.participant.pseudonym,
            site=self.participant.site,
            simulated=self.participant.simulated,
            session=self.session.number,
            position=attempt and attempt.trial.position,
            practice=attempt and attempt.trial.practice,
            task=attempt and attempt.trial.task,
            robot=attempt and attempt.trial.robot,
            policy=attempt and attempt.trial.policy,
            attempt=attempt and attempt.attempt.number,
            moment=self.moment,
            respondent=self.stored_answer.effective_respondent,
            questionnaire=self.questionnaire.name,
        )

    def to_row(self) -> AnswerRow:
        """Returns this answer as a row of the table ``answers``."""
        scale = self.questionnaire.find_response_scale(self.item)
        return AnswerRow(
            **vars(self.make_identifiers()),
            item=self.item.id,
            value=scale.compute_option_value(self.stored_answer.value),
            minimum=scale.lowest_value,
            maximum=scale.highest_value,
            points=scale.option_count,
            response_time_s=self.stored_answer.response_time_s,
            answered_at=self.stored_answer.answered_at,
        )


def list_participant_answers(
    store: StudyStore,
    participant: Participant,
    attempts: Iterable[ExportedAttempt],
    answered_items: AnsweredItems,
) -> list[ExportedAnswer]:
    """Returns all answers of a participant, in order. ``attempts``: at least all attempts of the participant."""
    by_id = {exported.attempt.id: exported for exported in attempts}
    sessions = {session.id: session for session in store.read_sessions(participant.pseudonym)}
    answers = store.read_answers(participant.pseudonym)
    moments = find_answer_moments(store.design, answers, store.read_session_events(participant.pseudonym))
    return [
        ExportedAnswer(
            participant,
            sessions[given.session],
            by_id.get(given.attempt or 0),
            given,
            moments[given.id],
            answered_items.find_questionnaire(given),
            answered_items.find_item(given),
        )
        for given in answers
    ]


@dataclass(frozen=True)
class OmittedAttempt:
    """A completed attempt whose recording cannot be exported. ``reason`` begins with the recording's name."""

    attempt: ExportedAttempt
    reason: str


def verify_attempts(
    attempts: Sequence[ExportedAttempt], progress: Callable[[int, int], None] = lambda done, all_: None
) -> tuple[list[ExportedAttempt], list[OmittedAttempt]]:
    """Returns the attempts with a complete, unchanged recording, and the attempts that cannot be exported.

    ``progress``: called with the number of recordings read and their total number.
    """
    sound: list[ExportedAttempt] = []
    left_out: list[OmittedAttempt] = []
    for number, exported in enumerate(attempts, start=1):
        try:
            exported.read_complete_recording()
            sound.append(exported)
        except StudyError as error:
            left_out.append(OmittedAttempt(exported, str(error)))
        progress(number, len(attempts))
    return sound, left_out


def group_by_scene(attempts: Iterable[ExportedAttempt]) -> dict[str, list[ExportedAttempt]]:
    """Returns the attempts by scene (task and robot). All observations of a scene have the same size."""
    found: dict[str, list[ExportedAttempt]] = {}
    for exported in attempts:
        found.setdefault(exported.scene_name, []).append(exported)
    return found
