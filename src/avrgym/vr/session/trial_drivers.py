"""The drivers of a session's trials. A driver computes the robot's actions, for example with a policy."""

from avrgym.policies.registry import find_used_plugins
from avrgym.system.used_plugins import UsedPlugin
from avrgym.vr.live_world.drivers import Driver, make_driver
from avrgym.vr.session.plan import SessionPolicies, TrialPlan


class TrialDrivers:
    """A driver for each policy of each environment.

    ``latest_failure``: message of the current driver's latest failure; empty without a failure.
    ``reported_failure_kinds``: failures that were already reported in this attempt, without details.
    """

    def __init__(self, policies: SessionPolicies, *, background: bool) -> None:
        """Create the drivers. External controllers run in the ``background``; otherwise the session waits for them."""
        self.latest_failure = ""
        self.reported_failure_kinds: set[str] = set()
        self._drivers = {key: make_driver(policy, background=background) for key, policy in policies.items()}
        self._plugins = {key: find_used_plugins(key[0], policy) for key, policy in policies.items()}

    def find_driver(self, trial: TrialPlan) -> Driver:
        """Returns the driver of a trial."""
        return self._drivers[trial.environment, trial.policy]

    def find_plugins(self, trial: TrialPlan) -> tuple[UsedPlugin, ...]:
        """Returns the plug-ins of a trial, with their versions at the session's start."""
        return self._plugins[trial.environment, trial.policy]

    def clear_failures(self) -> None:
        """Clear the failures of an earlier attempt."""
        self.latest_failure, self.reported_failure_kinds = "", set()

    def close(self) -> None:
        """Stop all drivers, and end their threads."""
        for driver in self._drivers.values():
            driver.close()
