"""Records the attempts of a session and reports them to its observer. Only a stored attempt completes its trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from avrgym.recording import answers_file, schema
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.reader import RecordingError
from avrgym.recording.schema import AttemptEnd
from avrgym.vr.session import events
from avrgym.vr.session.attempt import Attempt, AttemptResults, ConfigurationFactory
from avrgym.vr.session.events import EventSink
from avrgym.vr.tracking.tracking_frames import ReceivedFrame
from avrgym.vr.tracking.tracking_state import TrackingUpdate


@dataclass(frozen=True)
class QuestionnaireAttempt:
    """The attempt with the open questionnaire: trial and attempt number, both from 1, and recording."""

    trial_number: int
    attempt_number: int
    recording: Path


class AttemptStorage:
    """Stores the attempts of a session. The observer of ``sink`` stores the events.

    ``attempt`` is the running attempt, ``recordings`` contains the files of all attempts. ``unstored_trial_index`` is
    the index of a completed trial that is not stored yet. ``has_storage_failed``: the last attempt could not be stored.
    ``questionnaire_attempt`` is the latest attempt. Answers may arrive after its end.
    """

    def __init__(self, folder: Path, sink: EventSink) -> None:
        """``folder`` is the folder of recordings; files are never overwritten."""
        self.attempt: Attempt | None = None
        self.recordings: list[Path] = []
        self.unstored_trial_index: int | None = None
        self.has_storage_failed = False
        self.questionnaire_attempt: QuestionnaireAttempt | None = None
        self._folder, self._sink = folder, sink
        self._latest: Attempt | None = None

    @property
    def attempt_results(self) -> AttemptResults:
        """Success, force and tool speed of the latest attempt until now."""
        return AttemptResults() if self._latest is None else self._latest.attempt_results

    def begin_attempt(
        self,
        trial: int,
        configure: ConfigurationFactory,
        first_number: int,
        now_s: float,
        input_profile: InputProfile,
    ) -> Attempt:
        """Start an attempt at a trial, see ``Attempt``. ``trial`` and ``first_number`` are numbered from 1.

        Raises:
            OSError: if no recording can be opened.
        """
        attempt = Attempt(self._folder, trial, configure, now_s, first_number=first_number)
        if self.has_storage_failed:
            self._sink.clear_storage_errors()
        self.attempt = self._latest = attempt
        self.questionnaire_attempt = QuestionnaireAttempt(
            attempt.trial_number, attempt.number, attempt.recording_file
        )
        self.has_storage_failed = False
        self.recordings.append(attempt.recording_file)
        self._sink.report(
            events.TrialBegun(
                now_s, attempt.trial_number, attempt.number, attempt.recording_file, input_profile
            )
        )
        return attempt

    def record_event(self, name: str, detail: str, now_s: float) -> None:
        """Record an event in the running attempt; without an attempt, do nothing."""
        if self.attempt is not None:
            self.attempt.record("/events", schema.Event(name, detail), now_s)

    def record_answer(self, answer: schema.Answer, now_s: float) -> None:
        """Record an answer in the running attempt. If it has ended, write to a file next to its recording.

        Raises:
            OSError: if that file cannot be written.
        """
        if self.attempt is not None:
            self.attempt.record("/answers", answer, now_s)
        elif self.questionnaire_attempt is not None:
            answers_file.append_answer(self.questionnaire_attempt.recording, answer)

    def end_attempt(
        self, result: AttemptEnd, arrived: Sequence[ReceivedFrame], now_s: float
    ) -> RecordingError | None:
        """End a running attempt. Returns the error that makes its recording incomplete; ``None`` without an error.

        ``arrived`` are the tracking frames that arrived since the last tick.
        """
        attempt, self.attempt = self.attempt, None
        if attempt is None:
            return None
        attempt.record_frames(TrackingUpdate(arrived))
        failure = attempt.close(result, now_s)
        sums = attempt.steps, attempt.total_reward, attempt.success
        whose = attempt.trial_number, attempt.number, attempt.recording_file
        ending = "failed" if result == "completed" and failure is not None else result
        self._sink.report(events.TrialEnded(now_s, *whose, ending, failure is None, *sums))
        return failure

    def pop_failure(self) -> Exception | None:
        """Returns the latest error of the observer and clears it; ``None`` without an error.

        Also returns ``None`` if a storage failure was already reported and no further data can be lost.
        """
        failure = self._sink.pop_storage_error()
        at_stake = self.attempt is not None or self.unstored_trial_index is not None
        return failure if at_stake or not self.has_storage_failed else None

    def discard_attempt(self) -> None:
        """Mark the attempt as not stored, and clear all errors. Nothing is stored until the next attempt begins."""
        self.unstored_trial_index, self.has_storage_failed = None, True
        self._sink.clear_storage_errors()
