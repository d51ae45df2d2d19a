"""Checks that a wheel or source distribution contains the browser client, the policies and the body meshes."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = Path("src", "avrgym")
PAGES = tuple(f"vr/static/{name}.html" for name in ("index", "dashboard", "replay", "trial"))
REVISED = {
    "Feeding": ("Panda", "Gen3", "UR5", "Stretch"),
    "ScratchItch": ("Stretch",),
    "ArmManipulation": ("Jaco", "PR2", "Panda", "Gen3", "UR5", "Stretch"),
}
"""Robots with a Revised policy only, by task."""
ASSETS = (
    *(f"assets/human/{name}" for name in ("man.npz", "woman.npz", "man.jpg", "woman.jpg", "hair.jpg")),
    *(
        f"assets/policies/{task}{robot}-{kind}.safetensors"
        for task in ("Feeding", "Drinking", "ScratchItch", "BedBathing")
        for robot in ("Jaco", "PR2")
        for kind in ("original", "revised", "adaptive")
    ),
    *(
        f"assets/policies/{task}{robot}-revised.safetensors"
        for task, robots in REVISED.items()
        for robot in robots
    ),
    "assets/study.toml",
)


class CustomBuildHook(BuildHookInterface):
    """Refuses to build an incomplete distribution."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the client's pages if only they are missing; abort if anything else is missing.

        Editable installations are not checked.
        """
        if version == "editable":
            return
        missing = self._missing(ASSETS)
        if not missing and self._missing(PAGES):
            self._build_pages()
        missing += self._missing(PAGES)
        if missing:
            self.app.abort(
                f"avrgym: missing in {Path(self.root, PACKAGE)}: {', '.join(missing)}; a complete clone contains "
                "policies and bodies; `make client` builds the pages and installs Node.js if needed"
            )

    def _missing(self, names: tuple[str, ...]) -> list[str]:
        return [name for name in names if not Path(self.root, PACKAGE, name).is_file()]

    def _build_pages(self) -> None:
        """Run ``make client`` where this is a clone and ``make`` is installed."""
        if shutil.which("make") and Path(self.root, "Makefile").is_file():
            subprocess.run(["make", "client"], cwd=self.root, stdout=sys.stderr, check=False)
