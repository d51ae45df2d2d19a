"""Whom the worlds of an environment may meet."""

from avrgym.networks.policy import PolicyError
from avrgym.people.populations import Population, find_populations
from avrgym.tasks.human_view import human_view_of
from avrgym.tasks.registry import TASKS


def find_company(name_or_path: str, environment_id: str) -> tuple[Population, ...]:
    """The kinds of people that ``--people`` names, for an environment.

    Raises:
        ValueError: for unknown people, naming what is allowed; for a damaged file, and for humans who were trained for
            another environment, or whose network is of another size.
    """
    kinds = find_populations(name_or_path, TASKS)
    for kind in kinds:
        if kind.trained is None:
            continue
        trained_for = kind.trained.metadata.environment
        if trained_for != environment_id:
            raise PolicyError(
                f"{kind.name}: a human trained for {trained_for}, not for {environment_id}; allowed: those of "
                f"`avrgym train {environment_id} --recipe pair`"
            )
        view, joints = human_view_of(environment_id)
        sizes = (kind.trained.observation_size, kind.trained.action_size)
        if sizes != (view.size, joints):
            raise PolicyError(
                f"{kind.name}: a human with {sizes[0]} observations and {sizes[1]} actions; {environment_id} has "
                f"{view.size} and {joints}"
            )
    return kinds
