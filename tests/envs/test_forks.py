"""A forked process lacks the threads that step the worlds: environments raise an error there and never hang."""

import os
import subprocess
import sys

import numpy as np
import pytest

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.system.parallel_calls import count_available_cores

FORKS = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")

PROGRAM = """
import copy, gc, os, signal, sys
import gymnasium as gym
import numpy as np
import avrgym
from avrgym.tasks.episodes import Episodes

env = gym.make_vec("avrgym/FeedingJaco-v1", num_envs=2, num_threads={threads})
still = np.zeros((2, 7), np.float32)
env.reset(seed=0)
env.step(still)
bare = Episodes("avrgym/ScratchItchJaco-v1", 2, num_threads={threads})
child = os.fork()
if child == 0:
    signal.alarm(60)
    {act}
    sys.stdout.flush()
    sys.exit(0)
expected = env.step(still)[0]
status = os.waitpid(child, 0)[1]
assert status == 0, status
"""
REFUSED = """
    for use in (
        lambda: env.step(still),
        lambda: env.reset(seed=1),
        lambda: bare.reset(np.arange(2), [np.random.default_rng(0)] * 2),
        lambda: bare.simulation.step(),
    ):
        try:
            use()
        except RuntimeError as error:
            print(error)
"""
DELETED = "del env, bare; gc.collect(); print('deleted')"
CLOSED = "env.close(); print('closed')"
COPIED = "print(copy.deepcopy(env).step(still)[0].tobytes().hex()[:64])"
STEPPED = "print(env.step(still)[0].tobytes().hex()[:64])"
PARENT = "print(expected.tobytes().hex()[:64])"


def ran(act: str, threads: int, afterwards: str = "") -> list[str]:
    program = PROGRAM.format(act=act, threads=threads) + afterwards
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_in_another_process_worlds_with_threads_are_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    env = AssistiveVectorEnv("avrgym/FeedingJaco-v1", 2, num_threads=2)
    env.reset(seed=0)
    monkeypatch.setattr(os, "getpid", lambda: -1)
    for use in (lambda: env.step(np.zeros((2, 7), np.float32)), env.reset):
        with pytest.raises(RuntimeError, match="before the process forked"):
            use()


@FORKS
@pytest.mark.slow
def test_worlds_with_threads_are_refused_in_words() -> None:
    said = ran(REFUSED, threads=2)
    assert len(said) == 4
    assert len(set(said)) == 1
    assert "before the process forked" in said[0]
    assert "create the environment in this process" in said[0]
    assert "spawn" in said[0]


@FORKS
@pytest.mark.slow
@pytest.mark.parametrize("act", [DELETED, CLOSED])
def test_a_forked_process_frees_them_and_ends(act: str) -> None:
    assert len(ran(act, threads=2)) == 1


@FORKS
@pytest.mark.slow
@pytest.mark.parametrize(("act", "threads"), [(COPIED, 2), (STEPPED, 1)])
def test_a_copy_and_worlds_of_one_thread_go_on_to_the_same_bits(act: str, threads: int) -> None:
    child, parent = ran(act, threads, PARENT)
    assert child == parent


@FORKS
@pytest.mark.slow
@pytest.mark.skipif(count_available_cores() < 2, reason="one core, one thread")
def test_the_usual_number_of_threads_is_refused_too() -> None:
    assert len(ran(REFUSED, threads=0)) == 4
