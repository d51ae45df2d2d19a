"""The phases in which the robot does not move and no time limit applies: pause, failed recording, end."""

from __future__ import annotations

from typing import Self

from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.session import events, phases
from avrgym.vr.session.interruptions import Interruption
from avrgym.vr.session.phases.base_phases import BetweenTrialsPhase
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.session_state import SessionState


class SessionPaused(BetweenTrialsPhase):
    """The robot does not move until the participant presses the trigger, or the experimenter continues."""

    name = "paused"

    def __init__(self, state: SessionState, message: ParticipantText) -> None:
        super().__init__(state)
        self.message = message

    def on_ready(self) -> phases.PhaseAtTrialStart | Self:
        if self.state.is_paused:
            return self._refuse("paused_by_experimenter")
        return super().on_ready()

    def resume(self) -> phases.PhaseAtTrialStart | Self:
        held = self.state.is_paused
        super().resume()
        return self._begin_trial() if held else self


class RecordingFailed(SessionPaused):
    """An attempt could not be stored, and can be repeated."""

    def __init__(self, state: SessionState) -> None:
        super().__init__(state, ParticipantText("recording_failed"))

    def on_enter(self) -> None:
        self.state.attempt_storage.discard_attempt()


class SessionFinished(Phase):
    """The session is over. This is the last phase."""

    name = "finished"

    def __init__(self, state: SessionState, message: ParticipantText) -> None:
        super().__init__(state)
        self.message = message

    def on_enter(self) -> None:
        self.state.drivers.close()
        self.state.report_headset_time()

    def request_break(self, by: events.Initiator) -> Self:
        """Reject the request, because the session is over."""
        return self._refuse("nothing_to_begin", by)

    def interrupt(self, interruption: Interruption) -> Self:
        """Ignore the interruption. The participant usually takes off the headset in this phase."""
        return self

    def pause(self) -> Self:
        """Reject the request, because the session is over."""
        return self if self.state.is_paused else self._report("the session is finished")

    def correct_torso_height(self, torso_height_m: float) -> Self:
        """Reject the request, because the session is over."""
        return self._report("the session is finished")
