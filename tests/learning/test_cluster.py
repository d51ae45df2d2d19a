"""A cluster gives the same results as one process, even when workers die; several nodes on this computer."""

import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("ray", reason="clusters are an extra, too large for every computer")
pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.learning import training
from avrgym.learning.configuration import FeedforwardConfiguration
from avrgym.learning.evaluation import evaluate_all
from avrgym.learning.training import resume_training, train
from avrgym.system.cluster import Cluster, connect_to_cluster
from helpers.learning.ray_nodes import assert_same_training, process_and_node, raise_error, ray_nodes

pytestmark = pytest.mark.filterwarnings("ignore")  # of Ray's, whose processes and files end with its shutdown
FEEDING = "avrgym/FeedingJaco-v1"
TINY = FeedforwardConfiguration(
    environment="avrgym/ScratchItchJaco-v1",
    people="participants",
    steps=4 * 5 * 200,
    seed=4,
    num_envs=5,
    n_epochs=2,
    batch_size=250,
    threads=1,
    imitation_rounds=1,
    imitation_share=0.5,
    hard_share=0.5,
    critic_updates=1,
)


@pytest.fixture(scope="module")
def nodes() -> Iterator[Any]:
    with ray_nodes(1, 1) as started:
        yield started


@pytest.fixture(scope="module")
def cluster(nodes: Any) -> Iterator[Cluster]:
    with connect_to_cluster(nodes.address, 2) as opened:
        yield opened


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of one process."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "EVALUATION_EPISODES", 1)
        train(TINY, out)
    return out


@pytest.fixture(autouse=True)
def _measured_shortly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)


def test_cluster_and_killed_workers_do_not_change_weights(whole, cluster, tmp_path) -> None:
    """A worker dies in the middle of each part; the parts are not equal."""
    killed: set[int] = set()

    def kill(progress: training.TrainingProgress) -> None:
        processes = [process for process, _ in cluster.starmap(process_and_node, [(), ()])]
        killed.add(processes[0])
        threading.Timer(0.3, os.kill, (processes[0], signal.SIGKILL)).start()

    train(TINY, tmp_path / "shared", kill, cluster=cluster)
    assert len(killed) >= 2
    assert_same_training(tmp_path / "shared", whole)


def test_a_training_continues_without_the_cluster(whole, cluster, tmp_path) -> None:
    """Started on a cluster, finished in one process."""

    class Killed(Exception):
        pass

    def kill(progress: training.TrainingProgress) -> None:
        if progress.num_timesteps >= 3000:
            raise Killed

    with pytest.raises(Killed):
        train(TINY, tmp_path / "cut", kill, cluster=cluster)
    resume_training(tmp_path / "cut")
    assert_same_training(tmp_path / "cut", whole)


def test_rows_are_the_same_from_a_cluster(cluster) -> None:
    steps: list[int] = []
    rows = evaluate_all([FEEDING], "revised", "revised", 3, 7, steps.append, cluster=cluster)
    assert rows == evaluate_all([FEEDING], "revised", "revised", 3, 7, jobs=1)
    assert sum(steps) == 3 * 200


def test_the_error_of_a_call_is_raised(cluster) -> None:
    with pytest.raises(ValueError, match="2 is refused"):
        cluster.starmap(raise_error, [(2,)])


def test_too_many_worlds_are_refused_before_anything_is_written(cluster, tmp_path) -> None:
    with pytest.raises(RuntimeError, match=r"each worker needs .* use more workers"):
        cluster.reserve_memory(1 << 60)
    with pytest.raises(ValueError, match=r"worlds need .* of memory; this computer has"):
        train(replace(TINY, num_envs=10**9), tmp_path / "many", cluster=cluster)
    assert not list(tmp_path.iterdir())
