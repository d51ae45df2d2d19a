"""Finds robot descriptions and meshes in the installed package ``rtb-data``."""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import rtbdata


def find_rtb_data_path(path: str) -> Path:
    """Returns the path of a folder or file of the package, such as ``kinova_description/meshes``."""
    return Path(next(iter(rtbdata.__path__))) / "xacro" / path


def add_meshes(spec: mujoco.MjSpec, folder: str, meshes: Mapping[str, str]) -> None:
    """Add visual meshes to bodies. ``meshes`` maps each body to a file in the folder ``folder`` of the package.

    Raises:
        RuntimeError: if packages that read the meshes are missing.
    """
    try:
        from avrgym.models.urdf import add_trimesh, compute_mesh_colour, read_mesh
    except ImportError as error:
        raise RuntimeError(
            f"the package {error.name} is missing; it reads the meshes of the robot. Run `pip install avrgym[vr]`"
        ) from error

    for body, file in meshes.items():
        for number, part in enumerate(read_mesh(find_rtb_data_path(folder) / file)):
            add_trimesh(spec, spec.body(body), f"{body}_{number}", part, rgb=compute_mesh_colour(part))
