"""Trainings end with the same weights after kills of workers, nodes and the command.

Needs Ray, which ``make test-engines`` installs.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

pytest.importorskip("ray", reason="Ray is an extra")
pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.learning import training
from avrgym.learning.configuration import FeedforwardConfiguration
from avrgym.learning.training import TrainingProgress, train
from avrgym.system.cluster import Cluster, connect_to_cluster
from helpers.learning.ray_nodes import add_node, assert_same_training, kill_node, process_and_node, ray_nodes
from helpers.system.processes import kill_with_parent

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray closes its processes and files at shutdown
WORKERS_KILLED, NODES_KILLED, COMMANDS_KILLED = (
    int(number) for number in os.environ.get("AVRGYM_SOAK_KILLS", "20 5 5").split()
)
SMALL = FeedforwardConfiguration(
    environment="avrgym/ScratchItchJaco-v1", people="revised", seed=4, num_envs=4, n_epochs=1, batch_size=200,
    imitation_rounds=0, threads=1, hard_share=0.5,
)  # fmt: skip
COMMAND = """
import sys
from pathlib import Path
from avrgym.learning import training
from avrgym.system.cluster import connect
training.EVALUATION_EPISODES = 1
with connect(sys.argv[2], 2) as cluster:
    training.resume(Path(sys.argv[1]), cluster=cluster)
"""


@pytest.fixture(autouse=True)
def _short_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)


def undisturbed_training(updates: int, folder: Path) -> tuple[FeedforwardConfiguration, Path]:
    """Train for a number of updates in one process, without kills."""
    configuration = replace(SMALL, steps=updates * SMALL.steps_per_update)
    train(configuration, folder / "undisturbed")
    return configuration, folder / "undisturbed"


def first_worker(cluster: Cluster) -> int:
    return cluster.starmap(process_and_node, [(), ()])[0][0]


def test_workers_are_killed_in_the_middle_of_updates(tmp_path: Path) -> None:
    configuration, undisturbed = undisturbed_training(WORKERS_KILLED + 1, tmp_path)
    killed: list[int] = []
    with ray_nodes(1, 1) as nodes, connect_to_cluster(nodes.address, 2) as cluster:

        def kill(progress: TrainingProgress) -> None:
            if len(killed) < WORKERS_KILLED:
                killed.append(first_worker(cluster))
                after_s = 0.05 + 0.4 * (len(killed) * 0.618 % 1.0)
                threading.Timer(after_s, os.kill, (killed[-1], signal.SIGKILL)).start()

        train(configuration, tmp_path / "disturbed", kill, cluster=cluster)
    assert len(set(killed)) == WORKERS_KILLED
    assert_same_training(tmp_path / "disturbed", undisturbed)
    print(f"\n{WORKERS_KILLED} workers killed, the same weights")


def test_nodes_are_killed_in_the_middle_of_updates(tmp_path: Path) -> None:
    configuration, undisturbed = undisturbed_training(NODES_KILLED + 1, tmp_path)
    killed: list[Any] = []
    with ray_nodes(1, 1) as nodes, connect_to_cluster(nodes.address, 2) as cluster:

        def kill(progress: TrainingProgress) -> None:
            if len(killed) < NODES_KILLED:
                killed.append(next(iter(nodes.worker_nodes)))
                threading.Timer(0.2, kill_node, (killed[-1],)).start()
                nodes.worker_nodes.remove(killed[-1])
                add_node(nodes, 1)

        train(configuration, tmp_path / "disturbed", kill, cluster=cluster)
    assert len(killed) == NODES_KILLED
    assert_same_training(tmp_path / "disturbed", undisturbed)
    print(f"\n{NODES_KILLED} nodes killed, the same weights")


def test_the_command_is_killed_and_resumed(tmp_path: Path) -> None:
    configuration, undisturbed = undisturbed_training(COMMANDS_KILLED + 1, tmp_path)
    out = tmp_path / "disturbed"
    out.mkdir()
    (out / "configuration.json").write_bytes(msgspec.json.encode(asdict(configuration)))
    with ray_nodes(1, 1) as nodes:
        for number in range(COMMANDS_KILLED + 1):
            _resume(out, nodes.address, kill=number < COMMANDS_KILLED)
    assert_same_training(out, undisturbed)
    print(f"\n{COMMANDS_KILLED} commands killed, the same weights")


def _resume(out: Path, address: str, *, kill: bool) -> None:
    """Resume in another process. With ``kill``, kill it after the next checkpoint."""
    checkpoint = out / "checkpoint.pt"
    before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
    command = [sys.executable, "-c", COMMAND, out, address]
    with subprocess.Popen(command, preexec_fn=kill_with_parent) as process:
        while kill and process.poll() is None:
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns != before:
                time.sleep(0.3)
                process.kill()
            time.sleep(0.02)
    assert process.returncode == (-signal.SIGKILL if kill else 0)
