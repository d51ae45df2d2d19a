"""Check that all sessions used the design in the study's folder."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from avrgym.study.checking.finding import Finding
from avrgym.study.design.design import DESIGN_FILE, Design
from avrgym.study.design.design_comparison import (
    DesignTexts,
    find_value_differences,
    format_key_path,
    format_value,
    make_comparable_values,
    read_design_texts,
)
from avrgym.study.design.languages import list_participant_sentences
from avrgym.study.storage.database_rows import format_pseudonym
from avrgym.study.storage.session_designs import (
    SessionDesign,
    describe_trials,
    design_from_row,
    is_accepted_site_difference,
    read_designs_from_recordings,
    read_session_designs,
)
from avrgym.study.storage.store import StudyStore
from avrgym.system.toml_lines import ValuePath
from avrgym.texts.interface_texts import TEXTS_FOLDER, InvalidTextsError, normalize_whitespace

ADMISSION_FIELDS = ("inclusion", "order of inclusion")
"""Design fields that only affect the admission of participants."""
CONSENT_FIELD = "consent"
"""Design field of the consent text. ``check_consents`` compares it for each participant."""
FIELDS_WITHOUT_PARTICIPANT_EFFECT = ("title", "participants", "max_held_share", "max_repeats")
"""Design fields that do not affect participants. A different value is not an error."""


@dataclass(frozen=True)
class DesignDifference:
    """A value that differs between the current design and the design of sessions.

    ``key_path``: key path of the value. ``current_value``: value in the current design. ``session_value``: value in the
    design of ``session_designs``. A missing value is ``MISSING_VALUE``.
    """

    file_name: str
    key_path: ValuePath
    current_value: Any
    session_value: Any
    session_designs: list[SessionDesign]


def check_design(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about differences from the current design in sessions, admissions and recordings."""
    sessions = read_session_designs(store)
    for each in find_design_differences(store.design, _present_wordings(store), sessions):
        is_error = each.key_path[
            0
        ] not in FIELDS_WITHOUT_PARTICIPANT_EFFECT and not is_accepted_site_difference(
            store, each.session_designs, sessions
        )
        message = (
            f"{format_key_path(each.key_path)} is {format_value(each.current_value)}; it was "
            f"{format_value(each.session_value)} for"
        )
        yield Finding(
            each.file_name, f"{message} {describe_trials(each.session_designs, sessions)}", is_error=is_error
        )
    yield from _check_inclusion(store)
    yield from _check_recordings(store, sessions)


def check_stored_designs(store: StudyStore) -> Iterator[Finding]:
    """Yields a finding about sessions without a stored design, as in studies of AVR Gym 0.2."""
    sessions = read_session_designs(store)
    unknown = [entry for entry in sessions if entry.design_texts is None]
    if unknown:
        trials = describe_trials(unknown, sessions)
        message = f"does not contain the design of {trials}: only their recordings contain a part of it"
        yield Finding("database", message, is_error=False)


def find_design_differences(
    design: Design, wordings: DesignTexts | None, sessions: Sequence[SessionDesign]
) -> list[DesignDifference]:
    """Returns all differences between a design with its texts (``wordings``) and the designs of sessions."""
    found: dict[str, DesignDifference] = {}
    known: dict[bytes, list[DesignDifference]] = {}
    for entry in sessions:
        key = msgspec.json.encode([entry.design, entry.design_texts, entry.language], order="deterministic")
        if key not in known:
            known[key] = list(_differences(design, wordings, entry))
        for each in known[key]:
            name = f"{each.file_name} {each.key_path} {each.session_value!r}"
            found.setdefault(name, replace(each, session_designs=[])).session_designs.append(entry)
    return list(found.values())


def _differences(
    design: Design, wordings: DesignTexts | None, entry: SessionDesign
) -> Iterator[DesignDifference]:
    for place, here, there in find_value_differences(_of_sessions(design), _of_sessions(entry.design)):
        yield DesignDifference(DESIGN_FILE, place, here, there, [])
    if wordings is None or entry.design_texts is None:
        return
    language = entry.language
    for place, here, there in find_value_differences(
        wordings.get(language, {}), entry.design_texts.get(language, {})
    ):
        if place[0] != "sentences" or place[-1] in _both(design, entry.design):
            yield DesignDifference(f"{TEXTS_FOLDER}/{language}.toml", place, here, there, [])


def _of_sessions(design: Design) -> dict[str, Any]:
    """Returns the names and values of the design fields that affect sessions."""
    before = (*ADMISSION_FIELDS, CONSENT_FIELD)
    return {name: value for name, value in make_comparable_values(design).items() if name not in before}


def _both(a: Design, b: Design) -> set[str]:
    """Returns the sentences for participants that both designs contain."""
    first, second = (
        {normalize_whitespace(each) for each in list_participant_sentences(design)} for design in (a, b)
    )
    return first & second


def _present_wordings(store: StudyStore) -> DesignTexts | None:
    try:
        return read_design_texts(store.design, store.folder)
    except InvalidTextsError:
        return None


def _check_inclusion(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about differences between the current and the answered inclusion questions."""
    for (place, here, there), people in find_admission_differences(store, store.design, ADMISSION_FIELDS):
        message = f"{format_key_path(place)} is {format_value(here)}; it was {format_value(there)} for"
        yield Finding(DESIGN_FILE, f"{message} {', '.join(people)}")


def find_admission_differences(
    store: StudyStore, design: Design, fields: Sequence[str]
) -> list[tuple[tuple[ValuePath, Any, Any], list[str]]]:
    """Compare fields of a design with the design at each participant's admission.

    Returns:
        Each difference (key path, value in ``design``, value at admission), and the pseudonyms of its participants.
    """
    found: dict[str, tuple[tuple[ValuePath, Any, Any], list[str]]] = {}
    expected = {name: make_comparable_values(design)[name] for name in fields}
    for row in store.read_stored_designs():
        if row.session is None:
            asked = make_comparable_values(design_from_row(row))
            for change in find_value_differences(expected, {name: asked[name] for name in fields}):
                found.setdefault(repr(change), (change, []))[1].append(format_pseudonym(row.participant))
    return list(found.values())


def _check_recordings(store: StudyStore, sessions: Sequence[SessionDesign]) -> Iterator[Finding]:
    """Yields findings about differences between recordings and the stored design of their session.

    Different furniture is not an error; all other differences are errors.
    """
    stored = {entry.session.id: entry for entry in sessions if entry.design_texts is not None}
    for entry in read_designs_from_recordings(store):
        own = stored.get(entry.session.id)
        if own is None:
            continue
        for place, before, then in find_value_differences(
            _of_sessions(own.design), _of_sessions(entry.design)
        ):
            yield Finding(
                str(entry.session),
                f"was recorded with another {format_key_path(place)} than its design has: {format_value(then)} "
                f"instead of "
                f"{format_value(before)}, for {describe_trials([entry])}",
                is_error=place[0] != "furniture",
            )
