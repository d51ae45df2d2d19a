"""Exports scenes to GLB files in a separate process, which does not delay the real-time thread."""

import asyncio
import multiprocessing
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

import mujoco

from avrgym.models.cameras import add_wrist_camera
from avrgym.models.human import Person
from avrgym.models.scene import build_scene_spec
from avrgym.system.child_processes import block_terminal_signals, exit_with_parent
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.vr.scene.scene_export import export_glb

P = ParamSpec("P")
R = TypeVar("R")

MAX_CACHED_SCENES = 10
"""Maximum number of cached scenes. A scene needs about 2 MB of memory."""


def warm_up_process() -> None:
    """Does nothing. When the process runs this function, it imports its modules, before a scene is requested."""


def export_scene(environment_id: str, person: Person, settings: Settings = DEFAULT_SETTINGS) -> bytes:
    """Returns the GLB file of an environment with a person."""
    return export_glb(build_model_with_appearance(environment_id, person, settings))


def build_model_with_appearance(
    environment_id: str, person: Person, settings: Settings = DEFAULT_SETTINGS
) -> mujoco.MjModel:
    """Returns the model of an environment with a person, including materials, textures and the wrist camera."""
    _, scene = find_task_and_scene(environment_id, settings)
    spec = build_scene_spec(scene, person, moving=True, appearance=True)
    add_wrist_camera(spec, scene)
    return spec.compile()


class SceneExporter:
    """Exports each scene once, and caches its GLB file."""

    def __init__(self) -> None:
        self._pool = make_export_pool()
        self._scenes: dict[int, Future[bytes]] = {}
        self._lock = threading.Lock()

    def start_process(self) -> None:
        """Start the process in advance, before the first scene is requested."""
        with self._lock:
            self._submit(warm_up_process)

    def start_export(
        self, number: int, environment_id: str, person: Person, settings: Settings = DEFAULT_SETTINGS
    ) -> Future[bytes]:
        """Starts the export of scene ``number``, unless it is cached. Returns the future of the GLB file."""
        with self._lock:
            if number not in self._scenes:
                self._scenes[number] = self._submit(export_scene, environment_id, person, settings)
                while len(self._scenes) > MAX_CACHED_SCENES:
                    del self._scenes[next(iter(self._scenes))]
            return self._scenes[number]

    async def wait_for_glb(
        self, number: int, environment_id: str, person: Person, settings: Settings = DEFAULT_SETTINGS
    ) -> bytes:
        """Waits for the GLB file of scene ``number`` and returns it. After an error, the next request exports it
        again."""
        scene = self.start_export(number, environment_id, person, settings)
        try:
            return await asyncio.shield(asyncio.wrap_future(scene))
        except Exception:
            with self._lock:
                if self._scenes.get(number) is scene:
                    del self._scenes[number]
            raise

    def _submit(self, work: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        with block_terminal_signals():
            try:
                return self._pool.submit(work, *args, **kwargs)
            except BrokenProcessPool:
                self._pool = make_export_pool()
                return self._pool.submit(work, *args, **kwargs)

    def close(self) -> None:
        """Stop the export process. Exports that have not started are cancelled."""
        self._pool.shutdown(cancel_futures=True)


def make_export_pool() -> ProcessPoolExecutor:
    """Returns a pool of one process. It exits when the current process exits."""
    return ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), initializer=exit_with_parent
    )
