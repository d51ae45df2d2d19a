"""Commands of ``avrgym study`` for personal tokens of experimenters."""

from typing import Annotated, Any

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
from avrgym.vr.server.network_addresses import DEFAULT_PORT

ExperimenterNameArgument = Annotated[
    str, typer.Argument(help="Name of the experimenter: at most 40 letters, digits, - and _.")
]


def add_experimenter(folder: StudyFolderArgument, name: ExperimenterNameArgument) -> None:
    """Create a personal token for an experimenter.

    The audit log then contains the experimenter's name. The token is printed only now; the study stores only its
    checksum.
    """
    from avrgym.study.people.experimenters import add_experimenter as add
    from avrgym.study.storage.audit_log import ADD_EXPERIMENTER_ACTION
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        token = add(store, name)
        log_command(store, ADD_EXPERIMENTER_ACTION, detail=name)
    print_line(f"token     {token} (shown only once)")
    print_line(
        f"dashboard http://localhost:{DEFAULT_PORT}/dashboard#token={token} while `avrgym serve --study {folder}` runs"
    )


def experimenters(folder: StudyFolderArgument, json_file: JsonFileOption = None) -> None:
    """List experimenters with a personal token."""
    from avrgym.study.people.experimenters import list_experimenters
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            rows: list[dict[str, Any]] = [
                {"name": each.name, "created_at": each.created_at, "revoked_at": each.revoked_at}
                for each in list_experimenters(store)
            ]
        write_json(json_file, rows)
    if rows:
        print_table(rows)
    else:
        print_line(f"no experimenter has a token; `avrgym study add-experimenter {folder} NAME` creates one")


def revoke_experimenter(folder: StudyFolderArgument, name: ExperimenterNameArgument) -> None:
    """Revoke the token of an experimenter.

    Open pages with this token are closed within seconds.
    """
    from avrgym.study.people.experimenters import revoke_experimenter as revoke
    from avrgym.study.storage.audit_log import REVOKE_EXPERIMENTER_ACTION
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        revoke(store, name)
        log_command(store, REVOKE_EXPERIMENTER_ACTION, detail=name)
    print_line(f"the token of {name} is revoked")
