"""Gymnasium's vector wrappers in every autoreset mode: as with Gymnasium's own environments, and as documented."""

import re
from collections.abc import Callable
from typing import Any

import array_api_compat.numpy
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import vector as wrappers
from gymnasium.wrappers.transform_action import ClipAction
from gymnasium.wrappers.transform_observation import FlattenObservation
from gymnasium.wrappers.transform_reward import ClipReward

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning.stable_baselines import SB3VectorEnv
from helpers.browser.documentation import DOCS
from helpers.simulation.vector_environments import EPISODE, WORLDS, assert_same, make_both

FEEDING = "avrgym/FeedingJaco-v1"
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (2 * EPISODE + 3, WORLDS, 7)).astype(np.float32)
Wrap = Callable[[VectorEnv], VectorEnv]
WRAPPERS: dict[str, Wrap] = {
    "VectorizeTransformObservation": lambda env: wrappers.VectorizeTransformObservation(
        env, FlattenObservation
    ),
    "VectorizeTransformAction": lambda env: wrappers.VectorizeTransformAction(env, ClipAction),
    "VectorizeTransformReward": lambda env: wrappers.VectorizeTransformReward(env, ClipReward, min_reward=-1),
    "DictInfoToList": wrappers.DictInfoToList,
    "TransformObservation": lambda env: wrappers.TransformObservation(env, lambda seen: 2.0 * seen),
    "FlattenObservation": wrappers.FlattenObservation,
    "ReshapeObservation": lambda env: wrappers.ReshapeObservation(env, (5, 5)),
    "RescaleObservation": lambda env: wrappers.RescaleObservation(env, -1.0, 1.0),
    "DtypeObservation": lambda env: wrappers.DtypeObservation(env, np.float32),
    "NormalizeObservation": wrappers.NormalizeObservation,
    "TransformAction": lambda env: wrappers.TransformAction(env, lambda action: 0.5 * action),
    "ClipAction": wrappers.ClipAction,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, -2.0, 2.0),
    "TransformReward": lambda env: wrappers.TransformReward(env, lambda reward: 3.0 * reward),
    "ClipReward": lambda env: wrappers.ClipReward(env, -0.5, 0.5),
    "NormalizeReward": wrappers.NormalizeReward,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "ArrayConversion": lambda env: wrappers.ArrayConversion(env, np, array_api_compat.numpy),
    "NumpyToTorch": wrappers.NumpyToTorch,
}
OF_PICTURES = {"FilterObservation", "GrayscaleObservation", "ResizeObservation"}
"""Of observations that are pictures or dictionaries, which there are none of here."""
SHOWN = {"HumanRendering", "RecordVideo"}
WITH_JAX = {"JaxToNumpy", "JaxToTorch"}
NEXT_STEP, SAME_STEP, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
OF_OBSERVATIONS = {
    "VectorizeTransformObservation",
    *(name for name in WRAPPERS if name.endswith("Observation")),
}
CONVERSIONS = {"ArrayConversion", "NumpyToTorch"}
REFUSED = {(name, SAME_STEP) for name in OF_OBSERVATIONS | CONVERSIONS} | {("NormalizeObservation", DISABLED)}
FAST = ("NormalizeObservation", "ClipReward")
REFUSALS = (ValueError, AssertionError, BufferError)
TIMES = ("t", "_t")
"""What ``RecordEpisodeStatistics`` measures with a clock."""


def numbers(value: Any) -> Any:
    """A copy with tensors as arrays, and without what a clock measured."""
    if isinstance(value, torch.Tensor):
        return value.numpy().copy()
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, dict):
        return {name: numbers(each) for name, each in sorted(value.items()) if name not in TIMES}
    return [numbers(each) for each in value] if isinstance(value, list | tuple) else value


def lived(wrap: Wrap, env: VectorEnv, mode: AutoresetMode) -> Any:
    """All that more than two episodes give, or the refusal."""
    try:
        wrapped = wrap(env)
        of_tensors = isinstance(wrapped, wrappers.NumpyToTorch)
        given: list[Any] = [numbers(wrapped.reset(seed=2))]
        for action in ACTIONS:
            given.append(numbers(wrapped.step(torch.as_tensor(action) if of_tensors else action)))
            ended = given[-1][3]
            if mode is DISABLED and ended.any():
                given.append(numbers(wrapped.reset(options={"reset_mask": ended.copy()})))
    except REFUSALS as error:
        return f"{type(error).__name__}: {error}"
    return given


def assert_same_everywhere(ours: Any, theirs: Any, where: str) -> None:
    if isinstance(theirs, list):
        for number, pair in enumerate(zip(ours, theirs, strict=True)):
            assert_same_everywhere(*pair, f"{where}[{number}]")
    elif isinstance(theirs, dict):
        assert ours.keys() == theirs.keys(), where
        for name, value in theirs.items():
            assert_same_everywhere(ours[name], value, f"{where}[{name!r}]")
    elif isinstance(theirs, np.ndarray):
        assert_same(ours, theirs, where)
    else:
        assert ours == theirs, where


def test_every_wrapper_is_tried() -> None:
    assert {*WRAPPERS, *OF_PICTURES, *SHOWN, *WITH_JAX} == set(wrappers.__all__)


@pytest.mark.fast_cases(3)
@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in WRAPPERS]
)
def test_it_does_what_it_does_around_gymnasium_s_own(name: str, mode: AutoresetMode) -> None:
    ours, theirs = (lived(WRAPPERS[name], env, mode) for env in make_both(FEEDING, mode, "revised"))
    assert isinstance(theirs, str) == ((name, mode) in REFUSED), theirs
    assert_same_everywhere(ours, theirs, name)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (
            {"autoreset_mode": NEXT_STEP},
            "autoreset mode NEXT_STEP does not fit Stable-Baselines3; allowed: .*AutoresetMode.SAME_STEP",
        ),
        (
            {"autoreset_mode": DISABLED},
            "autoreset mode DISABLED does not fit Stable-Baselines3; allowed: .*AutoresetMode.SAME_STEP",
        ),
        ({"max_episode_steps": -1}, "episodes that end; allowed: max_episode_steps of 1 or more"),
    ],
)
def test_stable_baselines3_refuses_what_it_cannot_learn_from(how: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SB3VectorEnv(AssistiveVectorEnv(FEEDING, 2, num_threads=1, **how))


def test_the_page_lists_the_modes_of_each_wrapper() -> None:
    page = (DOCS / "how_to" / "gymnasium.md").read_text()
    table = page.partition("| wrapper |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (`\w+`[^|]*) \| ([^|]+) \|", table, re.M)
    said = {
        (name, mode)
        for names, modes in rows
        for name in re.findall(r"`(\w+)`", names)
        for mode in AutoresetMode
        if f"`{mode.name}`" not in modes and modes != "every"
    }
    named = {name for names, _ in rows for name in re.findall(r"`(\w+)`", names)}
    assert named == {*WRAPPERS, "RecordVideo"}
    assert said == REFUSED
