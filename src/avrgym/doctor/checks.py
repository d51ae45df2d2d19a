"""All checks of this computer, in the order of output."""

import platform
from collections.abc import Iterator
from pathlib import Path

from avrgym.doctor import connections, graphics, installation, machine
from avrgym.doctor.finding import Check, Finding, error
from avrgym.doctor.installation import offered_extras, requirements_of
from avrgym.system.files import user_data_folder
from avrgym.vr.server.addresses import PORT
from avrgym.vr.server.certificate import certificate_in, lan_names

CHECKS = (
    Check("Python", lambda: installation.python(platform.python_version())),
    Check("packages", lambda: installation.packages(installation.requirements_of())),
    Check("extras", lambda: installation.extras({name: requirements_of(name) for name in offered_extras()})),
    Check("plug-ins", installation.plugins),
    Check("client", installation.client),
    Check("graphics card", graphics.graphics_card),
    Check("OpenGL", graphics.rendering),
    Check("browser", connections.browser),
    Check("headset", connections.headset),
    Check("port", lambda: connections.port(PORT)),
    Check("network", lambda: connections.network(lan_names())),
    Check("firewall", lambda: connections.firewall(PORT)),
    Check("certificate", lambda: connections.certificate(certificate_in(user_data_folder(), lan_names()))),
    Check("processors", machine.processors),
    Check("priority", machine.real_time_priority),
    Check("timer", lambda: machine.timer(machine.oversleep_s())),
    Check("CPU idle states", machine.cpu_idle_states),
    Check("open files", machine.open_file_limit),
    Check("disk", lambda: machine.free_space(Path.cwd())),
    Check("this folder", lambda: machine.writable(Path.cwd())),
    Check("data folder", lambda: machine.writable(user_data_folder())),
)


def run_checks(checks: tuple[Check, ...] = CHECKS) -> Iterator[tuple[str, Finding]]:
    """Run all checks; yield the name and result of each. An exception in a check becomes an error."""
    for check in checks:
        try:
            yield check.name, check.run()
        except Exception as failure:  # a broken installation may raise anything
            yield check.name, error(f"the check failed: {failure!r}", "report this line as an issue")
