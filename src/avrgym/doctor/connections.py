"""Check the connection to a headset: browser, cable, port, network, firewall and certificate."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from avrgym.doctor.finding import Finding, make_ok_finding, make_warning_finding
from avrgym.system.files import find_exposed_paths
from avrgym.vr.emulation.emulated_headset import find_chromium
from avrgym.vr.server.certificate import Certificate, find_renewal_reason
from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS
from avrgym.vr.server.web_server import ServerError, open_listener

COMMAND_TIMEOUT_S = 20.0
UFW_CONFIG_FILE = Path("/etc/ufw/ufw.conf")


def check_browser() -> Finding:
    """Check whether Playwright and Chromium are installed; `avrgym demo` needs them for images."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return make_warning_finding(
            "Playwright is not installed; the demo needs it for images", "pip install 'avrgym[browser]'"
        )
    found = find_chromium()
    if found is None:
        with sync_playwright() as playwright:
            found = playwright.chromium.executable_path
    if not Path(found).is_file():
        return make_warning_finding(
            "Chromium is not installed; the demo needs it for images", "playwright install chromium"
        )
    return make_ok_finding(found)


def check_headset() -> Finding:
    """Check whether a headset is connected by cable and allows USB debugging."""
    program = shutil.which("adb")
    if program is None:
        return make_warning_finding(
            "adb is not installed; it connects a Quest or Pico by cable",
            "sudo apt install adb, or Android's platform tools; not needed with --lan or SteamVR",
        )
    ran = subprocess.run(
        [program, "devices"], capture_output=True, text=True, timeout=COMMAND_TIMEOUT_S, check=False
    )
    attached = re.findall(r"^(\S+)\t(.+)$", ran.stdout, re.MULTILINE)
    ready = [serial for serial, state in attached if state == "device"]
    if ready:
        return make_ok_finding(f"connected: {', '.join(ready)}")
    if attached:
        serial, state = attached[0]
        return make_warning_finding(
            f"{serial} is connected, but {state}", "put the headset on and allow USB debugging"
        )
    return make_warning_finding(
        "adb finds no headset", "connect it by USB in developer mode; see docs/how_to/connect_headset.md"
    )


def check_port(number: int) -> Finding:
    """Check whether a server can listen on the port ``number`` of this computer."""
    try:
        open_listener(LOOPBACK_HOSTS[0], number).close()
    except ServerError as failure:
        return make_warning_finding(
            str(failure).partition(";")[0], "avrgym serve --port 0 chooses a free port"
        )
    return make_ok_finding(f"{number} is free")


def check_network(names: Sequence[str]) -> Finding:
    """Check whether this computer has an address in the local network. ``names``: its addresses and host names."""
    if not any(re.fullmatch(r"[\d.]+", name) for name in names):
        return make_warning_finding(
            "this computer has no network address, so headsets cannot use --lan",
            "join the headset's network, or use a cable",
        )
    return make_ok_finding(", ".join(names))


def check_firewall(number: int, ufw: Path = UFW_CONFIG_FILE) -> Finding:
    """Check whether a firewall blocks the port ``number`` for headsets in the local network."""
    if ufw.is_file() and re.search(r"^ENABLED=yes", ufw.read_text(), re.MULTILINE):
        return make_warning_finding(
            "ufw is active and may block headsets with --lan",
            f"sudo ufw allow {number}/tcp, if you have not already",
        )
    program = shutil.which("firewall-cmd")
    if program is None or not _succeeds(program, "--state"):
        return make_ok_finding("neither ufw nor firewalld is active")
    if _succeeds(program, f"--query-port={number}/tcp"):
        return make_ok_finding(f"firewalld allows {number}/tcp")
    return make_warning_finding(
        f"firewalld blocks {number}/tcp for headsets of the network",
        f"sudo firewall-cmd --add-port={number}/tcp",
    )


def _succeeds(*command: str) -> bool:
    return (
        subprocess.run(command, capture_output=True, timeout=COMMAND_TIMEOUT_S, check=False).returncode == 0
    )


def check_certificate(expected: Certificate) -> Finding:
    """Check whether the certificate of --lan is valid, and whether other users can read its key."""
    if not expected.certificate_file.exists():
        return make_ok_finding(f"none yet; --lan creates one in {expected.certificate_file.parent}")
    if any(find_exposed_paths(expected.key_file)):
        return make_warning_finding(
            f"other users can read {expected.key_file}", f"chmod 600 '{expected.key_file}'"
        )
    reason = find_renewal_reason(expected)
    if reason is not None:
        return make_warning_finding(
            f"{expected.certificate_file}: {reason}",
            "nothing to do: --lan creates a new one, which you must trust again on each headset",
        )
    return make_ok_finding(f"{expected.certificate_file}")
