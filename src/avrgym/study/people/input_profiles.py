"""Store input profiles: how a participant selects items and stops the robot."""

from collections.abc import Mapping
from itertools import product
from typing import Any

import msgspec

from avrgym.recording.input_profile import InputProfile, InputProfileError, parse_input_profile
from avrgym.study.design.design import Design
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, record_event
from avrgym.tasks.registry import describe_missing_arm


def make_input_profile(values: Mapping[str, Any]) -> InputProfile:
    """Returns the input profile with these values. Raises ``StudyError`` for invalid values or combinations."""
    try:
        return parse_input_profile(values)
    except InputProfileError as error:
        raise StudyError(str(error)) from None


def check_required_participant_arms(design: Design, profile: InputProfile | None) -> None:
    """Raise ``StudyError`` if a task of the design works on an absent arm of the profile."""
    conditions = [design.find_condition_settings(name) for name in design.policies]
    fault = describe_missing_arm(product(design.tasks, conditions), profile.absent_arms if profile else ())
    if fault:
        raise StudyError(fault)


def set_input_profile(
    store: StudyStore, pseudonym: str, profile: InputProfile, session: int | None = None
) -> None:
    """Store a participant's input profile. It replaces the earlier one. ``session``: the id of the running session.

    Raises:
        StudyError: for an unknown participant, or if a task of the study works on an absent arm.
    """
    check_required_participant_arms(store.design, profile)
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        values = msgspec.to_builtins(profile)
        hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, participant.number, input_profile=values)
        subject = {"participant": participant.number} | ({} if session is None else {"session": session})
        record_event(connection, "input changed", profile.describe(), subject)
