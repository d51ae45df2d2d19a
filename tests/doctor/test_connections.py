"""Checks of the connection to a headset: occupied ports, missing programs, firewalls."""

import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from avrgym.doctor import connections
from avrgym.doctor.finding import Finding
from avrgym.vr.server.certificate import load_or_create_certificate, locate_certificate

NAMES = ("192.0.2.7", "lab", "lab.local")


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Installs a program, a shell script; nothing else is installed."""
    monkeypatch.setenv("PATH", str(tmp_path))

    def install(name: str, script: str) -> None:
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)

    return install


def test_an_occupied_port_is_a_warning() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        found = connections.check_port(number)
        assert (found.state, f"127.0.0.1:{number}" in found.message) == ("warning", True)
        assert "--port 0" in found.fix
    assert connections.check_port(number).state == "ok"


def test_a_browser_is_found_or_missed(
    program: Callable[[str, str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLAYWRIGHT_BROWSERS_PATH", str(tmp_path / "none"))
    assert connections.check_browser().fix == "playwright install chromium"
    program("chromium", "")
    assert connections.check_browser().message == str(tmp_path / "chromium")


ATTACHED = "List of devices attached"


@pytest.mark.parametrize(
    ("listed", "state", "words"),
    [
        (ATTACHED, "warning", "adb finds no headset"),
        (f"{ATTACHED}\\n1WMHH\\tdevice", "ok", "connected: 1WMHH"),
        (f"{ATTACHED}\\n1WMHH\\tunauthorized", "warning", "1WMHH is connected, but unauthorized"),
        (f"{ATTACHED}\\n1WMHH\\toffline\\n2WMHH\\tdevice", "ok", "connected: 2WMHH"),
    ],
)
def test_a_headset_on_a_cable(
    listed: str, state: str, words: str, program: Callable[[str, str], None]
) -> None:
    program("adb", f"printf '{listed}\\n'")
    found = connections.check_headset()
    assert (found.state, found.message) == (state, words)


def test_without_adb_the_fix_is_its_installation(program: Callable[[str, str], None]) -> None:
    assert "adb is not installed" in connections.check_headset().message


def test_a_network_is_named_or_missed() -> None:
    assert connections.check_network(NAMES) == Finding("ok", "192.0.2.7, lab, lab.local")
    assert connections.check_network(NAMES[1:]).state == "warning"


def test_firewalls_that_are_on(program: Callable[[str, str], None], tmp_path: Path) -> None:
    ufw = tmp_path / "ufw.conf"
    assert connections.check_firewall(8000, ufw).state == "ok"
    ufw.write_text("# comment\nENABLED=yes\n")
    assert connections.check_firewall(8000, ufw).fix.startswith("sudo ufw allow 8000/tcp")
    ufw.write_text("ENABLED=no\n")
    assert connections.check_firewall(8000, ufw).state == "ok"
    program("firewall-cmd", "exit 1")
    assert connections.check_firewall(8000, ufw).message == "neither ufw nor firewalld is active"
    program("firewall-cmd", '[ "$1" = --state ]')
    assert connections.check_firewall(8000, ufw).fix == "sudo firewall-cmd --add-port=8000/tcp"
    program("firewall-cmd", '[ "$1" = --state ] || [ "$1" = --query-port=8000/tcp ]')
    assert connections.check_firewall(8000, ufw).message == "firewalld allows 8000/tcp"


def test_a_certificate_is_examined_and_never_made(tmp_path: Path) -> None:
    folder = tmp_path / "with space"
    wanted = locate_certificate(folder, NAMES)
    assert connections.check_certificate(wanted).message.startswith("none yet")
    assert not folder.exists()
    load_or_create_certificate(NAMES, folder)
    assert connections.check_certificate(wanted) == Finding("ok", str(wanted.certificate_file))
    other = connections.check_certificate(locate_certificate(folder, ("192.0.2.8",)))
    assert (other.state, "lacks a current name" in other.message) == ("warning", True)
    wanted.key_file.chmod(0o644)
    assert "chmod 600" in connections.check_certificate(wanted).fix
    wanted.key_file.chmod(0o600)
    wanted.key_file.write_text("broken")
    assert "cannot be read" in connections.check_certificate(wanted).message
