"""Merge the studies of several sites into one.

The primary key of a merged row is computed from the site's number and the row's key at the site. A merge compares
all rows, and writes missing and changed rows. It can be repeated. After an interruption, the next merge completes it.
Without new data, a repeated merge changes nothing. For each participant, recordings are copied first. All rows are then
written in one transaction.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sqlalchemy as sa
import tomlkit

from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import SITE_SPECIFIC_FIELDS
from avrgym.study.design.toml_validation import read_text
from avrgym.study.merge.row_transfer import (
    RowsByTable,
    SiteRecording,
    group_rows_by_participant,
    list_site_recordings,
    write_merged_rows,
)
from avrgym.study.merge.site_studies import (
    SiteStudy,
    check_distinct_studies,
    check_site_continuation,
    read_site_study,
)
from avrgym.study.merge.study_differences import find_study_differences
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.plan.study_files import list_study_files
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database import DATABASE_FILE as DATABASE
from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, DeletedParticipant, Site, format_pseudonym
from avrgym.study.storage.object_store import OBJECT_STORE_VARIABLE
from avrgym.study.storage.sites import (
    OMITTED_RECORDING_EVENT,
    SITE_DIFFERENCE_EVENT,
    compute_merged_participant_number,
    compute_merged_row_id,
    record_event_once,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows
from avrgym.system.files import (
    make_private_folder,
    remove_leftover_files,
    write_folder_atomically,
    write_private_file,
)


def make_merged_study(like: StudyStore, names: Mapping[int, str], out: Path) -> None:
    """Create an empty merged study in a new folder.

    ``like``: study with the design. ``names``: site names, by site number.
    """

    def write(folder: Path) -> None:
        write_private_file(folder / DESIGN, _without_local(read_text(like.folder / DESIGN)))
        for name in list_study_files(like):
            make_private_folder((folder / name).parent)
            shutil.copyfile(like.folder / name, folder / name)
        with StudyStore(folder) as store, store.database.write_transaction() as connection:
            for number, name in names.items():
                hash_chain.insert_row(
                    connection, schema.SITE_TABLE, number=number, name=name, num_entries=0, last_digest=""
                )

    write_folder_atomically(out, write)


def _without_local(design: str) -> str:
    """Returns the text of a design without the fields of ``SITE_SPECIFIC_FIELDS``. The other lines are unchanged."""
    document: Any = tomlkit.parse(design)
    if not any(document.get(name) for name in SITE_SPECIFIC_FIELDS):
        return design
    for name in SITE_SPECIFIC_FIELDS:
        document.pop(name, None)
    return tomlkit.dumps(document)


@dataclass(frozen=True)
class MergedSite:
    """Result of the merge of one site.

    ``site_name``: name. ``pseudonym_range``: range of pseudonyms in the merged study. Other fields: numbers of
    participants, recordings, copied recordings, written rows and deleted participants.
    """

    site_name: str
    participant_count: int
    pseudonym_range: str
    recording_count: int
    copied_recording_count: int
    written_row_count: int
    deleted_participant_count: int


@dataclass
class _SiteMerge:
    """Data of one site during a merge. ``differing``: accepted differences. ``faults``: errors, by attempt id."""

    number: int
    source: SiteStudy
    differing: Sequence[str]
    recordings: Mapping[int, Sequence[SiteRecording]]
    faults: dict[int, str] = field(default_factory=dict[int, str])
    copied: int = 0
    written: int = 0
    deleted: int = 0


def merge_studies(
    folders: Sequence[Path],
    out: Path,
    *,
    accept_differences: bool = False,
    skip_damaged: bool = False,
    progress: Callable[[int, int], None] = lambda done, all_: None,
    report: Callable[[str], None] = lambda text: None,
) -> list[MergedSite]:
    """Merge studies into a new folder, or update an earlier merge. Returns a result for each site.

    The sites' studies are not changed.

    Args:
        folders: the folders of the sites' studies.
        out: the folder of the merged study.
        accept_differences: merge studies even if designs, texts, policies or plans differ.
        skip_damaged: omit damaged and missing recordings.
        progress: called with the number of compared recordings and their total number.
        report: called with each accepted difference, and with each omitted recording.

    Raises:
        StudyError: if studies differ, are the same, lack recordings, or were changed by another program. Also if
            ``out`` contains other files. In these cases, nothing is changed.
        DesignError: if a site's ``study.toml`` is invalid.
    """
    _check_places(folders, out)
    with ExitStack() as stack:
        sources = [read_site_study(stack.enter_context(StudyStore(folder))) for folder in folders]
        check_distinct_studies(sources)
        merged = _open_merged(out, stack)
        sites = _number(sources, merged, out, accepted=accept_differences)
        _verify(sites, progress)
        _report_omissions(sites, report, skip_damaged=skip_damaged)
        if merged is None:
            make_merged_study(sources[0].store, {site.number: site.source.site_name for site in sites}, out)
            merged = stack.enter_context(StudyStore(out))
        remove_leftover_files(merged.folder / RECORDINGS_FOLDER)
        return [_merge_site(merged, site) for site in sites]


# Checks before the first write


def _check_places(folders: Sequence[Path], out: Path) -> None:
    if os.environ.get(DATABASE_URL_VARIABLE):
        raise StudyError(
            f"{DATABASE_URL_VARIABLE} is set and would replace the database of each site: unset it. For a site with "
            "PostgreSQL, set `url` under [database] in its study.toml, and store the password in ~/.pgpass"
        )
    if os.environ.get(OBJECT_STORE_VARIABLE):
        raise StudyError(
            f"{OBJECT_STORE_VARIABLE} is set and would replace the object store of each site: unset it, and set `url` "
            "under [recordings] in the study.toml of each site that uses an object store"
        )
    for folder in folders:
        if out.resolve().is_relative_to(folder.resolve()):
            raise StudyError(f"{out} is in the folder of a site, {folder}; choose another folder")
    if out.exists() and not out.is_dir():
        raise StudyError(f"{out} is a file; choose a folder")


def _open_merged(out: Path, stack: ExitStack) -> StudyStore | None:
    """Returns the opened merged study in a folder; ``None`` for a new or empty folder."""
    if not out.exists() or not any(out.iterdir()):
        return None
    if (out / DATABASE).is_file():
        store = stack.enter_context(StudyStore(out))
        if store.read_sites():
            return store
    raise StudyError(f"{out} contains other files; choose a new folder, or the folder of an earlier merge")


def _number(
    sources: Sequence[SiteStudy], merged: StudyStore | None, out: Path, *, accepted: bool
) -> list[_SiteMerge]:
    """Returns the sites with their numbers. Raises ``StudyError`` if a site does not match the merged study."""
    known = merged.read_sites() if merged else []
    people = merged.read_participants() if merged else []
    gone = {each.number for each in merged.read_deleted_participants()} if merged else set[int]()
    like = (known[0].name, merged) if merged else (sources[0].site_name, sources[0].store)
    numbers = {site.name: site.number for site in known}
    sites: list[_SiteMerge] = []
    for source in sources:
        check_site_continuation(source, known, people)
        number = numbers.setdefault(source.site_name, len(numbers) + 1)
        differing = find_study_differences(like, (source.site_name, source.store), accepted=accepted)
        recordings: dict[int, list[SiteRecording]] = {
            person: []
            for person in source.enrolment_times
            if compute_merged_participant_number(number, person) not in gone
        }
        for each in list_site_recordings(source, number, out):
            if each.participant_number in recordings:
                recordings[each.participant_number].append(each)
        sites.append(_SiteMerge(number, source, differing, recordings))
    return sites


def _verify(sites: Sequence[_SiteMerge], progress: Callable[[int, int], None]) -> None:
    """Check all recordings. Each site's ``faults`` then contains the recordings that cannot be copied."""
    everything = [
        (site, each) for site in sites for recordings in site.recordings.values() for each in recordings
    ]
    for done, (site, each) in enumerate(everything, start=1):
        fault = None if each.is_copied() else each.find_copy_error()
        if fault is not None:
            site.faults[each.attempt_id] = fault
        progress(done, len(everything))


