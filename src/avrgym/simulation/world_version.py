"""Versions of the simulated world: its physics, how episodes begin, and what is rewarded.

Whatever changes what a recording's steps lead to raises ``WORLD_VERSION`` once for each release. Recordings say which
version they were made with and are stepped again with that one.
"""

WORLD_VERSIONS = (1, 2)
WORLD_VERSION = WORLD_VERSIONS[-1]
"""That of new recordings. Version 1 is AVR Gym 0.1.0, whose recordings do not name theirs."""


def check_world_version(version: int) -> None:
    """Refuse a version that this release cannot make.

    Raises:
        ValueError: naming the versions there are.
    """
    if version not in WORLD_VERSIONS:
        known = ", ".join(map(str, WORLD_VERSIONS))
        raise ValueError(f"unknown world version {version!r}; this release makes {known}")
