"""The policy files of a study, and the check that all sessions used the same files."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from avrgym.policies import controllers
from avrgym.policies.lerobot import is_lerobot_policy, lerobot_weights_file
from avrgym.policies.trained import PolicyError, packaged_policies
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.preflight import environment_policy_pairs
from avrgym.study.storage.rows import StudyEvent
from avrgym.study.storage.session_designs import (
    SessionDesign,
    describe_trials,
    is_accepted_site_difference,
    session_designs,
)
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.system import plugins

POLICIES_USED_EVENT = "policies used"
"""Name of the event that stores the policy files of a session."""


class PolicyFile(msgspec.Struct, frozen=True):
    """The file of a policy in an environment. ``sha256`` is ``None`` for a policy without a file."""

    environment: str
    policy: str
    source: str
    sha256: str | None


@dataclass(frozen=True)
class UsedPolicy:
    """A policy file, and the sessions that used it."""

    policy_file: PolicyFile
    sessions: list[SessionDesign]


def policy_files(store: Store) -> tuple[PolicyFile, ...]:
    """Returns the current file of each policy of the design."""
    return tuple(
        _policy_file(store, environment, name) for environment, name in environment_policy_pairs(store)
    )


def _policy_file(store: Store, environment: str, policy: str) -> PolicyFile:
    try:
        source, path = _source(store, environment, policy)
    except PolicyError:
        return PolicyFile(environment, policy, "missing", None)
    return PolicyFile(
        environment, policy, source, hashlib.sha256(path.read_bytes()).hexdigest() if path else None
    )


def _source(store: Store, environment: str, policy: str) -> tuple[str, Path | None]:
    """Returns the source of a policy as text, and the policy's file (``None`` without one).

    Raises ``PolicyError`` for a missing policy.
    """
    source = store.policy_source(environment, policy)
    packaged, plugin = packaged_policies(environment), controllers.registered_controllers().get(source)
    if source in packaged:
        return source, packaged[source]
    if plugin is not None:
        return plugins.describe_entry_point(plugin), controllers.python_controller_file(plugin.value)
    if Path(source).is_file():
        return Path(source).relative_to(store.folder).as_posix(), Path(source)
    if is_lerobot_policy(source):
        return source, lerobot_weights_file(source)
    return source, controllers.python_controller_file(source) if ":" in source else None


def used_policies(store: Store) -> dict[tuple[str, str], list[UsedPolicy]]:
    """Returns the policy files that sessions used, by environment and policy, in order of first use."""
    files = {event.session: _decoded(event) for event in store.events() if event.name == POLICIES_USED_EVENT}
    found: dict[tuple[str, str], list[UsedPolicy]] = {}
    for entry in session_designs(store):
        for file in files.get(entry.session.id, []):
            known = found.setdefault((file.environment, file.policy), [])
            same = [each for each in known if each.policy_file == file]
            if not same:
                known.append(UsedPolicy(file, []))
            (same or known[-1:])[0].sessions.append(entry)
    return found


def _decoded(event: StudyEvent) -> list[PolicyFile]:
    try:
        return msgspec.json.decode(event.detail, type=list[PolicyFile])
    except msgspec.DecodeError as error:
        raise StudyError(
            f"the study's database: event {event.id} is damaged: {error}; restore a backup"
        ) from error


def check_used_policies(store: Store) -> Iterator[Finding]:
    """Yields findings about policy files that differ between sessions, or that no session used."""
    used = used_policies(store)
    present = {(each.environment, each.policy): each for each in policy_files(store)} if used else {}
    for key, files in used.items():
        where = f"policy {key[1]}"
        if len(files) > 1:
            parts = [
                f"{policy_file_text(each.policy_file)} for {describe_trials(each.sessions)}" for each in files
            ]
            sessions = [entry for each in files for entry in each.sessions]
            is_error = not all(is_accepted_site_difference(store, each.sessions, sessions) for each in files)
            message = f"of {key[0]} was not the same in all sessions: {'; '.join(parts)}"
            yield Finding(where, message, is_error=is_error)
        now = present.get(key)
        if now is not None and now not in [each.policy_file for each in files]:
            yield Finding(
                where, f"of {key[0]} is {policy_file_text(now)}, which no session used", is_error=False
            )


def policy_file_text(file: PolicyFile) -> str:
    """Returns the source of a policy as text, with the first 12 digits of the file's SHA-256."""
    return file.source if file.sha256 is None else f"{file.source} (SHA-256 {file.sha256[:12]}…)"
