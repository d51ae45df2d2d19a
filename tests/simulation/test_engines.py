"""Engines: what each refuses, and that Warp's worlds go the way of those on threads."""

import pickle
import sys
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from avrgym.robots.registry import ROBOTS
from avrgym.simulation.engines import engine, warp
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Controller
from helpers.simulation.two_engines import copy_state, episodes_on_both, step_both

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
    warp.import_libraries.cache_clear()
    with pytest.raises(
        RuntimeError, match=r"package warp, which is missing; run `pip install avrgym\[gpu\]`"
    ):
        gym.make_vec(ENVIRONMENT, num_envs=2, engine="warp")


def test_more_worlds_than_memory_are_refused_with_how_many_there_is_room_for() -> None:
    with pytest.raises(
        ValueError, match=r"^100000000 worlds need \d+\.\d GiB .*; allowed: up to \d+ worlds$"
    ):
        Episodes(ENVIRONMENT, 100_000_000)


def test_memory_is_enough_to_the_last_world() -> None:
    engine.check_memory(10, 100, 1000, "a device")
    engine.check_memory(10, 100, None, "a device that does not tell")
    with pytest.raises(ValueError, match="on a device; allowed: up to 9"):
        engine.check_memory(10, 100, 999, "a device")


def test_threads_have_no_device_of_their_own() -> None:
    with pytest.raises(
        ValueError, match="has no device; allowed: on_device=False, or engine warp or warp:DEVICE"
    ):
        Episodes(ENVIRONMENT, 1, on_device=True)


def test_forces_by_region_are_not_had_on_a_device() -> None:
    scene = Episodes(ENVIRONMENT, 1).scene
    with pytest.raises(ValueError, match="by_region and on_device are both true; allowed: one of them"):
        Simulation(scene, 1, by_region=True, engine="warp:cpu", on_device=True)


# On Warp's own processor device --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scratched() -> tuple[list[Episodes], Controller]:
    """Three people who are being scratched, in the same state on both engines, and who does it."""
    episodes = episodes_on_both(ENVIRONMENT, 3)
    threads = episodes[0]
    expert = threads.task.expert(threads)
    for _ in range(TO_THE_ITCH):
        threads.step(np.asarray(expert(threads.observe()), float))
    copy_state(episodes)
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
        assert step.joint_positions < 2e-4
        np.testing.assert_allclose(step.warp.force_on_person_n, step.threads.force_on_person_n, atol=0.05)
        np.testing.assert_allclose(step.warp.observation, step.threads.observation, atol=0.05)
        touched |= step.threads.force_on_person_n > 0.5
    assert touched.all()


@with_warp
def test_what_begins_in_one_world_changes_no_other(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    before = [simulation.get_qpos(world) for world in range(3)]
    both[1].reset(np.array([1]), [np.random.default_rng(8)])
    after = [simulation.get_qpos(world) for world in range(3)]
    np.testing.assert_array_equal(before[0], after[0])
    np.testing.assert_array_equal(before[2], after[2])
    assert np.abs(before[1] - after[1]).max() > 0.01


@with_warp
def test_a_world_that_is_put_back_goes_the_same_way_again(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    simulation.command_robot(np.full((3, 7), 0.5))
    saved = simulation.get_integration_state(2)
    simulation.step(3)
    first = simulation.get_qpos(2)
    simulation.set_integration_state(saved, 2)
    simulation.step(3)
    np.testing.assert_allclose(simulation.get_qpos(2), first, atol=1e-6)


@with_warp
def test_an_overflow_is_told(both: list[Episodes]) -> None:
    simulation = both[1].simulation
    simulation.step(1)
    overflow = both[1].simulation.engine._data.overflow  # pyright: ignore[reportAttributeAccessIssue]
    overflow.assign(np.array([0, 1, 8 | 1 << 9], dtype=np.int32))
    with pytest.raises(RuntimeError, match="overflowed: NEFC in 1, NARROWPHASE in 1 of 3 worlds"):
        simulation.step(1)
    simulation.step(1)


@with_warp
def test_a_device_that_there_is_not_is_named() -> None:
    with pytest.raises(ValueError, match=r"has no device 'cuda:17'; allowed: .*cpu"):
        Episodes(ENVIRONMENT, 1, engine="warp:cuda:17")


@with_warp
def test_without_a_gpu_the_engine_says_so() -> None:
    if warp.import_libraries().torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(
        ValueError, match="needs a CUDA device, and PyTorch finds none; `warp:cpu` uses the CPU"
    ):
        Episodes(ENVIRONMENT, 1, engine="warp")


# Where steps stay on the device ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def there() -> Episodes:
    """Two worlds whose steps stay on the device."""
    return Episodes(ENVIRONMENT, 2, people="revised", engine="warp:cpu", num_threads=1, on_device=True)


def begin(episodes: Episodes) -> Any:
    return episodes.reset(np.arange(2), [np.random.default_rng([3, world]) for world in range(2)])


def tensor(values: Any) -> Any:
    return warp.import_libraries().torch.as_tensor(values, dtype=warp.import_libraries().torch.float32)


@with_warp
def test_steps_on_the_device_go_the_way_of_those_on_threads(there: Episodes) -> None:
    threads = Episodes(ENVIRONMENT, 2, people="revised", num_threads=1)
    np.testing.assert_allclose(begin(there), begin(threads), atol=1e-6)
    expert = threads.task.expert(threads)
    most_n = 0.0
    for _ in range(25):
        action = np.clip(np.asarray(expert(threads.observe()), float), -1.0, 1.0)
        wanted, found = threads.step(action), there.step(tensor(action))
        for name in ("reward", "distance_m", "force_on_person_n", "observation"):
            np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), atol=0.05, err_msg=name)
        np.testing.assert_array_equal(found.success, wanted.success)
        most_n = max(most_n, float(wanted.force_on_person_n.max()))
    there.check_device_results()
    assert most_n > 1.0
    assert {value.dtype for value in (found.observation, found.reward, *found.reward_terms.values())} == {
        warp.import_libraries().torch.float32
    }


