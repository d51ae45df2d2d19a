"""The command ``avrgym clone``: fit a policy to demonstrations."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import SeedOption
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import print_line, report_errors


def clone(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.")],
    datasets: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of `avrgym export demonstrations`, without images.", metavar="DATASET..."
        ),
    ],
    out: Annotated[Path, typer.Option(help="A new file.", metavar="FILE")] = Path("clone.safetensors"),
    episodes: Annotated[
        int | None, typer.Option(help="Number of episodes of each dataset; by default all.", min=1)
    ] = None,
    seed: SeedOption = 0,
) -> None:
    """Fit a recurrent policy to demonstrations (behaviour cloning).

    Corrections of a policy have the same total weight as all other demonstrations. Install `avrgym[train,export]`
    first.
    """
    with report_errors():
        for module, extra in (("pyarrow", "export"), ("torch", "train")):
            if find_spec(module) is None:
                raise ValueError(f"clone needs {module}; run `pip install avrgym[{extra}]`")
        if out.exists():
            raise FileExistsError(f"{out} already exists; choose another file with --out FILE")
        from avrgym.learning import behaviour_cloning

        read = behaviour_cloning.read_episodes(env, datasets, episodes)
        loss = 0.0
        with show_progress_bar("cloning", behaviour_cloning.GRADIENT_STEPS, "steps") as bar:

            def report(steps: int, latest: float) -> None:
                nonlocal loss
                loss = latest
                bar.update(steps)

            behaviour_cloning.clone(env, read, seed, report).save(out)
        print_line(f"episodes  {read.actions.shape[1]}; mean squared error of the actions {loss:.4f}")
        print_line(f"policy    {out}")
        print_line(f"    avrgym evaluate {env} --policy {out} --people participants")