def _report_omissions(
    sites: Sequence[_SiteMerge], report: Callable[[str], None], *, skip_damaged: bool
) -> None:
    faults = [f"{site.source.site_name}: {fault}" for site in sites for fault in site.faults.values()]
    if faults and not skip_damaged:
        raise StudyError(
            f"nothing was merged: {'; '.join(faults)}; use --skip-damaged to omit damaged and missing recordings"
        )
    for words in [*(each for site in sites for each in site.differing), *faults]:
        report(words)


# One site


def _merge_site(merged: StudyStore, site: _SiteMerge) -> MergedSite:
    with merged.database.write_transaction() as connection:
        _enter(connection, site)
    rows = group_rows_by_participant(site.source, site.number)
    for person, recordings in site.recordings.items():
        _merge_participant(merged, site, person, recordings, rows[person])
    site.deleted = sum(1 for _ in _delete(merged, site))
    with merged.database.write_transaction() as connection:
        site.written += write_merged_rows(connection, rows.get(None, {}))
        _merge_rest(connection, site)
    return MergedSite(
        site_name=site.source.site_name,
        participant_count=len(site.recordings),
        pseudonym_range=_range(
            [compute_merged_participant_number(site.number, person) for person in site.recordings]
        ),
        recording_count=sum(each.target_path.is_file() for own in site.recordings.values() for each in own),
        copied_recording_count=site.copied,
        written_row_count=site.written,
        deleted_participant_count=site.deleted,
    )


