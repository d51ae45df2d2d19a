"""Check that a study can run: policies can be loaded, and every body has valid initial states in every environment."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import product

from avrgym.policies.registry import AnyPolicy, find_used_plugins, resolve_session_policy
from avrgym.policies.trained_policies import PolicyError
from avrgym.study.checking.finding import Finding
from avrgym.study.storage.store import StudyStore
from avrgym.system.used_plugins import UsedPlugin
from avrgym.tasks.constants import make_environment_id
from avrgym.tasks.placement_check import count_samples_by_body
from avrgym.tasks.registry import ENVIRONMENTS, find_plugins
from avrgym.tasks.settings import Settings


def load_study_policy(store: StudyStore, environment: str, policy: str) -> AnyPolicy:
    """Returns a policy of the study's design for an environment.

    Raises:
        PolicyError: if the policy is missing, damaged, or trained for another environment.
    """
    design = store.design
    return resolve_session_policy(
        store.find_policy_source(environment, policy),
        environment,
        design.find_condition_settings(policy),
        allow_other_settings=design.allow_other_settings,
    )


def list_environment_policy_pairs(store: StudyStore) -> list[tuple[str, str]]:
    """Returns all pairs of environment and policy in the design's trials and practice trials."""
    design = store.design
    names = sorted({*design.policies, design.practice_policy} - {""})
    return [
        (make_environment_id(task, robot), name)
        for task, robot, name in product(design.tasks, design.robots, names)
    ]


def find_needed_plugins(store: StudyStore) -> tuple[UsedPlugin, ...]:
    """Returns the installed plug-ins that the design's trials and practice trials use."""
    found: set[UsedPlugin] = set()
    for environment, name in list_environment_policy_pairs(store):
        found |= {*find_plugins(environment)}
        with suppress(PolicyError):
            found |= {*find_used_plugins(environment, load_study_policy(store, environment, name))}
    return tuple(sorted(found, key=lambda plugin: plugin.label))


def find_policy_errors(store: StudyStore) -> Iterator[tuple[str, str]]:
    """Yields the name and error message of each policy that cannot be loaded."""
    for environment, name in list_environment_policy_pairs(store):
        try:
            load_study_policy(store, environment, name)
        except PolicyError as error:
            yield name, str(error)


def check_initial_states(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about environments without a valid initial state, or with too many rejected samples.

    The check samples a few initial states with the shortest and the tallest body that calibration accepts.
    """
    for task, robot in product(store.design.tasks, store.design.robots):
        environment = make_environment_id(task, robot)
        if environment in ENVIRONMENTS:
            for settings in {
                store.design.find_condition_settings(name): None for name in ("", *store.design.conditions)
            }:
                yield from _check_environment(environment, settings)


def _check_environment(environment: str, settings: Settings) -> Iterator[Finding]:
    try:
        drawn_starts = count_samples_by_body(environment, settings)
    except Exception as error:  # plug-ins may raise any exception
        yield Finding(environment, f"no initial state can be sampled: {type(error).__name__}: {error}")
        return
    for person, drawn in drawn_starts:
        if drawn.reset_error:
            yield Finding(environment, drawn.reset_error.removeprefix(f"{environment}: "))
        elif drawn.error_message:
            body = f"a {person.sex} with a torso of {person.torso_height_m:.2f} m"
            yield Finding(environment, f"next to {body} {drawn.error_message}", is_error=False)
