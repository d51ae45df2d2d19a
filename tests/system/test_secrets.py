"""No file of the repository contains a private key or an access token."""

import re
import subprocess

import pytest

from helpers.system.paths import ROOT

SECRET = re.compile(
    rb"-----BEGIN [A-Z ]*PRIVATE KEY-----"
    rb"|\bAKIA[0-9A-Z]{16}\b"  # Amazon
    rb"|\bgh[pousr]_[0-9A-Za-z]{36}\b"  # GitHub
    rb"|\bhf_[A-Za-z]{34}\b"  # Hugging Face
    rb"|\bpypi-AgEI[0-9A-Za-z_-]{50}"
    rb"|\bxox[abprs]-[0-9A-Za-z-]{20}"  # Slack
)


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="only a clone lists its files")
def test_tracked_files_contain_no_secrets() -> None:
    listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT).split(b"\0")
    paths = [ROOT / name.decode() for name in listed if name]
    found = [str(path) for path in paths if path.is_file() and SECRET.search(path.read_bytes())]
    assert found == []


@pytest.mark.parametrize(
    "text", ["-----BEGIN EC PRIVATE" + " KEY-----", "AKIA" + 16 * "A", "ghp_" + 36 * "a"]
)
def test_secrets_are_recognized(text: str) -> None:
    assert SECRET.search(f"key = {text}\n".encode())
