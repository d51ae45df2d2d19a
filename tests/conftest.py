"""What several test files share."""

import resource
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

import avrgym  # noqa: F401  before any test imports MuJoCo: it chooses how that draws

pytest.register_assert_rewrite("killing")

if TYPE_CHECKING:
    from avrgym.models.scene import Stage


@pytest.fixture
def rng() -> np.random.Generator:
    """A random stream of the test's own."""
    return np.random.default_rng(20261121)


@pytest.fixture(scope="session")
def feeding_stage() -> "Stage":
    """What stands in the scene when the Jaco feeds."""
    from avrgym.models.robots import JACO
    from avrgym.tasks import TASKS

    return TASKS["Feeding"].stage(JACO)


@pytest.fixture
def small_files() -> Iterator[Callable[[int], None]]:
    """Sets the size at which files stop growing, as on a full disk; 0 for no limit."""
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size: int) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size or unlimited[0], unlimited[1]))

    yield limit
    limit(0)
