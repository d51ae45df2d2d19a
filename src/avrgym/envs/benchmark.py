"""Measures the speed of environments, and the speed of physics alone in the same worlds."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from mujoco.batch import Batch

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import to_device_of
from avrgym.models.cameras import IMAGE_KINDS, WRIST_CAMERA, CameraSpec
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.simulation.engines.engine import Engine
from avrgym.system import random_streams
from avrgym.system.engine_names import THREADS
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes

NUM_RUNS = 5
"""Number of measurement runs of an environment; medians over these runs are reported."""


@dataclass(frozen=True)
class SimulationSpeed:
    """Speed of an environment: medians over runs of whole episodes with random actions and static people.

    ``steps_per_second``: number of control steps (0.1 s) per second, with resets, observations and rewards.
    ``reset_ms_per_env``: duration of a reset, divided by the number of worlds. ``physics_steps_per_second``: number of
    physics steps (10 ms) per second without any other computation, with the same models, initial states and commands.
    ``ratio``: duration of these physics steps divided by the duration of whole episodes. If the engine uses a device,
    control steps run on the device, as in training.
    """

    env: str
    engine: str
    device: str
    num_envs: int
    threads: int
    steps_per_second: float
    reset_ms_per_env: float
    physics_steps_per_second: float
    ratio: float


@dataclass(frozen=True)
class _Run:
    reset_s: float
    episode_s: float
    physics_s: float


def measure_simulation_speed(
    environment_id: str, num_envs: int, progress: Callable[[], None] = lambda: None, engine: str = THREADS
) -> SimulationSpeed:
    """Measures the speed of an environment ``NUM_RUNS`` times. Returns the median results. ``progress`` is called after
    each run.

    Raises:
        ValueError: for an unknown environment or engine, or fewer than one world.
        RuntimeError: if a package that the engine needs is not installed.
    """
    if num_envs < 1:
        raise ValueError(f"num_envs is {num_envs}; allowed: 1 or more")
    episodes = Episodes(
        environment_id, num_envs, people="revised", engine=engine, on_device=engine != THREADS
    )
    _run(episodes, seed=0, steps=2)
    runs: list[_Run] = []
    for seed in range(NUM_RUNS):
        runs.append(_run(episodes, seed, EPISODE_STEPS))
        progress()
    steps = num_envs * EPISODE_STEPS
    return SimulationSpeed(
        env=environment_id,
        engine=episodes.simulation.engine.name,
        device=episodes.simulation.engine.device,
        num_envs=num_envs,
        threads=episodes.simulation.batch.nthread,
        steps_per_second=median(steps / (run.reset_s + run.episode_s) for run in runs),
        reset_ms_per_env=median(1000.0 * run.reset_s / num_envs for run in runs),
        physics_steps_per_second=median(DEFAULT_SUBSTEPS * steps / run.physics_s for run in runs),
        ratio=median(run.physics_s / (run.reset_s + run.episode_s) for run in runs),
    )


CAMERA_SIZES_PX = ((64, 64), (128, 128), (640, 480))
"""Width and height of the images for which the rendering speed is measured."""
NUM_IMAGES = 10
"""Number of images of one kind and size in a measurement."""


@dataclass(frozen=True)
class CameraSpeed:
    """Rendering speed of one camera, without physics.

    ``kind`` is the type of image, such as ``depth``. ``size_px`` is width × height. ``frames_per_second`` is the number
    of images per second.
    """

    env: str
    camera: str
    kind: str
    size_px: str
    frames_per_second: float


def measure_camera_speed(
    environment_id: str, progress: Callable[[], None] = lambda: None, frames: int = NUM_IMAGES
) -> list[CameraSpeed]:
    """Measures the image rate of the wrist camera. Returns one result for each kind and size of images.

    ``progress`` is called after each kind and size.

    Raises:
        ValueError: for an unknown environment.
        RuntimeError: if nothing can be rendered. The message contains a setting that may help.
    """
    episodes = Episodes(environment_id, 1, people="revised", num_threads=1)
    _reset(episodes, seed=0)
    rows: list[CameraSpeed] = []
    for (width, height), kind in product(CAMERA_SIZES_PX, IMAGE_KINDS):
        camera = CameraSpec(WRIST_CAMERA, width, height, (kind,))
        episodes.render_images([camera])  # compiles the appearance
        began = perf_counter()
        for _ in range(frames):
            episodes.render_images([camera])
        speed = frames / (perf_counter() - began)
        rows.append(CameraSpeed(environment_id, WRIST_CAMERA, kind, f"{width} x {height}", speed))
        progress()
    episodes.close_renderer()
    return rows


def _run(episodes: Episodes, seed: int, steps: int) -> _Run:
    """Runs ``steps`` control steps of all worlds with all computations, then with physics alone. Returns both
    durations.
    """
    engine = episodes.simulation.engine
    drawn = random_streams.make_benchmark_action_rng(seed).uniform(
        -1.0, 1.0, (steps, episodes.simulation.num_worlds, episodes.action_size)
    )
    actions = to_device_of(drawn, episodes.simulation.reference_array)
    began = perf_counter()
    _reset(episodes, seed)
    reset_s = perf_counter() - began
    apart = _copy_of(engine.batch) if engine.name == THREADS else None
    began = perf_counter()
    commands: list[FloatArray] = []
    for action in actions:
        episodes.step(action)
        commands.append(episodes.simulation.get_servo_commands())
    episodes.check_device_results()  # this waits until a device has finished
    episode_s = perf_counter() - began
    if apart is None:  # a second set of worlds would need twice the memory of the device
        _reset(episodes, seed)
        return _Run(reset_s, episode_s, _physics_s(engine, engine.world_arrays.ctrl, engine.step, commands))
    return _Run(
        reset_s, episode_s, _physics_s(engine, apart.bind("ctrl"), partial(apart.step, None), commands)
    )


def _reset(episodes: Episodes, seed: int) -> None:
    worlds = np.arange(episodes.simulation.num_worlds)
    episodes.reset(
        worlds, [random_streams.make_benchmark_episode_rng(seed, world) for world in worlds.tolist()]
    )


def _physics_s(engine: Engine, ctrl: Any, step: Callable[[int], None], commands: list[FloatArray]) -> float:
    """Repeats control steps with these commands, without observations and rewards. Returns the duration in seconds."""
    began = perf_counter()
    for command in commands:
        ctrl[:] = command
        step(DEFAULT_SUBSTEPS)
    engine.check_overflow()
    return perf_counter() - began


def _copy_of(batch: Batch) -> Batch:
    """Returns a copy of a batch with the same models and states."""
    bare = Batch(batch.get_model(0), batch.nsim, batch.nthread, persistent=True)
    bare.set_models([batch.get_model(world) for world in range(batch.nsim)])
    bare.state[:] = batch.state
    return bare
