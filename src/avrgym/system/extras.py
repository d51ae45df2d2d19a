"""The extras of AVR Gym: groups of optional packages, installed by ``pip install 'avrgym[NAME]'``."""

import re
from functools import cache
from importlib.metadata import PackageNotFoundError, requires

DEVELOPER_EXTRAS = ("dev", "docs")
"""Names of the extras for developers of AVR Gym."""
_EVERYTHING = "all"
_DISTRIBUTIONS = {
    "google": "mcap_protobuf_support",
    "mcap_protobuf": "mcap_protobuf_support",
    "pxr": "usd_core",
    "ray": "ray",
    "rsl_rl": "rsl_rl_lib",
    "starlette": "fastapi",
    "warp": "warp_lang",
}
"""Distribution (installable package) of a module, if the two names differ."""


def find_extra(module: str, preferred: str | None = None) -> str | None:
    """Returns the smallest extra that installs a module such as ``mcap.reader``; ``None`` if no extra installs it.

    Args:
        module: name of the module.
        preferred: comma-separated extras. If one of them installs the module, ``preferred`` is returned.
    """
    root = module.partition(".")[0]
    distribution = _DISTRIBUTIONS.get(root, root).lower()
    found = sorted(
        (len(installed), extra) for extra, installed in _extras().items() if distribution in installed
    )
    names = [extra for _, extra in found]
    if preferred is not None and any(each in names for each in preferred.split(",")):
        return preferred
    return next(iter(names), None)


@cache
def _extras() -> dict[str, set[str]]:
    """Returns the names of the distributions of each extra. Nested extras are resolved."""
    try:
        lines = requires("avrgym") or ()
    except PackageNotFoundError:
        return {}
    found: dict[str, set[str]] = {}
    included: dict[str, list[str]] = {}
    for line in lines:
        parts = re.match(r"([\w.-]+)(?:\[([\w,.-]+)\])?.*extra == ['\"](\w+)['\"]", line)
        if parts is None or parts[3] in (*DEVELOPER_EXTRAS, _EVERYTHING):
            continue
        name, others, extra = parts.groups()
        distributions = found.setdefault(extra, set())
        if name == "avrgym":
            included.setdefault(extra, []).extend(others.split(","))
        else:
            distributions.add(re.sub(r"[-.]", "_", name).lower())
    for extra, others in included.items():
        found[extra].update(*(found[other] for other in others))
    return found
