"""A policy drives the robot, and an operator takes over to correct it (interactive imitation learning)."""

from avrgym.array_types import FloatArray
from avrgym.policies.registry import AnyPolicy
from avrgym.tasks.episodes import Episodes
from avrgym.vr.live_world.drivers import OperatorDriver, RandomGenerators, make_driver
from avrgym.vr.protocol.messages import OperatorRole

RESUME_DELAY_S = 1.0
"""Time in seconds from a release to the policy's next action. In this time, an operator can open the clutch, move the
hand back and close the clutch again."""


class CorrectedDriver(OperatorDriver):
    """Drives the robot with a policy, or with the commands of an operator who takes over.

    The policy continues ``RESUME_DELAY_S`` seconds after the operator releases the robot. After ``stop_robot`` the
    robot holds its position until an operator drives and releases it, or until the next episode. The policy receives
    the observations of all control steps. Its memory therefore remains valid.
    """

    def __init__(self, policy: AnyPolicy, name: str, *, background: bool) -> None:
        """Create the driver of a policy. ``name``: the policy's name in recordings. ``background``: see
        ``make_driver``."""
        super().__init__()
        self._policy, self._name = make_driver(policy, background=background), name
        self._stopped, self._pause_steps, self._resume_steps = False, 0, 0

    @property
    def failure_message(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Message of the policy's current error; empty without an error."""
        return self._policy.failure_message

    @property
    def is_idle(self) -> bool:
        """Whether the robot holds its position because there is no action."""
        return self.active_operator is None and (self._is_paused or self._policy.is_idle)

    def reset(self, episodes: Episodes, generators: RandomGenerators) -> None:
        """Prepare for the episode that has just started."""
        super().reset(episodes, generators)
        self._policy.reset(episodes, generators)
        self._stopped, self._pause_steps = False, 0
        self._resume_steps = round(RESUME_DELAY_S * episodes.settings.control_hz)

    def stop_robot(self) -> None:
        """Stop the robot until an operator drives it."""
        super().stop_robot()
        self._stopped = True

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the action (1, A) of the operator who drives; without an operator, the action of the policy."""
        action = self._policy.act(observation)
        self._pause_steps = max(0, self._pause_steps - 1)
        if self.active_operator is not None or self._is_paused:
            return super().act(observation)
        self.latest_operator, self._changed = self._name, False
        return action

    def update_action(self) -> FloatArray | None:
        """Returns another action (1, A) at a later tick of the control step, or ``None`` to continue."""
        action = self._policy.update_action()
        if self.active_operator is not None or self._changed:
            return super().update_action()
        return None if self._is_paused else action

    def close(self) -> None:
        """Stop the robot, and end the policy's thread if it has one."""
        super().close()
        self._policy.close()

    def _leave(self, role: OperatorRole) -> None:
        releases = self.active_operator == role
        super()._leave(role)
        if releases:
            self._stopped, self._pause_steps = False, self._resume_steps + 1

    @property
    def _is_paused(self) -> bool:
        return self._stopped or self._pause_steps > 0
