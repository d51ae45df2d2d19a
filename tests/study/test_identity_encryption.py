"""Names are encrypted with a key outside the study: a key file or a passphrase."""

import json
import os
import pty
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.study.checking.database_checks import check_private_files
from avrgym.study.people.identities import encrypt_participant_names
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import enrol_participant, set_identity
from avrgym.study.storage import database, identity_file, identity_keys
from avrgym.study.storage.identity_file import Identity
from avrgym.study.storage.identity_keys import KEY_FILE_VARIABLE, PASSPHRASE_VARIABLE, KeyUnavailableError
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import get_user_data_folder
from helpers.studies.small_studies import small_study
from helpers.system.paths import DATA

NAME, CONTACT, SECRET = "Zora Unmistakable", "zora@example.org", "a long passphrase"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for variable in (database.DATABASE_URL_VARIABLE, PASSPHRASE_VARIABLE, KEY_FILE_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(identity_keys, "SCRYPT_COST", 4)
    yield
    identity_keys._given.clear()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return small_study(tmp_path / "study")


@pytest.fixture
def locked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study with names encrypted by a passphrase, which is missing."""
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME, contact=CONTACT)
    monkeypatch.delenv(PASSPHRASE_VARIABLE)
    return folder


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["study", *(str(argument) for argument in arguments)])


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith("study.")
    }


def is_readable(folder: Path) -> bool:
    return any(b"Zora" in data or CONTACT.encode() in data for data in contents(folder).values())


def notes(folder: Path) -> str:
    with StudyStore(folder) as store:
        return " ".join(f"{each.where} {each.message} {each.is_error}" for each in check_private_files(store))


# A key file


def test_new_study_uses_a_key_file_outside_the_study(folder: Path) -> None:
    said = avrgym("enrol", folder, "--body", "woman", "--name", NAME, "--contact", CONTACT)
    lock = identity_file.read_key_source(folder)
    assert lock is not None
    key = identity_keys.find_key_file_path(lock)
    assert str(key) in said.stdout
    assert "without it the names are lost, but no other data" in said.stdout
    assert key.is_relative_to(get_user_data_folder())
    assert key.stat().st_mode & 0o077 == 0
    assert not is_readable(folder)
    shown = avrgym("names", folder).stdout
    assert NAME in shown
    assert CONTACT in shown
    assert "key file" not in avrgym("enrol", folder, "--body", "man", "--name", "Max").stdout
    assert "not encrypted" not in notes(folder)


def test_study_works_without_the_key_file(folder: Path) -> None:
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME)
        lock = identity_file.read_key_source(folder)
        assert lock is not None
        key = identity_keys.find_key_file_path(lock)
        lost = key.rename(key.with_suffix(".elsewhere"))
        before = contents(folder)
        for act in (
            lambda: enrol_participant(store, "woman", name="Ada"),
            lambda: set_identity(store, "sub-001", "Ada", ""),
            lambda: identity_file.read_identities(folder),
            lambda: encrypt_participant_names(store),
        ):
            with pytest.raises(KeyUnavailableError, match="no other data"):
                act()
        assert contents(folder) == before
        assert len(store.read_participants()) == 1
        assert enrol_participant(store, "man") == "sub-002"
        key.write_text("ab" * 32)
        with pytest.raises(KeyUnavailableError, match=r"is wrong\. Nothing was changed"):
            identity_file.read_identities(folder)
        lost.replace(key)
        assert identity_file.read_identities(folder)["sub-001"].name == NAME


def test_key_file_must_be_outside_the_study(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(KEY_FILE_VARIABLE, str(folder / "private" / "names.key"))
    with StudyStore(folder) as store:
        with pytest.raises(StudyError, match="is in the study's folder"):
            enrol_participant(store, "woman", name=NAME)
        assert store.read_participants() == []
        monkeypatch.setenv(KEY_FILE_VARIABLE, str(tmp_path / "names.key"))
        enrol_participant(store, "woman", name=NAME)
        assert identity_file.read_identities(folder)["sub-001"] == Identity(NAME, "")
        monkeypatch.delenv(KEY_FILE_VARIABLE)
        with pytest.raises(KeyUnavailableError):
            identity_file.read_identities(folder)


# A passphrase


def test_names_need_the_right_passphrase(locked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not is_readable(locked)
    before = contents(locked)
    for given, words in (
        (None, f"set {PASSPHRASE_VARIABLE}"),
        ("wrong passphrase", "the passphrase of the identity file is wrong"),
    ):
        if given:
            monkeypatch.setenv(PASSPHRASE_VARIABLE, given)
        for command in ("names", "encrypt-names", "enrol --body man --name Ada"):
            name, *options = command.split()
            refused = avrgym(name, locked, *options)
            assert refused.exit_code == 1
            (line,) = refused.stderr.splitlines()
            assert words in line
            assert "Nothing was changed" in line
            assert "Zora" not in refused.output
    assert contents(locked) == before
    assert "was not searched for duplicate enrolments" in notes(locked)
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    assert NAME in avrgym("names", locked).stdout


def test_deletion_needs_no_passphrase(locked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with StudyStore(locked) as store:
        enrol_participant(store, "man")
        delete_participant(store, "sub-001")
    assert identity_file.read_pseudonyms_with_identity(locked) == set()
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    assert identity_file.read_identities(locked) == {}


def test_changed_entries_are_rejected(locked: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    with StudyStore(locked) as store:
        enrol_participant(store, "man", name="Max")
    path = locked / "private" / "identities.json"
    text = path.read_text().replace("sub-001", "x").replace("sub-002", "sub-001").replace("x", "sub-002")
    path.write_text(text)
    with pytest.raises(StudyError, match="is damaged or was changed"):
        identity_file.read_identities(locked)


def test_short_passphrase_is_rejected(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PASSPHRASE_VARIABLE, "short")
    with StudyStore(folder) as store:
        with pytest.raises(StudyError, match="at least 8 characters"):
            enrol_participant(store, "man", name="Max")
        assert store.read_participants() == []
    assert not (folder / "private" / "identities.json").exists()


@pytest.mark.slow
def test_passphrase_is_requested_in_the_terminal(locked: Path) -> None:
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "avrgym", "study", "names", str(locked)]
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    ) as process:
        os.close(theirs)
        said = _read_until(ours, b"locked): ")  # its last space comes once nothing is echoed
        os.write(ours, SECRET.encode() + b"\n")
        said += _read_until(ours, CONTACT.encode())
        assert process.wait() == 0
    os.close(ours)
    assert SECRET.encode() not in said


def _read_until(terminal: int, words: bytes) -> bytes:
    said = b""
    while words not in said:
        said += os.read(terminal, 1024)
    return said


# Studies of earlier versions


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A study of an earlier version with an unencrypted name."""
    return Path(shutil.copytree(DATA / "study-of-0.2.0", tmp_path / "old"))


def test_unencrypted_study_is_reported_and_encrypted(old: Path) -> None:
    assert "contains unencrypted names; `avrgym study encrypt-names" in notes(old)
    with StudyStore(old) as store:
        set_identity(store, "sub-001", "First Person", "")
    assert (old / "private" / "key.json").exists()
    before = identity_file.read_identities(old)
    said = avrgym("encrypt-names", old).stdout
    assert "may still contain it" in said
    assert not (old / "private" / "key.json").exists()
    assert identity_file.read_identities(old) == before
    assert b"Example Person" not in b"".join(contents(old).values())
    assert "not encrypted" not in notes(old)


def test_plain_file_remains_until_encryption_is_verified(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (old / "private" / "key.json").read_bytes()
    with StudyStore(old) as store, monkeypatch.context() as damage:
        damage.setattr(identity_file, "decrypt_identities", lambda *_: {})
        with pytest.raises(StudyError, match="could not be verified"):
            encrypt_participant_names(store)
    assert (old / "private" / "key.json").read_bytes() == before
    assert identity_file.read_key_source(old) is None


def test_leftover_plain_file_is_removed(old: Path) -> None:
    """A crash can leave the plain file next to the encrypted one."""
    plain = old / "private" / "key.json"
    kept = plain.read_bytes()
    assert avrgym("encrypt-names", old).exit_code == 0
    plain.write_bytes(kept)
    assert "is an unencrypted copy of the names" in notes(old)
    assert avrgym("encrypt-names", old).exit_code == 0
    assert not plain.exists()
    plain.write_bytes(kept.replace(b"sub-002", b"sub-009"))
    assert "contains sub-009, but identities.json does not" in avrgym("encrypt-names", old).stderr
    assert plain.exists()


def test_key_can_be_replaced_by_a_passphrase(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME)
    assert "must be entered in a terminal" in avrgym("encrypt-names", folder, "--passphrase").stderr
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    assert "a passphrase" in avrgym("encrypt-names", folder, "--passphrase").stdout
    identity_keys._given.clear()
    assert identity_file.read_identities(folder)["sub-001"].name == NAME
    monkeypatch.delenv(PASSPHRASE_VARIABLE)
    with pytest.raises(KeyUnavailableError):
        identity_file.read_identities(folder)


def test_deletion_covers_files_of_an_interrupted_key_change(folder: Path) -> None:
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME)
        left = folder / "private" / "identities.json.new"
        left.write_bytes((folder / "private" / "identities.json").read_bytes())
        assert "identities.json.new is the temporary file of a killed process" in " ".join(
            f"{each.where} {each.message}" for each in check_private_files(store)
        )
        delete_participant(store, "sub-001")
        assert not left.exists()


@pytest.mark.parametrize("change", [{"salt": "none"}, {"cost": 3}])
def test_damaged_key_source_is_reported(
    locked: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, object]
) -> None:
    path = locked / "private" / "identities.json"
    file = json.loads(path.read_bytes())
    file["lock"] |= change
    path.write_text(json.dumps(file))
    monkeypatch.setenv(PASSPHRASE_VARIABLE, SECRET)
    with pytest.raises(StudyError, match="the key source in the identity file is damaged"):
        identity_file.read_identities(locked)


