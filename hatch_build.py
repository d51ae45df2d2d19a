"""What a wheel or a source distribution must hold before it is built: the browser client, policies and bodies."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = Path("src", "avrgym")
PAGES = tuple(f"vr/static/{name}.html" for name in ("index", "dashboard", "replay", "trial"))
ASSETS = (
    *(f"assets/human/{name}" for name in ("man.npz", "woman.npz", "man.jpg", "woman.jpg", "hair.jpg")),
    *(
        f"assets/policies/{task}{robot}-{kind}.safetensors"
        for task in ("Feeding", "Drinking", "ScratchItch", "BedBathing")
        for robot in ("Jaco", "PR2")
        for kind in ("original", "revised", "adaptive")
    ),
    "assets/study.toml",
)


class CustomBuildHook(BuildHookInterface):
    """Refuses to build an installation that could not serve."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the pages if only they are missing; end the build where anything is.

        An editable installation finds them once they are built.
        """
        if version == "editable":
            return
        missing = self._missing(ASSETS)
        if not missing and self._missing(PAGES):
            self._build_pages()
        missing += self._missing(PAGES)
        if missing:
            self.app.abort(
                f"avrgym: missing in {Path(self.root, PACKAGE)}: {', '.join(missing)}; a whole clone holds policies "
                "and bodies, and `make client` builds the pages, with Node.js that it brings where there is none"
            )

    def _missing(self, names: tuple[str, ...]) -> list[str]:
        return [name for name in names if not Path(self.root, PACKAGE, name).is_file()]

    def _build_pages(self) -> None:
        """As ``make client`` does, in a clone on a machine with ``make``."""
        if shutil.which("make") and Path(self.root, "Makefile").is_file():
            subprocess.run(["make", "client"], cwd=self.root, stdout=sys.stderr, check=False)
