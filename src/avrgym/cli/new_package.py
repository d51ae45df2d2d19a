"""The program ``avrgym new``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.terminal import print_line, report_errors

if TYPE_CHECKING:
    from avrgym.skeletons.package_files import PackageKind

app = typer.Typer(no_args_is_help=True, help="Create a package with a task, robot or controller.")
ClassNameArgument = Annotated[
    str, typer.Argument(help="The name: a capital letter, then letters and digits, such as LiftArm.")
]
OutputFolderOption = Annotated[
    Path | None,
    typer.Option(help="A new folder; default: the package's name, in the current folder.", metavar="DIR"),
]


@app.command()
def task(name: ClassNameArgument, out: OutputFolderOption = None) -> None:
    """Create a package with a task.

    It contains a scene, an initial state, an observation, rewards, a success criterion and experts.
    """
    _write("task", name, out)


@app.command()
def robot(name: ClassNameArgument, out: OutputFolderOption = None) -> None:
    """Create a package with a robot.

    It contains a model, an arm, grips and mounts.
    """
    _write("robot", name, out)


@app.command()
def controller(name: ClassNameArgument, out: OutputFolderOption = None) -> None:
    """Create a package with a controller.

    It can be used with --policy.
    """
    _write("controller", name, out)


def _write(kind: "PackageKind", name: str, out: Path | None) -> None:
    from avrgym.skeletons.package_files import make_package_name, write_plugin_package

    with report_errors():
        for path in write_plugin_package(kind, name, out):
            print_line(f"written   {path}")
    folder = out or Path(make_package_name(name))
    print_line(f"Next: `pip install -e '{folder}'`, then read {folder / 'README.md'}")
