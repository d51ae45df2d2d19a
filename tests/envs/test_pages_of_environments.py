"""Code of the pages about Gymnasium's wrappers, particles and torso heights."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from avrgym.models.human.anthropometry import MAN, WOMAN
from avrgym.models.spoon import FOOD, SPOON
from avrgym.robots.registry import ROBOTS
from avrgym.tasks import registry
from avrgym.tasks.drinking import reward
from avrgym.tasks.drinking.task import DRINKING
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Task
from helpers.browser.documentation import DOCS, blocks

STEPS = 30


def code(page: str, word: str) -> str:
    (found,) = (text for language, text in blocks(DOCS / page) if language == "python" and word in text)
    return found


def test_a_spec_is_rebuilt_from_json() -> None:
    known: dict[str, Any] = {}
    exec(code("how_to/gymnasium.md", "from_json"), known)
    assert known["same"].spec.max_episode_steps == 400


@pytest.mark.slow
def test_a_video_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("moviepy")
    monkeypatch.chdir(tmp_path)
    exec(code("how_to/gymnasium.md", "RecordVideo"), {"gym": gym})
    (video,) = Path("videos").glob("*.mp4")
    assert video.stat().st_size > 1000


def add(task: Task, patch: pytest.MonkeyPatch) -> str:
    environment = f"avrgym/{task.name}Jaco-v1"
    patch.setitem(registry.TASKS, task.name, task)  # type: ignore[arg-type]
    patch.setitem(registry.ENVIRONMENTS, environment, (task.name, "Jaco"))  # type: ignore[arg-type]
    return environment


def run(environment: str) -> Episodes:
    world = Episodes(environment, 2, num_threads=1)
    world.reset(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    for _ in range(STEPS):
        world.step(np.tile(np.array([0.0, 0.5, 0.0, 0.0, 0.0, 1.0, 1.0]), (2, 1)))
    return world


def test_a_task_may_have_its_own_number_of_particles(monkeypatch: pytest.MonkeyPatch) -> None:
    known: dict[str, Any] = {}
    exec(code("how_to/add_a_task.md", "FOOD"), known)
    world = run(add(known["TASTE"], monkeypatch))
    assert world.task_state.eaten.shape == (2, 3)


@pytest.mark.parametrize("count", [1, 64])
def test_water_may_have_another_number_of_particles(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    cup = DRINKING.make_scene(ROBOTS["Jaco"]).tool
    assert cup.particles is not None
    less = replace(cup, particles=replace(cup.particles, initial_pos=cup.particles.initial_pos[:count]))
    task = replace(
        DRINKING,
        name="Sip",
        make_scene=lambda robot: replace(DRINKING.make_scene(robot), tool=less),
        make_initial_task_state=partial(reward.make_initial_task_state, particles=count),
    )
    assert run(add(task, monkeypatch)).task_state.drunk.shape == (2, count)


def test_a_number_of_particles_that_differs_from_the_state_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    feeding = registry.TASKS["Feeding"]
    three = replace(SPOON, particles=replace(FOOD, initial_pos=FOOD.initial_pos[:3]))
    wrong = replace(
        feeding, name="Wrong", make_scene=lambda robot: replace(feeding.make_scene(robot), tool=three)
    )
    message = r"carries 3 particles, but the task state has 8; set .*partial\(init_state, particles=3\)"
    with pytest.raises(ValueError, match=message):
        run(add(wrong, monkeypatch))


def test_torso_heights_follow_from_standing_heights() -> None:
    page = (DOCS / "how_to" / "people.md").read_text()
    medians = {"man": (1.755, MAN.torso_height_m), "woman": (1.625, WOMAN.torso_height_m)}
    (found,) = re.findall(r"about ([\d.]+) \(men\) or ([\d.]+) \(women\) times the standing height", page)
    assert found == tuple(f"{torso_m / standing_m:.3f}" for standing_m, torso_m in medians.values())
