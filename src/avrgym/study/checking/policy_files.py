"""The policy files of a study, and the check that all sessions used the same files."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from avrgym.policies import controllers
from avrgym.policies.lerobot import find_weights_file, is_lerobot_policy
from avrgym.policies.trained_policies import PolicyError, find_packaged_policies
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.preflight import list_environment_policy_pairs
from avrgym.study.storage.database_rows import StudyEvent
from avrgym.study.storage.session_designs import (
    SessionDesign,
    describe_trials,
    is_accepted_site_difference,
    read_session_designs,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
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
    session_designs: list[SessionDesign]


def find_policy_files(store: StudyStore) -> tuple[PolicyFile, ...]:
    """Returns the current file of each policy of the design."""
    return tuple(
        _policy_file(store, environment, name) for environment, name in list_environment_policy_pairs(store)
    )


def _policy_file(store: StudyStore, environment: str, policy: str) -> PolicyFile:
    try:
        source, path = _source(store, environment, policy)
    except PolicyError:
        return PolicyFile(environment, policy, "missing", None)
    return PolicyFile(
        environment, policy, source, hashlib.sha256(path.read_bytes()).hexdigest() if path else None
    )


def _source(store: StudyStore, environment: str, policy: str) -> tuple[str, Path | None]:
    """Returns the source of a policy as text, and the policy's file (``None`` without one).

    Raises ``PolicyError`` for a missing policy.
    """
    source = store.find_policy_source(environment, policy)
    packaged, plugin = (
        find_packaged_policies(environment),
        controllers.find_registered_controllers().get(source),
    )
    if source in packaged:
        return source, packaged[source]
    if plugin is not None:
        return plugins.describe_entry_point(plugin), controllers.find_python_controller_file(plugin.value)
    if Path(source).is_file():
        return Path(source).relative_to(store.folder).as_posix(), Path(source)
    if is_lerobot_policy(source):
        return source, find_weights_file(source)
    return source, controllers.find_python_controller_file(source) if ":" in source else None


def find_used_policies(store: StudyStore) -> dict[tuple[str, str], list[UsedPolicy]]:
    """Returns the policy files that sessions used, by environment and policy, in order of first use."""
    files = {
        event.session: _decoded(event) for event in store.read_events() if event.name == POLICIES_USED_EVENT
    }
    found: dict[tuple[str, str], list[UsedPolicy]] = {}
    for entry in read_session_designs(store):
        for file in files.get(entry.session.id, []):
            known = found.setdefault((file.environment, file.policy), [])
            same = [each for each in known if each.policy_file == file]
            if not same:
                known.append(UsedPolicy(file, []))
            (same or known[-1:])[0].session_designs.append(entry)
    return found


def _decoded(event: StudyEvent) -> list[PolicyFile]:
    try:
        return msgspec.json.decode(event.detail, type=list[PolicyFile])
    except msgspec.DecodeError as error:
        raise StudyError(
            f"the study's database: event {event.id} is damaged: {error}; restore a backup"
        ) from error


def check_used_policies(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about policy files that differ between sessions, or that no session used."""
    used = find_used_policies(store)
    present = {(each.environment, each.policy): each for each in find_policy_files(store)} if used else {}
    for key, files in used.items():
        where = f"policy {key[1]}"
        if len(files) > 1:
            parts = [
                f"{format_policy_file(each.policy_file)} for {describe_trials(each.session_designs)}"
                for each in files
            ]
            sessions = [entry for each in files for entry in each.session_designs]
            is_error = not all(
                is_accepted_site_difference(store, each.session_designs, sessions) for each in files
            )
            message = f"of {key[0]} was not the same in all sessions: {'; '.join(parts)}"
            yield Finding(where, message, is_error=is_error)
        now = present.get(key)
        if now is not None and now not in [each.policy_file for each in files]:
            yield Finding(
                where, f"of {key[0]} is {format_policy_file(now)}, which no session used", is_error=False
            )


def format_policy_file(file: PolicyFile) -> str:
    """Returns the source of a policy as text, with the first 12 digits of the file's SHA-256."""
    return file.source if file.sha256 is None else f"{file.source} (SHA-256 {file.sha256[:12]}…)"
