"""Whether what AVR Gym is made of is installed as it asks for."""

import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, metadata, requires, version

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from avrgym.doctor.finding import Finding, error, ok, warning
from avrgym.policies.registry import skipped_plugins
from avrgym.system.extras import DEVELOPER_EXTRAS
from avrgym.vr.server.web_server import INSTALL_PAGES, PAGES, ServerError, check_page

SHOWN_PACKAGES = ("mujoco", "numpy", "gymnasium")
"""The packages whose versions most reports of bugs need."""


def python(running: str, asked: str | None = None) -> Finding:
    """Whether the Python of this version is new enough for AVR Gym, or for what is ``asked``, as in ``>=3.11``."""
    wanted = asked or metadata("avrgym")["Requires-Python"]
    if SpecifierSet(wanted).contains(running, prereleases=True):
        return ok(f"{running} on {platform.system()} {platform.machine()}")
    return error(
        f"{running}; AVR Gym asks for {wanted}",
        "make a virtual environment with a newer Python and install AVR Gym there",
    )


def packages(wanted: Sequence[Requirement]) -> Finding:
    """Whether packages are installed in the versions that are asked for, such as ``numpy>=2.0``."""
    unmet = [each for each in wanted if _conflicting_version(each) is not None]
    if unmet:
        return error(_list_unmet(unmet), _install(unmet))
    shown = ", ".join(f"{each.name} {version(each.name)}" for each in wanted if each.name in SHOWN_PACKAGES)
    return ok(f"{len(wanted)} packages are as asked for; {shown}")


def requirements_of(extra: str = "") -> list[Requirement]:
    """Requirements of the installed AVR Gym, or of one of its extras with the extras that it includes."""
    needed = [Requirement(each) for each in requires("avrgym") or ()]
    own = [each for each in needed if _applies(each, extra) and not (extra and _applies(each, ""))]
    included = (
        inner
        for each in own
        if each.name == "avrgym"
        for name in each.extras
        for inner in requirements_of(name)
    )
    return [*(each for each in own if each.name != "avrgym"), *included]


def offered_extras() -> list[str]:
    """The extras of the installed AVR Gym that its users may want."""
    return [
        each for each in metadata("avrgym").get_all("Provides-Extra") or () if each not in DEVELOPER_EXTRAS
    ]


def _applies(needed: Requirement, extra: str) -> bool:
    return needed.marker is None or needed.marker.evaluate({"extra": extra})


def extras(wanted: Mapping[str, Sequence[Requirement]]) -> Finding:
    """Which extras are installed, of those with what they ask for; a package in another version is a warning."""
    wrong = [each for asked in wanted.values() for each in asked if _conflicting_version(each)]
    if wrong:
        return warning(_list_unmet(wrong), _install(wrong))
    there = [
        name for name, asked in wanted.items() if all(_conflicting_version(each) is None for each in asked)
    ]
    missing = [name for name in wanted if name not in there]
    without = f"; `pip install 'avrgym[{','.join(missing)}]'` brings the others" if missing else ""
    return ok(f"installed: {', '.join(there) or 'none'}{without}")


def client() -> Finding:
    """Whether the browser's pages are there."""
    try:
        for page in PAGES:
            check_page(page)
    except ServerError:
        return error("the browser client is missing", INSTALL_PAGES)
    return ok("the pages of participant, experimenter and replay are there")


def plugins() -> Finding:
    """Whether what other packages register can be used."""
    skipped = skipped_plugins()
    if skipped:
        return warning(f"skipped {'; '.join(skipped)}", "mend or uninstall that package; the rest works")
    return ok("nothing of other packages is broken")


def _conflicting_version(wanted: Requirement) -> str | None:
    """The installed version where it is another than asked for, "" where none is installed, else ``None``."""
    try:
        found = version(wanted.name)
    except PackageNotFoundError:
        return ""
    return None if wanted.specifier.contains(found, prereleases=True) else found


def _list_unmet(unmet: Iterable[Requirement]) -> str:
    found = ((each, _conflicting_version(each)) for each in unmet)
    return ", ".join(
        f"{each.name} {number or 'is missing'} (asked for: {each.specifier or 'any'})"
        for each, number in found
    )


def _install(unmet: Iterable[Requirement]) -> str:
    return " ".join(["pip install", *(f"'{each.name}{each.specifier}'" for each in unmet)])
