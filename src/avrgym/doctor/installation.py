"""Check the installation: Python, packages, extras, client and plug-ins."""

import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, metadata, requires, version

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from avrgym.doctor.finding import Finding, make_error_finding, make_ok_finding, make_warning_finding
from avrgym.policies.registry import collect_skipped_plugin_errors
from avrgym.system.extras import DEVELOPER_EXTRAS
from avrgym.vr.server.web_server import CLIENT_INSTALL_HINT, CLIENT_PAGES, ServerError, check_client_page

REPORTED_PACKAGES = ("mujoco", "numpy", "gymnasium")
"""Packages whose versions are printed for bug reports."""


def check_python(installed: str, requirement: str | None = None) -> Finding:
    """Check the Python version ``installed``. ``requirement``: such as ``>=3.11``; default: the requirement of AVR
    Gym."""
    required = requirement or metadata("avrgym")["Requires-Python"]
    if SpecifierSet(required).contains(installed, prereleases=True):
        return make_ok_finding(f"{installed} on {platform.system()} {platform.machine()}")
    return make_error_finding(
        f"{installed}; AVR Gym requires {required}",
        "create a virtual environment with a newer Python and install AVR Gym there",
    )


def check_packages(requirements: Sequence[Requirement]) -> Finding:
    """Check whether the installed packages meet requirements such as ``numpy>=2.0``."""
    unmet = [each for each in requirements if _conflicting_version(each) is not None]
    if unmet:
        return make_error_finding(_list_unmet(unmet), _install(unmet))
    shown = ", ".join(
        f"{each.name} {version(each.name)}" for each in requirements if each.name in REPORTED_PACKAGES
    )
    return make_ok_finding(f"{len(requirements)} packages meet their requirements; {shown}")


def find_requirements(extra: str = "") -> list[Requirement]:
    """Returns requirements of the installed ``avrgym`` package, or of one of its extras. Nested extras are resolved."""
    needed = [Requirement(each) for each in requires("avrgym") or ()]
    own = [each for each in needed if _applies(each, extra) and not (extra and _applies(each, ""))]
    included = (
        inner
        for each in own
        if each.name == "avrgym"
        for name in each.extras
        for inner in find_requirements(name)
    )
    return [*(each for each in own if each.name != "avrgym"), *included]


def list_user_extras() -> list[str]:
    """Returns the extras of the installed ``avrgym`` package, without the extras for developers."""
    return [
        each for each in metadata("avrgym").get_all("Provides-Extra") or () if each not in DEVELOPER_EXTRAS
    ]


def _applies(needed: Requirement, extra: str) -> bool:
    return needed.marker is None or needed.marker.evaluate({"extra": extra})


def check_extras(requirements: Mapping[str, Sequence[Requirement]]) -> Finding:
    """Check the packages of the extras. If a package has a wrong version, the finding is a warning.

    ``requirements``: required packages, by the name of the extra.
    """
    wrong = [each for required in requirements.values() for each in required if _conflicting_version(each)]
    if wrong:
        return make_warning_finding(_list_unmet(wrong), _install(wrong))
    installed = [
        name
        for name, required in requirements.items()
        if all(_conflicting_version(each) is None for each in required)
    ]
    missing = [name for name in requirements if name not in installed]
    without = f"; `pip install 'avrgym[{','.join(missing)}]'` installs the others" if missing else ""
    return make_ok_finding(f"installed: {', '.join(installed) or 'none'}{without}")


def check_browser_client() -> Finding:
    """Check whether the pages of the browser client are installed."""
    try:
        for page in CLIENT_PAGES:
            check_client_page(page)
    except ServerError:
        return make_error_finding("the browser client is missing", CLIENT_INSTALL_HINT)
    return make_ok_finding("the pages of participant, experimenter and replay are installed")


def check_plugins() -> Finding:
    """Check whether all plug-ins of other packages can be loaded."""
    skipped = collect_skipped_plugin_errors()
    if skipped:
        return make_warning_finding(
            f"skipped {'; '.join(skipped)}", "fix or uninstall that package; other packages work"
        )
    return make_ok_finding("all plug-ins can be loaded")


def _conflicting_version(requirement: Requirement) -> str | None:
    """Returns the installed version of a package if it conflicts with the requirement.

    If the package is missing, returns "". Without a conflict, returns ``None``.
    """
    try:
        found = version(requirement.name)
    except PackageNotFoundError:
        return ""
    return None if requirement.specifier.contains(found, prereleases=True) else found


def _list_unmet(unmet: Iterable[Requirement]) -> str:
    found = ((each, _conflicting_version(each)) for each in unmet)
    return ", ".join(
        f"{each.name} {number or 'is missing'} (required: {each.specifier or 'any'})"
        for each, number in found
    )


def _install(unmet: Iterable[Requirement]) -> str:
    return " ".join(["pip install", *(f"'{each.name}{each.specifier}'" for each in unmet)])
