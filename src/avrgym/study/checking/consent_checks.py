"""Check consents: whether the archived consent texts are the texts that participants read."""

import hashlib
from collections import defaultdict
from collections.abc import Iterator

from avrgym.study.checking.finding import Finding
from avrgym.study.design.design import DESIGN_FILE
from avrgym.study.people.consents import (
    find_consents_to_other_texts,
    format_consenting_pseudonyms,
    read_current_consent_text,
)
from avrgym.study.storage.database_rows import ConsentRecord, ConsentText
from avrgym.study.storage.sites import compute_site_number
from avrgym.study.storage.store import StudyStore, find_rows
from avrgym.texts.interface_texts import normalize_whitespace


def check_consents(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about consent texts: different texts with one version, changed texts, and missing texts."""
    with store.database.read_transaction() as connection:
        consents, archive = find_rows(connection, ConsentRecord), find_rows(connection, ConsentText)
    for kept in archive:
        if hashlib.sha256(kept.text.encode()).hexdigest() != kept.sha256:
            yield Finding(
                f"consent_text {kept.id}", "was changed: its checksum differs from the stored checksum"
            )
    if store.read_sites():
        yield from _check_sites(consents, archive)
    else:
        yield from _check_present_texts(store, consents, archive)
    archived = {kept.sha256 for kept in archive}
    without = [each for each in consents if each.sha256 not in archived]
    if without:
        yield Finding(
            "consent",
            f"the archive lacks the consent text of {format_consenting_pseudonyms(without)}",
            is_error=False,
        )


def _check_present_texts(
    store: StudyStore, consents: list[ConsentRecord], archive: list[ConsentText]
) -> Iterator[Finding]:
    """Yields findings about the design's consent text: participants read another text with the same version."""
    first = store.design.languages[0]
    for language in sorted({each.language or first for each in consents}):
        shown = read_current_consent_text(store, language)
        others = find_consents_to_other_texts(shown, consents, archive, first) if shown else []
        if others:
            yield Finding(
                DESIGN_FILE,
                f"[consent] in {language} differs from the text that {format_consenting_pseudonyms(others)} read as "
                f"version {store.design.consent.version}; increase the version, or restore the earlier text",
            )


def _check_sites(consents: list[ConsentRecord], archive: list[ConsentText]) -> Iterator[Finding]:
    """Yields findings about different texts with the same version at one site. Texts may differ between sites."""
    words = {kept.sha256: normalize_whitespace(kept.text) for kept in archive}
    read = defaultdict[tuple[int, str, str], dict[str, list[ConsentRecord]]](lambda: defaultdict(list))
    for each in consents:
        if each.sha256 in words and each.version is not None:
            use = compute_site_number(each.participant), each.version, each.language or ""
            read[use][words[each.sha256]].append(each)
    for (_, version, _), texts in read.items():
        if len(texts) > 1:
            who = " and ".join(format_consenting_pseudonyms(each) for each in texts.values())
            yield Finding("consent", f"{who} read different texts with the same version {version}")
