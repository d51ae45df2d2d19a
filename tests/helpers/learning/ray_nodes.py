"""A Ray cluster with several nodes on this machine."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from helpers.system.paths import TESTS
from helpers.system.processes import free_port

os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112  as Ray spells it

_PORTS = (
    "metrics_agent_port",
    "runtime_env_agent_port",
    "dashboard_agent_listen_port",
    "metrics_export_port",
)


def add_node(nodes: Any, cores: int) -> Any:
    """Add a node with free ports."""
    return nodes.add_node(num_cpus=cores, include_dashboard=False, **{name: free_port() for name in _PORTS})


@contextmanager
def ray_nodes(*cores: int) -> Iterator[Any]:
    """Run a cluster: a head node without cores, and one node for each entry of ``cores``."""
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    os.environ["PYTHONPATH"] = str(TESTS)  # workers import test functions
    nodes = Cluster()
    try:
        add_node(nodes, 0)
        for count in cores:
            add_node(nodes, count)
        yield nodes
    finally:
        nodes.shutdown()


def kill_node(node: Any) -> None:
    """Kill all processes of a node."""
    node.kill_raylet(check_alive=False)


def kill_node_named(nodes: Any, name: str) -> None:
    """Kill the node with this id."""
    node = next(each for each in nodes.worker_nodes if each.node_id == name)
    kill_node(node)
    nodes.worker_nodes.remove(node)


def assert_same_training(out: Path, expected: Path) -> None:
    """Assert that the checkpoints of two trainings are bit-identical."""
    import torch

    one, other = (torch.load(folder / "checkpoint.pt", weights_only=True) for folder in (out, expected))
    assert one["steps"] == other["steps"]
    for part in ("policy", "observations", "returns"):
        for name, value in one[part].items():
            assert np.array_equal(np.asarray(value), np.asarray(other[part][name])), name


def process_and_node() -> tuple[int, str]:
    """Return the process and the node of a call."""
    import ray

    return os.getpid(), ray.get_runtime_context().get_node_id()


def raise_error(number: int) -> None:
    """Raise ``ValueError``."""
    raise ValueError(f"{number} is refused")
