"""The public robot descriptions that the installed ``rtb-data`` ships."""

from pathlib import Path

import rtbdata


def rtb_data_path(path: str) -> Path:
    """A folder or file among them, such as ``kinova_description/meshes``."""
    return Path(next(iter(rtbdata.__path__))) / "xacro" / path
