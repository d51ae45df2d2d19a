"""The command ``avrgym demo``."""

from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import SeedOption
from avrgym.cli.terminal import print_line, report_errors


def demo(
    out: Annotated[Path, typer.Option(help="A folder for recordings, pictures and pages.")] = Path("demo"),
    seed: SeedOption = 0,
) -> None:
    """Run a simulated session and write a 3D replay of each trial.

    The session has one trial each of feeding, drinking, itch scratching and bed bathing, with Jaco or PR2. The command
    takes about two minutes.
    """
    from avrgym.demo import run_demo

    with report_errors():
        result = run_demo(_unused_folder(out), seed, lambda text: print_line(f"  {text}"))
    for recording in result.recordings:
        print_line(f"recorded  {recording}")
    for page in result.pages:
        print_line(f"page      {page}")
    if result.browser_error:
        print_line(
            "No browser was found for images of the participant's view; `avrgym doctor` shows how to install one."
        )
    else:
        print_line(f"pictures  {result.pages[0].parent / 'pictures'}, the participant's view")
    print_line(
        f"Open {result.pages[0]} in a browser: the trial in 3D. `avrgym serve` starts the server for a headset."
    )


def _unused_folder(wanted: Path) -> Path:
    """Returns the first free path of wanted, wanted-2, wanted-3 …: no folder, or an empty folder."""
    number, folder = 1, wanted
    while folder.exists() and any(folder.iterdir()):
        number += 1
        folder = wanted.with_name(f"{wanted.name}-{number}")
    return folder
