"""The commands ``avrgym export``."""

from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.terminal import plain_errors, say

app = typer.Typer(no_args_is_help=True, help="Write policies for other programs.")


@app.command("policy")
def export_policy(
    policy: Annotated[str, typer.Argument(help="original, revised or a .safetensors file.")],
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.", metavar="ENV")],
    out: Annotated[Path, typer.Argument(help="A new .onnx file.", metavar="OUT.onnx")],
) -> None:
    """Write a trained policy as an ONNX file.

    The graph takes observations and gives mean actions. Whatever runs ONNX runs it, `--policy OUT.onnx` too.
    """
    from avrgym.policies.registry import find
    from avrgym.policies.trained import Policy

    with plain_errors():
        try:
            from avrgym.policies.onnx_export import write_onnx
        except ModuleNotFoundError as error:
            raise ValueError(f"{error.name} is missing; `pip install avrgym[onnx]` brings it") from error
        found = find(policy, env)
        if not isinstance(found, Policy):
            raise ValueError(
                f"{policy} is no trained policy; allowed: original, revised or a .safetensors file"
            )
        write_onnx(found, out)
        say(f"policy    {out}: {found.observation_size} numbers in, {found.action_size} out")
        if found.action_deviation:
            say(
                f"It was trained to act with chance, ±{found.action_deviation:g}; the file holds its mean actions."
            )
