"""What a wheel or a source distribution must hold before it is built: the browser client."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PAGES = ("index.html", "dashboard.html", "replay.html", "trial.html")


class CustomBuildHook(BuildHookInterface):
    """Refuses to build an installation that could not serve."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """End the build where a page is missing; an editable installation finds it once it is built."""
        static = Path(self.root) / "src" / "avrgym" / "vr" / "static"
        missing = [name for name in PAGES if not (static / name).is_file()]
        if missing and version != "editable":
            self.app.abort(
                f"avrgym: the browser client is not built ({', '.join(missing)} missing in {static}); "
                "run `make client` first, which brings Node.js where there is none, or use `pip install -e .`"
            )
