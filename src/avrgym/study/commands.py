"""The program ``avrgym study``."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from avrgym.terminal import JsonFile, check_folder, plain_errors, print_table, say, write_json

app = typer.Typer(no_args_is_help=True, help="Lead a study from its design to the export of its data.")
Folder = Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")]


@app.command()
def new(folder: Folder) -> None:
    """Write study.toml: the paper's protocol with comments, to be changed as you like."""
    from avrgym.study.store import create_study

    with plain_errors():
        path = create_study(folder)
    say(f"design    {path}")


@app.command()
def status(folder: Folder, json_file: JsonFile = None) -> None:
    """Show how a study stands: its participants, their trials and how the orders are filled."""
    from avrgym.study.store import Store
    from avrgym.study.summary import summarise_study

    with plain_errors():
        check_folder(json_file)
        with Store(folder) as store:
            summary = summarise_study(store)
        write_json(json_file, asdict(summary))
    say(f"{summary.title}")
    say(
        f"{summary.completed} of {summary.planned} participants completed, {summary.withdrawn} withdrew, "
        f"{summary.excluded} excluded, {summary.deleted} deleted; {summary.simulated} are simulated"
    )
    say(f"participants per order  {', '.join(map(str, summary.filled))}")
    if summary.participants:
        print_table([asdict(participant) for participant in summary.participants])


@app.command()
def check(folder: Folder, json_file: JsonFile = None) -> None:
    """Check that every recording is there, loads and is unchanged, and that every completed trial has its answers."""
    from avrgym.study.checking import check_study
    from avrgym.study.store import Store

    with plain_errors():
        check_folder(json_file)
        with Store(folder) as store:
            findings = check_study(store)
        write_json(json_file, [asdict(finding) for finding in findings])
    for finding in findings:
        say(f"{'wrong' if finding.wrong else 'note '}  {finding.where}: {finding.what}")
    wrong = sum(finding.wrong for finding in findings)
    say(f"{wrong} things are wrong" if wrong else "nothing is wrong")
    if wrong:
        raise typer.Exit(1)


@app.command()
def export(
    folder: Folder,
    out: Annotated[Path, typer.Option(help="A folder for the export; it must not hold anything yet.")],
    data_format: Annotated[str, typer.Option("--format", help="csv, bids, hdf5 or lerobot.")],
) -> None:
    """Export a study, pseudonymised: movements of head and hands may still identify a person."""
    from avrgym.study.export import export_study
    from avrgym.study.store import Store

    with plain_errors(), Store(folder) as store:
        files = export_study(store, data_format, out)
    say(f"{files} files in {out}. They are pseudonymised, not anonymous.")


@app.command("delete-participant")
def delete_participant(
    folder: Folder,
    participant: Annotated[str, typer.Argument(help="A pseudonym such as sub-001.")],
) -> None:
    """Delete all that a participant left: recordings, rows, key entry, and the database's backups."""
    from avrgym.study.deletion import delete_participant as delete
    from avrgym.study.store import Store

    with plain_errors(), Store(folder) as store:
        delete(store, participant)
    say(
        f"{participant} is deleted. Exports and copies made earlier lie outside the study: delete them yourself."
    )
