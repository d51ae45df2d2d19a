"""Fixtures for several test files."""

import atexit
import gc
import os
import resource
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np
import pytest

import avrgym  # noqa: F401  before MuJoCo, whose rendering backend it selects
from avrgym.tasks.constants import PAPER_ENVIRONMENTS

pytest.register_assert_rewrite("helpers")

gc.disable()  # while thousands of modules and tests are collected

os.environ["XDG_DATA_HOME"] = tempfile.mkdtemp(prefix="avrgym-data-")
atexit.register(shutil.rmtree, os.environ["XDG_DATA_HOME"], ignore_errors=True)

if TYPE_CHECKING:
    from avrgym.models.scene import SceneConfig


LONG = (
    "test_session.py",
    "test_every_environment.py",
    "test_live_server.py",
    "test_mixed_session.py",
    "test_figures_of_policies.py",
    "test_study_merge.py",
    "test_study_store.py",
    "test_analysis_bad_input.py",
    "test_webxr.py",
    "test_starts.py",
)
"""The longest files run first, to balance the processes."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all except ``fast_cases`` cases as slow, and run long files first.

    Of the cases of other environments than the paper's, all except one are slow.
    """
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        cases[item.nodeid.partition("[")[0]].append(item)
    for name, group in cases.items():
        if marker := group[0].get_closest_marker("fast_cases"):
            fast = set(np.linspace(0, len(group) - 1, marker.args[0]).round().astype(int).tolist())
            slow = [item for number, item in enumerate(group) if number not in fast]
        else:
            slow = [item for item in group if _environments(item) - {*PAPER_ENVIRONMENTS}]
            if slow:
                del slow[crc32(name.encode()) % len(slow)]
        for item in slow:
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


def _environments(item: pytest.Item) -> set[str]:
    """Environment ids among the parameters of a test case."""
    case = getattr(item, "callspec", None)
    parameters = () if case is None else case.params.values()
    return {each for each in parameters if isinstance(each, str) and each.startswith("avrgym/")}


def pytest_collection_finish() -> None:
    """Exclude loaded modules from garbage collection, and collect garbage less often."""
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)
    gc.enable()


@pytest.fixture
def rng() -> np.random.Generator:
    """A random generator with a fixed seed."""
    return np.random.default_rng(20261121)


@pytest.fixture(scope="module")
def relaxed_limits() -> Iterator[None]:
    """Relax the time limits of trials for tests in real time."""
    from helpers.vr.time_limits import RELAXED_LIMITS, set_limits

    with pytest.MonkeyPatch.context() as patch:
        set_limits(RELAXED_LIMITS, patch)
        yield


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Run PyTorch in one thread for reproducible sums."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def feeding_scene() -> "SceneConfig":
    """The scene of Feeding with the Jaco."""
    from avrgym.robots.jaco.robot import JACO
    from avrgym.tasks.registry import TASKS

    return TASKS["Feeding"].make_scene(JACO)


@pytest.fixture(scope="session")
def postgresql() -> Iterator[Path]:
    """The socket folder of a running PostgreSQL server."""
    from helpers.studies.small_studies import postgresql_programs, postgresql_server

    programs = postgresql_programs()
    if programs is None:
        pytest.skip("PostgreSQL's server is not installed (Debian: postgresql), only SQLite is tested")
    with postgresql_server(programs) as server:
        yield server


@pytest.fixture
def small_files() -> Iterator[Callable[[int], None]]:
    """Return a function that limits the file size, as on a full disk; 0 removes the limit."""
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size: int) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size or unlimited[0], unlimited[1]))

    yield limit
    limit(0)
