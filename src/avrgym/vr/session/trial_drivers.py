"""Who drives the robots of a session's trials."""

from avrgym.policies.registry import plugins_used
from avrgym.system.used_plugins import UsedPlugin
from avrgym.vr.live_world.drivers import Driver, make_driver
from avrgym.vr.session.plan import Policies, TrialPlan


class Drivers:
    """A driver for each policy of each environment. ``failure`` is what the current one was last heard to fail with."""

    def __init__(self, policies: Policies, *, background: bool) -> None:
        """Others' controllers run ``background`` the session's thread, or make it wait."""
        self.failure = ""
        self.kinds_told: set[str] = set()
        self._drivers = {key: make_driver(policy, background=background) for key, policy in policies.items()}
        self._plugins = {key: plugins_used(key[0], policy) for key, policy in policies.items()}

    def of(self, trial: TrialPlan) -> Driver:
        """Who drives in a trial."""
        return self._drivers[trial.environment, trial.policy]

    def plugins_in(self, trial: TrialPlan) -> tuple[UsedPlugin, ...]:
        """The plug-ins that a trial uses, as they were when the session began."""
        return self._plugins[trial.environment, trial.policy]

    def begin(self) -> None:
        """Forget what went wrong in an earlier attempt."""
        self.failure, self.kinds_told = "", set()

    def close(self) -> None:
        """Nobody drives any more."""
        for driver in self._drivers.values():
            driver.close()
