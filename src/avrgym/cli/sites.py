"""The command ``avrgym study merge``, and the table of participants by site and trial order."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.progress import CONTINUE_HINT, show_progress_bar
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)

if TYPE_CHECKING:
    from avrgym.study.checking.study_summary import StudySummary


def merge(
    folders: Annotated[
        list[Path], typer.Argument(help="The folders of the sites' studies.", metavar="SITE...")
    ],
    out: Annotated[
        Path, typer.Option(help="A new folder for the merged study, or the folder of an earlier merge.")
    ],
    accept_differences: Annotated[
        bool,
        typer.Option("--accept-differences", help="Merge studies although their designs or plans differ."),
    ] = False,
    skip_damaged: Annotated[
        bool,
        typer.Option("--skip-damaged", help="Omit recordings that are damaged or missing at their site."),
    ] = False,
    json_file: JsonFileOption = None,
) -> None:
    """Merge the studies of several sites into one study.

    Repeat the command to add new data of the sites. Names of participants are not copied.
    """
    from avrgym.study.merge.study_merge import merge_studies
    from avrgym.study.storage.store import StudyStore

    notes: list[str] = []
    with report_errors():
        check_json_file(json_file)
        with show_progress_bar("comparing recordings", unit="recordings", stopped=CONTINUE_HINT) as bar:
            sites = merge_studies(
                folders,
                out,
                accept_differences=accept_differences,
                skip_damaged=skip_damaged,
                progress=bar.update,
                report=notes.append,
            )
        if any(
            site.written_row_count or site.copied_recording_count or site.deleted_participant_count
            for site in sites
        ):
            with StudyStore(out) as merged:
                log_command(merged, "merge", detail=", ".join(site.site_name for site in sites))
        write_json(json_file, [asdict(site) for site in sites])
    for words in notes:
        print_line(f"note      {words}")
    print_table([asdict(site) for site in sites])
    print_line(f"merged    {out}; names and contacts stay in the sites' identity files")


def print_order_counts(summary: "StudySummary") -> None:
    """Print the number of participants in each trial order, by site."""
    for site, filled in summary.filled_by_site.items():
        print_line(f"at {site}  {', '.join(map(str, filled))}")