@with_warp
def test_a_step_on_the_device_copies_nothing_to_the_host(there: Episodes, both: list[Episodes]) -> None:
    from helpers.simulation.no_host_copies import HostCopyError, forbid_host_copies

    begin(there)
    action = tensor(np.full((2, 7), 0.3))
    there.step(action)
    with forbid_host_copies():
        for _ in range(2):
            there.step(action)
    with pytest.raises(HostCopyError), forbid_host_copies():
        there.check_device_results()
    with pytest.raises(HostCopyError), forbid_host_copies():
        both[1].step(np.full((3, 7), 0.3))


@with_warp
def test_an_overflow_on_the_device_ends_the_episode(there: Episodes) -> None:
    begin(there)
    overflow = there.simulation.engine._data.overflow  # pyright: ignore[reportAttributeAccessIssue]
    for ask in (there.check_device_results, lambda: begin(there)):
        overflow.assign(np.array([1, 0], dtype=np.int32))
        there.step(tensor(np.zeros((2, 7))))
        with pytest.raises(RuntimeError, match="buffers of engine 'warp' overflowed: NEFC in 1 of 2 worlds"):
            ask()
    there.check_device_results()


@with_warp
def test_actions_on_the_device_are_tensors_there_and_finite(there: Episodes) -> None:
    begin(there)
    for wrong in (np.zeros((2, 7)), tensor(np.zeros((2, 6))), tensor(np.zeros((2, 7))).double()):
        with pytest.raises(ValueError, match=r"allowed: tensors of shape \(2, 7\), torch.float32 on cpu"):
            there.step(wrong)
    there.step(tensor(np.array([[np.nan] * 7, [0.0] * 7])))
    assert np.isfinite(there.simulation.get_qpos(0)).all()
    with pytest.raises(
        ValueError, match=r"actions in 1 worlds contain NaN or infinity; allowed: finite numbers"
    ):
        there.check_device_results()
    there.check_device_results()


@with_warp
def test_a_copy_goes_on_where_its_original_is(there: Episodes) -> None:
    begin(there)
    action = tensor(np.full((2, 7), -0.2))
    there.step(action)
    copy = pickle.loads(pickle.dumps(there))
    assert copy.simulation.engine.name == "warp"
    for _ in range(3):
        wanted, found = there.step(action), copy.step(action)
    np.testing.assert_allclose(found.observation, wanted.observation, atol=1e-5)


def test_a_driving_robot_needs_the_engine_threads():
    driving = [robot.name for robot in ROBOTS.values() if robot.drive is not None]
    for robot in driving:
        with pytest.raises(ValueError, match="does not simulate robots that drive; allowed: threads"):
            Episodes(f"avrgym/Feeding{robot}-v1", 1, engine="warp")
