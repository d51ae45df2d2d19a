"""Robot descriptions of the installed package ``rtb-data``."""

from pathlib import Path

import rtbdata


def rtb_data_path(path: str) -> Path:
    """Path of a folder or file of the package, such as ``kinova_description/meshes``."""
    return Path(next(iter(rtbdata.__path__))) / "xacro" / path
