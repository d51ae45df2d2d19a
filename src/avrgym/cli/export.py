"""The commands of ``avrgym export``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import PEOPLE, Impairment, SceneSettings, Seed
from avrgym.cli.terminal import print_line, report_errors

app = typer.Typer(no_args_is_help=True, help="Write policies and scenes for other programs.")


@app.command("policy")
def export_policy(
    policy: Annotated[str, typer.Argument(help="original, revised or a .safetensors file.")],
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.", metavar="ENV")],
    out: Annotated[Path, typer.Argument(help="A new .onnx file.", metavar="OUT.onnx")],
) -> None:
    """Write a trained policy as an ONNX file.

    The file maps observations to mean actions. `--policy OUT.onnx` and any ONNX runtime can use it.
    """
    from avrgym.policies.onnx import write_onnx
    from avrgym.policies.registry import find
    from avrgym.policies.trained import Policy

    with report_errors():
        found = find(policy, env)
        if not isinstance(found, Policy):
            raise ValueError(
                f"{policy} is not a trained policy; allowed: original, revised or a .safetensors file"
            )
        write_onnx(found, out)
        print_line(f"policy    {out}: {found.observation_size} numbers in, {found.action_size} out")
        if found.action_std:
            print_line(
                f"It was trained with exploration noise (standard deviation {found.action_std:g}); "
                "the file returns mean actions."
            )


@app.command("scene")
def export_scene(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.", metavar="ENV")],
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    people: Annotated[str, typer.Option(help=f"Population of people: {PEOPLE}.")] = "revised",
    impairment: Impairment = "none",
    seed: Seed = 0,
    settings: SceneSettings = None,
    usd: Annotated[bool, typer.Option("--usd", help="Also write the scene as USD.")] = False,
) -> None:
    """Write a scene at the start of an episode for MuJoCo and other programs.

    scene.mjb reproduces the simulation bit for bit. scene.xml (MJCF) can be read, edited and rendered. start.json
    contains the initial state.
    """
    import numpy as np

    from avrgym.envs.scene_files import MJB, MJCF, START, USD, check_new_folder, write_scene, write_usd
    from avrgym.system import random_streams
    from avrgym.tasks.episodes import Episodes
    from avrgym.tasks.settings import parse_settings

    with report_errors():
        if usd and find_spec("pxr") is None:
            raise ValueError("--usd needs usd-core; run `pip install avrgym[usd]`")
        check_new_folder(out)
        episodes = Episodes(
            env,
            1,
            people=people,
            impairment=impairment,
            num_threads=1,
            settings=parse_settings(settings or []),
        )
        episodes.reset(np.array([0]), [random_streams.episode_generator(seed)])
        write_scene(episodes, out)
        print_line(f"MJB       {out / MJB}: the physics model, without appearance")
        print_line(f"MJCF      {out / MJCF}: with appearance; the person's body is stiffer")
        print_line(f"start     {out / START}")
        if usd:
            write_usd(episodes, out / USD)
            print_line(f"USD       {out / USD}: appearance at the start")
