"""Commands of ``avrgym study`` for invitations to a hosted study."""

import csv
from dataclasses import asdict
from errno import EEXIST
from io import StringIO
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.plan import StudyFolderArgument
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)


def invite(
    folder: StudyFolderArgument,
    address: Annotated[str, typer.Option(help="The public address of the study, such as https://study.org.")],
    out: Annotated[Path, typer.Option(help="Write the links to this new CSV file.", metavar="CSV")],
    number: Annotated[int, typer.Option(help="Number of invitations.", min=1, max=100_000)] = 1,
    labels: Annotated[
        Path | None,
        typer.Option(
            help="A CSV file with the column label: one invitation for each row. Labels must not contain names.",
            metavar="CSV",
        ),
    ] = None,
    places: Annotated[
        int,
        typer.Option(help="Maximum number of participants for each link; 1: each link is valid once.", min=1),
    ] = 1,
    days: Annotated[float, typer.Option(help="Days until the links expire.")] = 14.0,
) -> None:
    """Create invitation links for participants at home.

    The links are written only now; the study stores only their checksums.
    """
    from avrgym.hosting.public_links import make_invitation_link, parse_public_address
    from avrgym.study.people.invitations import create_invitations
    from avrgym.study.storage.store import StudyStore
    from avrgym.system.files import write_private_file

    with report_errors(), StudyStore(folder) as store:
        base = parse_public_address(address)
        wanted = [""] * number if labels is None else _read_labels(labels)
        if out.exists():
            raise FileExistsError(EEXIST, "file exists", str(out))
        created = create_invitations(store, wanted, days=days, places=places)
        log_command(store, "create invitations", detail=f"{len(created)} with {places} places")
        table = StringIO()
        rows = csv.writer(table, lineterminator="\n")
        rows.writerow(["id", "label", "link", "expires_at", "places"])
        for each in created:
            link = make_invitation_link(base, each.token)
            rows.writerow([each.id, each.label, link, each.expires_at, each.places])
        write_private_file(out, table.getvalue())
    print_line(f"links     {out} ({len(created)}, valid until {created[0].expires_at[:16]} UTC)")


def invitations(
    folder: StudyFolderArgument,
    close: Annotated[
        int | None, typer.Option(help="Close the invitation with this id.", metavar="ID")
    ] = None,
    new_link: Annotated[
        str,
        typer.Option(
            help="Print a new link to the page of this participant. The earlier link becomes invalid.",
            metavar="PSEUDONYM",
        ),
    ] = "",
    address: Annotated[str, typer.Option(help="The study's public address, for --new-link.")] = "",
    json_file: JsonFileOption = None,
) -> None:
    """List invitations and the uses of each link."""
    from avrgym.hosting.public_links import make_participant_link, parse_public_address
    from avrgym.study.people.invitations import close_invitation, list_invitations, replace_participant_token
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        base = parse_public_address(address) if new_link else ""
        with StudyStore(folder) as store:
            if new_link:
                print_line(make_participant_link(base, replace_participant_token(store, new_link)))
                log_command(store, "replace link", new_link)
            if close is not None:
                close_invitation(store, close)
                log_command(store, "close invitation", detail=str(close))
            rows = [asdict(each) for each in list_invitations(store)]
        write_json(json_file, rows)
    if rows:
        print_table(rows)
    else:
        print_line(f"there are no invitations; `avrgym study invite {folder}` creates them")


def _read_labels(path: Path) -> list[str]:
    """Returns the column ``label`` of a CSV file. Raises ``ValueError`` if the column or a label is missing."""
    with open(path, newline="", encoding="utf-8-sig") as file:
        rows = csv.DictReader(file)
        if "label" not in (rows.fieldnames or ()):
            raise ValueError(
                f"{path} has no column 'label'; allowed: a CSV file with 'label' in its first row"
            )
        labels = [(row["label"] or "").strip() for row in rows]
    if not labels or not all(labels):
        raise ValueError(f"{path}: a row has no label; allowed: a label in each row")
    return labels
