"""The commands of ``avrgym export``."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from avrgym.cli.options import (
    ALLOWED_PEOPLE_TEXT,
    EpisodeStepsOption,
    ImpairmentOption,
    SeedOption,
    SettingsOption,
)
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import print_line, report_errors
from avrgym.policies.policy_names import POLICY_CHOICES_TEXT
from avrgym.tasks.constants import EPISODE_STEPS

CameraOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Also write colour images of a camera, such as wrist:128x96. Repeatable.", metavar="CAMERA"
    ),
]

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
    from avrgym.policies.registry import resolve_policy
    from avrgym.policies.trained_policies import Policy

    with report_errors():
        found = resolve_policy(policy, env)
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


@app.command("demonstrations")
def export_demonstrations(
    source: Annotated[Path, typer.Argument(help="A folder of `avrgym demonstrate`.", metavar="FOLDER")],
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    camera: CameraOption = None,
) -> None:
    """Write the successful demonstrations of a folder as a LeRobot dataset."""
    with report_errors():
        _check_dataset_packages()
        from avrgym.vr.demonstration.dataset import write_lerobot_dataset

        with show_progress_bar("demonstrations", None, "episodes") as bar:
            omitted = write_lerobot_dataset(source, out, camera or [], bar.update)
        print_line(f"dataset   {out}")
        for reason in omitted:
            print_line(f"omitted   {reason}")
        _print_training(out)


@app.command("simulated-demonstrations")
def export_simulated_demonstrations(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.", metavar="ENV")],
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    policy: Annotated[
        str, typer.Option(help=f"The policy that the simulated operator follows: {POLICY_CHOICES_TEXT}.")
    ] = "oracle",
    episodes: Annotated[int, typer.Option(help="Number of successful episodes.", min=1)] = 50,
    people: Annotated[str, typer.Option(help=f"Population of people: {ALLOWED_PEOPLE_TEXT}.")] = "revised",
    impairment: ImpairmentOption = "none",
    camera: CameraOption = None,
    settings: SettingsOption = None,
    episode_steps: EpisodeStepsOption = EPISODE_STEPS,
    seed: SeedOption = 0,
) -> None:
    """Write demonstrations of a simulated operator as a LeRobot dataset.

    The operator acts 0.2 s later than the policy and less precisely. Failed attempts are discarded.
    """
    with report_errors():
        _check_dataset_packages()
        from avrgym.learning import demonstrations
        from avrgym.learning.lerobot_dataset import write_dataset
        from avrgym.models.cameras import parse_cameras
        from avrgym.policies.registry import resolve_policy
        from avrgym.system.files import write_folder_atomically
        from avrgym.tasks.episodes import Episodes
        from avrgym.tasks.settings import parse_settings

        if out.exists():
            raise FileExistsError(f"{out} already exists; choose another name")
        changes = parse_settings(settings or [])
        world = Episodes(
            env,
            min(episodes, demonstrations.MAX_WORLDS),
            people=people,
            impairment=impairment,
            settings=changes,
        )
        cameras = parse_cameras(camera or [], world.scene.robot)
        totals = demonstrations.DemonstrationCounts(0, 0)
        with show_progress_bar(f"demonstrating {env}", episodes, "episodes") as bar:

            def report(latest: demonstrations.DemonstrationCounts) -> None:
                nonlocal totals
                totals = latest
                bar.update(totals.successes)

            shown = demonstrations.simulate_demonstrations(
                world, resolve_policy(policy, env, changes), episodes, episode_steps, seed, cameras, report
            )
            about = {
                "observation": world.observation_spec,
                "scene": world.scene,
                "control_hz": world.settings.control_hz,
            }
            write_folder_atomically(out, lambda folder: write_dataset(folder, shown, **about))
        print_line(f"dataset   {out}")
        print_line(f"successes {totals.successes} of {totals.attempts} attempts")
        _print_training(out)


def _check_dataset_packages() -> None:
    """Raise ``ValueError`` if a package that writes LeRobot datasets is missing."""
    if find_spec("pyarrow") is None:
        raise ValueError("LeRobot datasets need pyarrow; run `pip install avrgym[export]`")


def _print_training(dataset: Path) -> None:
    """Print the command that trains a LeRobot policy with this dataset."""
    print_line("Train a policy with LeRobot")
    print_line(
        f"    lerobot-train --dataset.repo_id=avrgym/{dataset.name} --dataset.root={dataset} --policy.type=act "
        "--policy.push_to_hub=false --output_dir=act"
    )


@app.command("scene")
def export_scene(
    env: Annotated[str, typer.Argument(help="An environment id; `avrgym envs` lists them.", metavar="ENV")],
    out: Annotated[Path, typer.Argument(help="A new folder.", metavar="OUT")],
    people: Annotated[str, typer.Option(help=f"Population of people: {ALLOWED_PEOPLE_TEXT}.")] = "revised",
    impairment: ImpairmentOption = "none",
    seed: SeedOption = 0,
    settings: SettingsOption = None,
    usd: Annotated[bool, typer.Option("--usd", help="Also write the scene as USD.")] = False,
) -> None:
    """Write a scene at the start of an episode for MuJoCo and other programs.

    scene.mjb reproduces the simulation bit for bit. scene.xml (MJCF) can be read, edited and rendered. start.json
    contains the initial state.
    """
    import numpy as np

    from avrgym.envs.scene_files import (
        INITIAL_STATE_FILE,
        MJB_FILE,
        MJCF_FILE,
        USD_FILE,
        check_new_folder,
        write_scene,
        write_usd,
    )
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
        episodes.reset(np.array([0]), [random_streams.make_episode_rng(seed)])
        write_scene(episodes, out)
        print_line(f"MJB       {out / MJB_FILE}: the physics model, without appearance")
        print_line(f"MJCF      {out / MJCF_FILE}: with appearance; the person's body is stiffer")
        print_line(f"start     {out / INITIAL_STATE_FILE}")
        if usd:
            write_usd(episodes, out / USD_FILE)
            print_line(f"USD       {out / USD_FILE}: appearance at the start")
