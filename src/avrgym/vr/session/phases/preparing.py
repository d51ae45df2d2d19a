"""The phases before a trial: the participant puts on the headset, is measured, and looks whether all fits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self

from avrgym.models import human
from avrgym.simulation.room import NoRoomError
from avrgym.texts.texts import Said, SaidError
from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.phases.kinds import InVR, Ongoing, Resting
from avrgym.vr.session.state import SessionState
from avrgym.vr.tracking.calibration import measure_torso_height

_PUT_ON = Said("waiting")


class Waiting(Ongoing):
    """The participant is not in VR."""

    name = "waiting"
    can_choose_body = True

    def __init__(self, state: SessionState, says: Said = _PUT_ON) -> None:
        super().__init__(state)
        self.says = says

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Self:
        self.state.choose_body(choice, by)
        return self


class Calibration(InVR):
    """The participant rests where they sit or lie, and presses the trigger: their torso height is measured there."""

    name = "calibration"
    awaits_ready = can_choose_body = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        seated = state.world.scene_config.posture is human.SEATED
        self.says = Said("calibration_seated" if seated else "calibration_lying")
        state.tracking.forget_place()

    def take_tracking(self, tracking: messages.Tracking) -> None:
        """The first frame says where they are."""
        frame = self.state.tracking.take(tracking, self.state.now_s)
        if frame.usable and self.state.tracking.registration is None:
            assert tracking.head is not None
            self.state.tracking.place(tracking.head, self.state.person, self.state.world.scene_config.posture)
            self.state.tell_scene()

    def choose_body(self, choice: messages.ChooseBody, by: events.Who) -> Self:
        if self.state.choose_body(choice, by):
            self.state.tracking.place_again(self.state.person)
            self.state.tell_scene()
        return self

    def ready(self) -> LoadCheck | Self:
        """Seat the participant: height, place and direction from the last half second of tracking."""
        state = self.state
        measured, posture = not state.height_known, state.world.scene_config.posture
        try:
            head = state.tracking.steady_head(state.now_s)
            if measured:
                height_m = measure_torso_height(state.person.sex, posture, head, state.plan.furniture)
                state.give_torso_height(height_m)
        except SaidError as error:
            state.explain(error.said)
            return self
        state.calibrated_for = posture
        state.tracking.place(head, state.person, posture)
        state.sink.tell(events.Calibrated(state.now_s, state.person.torso_height_m, measured))
        return LoadCheck(state)


class Loading(InVR, ABC):
    """The current trial's world is made and shown."""

    name = "loading"
    says = Said("loading")

    def entered(self) -> None:
        self.state.worlds.prepare(self.state.trial, self.state.person)

    def wait(self) -> phases.Loaded | Self:
        """Put up the world that is waited for; go on when the client shows it."""
        state = self.state
        if not state.worlds.is_fresh(state.trial, state.person):
            state.worlds.prepare(state.trial, state.person)
            if not state.worlds.ready:
                return self
            try:
                state.worlds.change()
            except NoRoomError as error:
                state.report(f"the robot has no room to begin: {error}")
                return phases.Paused(state, Said("no_room"))
            except Exception as error:  # whatever a compiler or a file may raise
                state.report(f"the scene cannot be made: {error}")
                return phases.Paused(state, Said("scene_failed"))
        state.tell_scene()
        return self.loaded() if state.worlds.is_shown else self

    @abstractmethod
    def loaded(self) -> phases.Loaded:
        """What follows when the client shows the scene."""


class LoadTrial(Loading):
    """The trial begins when its world is shown."""

    def loaded(self) -> phases.Begins:
        return self._begin_trial()


class LoadCalibration(Loading):
    """The participant is measured when the seat or bed is shown."""

    def loaded(self) -> Calibration:
        return Calibration(self.state)


class LoadCheck(Loading):
    """The participant looks at their body when it is shown."""

    def loaded(self) -> Check:
        return Check(self.state)


class Storing(InVR):
    """A completed trial is being stored."""

    name = "loading"
    says = Said("storing")

    def wait(self) -> phases.Begins | Self:
        return self if self.state.storage.completing is not None else self._begin_trial()


class Check(Resting):
    """The participant looks whether body and seat fit."""

    name = "check"
    says = Said("check")


class AskReady(Resting):
    """The trial is shown, and begins when the participant is ready for it."""

    name = "ready"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.says = told_of_trial("ready", state)


def told_of_trial(key: str, state: SessionState) -> Said:
    """What is said of the trial that comes next: which it is, and what its task is."""
    plan, trial = state.plan, state.current
    number = {"trial": str(state.trial + 1), "trials": str(len(plan.trials))}
    which = plan.texts.say(Said("practice") if trial.practice else Said("trial", number))
    return Said(key, {"trial": which, "goal": plan.goal_of(trial)})