@pytest.mark.parametrize("name", ["identities.json", "key.json"])
def test_invalid_bytes_are_reported_as_damage(folder: Path, name: str) -> None:
    path = folder / "private" / name
    path.parent.mkdir(mode=0o700)
    path.write_bytes(b'{"format": "\xff"}')
    with pytest.raises(StudyError, match=r"not (an identity|a key) file"):
        identity_file.read_pseudonyms_with_identity(folder)


@pytest.mark.parametrize(
    ("locks", "opens"), [("gr\udcfcn is long", "gr\udcfcn is long"), ("grün is long", "gru\u0308n is long")]
)
def test_passphrase_is_normalised(folder: Path, locks: str, opens: str) -> None:
    identity_keys.set_passphrase(folder, locks)
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME)
    identity_keys.set_passphrase(folder, opens)
    assert identity_file.read_identities(folder)["sub-001"].name == NAME


def test_key_file_is_written_before_names(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    fsync = os.fsync

    def noted(number: int) -> None:
        synced.append(Path(os.readlink(f"/proc/self/fd/{number}")).name)
        fsync(number)

    monkeypatch.setattr(os, "fsync", noted)
    with StudyStore(folder) as store:
        enrol_participant(store, "woman", name=NAME)
    lock = identity_file.read_key_source(folder)
    assert lock is not None
    names = [each for each in synced if each.endswith(".key") or "identities" in each]
    assert names[0] == identity_keys.find_key_file_path(lock).name
