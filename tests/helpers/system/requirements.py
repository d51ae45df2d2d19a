"""Requirements of the package without extras."""

import re
from importlib import metadata

from packaging.requirements import Requirement


def required(name: str = "avrgym") -> set[str]:
    """Return the direct and indirect requirements of a distribution, without extras."""
    needed = (Requirement(each) for each in metadata.requires(name) or ())
    own = {each.name for each in needed if each.marker is None or each.marker.evaluate({"extra": ""})}
    return own.union(*map(required, own))


def modules_of_extras() -> set[str]:
    """Return the top-level modules of installed distributions that the core does not require."""
    core = {_normalised(each) for each in ("avrgym", *required())}
    found = metadata.packages_distributions().items()
    return {module for module, names in found if not core & {_normalised(each) for each in names}}


def _normalised(name: str) -> str:
    return re.sub("[-_.]+", "-", name).lower()
