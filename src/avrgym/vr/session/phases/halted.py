"""The phases in which nothing goes on by itself."""

from __future__ import annotations

from typing import Self

from avrgym.vr.session import phases
from avrgym.vr.session.phases.kinds import Resting
from avrgym.vr.session.phases.phase import Phase
from avrgym.vr.session.state import SessionState


class Paused(Resting):
    """The robot holds still until the participant presses the trigger, or the experimenter goes on."""

    name = "paused"

    def __init__(self, state: SessionState, text: str) -> None:
        super().__init__(state)
        self.text = text

    def ready(self) -> phases.Begins | Self:
        if self.state.on_hold:
            return self._refuse("the experimenter has paused the session and will continue it")
        return super().ready()

    def go_on(self) -> phases.Begins | Self:
        held = self.state.on_hold
        super().go_on()
        return self._begin_trial() if held else self


class RecordingFailed(Paused):
    """An attempt could not be stored, and can be repeated."""

    def __init__(self, state: SessionState) -> None:
        text = "The recording failed: the robot holds still. Press the trigger to try again."
        super().__init__(state, text)

    def entered(self) -> None:
        self.state.storage.give_up()


class Finished(Phase):
    """The session is over; nothing leads out of here."""

    name = "finished"

    def __init__(self, state: SessionState, text: str) -> None:
        super().__init__(state)
        self.text = f"{text} Thank you! You may take off the headset."

    def entered(self) -> None:
        self.state.drivers.close()

    def pause(self) -> Self:
        """Nothing begins any more; whoever asks is told, unless the session is paused already."""
        return self if self.state.on_hold else self._refuse("the session is finished", "experimenter")

    def correct_torso_height(self, torso_height_m: float) -> Self:
        """Nobody has a body any more."""
        return self._refuse("the session is finished", "experimenter")
