"""Tests of the task: it is registered, and it runs."""

from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.task_check import check_task


def test_environment_is_registered() -> None:
    assert "avrgym/TouchElbowJaco-v1" in ENVIRONMENTS


def test_episodes_run() -> None:
    check_task("TouchElbow")
