"""The command ``avrgym demo``."""

from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import Seed
from avrgym.cli.terminal import plain_errors, say


def demo(
    out: Annotated[Path, typer.Option(help="A folder for recordings, pictures and report.")] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Run a simulated participant's session, then its report.

    In all four tasks, with both robots; takes about two minutes.
    """
    from avrgym.demo.session import run_demo

    with plain_errors():
        folder = _free_folder(out)
        result = run_demo(folder, seed, lambda text: say(f"  {text}"))
    for recording in result.recordings:
        say(f"recorded  {recording}")
    say(f"report    {result.report}")
    if result.without_browser:
        say("There was no browser, so the report has no pictures through the participant's eyes.")
    say("Open the report in a browser. `avrgym serve` starts the live server for a headset.")


def _free_folder(wanted: Path) -> Path:
    """The wanted folder, or the first of wanted-2, wanted-3 and so on that holds nothing yet."""
    number, folder = 1, wanted
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder
