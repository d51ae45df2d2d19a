"""Elementary functions are accurate and give the same bits on every processor."""

import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from avrgym.geometry import elementary

COUNT = 50_000
EXACT = np.longdouble


@pytest.mark.parametrize(
    ("own", "numpys", "low", "high"),
    [
        (elementary.sin, np.sin, -100.0, 100.0),
        (elementary.cos, np.cos, -100.0, 100.0),
        (elementary.tan, np.tan, -1.4, 1.4),
        (elementary.arcsin, np.arcsin, -1.0, 1.0),
        (elementary.arccos, np.arccos, -1.0, 1.0),
        (elementary.tanh, np.tanh, -30.0, 30.0),
    ],
)
def test_functions_of_one_number_are_right(
    rng: np.random.Generator, own: Callable, numpys: Callable, low: float, high: float
) -> None:
    x = rng.uniform(low, high, COUNT)
    exact = numpys(x.astype(EXACT))
    assert np.max(np.abs(own(x) - exact) / np.maximum(1.0, np.abs(exact))) < 3e-15


@pytest.mark.parametrize("own", [elementary.sin, elementary.tanh, elementary.arcsin])
def test_odd_functions_keep_tiny_numbers_to_their_last_bits(rng: np.random.Generator, own: Callable) -> None:
    tiny = 10.0 ** rng.uniform(-300.0, -9.0, 1000)
    np.testing.assert_allclose(own(tiny), tiny, rtol=1e-15)
    np.testing.assert_array_equal(own(-tiny), -own(tiny))


def test_the_angle_of_a_point_is_right_in_every_quadrant_and_on_the_axes(rng: np.random.Generator) -> None:
    y, x = rng.normal(size=(2, COUNT)) * 10.0 ** rng.uniform(-12.0, 12.0, (2, COUNT))
    exact = np.arctan2(y.astype(EXACT), x.astype(EXACT))
    assert np.max(np.abs((elementary.arctan2(y, x) - exact) / exact)) < 1e-15
    axes = np.array([0.0, -0.0, 1.0, -1.0, 5e-324, 1e308])
    for y in axes:
        np.testing.assert_array_equal(elementary.arctan2(y, axes), np.arctan2(y, axes))


def test_powers_are_right(rng: np.random.Generator) -> None:
    base, exponent = 10.0 ** rng.uniform(-12.0, 3.0, COUNT), rng.uniform(-2.0, 2.0, COUNT)
    exact = base.astype(EXACT) ** exponent.astype(EXACT)
    error = np.abs((elementary.power(base, exponent) - exact) / exact)
    assert np.max(error / (1.0 + np.abs(np.log(exact)))) < 1e-15
    np.testing.assert_array_equal(elementary.power([0.0, 1.0], [0.5, 7.0]), [0.0, 1.0])


def test_single_precision_stays_single_and_is_good_for_a_millionth(rng: np.random.Generator) -> None:
    x = rng.uniform(-50.0, 50.0, COUNT).astype(np.float32)
    sine, cosine = elementary.sine_and_cosine(x)
    assert (sine.dtype, cosine.dtype) == (np.float32, np.float32)
    assert np.max(np.abs(sine - np.sin(x.astype(float)))) < 1e-6
    assert np.max(np.abs(cosine - np.cos(x.astype(float)))) < 1e-6


EPISODE = """
import hashlib
import numpy as np
from avrgym.tasks.episodes import Episodes
from avrgym.policies.trained_policies import load_policy

episodes = Episodes("avrgym/FeedingPR2-v1", 4, people="participants", num_threads=1)
policy = load_policy("revised", "avrgym/FeedingPR2-v1", episodes.observation.size, 7)
generators = [np.random.default_rng(seed) for seed in range(4)]
observation = episodes.reset(np.arange(4), generators)
for _ in range(30):
    action = policy.act(observation, generators).astype(float)
    step = episodes.step(action)
    observation = step.observation
    print(hashlib.sha256(observation.tobytes() + step.reward.tobytes() + action.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_an_episode_is_the_same_bits_whatever_a_processor_offers_to_numpy() -> None:
    """Base search, policy, moving person and reward, with all and with none of a processor's extensions."""
    offered = [name for name in __cpu_dispatch__ if __cpu_features__[name]]
    if not offered:
        pytest.skip("this processor offers NumPy nothing that could be left out")
    least = {"NPY_DISABLE_CPU_FEATURES": " ".join(offered), "OPENBLAS_CORETYPE": "Nehalem"}
    runs = [
        subprocess.run(
            [sys.executable, "-c", EPISODE],
            env=os.environ | changes,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for changes in ({}, least)
    ]
    assert runs[0].count("\n") == 30
    assert runs[0] == runs[1]
