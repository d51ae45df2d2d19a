"""Check that all sessions used the design in the study's folder."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from avrgym.study.checking.finding import Finding
from avrgym.study.design.comparison import (
    DesignTexts,
    comparable_values,
    differences,
    key_path_text,
    read_design_texts,
    value_text,
)
from avrgym.study.design.design import FILE, Design
from avrgym.study.design.languages import participant_sentences
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.session_designs import (
    SessionDesign,
    describe_trials,
    design_from_row,
    designs_from_recordings,
    is_accepted_site_difference,
    session_designs,
)
from avrgym.study.storage.store import Store
from avrgym.system.toml_lines import ValuePath
from avrgym.texts.interface_texts import TEXTS_FOLDER, InvalidTextsError, normalize_whitespace

ADMISSION_FIELDS = ("inclusion", "order of inclusion")
"""Design fields that only affect the admission of participants."""
CONSENT_FIELD = "consent"
"""Design field of the consent text. ``check_consents`` compares it for each participant."""
FIELDS_WITHOUT_EFFECT = ("title", "participants", "max_held_share", "max_repeats")
"""Design fields that do not affect participants. A different value is not an error."""


@dataclass(frozen=True)
class DesignDifference:
    """A value that differs between the current design and the design of sessions.

    ``place``: key path of the value. ``current_value``: value in the current design. ``session_value``: value in the
    design of ``sessions``. A missing value is ``MISSING_VALUE``.
    """

    file: str
    place: ValuePath
    current_value: Any
    session_value: Any
    sessions: list[SessionDesign]


def check_design(store: Store) -> Iterator[Finding]:
    """Yields findings about differences from the current design in sessions, admissions and recordings."""
    sessions = session_designs(store)
    for each in design_differences(store.design, _present_wordings(store), sessions):
        is_error = each.place[0] not in FIELDS_WITHOUT_EFFECT and not is_accepted_site_difference(
            store, each.sessions, sessions
        )
        message = (
            f"{key_path_text(each.place)} is {value_text(each.current_value)}; it was "
            f"{value_text(each.session_value)} for"
        )
        yield Finding(each.file, f"{message} {describe_trials(each.sessions, sessions)}", is_error=is_error)
    yield from _check_inclusion(store)
    yield from _check_recordings(store, sessions)


def check_stored_designs(store: Store) -> Iterator[Finding]:
    """Yields a finding about sessions without a stored design, as in studies of AVR Gym 0.2."""
    sessions = session_designs(store)
    unknown = [entry for entry in sessions if entry.wordings is None]
    if unknown:
        trials = describe_trials(unknown, sessions)
        message = f"does not contain the design of {trials}: only their recordings contain a part of it"
        yield Finding("database", message, is_error=False)


def design_differences(
    design: Design, wordings: DesignTexts | None, sessions: Sequence[SessionDesign]
) -> list[DesignDifference]:
    """Returns all differences between a design with its texts (``wordings``) and the designs of sessions."""
    found: dict[str, DesignDifference] = {}
    known: dict[bytes, list[DesignDifference]] = {}
    for entry in sessions:
        key = msgspec.json.encode([entry.design, entry.wordings, entry.language], order="deterministic")
        if key not in known:
            known[key] = list(_differences(design, wordings, entry))
        for each in known[key]:
            name = f"{each.file} {each.place} {each.session_value!r}"
            found.setdefault(name, replace(each, sessions=[])).sessions.append(entry)
    return list(found.values())


def _differences(
    design: Design, wordings: DesignTexts | None, entry: SessionDesign
) -> Iterator[DesignDifference]:
    for place, here, there in differences(_of_sessions(design), _of_sessions(entry.design)):
        yield DesignDifference(FILE, place, here, there, [])
    if wordings is None or entry.wordings is None:
        return
    language = entry.language
    for place, here, there in differences(wordings.get(language, {}), entry.wordings.get(language, {})):
        if place[0] != "sentences" or place[-1] in _both(design, entry.design):
            yield DesignDifference(f"{TEXTS_FOLDER}/{language}.toml", place, here, there, [])


def _of_sessions(design: Design) -> dict[str, Any]:
    """Returns the names and values of the design fields that affect sessions."""
    before = (*ADMISSION_FIELDS, CONSENT_FIELD)
    return {name: value for name, value in comparable_values(design).items() if name not in before}


def _both(a: Design, b: Design) -> set[str]:
    """Returns the sentences for participants that both designs contain."""
    first, second = (
        {normalize_whitespace(each) for each in participant_sentences(design)} for design in (a, b)
    )
    return first & second


def _present_wordings(store: Store) -> DesignTexts | None:
    try:
        return read_design_texts(store.design, store.folder)
    except InvalidTextsError:
        return None


def _check_inclusion(store: Store) -> Iterator[Finding]:
    """Yields findings about differences between the current and the answered inclusion questions."""
    for (place, here, there), people in admission_differences(store, store.design, ADMISSION_FIELDS):
        message = f"{key_path_text(place)} is {value_text(here)}; it was {value_text(there)} for"
        yield Finding(FILE, f"{message} {', '.join(people)}")


def admission_differences(
    store: Store, design: Design, fields: Sequence[str]
) -> list[tuple[tuple[ValuePath, Any, Any], list[str]]]:
    """Compare fields of a design with the design at each participant's admission.

    Returns:
        Each difference (key path, value in ``design``, value at admission), and the pseudonyms of its participants.
    """
    found: dict[str, tuple[tuple[ValuePath, Any, Any], list[str]]] = {}
    expected = {name: comparable_values(design)[name] for name in fields}
    for row in store.stored_designs():
        if row.session is None:
            asked = comparable_values(design_from_row(row))
            for change in differences(expected, {name: asked[name] for name in fields}):
                found.setdefault(repr(change), (change, []))[1].append(pseudonym_of(row.participant))
    return list(found.values())


def _check_recordings(store: Store, sessions: Sequence[SessionDesign]) -> Iterator[Finding]:
    """Yields findings about differences between recordings and the stored design of their session.

    Different furniture is not an error; all other differences are errors.
    """
    stored = {entry.session.id: entry for entry in sessions if entry.wordings is not None}
    for entry in designs_from_recordings(store):
        own = stored.get(entry.session.id)
        if own is None:
            continue
        for place, before, then in differences(_of_sessions(own.design), _of_sessions(entry.design)):
            yield Finding(
                str(entry.session),
                f"was recorded with another {key_path_text(place)} than its design has: {value_text(then)} instead of "
                f"{value_text(before)}, for {describe_trials([entry])}",
                is_error=place[0] != "furniture",
            )
