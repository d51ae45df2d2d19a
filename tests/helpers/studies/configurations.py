"""Configurations of synthetic recordings."""

import dataclasses
from datetime import UTC, datetime
from typing import Any

from msgspec.structs import replace

from avrgym.models.human import JOINTS
from avrgym.recording.configuration import BodyModel, TrialConfiguration
from avrgym.recording.reader import Recording, read_header
from avrgym.study.design.design import Design
from avrgym.study.storage.database_rows import Trial
from avrgym.tasks.registry import TASKS, find_environment, find_plugins
from avrgym.vr.session.attempt import read_package_versions
from helpers.system.paths import OLD_RECORDING


def configuration(**changes: Any) -> TrialConfiguration:
    """Return a valid configuration of this version with changed fields."""
    return replace(
        read_header(OLD_RECORDING).configuration, **{"versions": read_package_versions()} | changes
    )


def made_recording(*messages: tuple[str, int, Any], **changes: Any) -> Recording:
    """Return a complete recording of messages (topic, log_time_ns, record)."""
    return Recording(configuration(**changes), None, list(messages), True, datetime(2026, 1, 1, tzinfo=UTC))


def with_configuration(recording: Recording, **changes: Any) -> Recording:
    """Return a recording with changed fields of its configuration."""
    return dataclasses.replace(recording, configuration=replace(recording.configuration, **changes))


def trial_configuration(
    design: Design, trial: Trial, *, simulated: bool, person: BodyModel, **changes: Any
) -> TrialConfiguration:
    """Return the configuration of a trial of a design."""
    task, _ = find_environment(trial.environment)
    values = {
        "versions": read_package_versions(),
        "environment": trial.environment,
        "policy": trial.policy,
        "seed": trial.seed,
        "practice": trial.practice,
        "goal": design.goals.get(task) or TASKS[task].goal_description,
        "trial_number": trial.position,
        "planned_steps": design.trial_steps,
        "simulated": simulated,
        "person": person,
        "joint_names": tuple(JOINTS),
        "force_guard": design.force_guard,
        "withdraw_after_success": design.withdraw_after_success,
        "free_movement_s": design.free_movement_s,
        "stop_rules": design.stop_rules,
        "furniture": design.furniture,
        "reward_weights": dict(TASKS[task].reward_weights),
        "items": () if trial.practice else design.list_items_at_moment("after_trial", trial.seed),
        "plugins": find_plugins(trial.environment),
    }
    return configuration(**values | changes)
