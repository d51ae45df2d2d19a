"""Consents in exports: each decision, and the archived texts as files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from avrgym.study.storage.rows import ConsentText
from avrgym.study.storage.store import Store

FOLDER = "consent_texts"
CHECKSUM_DIGITS = 12
"""Number of digits of the checksum in the names of files."""


def consent_rows(store: Store) -> Iterator[dict[str, Any]]:
    """A row for every decision of every participant, in order."""
    files = {kept.sha256: _file(kept) for kept in store.consent_texts()}
    for participant in store.participants():
        for number, each in enumerate(store.consents(participant.pseudonym), start=1):
            yield {
                "participant": participant.pseudonym,
                "site": participant.site,
                "simulated": participant.simulated,
                "decision": number,
                "agreed": each.agreed,
                "version": each.version,
                "language": each.language,
                "decided_at": each.at,
                "sha256": each.sha256,
                "text": files.get(each.sha256 or ""),
            }


def write_consent_texts(store: Store, folder: Path) -> None:
    """Write every archived text into a file whose bytes have its checksum."""
    for kept in store.consent_texts():
        path = folder / _file(kept)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(kept.text.encode())


def _file(kept: ConsentText) -> str:
    return f"{FOLDER}/{kept.language}-{kept.sha256[:CHECKSUM_DIGITS]}.txt"
