"""Renders scenes to GLB files in a process of its own, away from the real-time thread."""

import asyncio
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

import mujoco

from avrgym.models.human import Person
from avrgym.models.scene import build_spec
from avrgym.robots.registry import find_robot
from avrgym.system.children import end_with_parent, undisturbed
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.vr.scene.scene_export import export_glb

SCENES_KEPT = 10
"""All eight environments, and a little more: each is about two megabytes."""


def render_scene(environment_id: str, person: Person) -> bytes:
    """The GLB of an environment with a person in it."""
    return export_glb(shown_model(environment_id, person))


def shown_model(environment_id: str, person: Person) -> mujoco.MjModel:
    """The model of an environment with a person in it, with its appearance."""
    task, robot = find_environment(environment_id)
    scene = TASKS[task].scene(find_robot(robot))
    return build_spec(scene, person, moving=True, appearance=True).compile()


class SceneRenderer:
    """Renders each scene once, whoever asks."""

    def __init__(self) -> None:
        self._pool = rendering_process()
        self._scenes: dict[int, asyncio.Task[bytes]] = {}

    async def glb(self, number: int, environment_id: str, person: Person) -> bytes:
        """The scene of a number; a failure is raised to all who wait, and the next request tries again."""
        if number not in self._scenes:
            self._scenes[number] = asyncio.create_task(self._render(environment_id, person))
            while len(self._scenes) > SCENES_KEPT:
                del self._scenes[next(iter(self._scenes))]
        try:
            return await asyncio.shield(self._scenes[number])
        except Exception:
            self._scenes.pop(number, None)
            raise

    async def _render(self, environment_id: str, person: Person) -> bytes:
        events = asyncio.get_running_loop()
        try:
            with undisturbed():
                rendered = events.run_in_executor(self._pool, render_scene, environment_id, person)
            return await rendered
        except BrokenProcessPool:
            self._pool = rendering_process()
            raise

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(cancel_futures=True)


def rendering_process() -> ProcessPoolExecutor:
    """A pool of one process that ends when this one does."""
    return ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent
    )
