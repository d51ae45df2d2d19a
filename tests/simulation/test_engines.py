"""Engines: what each refuses, and that Warp's worlds go the way of those on threads."""

import sys
from importlib.util import find_spec

import gymnasium as gym
import numpy as np
import pytest

from avrgym.simulation.engines import engine, warp
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Controller
from engines import on_both, put_in_the_same_state, step_both

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"
TO_THE_ITCH = 45
"""Control steps after which the expert scratches them all."""
with_warp = pytest.mark.skipif(
    find_spec("mujoco_warp") is None,
    reason="the extra `gpu` is not installed: 400 MB, and a minute to compile its kernels",
)


@pytest.mark.parametrize("name", ["cuda", "", "Threads", "threads:2", "warp:", "warpcpu"])
def test_an_unknown_engine_is_refused_with_what_there_is(name: str) -> None:
    with pytest.raises(ValueError, match="allowed: threads, warp, or warp:DEVICE"):
        gym.make_vec(ENVIRONMENT, num_envs=2, engine=name)


def test_what_the_engine_lacks_is_named_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "warp", None)
    warp.libraries.cache_clear()
    with pytest.raises(RuntimeError, match=r"^warp is missing; `pip install avrgym\[gpu\]` brings"):
        gym.make_vec(ENVIRONMENT, num_envs=2, engine="warp")


def test_more_worlds_than_memory_are_refused_with_how_many_there_is_room_for() -> None:
    with pytest.raises(ValueError, match=r"^100000000 worlds take \d+\.\d GiB .*; allowed: up to \d+$"):
        Episodes(ENVIRONMENT, 100_000_000)


def test_memory_is_enough_to_the_last_world() -> None:
    engine.check_memory(10, 100, 1000, "a device")
    engine.check_memory(10, 100, None, "a device that does not tell")
    with pytest.raises(ValueError, match="on a device; allowed: up to 9"):
        engine.check_memory(10, 100, 999, "a device")


# On Warp's own processor device --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scratched() -> tuple[list[Episodes], Controller]:
    """Three people who are being scratched, in the same state on both engines, and who does it."""
    episodes = on_both(ENVIRONMENT, 3)
    threads = episodes[0]
    expert = threads.task.expert(threads)
    for _ in range(TO_THE_ITCH):
        threads.step(np.asarray(expert(threads.observe()), float))
    put_in_the_same_state(episodes)
    return episodes, expert


@pytest.fixture
def both(scratched: tuple[list[Episodes], Controller]) -> list[Episodes]:
    """Their worlds."""
    return scratched[0]


@with_warp
def test_worlds_go_the_same_way_while_tools_touch_people(
    scratched: tuple[list[Episodes], Controller],
) -> None:
    touched = np.zeros(3, dtype=bool)
    for step in step_both(*scratched, 5):
        assert step.angles_rad < 2e-4
        np.testing.assert_allclose(step.warp.force_on_person_n, step.threads.force_on_person_n, atol=0.05)
        np.testing.assert_allclose(step.warp.observation, step.threads.observation, atol=0.05)
        touched |= step.threads.force_on_person_n > 0.5
    assert touched.all()


@with_warp
def test_what_begins_in_one_world_changes_no_other(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    before = [simulation.qpos(world) for world in range(3)]
    both[1].begin(np.array([1]), [np.random.default_rng(8)])
    after = [simulation.qpos(world) for world in range(3)]
    np.testing.assert_array_equal(before[0], after[0])
    np.testing.assert_array_equal(before[2], after[2])
    assert np.abs(before[1] - after[1]).max() > 0.01


@with_warp
def test_a_world_that_is_put_back_goes_the_same_way_again(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    simulation.command_robot(np.full((3, 7), 0.5))
    saved = simulation.integration_state(2)
    simulation.step(3)
    first = simulation.qpos(2)
    simulation.restore(saved, 2)
    simulation.step(3)
    np.testing.assert_allclose(simulation.qpos(2), first, atol=1e-6)


@with_warp
def test_an_overflow_is_told(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    simulation.step(1)
    overflow = both[1].simulation.engine._data.overflow  # pyright: ignore[reportAttributeAccessIssue]
    overflow.assign(np.array([0, 1, 8 | 1 << 9], dtype=np.int32))
    with pytest.raises(
        RuntimeError, match="overflowed: NEFC in 1, NARROWPHASE in 1 of 3 worlds; each has room"
    ):
        simulation.step(1)
    simulation.step(1)


@with_warp
def test_a_device_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match=r"has no device 'cuda:17'; allowed: .*cpu"):
        Episodes(ENVIRONMENT, 1, engine="warp:cuda:17")


@with_warp
def test_without_a_gpu_the_engine_says_so() -> None:
    if warp.libraries().torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(
        ValueError, match="needs a CUDA device, and PyTorch finds none here; `warp:cpu` runs it"
    ):
        Episodes(ENVIRONMENT, 1, engine="warp")