def _enter(connection: sa.Connection, site: _SiteMerge) -> None:
    """Store the number of a new site. Raises ``StudyError`` if another merge assigned this number."""
    for known in find_rows(connection, Site, number=site.number):
        if known.name != site.source.site_name:
            raise StudyError(
                f"another process merged {known.name!r} at the same time; merge {site.source.site_name!r} again"
            )
        return
    row = {"number": site.number, "name": site.source.site_name, "num_entries": 0, "last_digest": ""}
    hash_chain.insert_row(connection, schema.SITE_TABLE, **row)


def _merge_participant(
    merged: StudyStore, site: _SiteMerge, person: int, recordings: Sequence[SiteRecording], rows: RowsByTable
) -> None:
    for each in recordings:
        if each.attempt_id not in site.faults:
            site.copied += each.copy_file()
    number = compute_merged_participant_number(site.number, person)
    with merged.database.write_transaction() as connection:
        if find_rows(connection, DeletedParticipant, number=number):
            return  # deleted during this merge
        site.written += write_merged_rows(connection, rows)
        for each in recordings:
            if each.attempt_id in site.faults:
                attempt = compute_merged_row_id(site.number, each.attempt_id)
                record_event_once(
                    connection,
                    OMITTED_RECORDING_EVENT,
                    site.faults[each.attempt_id],
                    participant=number,
                    attempt=attempt,
                )


def _delete(merged: StudyStore, site: _SiteMerge) -> Iterator[int]:
    """Delete merged participants that the site has deleted. Yields their numbers in the merged study."""
    present = {each.number for each in merged.read_participants()}
    for row in site.source.rows_by_table["tombstone"]:
        number = compute_merged_participant_number(site.number, row["number"])
        pseudonym = format_pseudonym(number)
        if number in present or (merged.folder / RECORDINGS_FOLDER / pseudonym).exists():
            delete_participant(merged, pseudonym)
            yield number


def _merge_rest(connection: sa.Connection, site: _SiteMerge) -> None:
    """Store the site's deletions, the accepted differences, and the head of the site's hash chain."""
    for row in site.source.rows_by_table["tombstone"]:
        number = compute_merged_participant_number(site.number, row["number"])
        if not find_rows(connection, DeletedParticipant, number=number):
            hash_chain.insert_row(connection, schema.TOMBSTONE_TABLE, **{**row, "number": number})
    for words in site.differing:
        record_event_once(connection, SITE_DIFFERENCE_EVENT, words)
    head = site.source.hash_chain_head
    (before,) = find_rows(connection, Site, number=site.number)
    if (before.num_entries, before.last_digest) != (head.number, head.digest):
        hash_chain.update_row(
            connection, schema.SITE_TABLE, site.number, num_entries=head.number, last_digest=head.digest
        )


def _range(numbers: Sequence[int]) -> str:
    if not numbers:
        return "nobody"
    first, last = format_pseudonym(min(numbers)), format_pseudonym(max(numbers))
    return first if first == last else f"{first} to {last}"
