"""The phases of a trial: from free movement to the questionnaire."""

from __future__ import annotations

from typing import Self

from avrgym.vr.protocol import messages
from avrgym.vr.session import events, phases
from avrgym.vr.session.phases.kinds import InPlace, Stoppable
from avrgym.vr.session.questions import Questions
from avrgym.vr.session.state import SessionState
from avrgym.vr.tracking.driving import Driver, Operator, in_world
from avrgym.vr.tracking.world import ControlStep


class FreeBefore(Stoppable):
    """The participant moves freely before the robot does."""

    name = "free_before"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        plan, trial = state.plan, state.current
        kind = "Practice" if trial.practice else f"Trial {state.trial + 1} of {len(plan.trials)}"
        self.text = (
            f"{kind}: {plan.goal_of(trial)} Move your head and arms as you like; the robot holds still."
        )
        self.seconds = plan.free_movement_s

    def time_over(self) -> Countdown:
        return Countdown(self.state)


class Countdown(Stoppable):
    """The robot is about to start; it waits for a participant whose tracking is lost."""

    name = "countdown"
    text = "The robot starts in"

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.countdown_s

    def time_over(self) -> Trial | Self:
        if self.state.tracking.lost:
            return self
        self.state.worlds.use_up()
        return Trial(self.state)


class Trial(Stoppable):
    """The robot drives."""

    name = "trial"
    text = "The robot is helping you. Press a menu button to stop it."

    @property
    def driver(self) -> Driver:
        return self.state.driver

    def drive(self, wish: messages.Drive) -> None:
        if not isinstance(self.driver, Operator):
            self._refuse("in this trial nobody drives by hand", "experimenter")
        elif wish.engaged:
            self.driver.drive(in_world(wish.linear), in_world(wish.angular), self.state.now_s)
        else:
            self.driver.let_go()

    def finish_step(self, step: ControlStep) -> Retreat | Self:
        attempt = self.state.storage.attempt
        assert attempt is not None
        attempt.record_step(step, self.state.current.policy, self.driver.idle, self.state.now_s)
        if attempt.steps < self.state.plan.trial_steps:
            return self
        return Retreat(self.state)


class Retreat(InPlace):
    """The robot takes its tool away from the person; what the trial gave is kept, whatever happens now."""

    name = "retreat"
    text = "The robot has finished and moves away from you. Press a menu button to stop it."
    moves = can_be_stopped = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        state.world.retreat()

    def wait(self) -> FreeAfter | Self:
        return self if self.state.world.retreating else self._hold()

    def stop(self, by: events.Who) -> FreeAfter:
        self.state.record_event("retreat_stopped", by)
        self.state.sink.tell(events.Stopped(self.state.now_s, by))
        return self._hold()

    def pause(self) -> FreeAfter:
        super().pause()
        return self._hold()

    def lose_time(self, seconds: float) -> FreeAfter:
        super().lose_time(seconds)
        return self._hold()

    def lose_tracking(self) -> FreeAfter:
        return self._hold()

    def _hold(self) -> FreeAfter:
        self.state.world.hold()
        return FreeAfter(self.state)


class FreeAfter(InPlace):
    """The participant moves freely after the robot has finished; what it gave is kept. The next world is made."""

    name = "free_after"
    text = "The robot has finished and holds still. Move as you like."
    moves = True

    def __init__(self, state: SessionState) -> None:
        super().__init__(state)
        self.seconds = state.plan.free_movement_s

    def entered(self) -> None:
        upcoming = self.state.trial + 1
        if upcoming == len(self.state.plan.trials):
            return
        self.state.worlds.prepare(upcoming, self.state.person)
        url = self.state.worlds.upcoming(upcoming, self.state.person)
        if url is not None:
            self.state.send(messages.Upcoming(url=url))

    def time_over(self) -> Questionnaire | phases.Begins | phases.Finished:
        items = self.state.plan.items_after(self.state.current)
        return Questionnaire(self.state, Questions(items)) if items else self._complete_trial()


class Questionnaire(InPlace):
    """The participant rates the trial, one item after another."""

    name = "questionnaire"
    text = "Point at your answer and press the trigger."

    def __init__(self, state: SessionState, questions: Questions) -> None:
        super().__init__(state)
        self._questions = questions

    @property
    def question(self) -> messages.Question:
        return self._questions.question()

    def answer(self, answer: messages.Answer) -> phases.Begins | phases.Finished | Self:
        """Take the answer to the question that is asked; after the last one the trial is complete."""
        attempt, now_s = self.state.storage.attempt, self.state.now_s
        if attempt is None:
            return self._refuse("an answer counts only while the questionnaire is open")
        try:
            given = self._questions.take(answer)
        except ValueError as error:
            self.state.problem(str(error))
            self.state.send(self.question)
            return self
        attempt.record("/answers", given, now_s)
        self.state.sink.tell(events.Answered(now_s, attempt.trial, attempt.number, given))
        verdict = self.state.plan.stop_rules.verdict(given)
        if verdict is not None:
            self.state.obey(verdict)
        if self._questions.done:
            return self._complete_trial()
        self.state.send(self.question)
        return self
