"""The commands of ``avrgym study`` that show and encrypt names."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.plan import StudyFolderArgument
from avrgym.cli.terminal import print_line, print_table, report_errors

KEY_BACKUP_ADVICE = "Store a copy of it outside the study: without it the names are lost, but no other data."


def names(folder: StudyFolderArgument) -> None:
    """Show names and contacts of the participants."""
    from avrgym.study.storage import identity_file
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        unlock_identity_file(folder)
        known = identity_file.read_identities(store.folder)
        log_command(store, "read names")
    if not known:
        print_line("no names are stored")
        return
    print_table(
        [
            {"participant": pseudonym, "name": each.name, "contact": each.contact}
            for pseudonym, each in sorted(known.items())
        ]
    )


def encrypt_names(
    folder: StudyFolderArgument,
    passphrase: Annotated[
        bool, typer.Option("--passphrase", help="Use a passphrase instead of a key file.")
    ] = False,
) -> None:
    """Encrypt names with a new key or passphrase.

    The unencrypted file is removed after the encrypted file was verified. Names that are already encrypted are
    encrypted with the new key.
    """
    from avrgym.study.people.identities import encrypt_participant_names as encrypt
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        unlock_identity_file(folder)
        was_plain = encrypt(store, (lambda: _new_passphrase(folder)) if passphrase else None)
        log_command(store, "encrypt names")
    print_name_encryption(folder)
    if was_plain:
        print_line(
            "The unencrypted file is removed. Snapshots, backups and free space of the disk may still contain it: "
            "delete old copies yourself."
        )


def unlock_identity_file(folder: Path) -> None:
    """Ask for the passphrase of the identity file, if it is needed and no environment variable contains it.

    Without a terminal, the identity file remains locked.
    """
    from avrgym.study.storage import identity_file, identity_keys

    lock = identity_file.read_key_source(folder)
    is_needed = lock is not None and lock.kind == "passphrase"
    if is_needed and identity_keys.find_passphrase(folder) is None and sys.stdin.isatty():
        question = "Passphrase of the identity file (Enter: do not unlock it)"
        if passphrase := typer.prompt(question, default="", show_default=False, hide_input=True):
            identity_keys.set_passphrase(folder, passphrase)
            identity_file.read_identities(folder)


def print_name_encryption(folder: Path) -> None:
    """Print the type of encryption of the names, and advice to store a copy of the key."""
    from avrgym.study.storage import identity_file, identity_keys

    lock = identity_file.read_key_source(folder)
    if lock is None:
        return
    what = (
        "a passphrase"
        if lock.kind == "passphrase"
        else f"the key file {identity_keys.find_key_file_path(lock)}"
    )
    print_line(f"names     are encrypted with {what}. {KEY_BACKUP_ADVICE}")


def _new_passphrase(folder: Path) -> str:
    """Returns a new passphrase from an environment variable.

    If the variable is missing, or contains the current passphrase, the new passphrase is read from the terminal.
    """
    from avrgym.study.storage import identity_file, identity_keys

    lock = identity_file.read_key_source(folder)
    if (lock is None or lock.kind == "file") and (given := os.environ.get(identity_keys.PASSPHRASE_VARIABLE)):
        return given
    if not sys.stdin.isatty():
        raise RuntimeError("a new passphrase must be entered in a terminal; nothing was changed")
    return typer.prompt("New passphrase of the identity file", hide_input=True, confirmation_prompt=True)
