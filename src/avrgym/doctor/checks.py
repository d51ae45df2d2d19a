"""All checks of this computer, in the order of output."""

import platform
from collections.abc import Iterator
from pathlib import Path

from avrgym.doctor import connections, graphics, installation, machine
from avrgym.doctor.finding import Check, Finding, make_error_finding
from avrgym.doctor.installation import find_requirements, list_user_extras
from avrgym.system.files import get_user_data_folder
from avrgym.vr.server.certificate import find_lan_host_names, locate_certificate
from avrgym.vr.server.network_addresses import DEFAULT_PORT

COMPUTER_CHECKS = (
    Check("Python", lambda: installation.check_python(platform.python_version())),
    Check("packages", lambda: installation.check_packages(installation.find_requirements())),
    Check(
        "extras",
        lambda: installation.check_extras({name: find_requirements(name) for name in list_user_extras()}),
    ),
    Check("plug-ins", installation.check_plugins),
    Check("client", installation.check_browser_client),
    Check("graphics card", graphics.check_graphics_card),
    Check("OpenGL", graphics.check_rendering),
    Check("browser", connections.check_browser),
    Check("headset", connections.check_headset),
    Check("port", lambda: connections.check_port(DEFAULT_PORT)),
    Check("network", lambda: connections.check_network(find_lan_host_names())),
    Check("firewall", lambda: connections.check_firewall(DEFAULT_PORT)),
    Check(
        "certificate",
        lambda: connections.check_certificate(
            locate_certificate(get_user_data_folder(), find_lan_host_names())
        ),
    ),
    Check("processors", machine.check_processor_count),
    Check("priority", machine.check_real_time_priority),
    Check("timer", lambda: machine.check_sleep_precision(machine.measure_oversleep_s())),
    Check("CPU idle states", machine.check_cpu_idle_states),
    Check("open files", machine.check_open_file_limit),
    Check("disk", lambda: machine.check_free_space(Path.cwd())),
    Check("this folder", lambda: machine.check_folder_writable(Path.cwd())),
    Check("data folder", lambda: machine.check_folder_writable(get_user_data_folder())),
)


def run_checks(checks: tuple[Check, ...] = COMPUTER_CHECKS) -> Iterator[tuple[str, Finding]]:
    """Yields the name and the finding of each check. If a check raises an exception, its finding is an error."""
    for check in checks:
        try:
            yield check.name, check.run_check()
        except Exception as failure:  # a broken installation may raise anything
            yield (
                check.name,
                make_error_finding(f"the check failed: {failure!r}", "report this line as an issue"),
            )
